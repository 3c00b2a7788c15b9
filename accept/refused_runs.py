"""What stays and what is said where a run fails over an older result, takes two case files, or a mistyped option."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import ddic_command, environment, images

OPTION = "-dual_kps_rtol"
"""For -dual_ksp_rtol."""

SHOWN = 160
"""Characters of what was said that a row shows."""

_GOOD = ('[images]\nreference = "images/reference.tif"\ndeformed = "images/deformed.tif"\n'
         "[mesh.structured]\nregion = [20, 20, 220, 220]\nelement_size = 20\n"
         '[solver]\nmethod = "dual"\nsubdomains = 4\n')
"""Solved by the method whose option is mistyped: another one has no use for it, spelt right or not."""

_FAILS = _GOOD + "[gauss_newton]\nmax_iterations = 1\n[start]\nrigid = false\npyramid = false\nindependent = false\n"


def measure_refused_runs(scale: Scale) -> list[Row]:
    """Run ``ddic run`` as a user does who mistypes, or whose images do not match.

    Parameters
    ----------
    scale : Scale
        A smoke run does the same: the pair is small.

    Returns
    -------
    list of Row
        One for each case of the table.
    """
    folder = scale.folder("refused_runs")
    images("translation", "--vector", "1.3", "-0.7", "--size", "240x240", "--seed", "3", folder=folder / "images")
    for left in (*folder.glob("result*"), *folder.glob("other*")):
        left.unlink()
    return [_fail_over_older_result(folder), _name_two_cases(folder), _mistype_an_option(folder)]


def _run(folder: Path, case: str, *arguments: str) -> tuple[int, str]:
    """Exit code, and all that is printed."""
    (folder / "case.toml").write_text(f'{case}[output]\nfile = "result.vtkhdf"\n', encoding="utf-8")
    done = subprocess.run([ddic_command(), "run", "case.toml", *arguments], cwd=folder, env=environment(), text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
    return done.returncode, done.stdout


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.glob("result*"))


def _converged(folder: Path, name: str) -> object:
    path = folder / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8"))["converged"] if path.is_file() else None


def _fail_over_older_result(folder: Path) -> Row:
    good, _ = _run(folder, _GOOD)
    failed, printed = _run(folder, _FAILS)
    names = _names(folder)
    states = {name: _converged(folder, name) for name in ("result", "result.earlier", "result.not_converged")}
    last = printed.strip().splitlines()[-1]
    as_said = {"result": None, "result.earlier": True, "result.not_converged": False}
    held = (good, failed) == (0, 1) and "result.vtkhdf" not in names and states == as_said and "not_converged" in last
    return Row("a run that does not converge, over an older result",
               "exit code 1; the older result is called earlier; the last field is marked; its name is said",
               f"exit codes {good}, {failed}; converged: {states}; {len(names)} files; "
               f"{'the line names the last field' if 'not_converged' in last else last[:SHOWN]}", held)


def _name_two_cases(folder: Path) -> Row:
    (folder / "other.toml").write_text(_GOOD, encoding="utf-8")
    before = {path: path.stat().st_mtime_ns for path in folder.glob("result*")}
    code, printed = _run(folder, _GOOD, "other.toml")
    untouched = before == {path: path.stat().st_mtime_ns for path in folder.glob("result*")}
    said = printed.strip().splitlines()
    return Row("ddic run case.toml other.toml", "exit code 2, one line that names the second, nothing written",
               f"exit code {code}; {'nothing' if untouched else 'something'} written; {len(said)} line: "
               f"{' '.join(said)[:SHOWN]}", code == 2 and untouched and len(said) == 1 and "other.toml" in said[0])


def _mistype_an_option(folder: Path) -> Row:
    code, printed = _run(folder, _GOOD, OPTION, "1e-3")
    said = [line for line in printed.splitlines() if OPTION in line]
    right, silent = _run(folder, _GOOD, OPTION.replace("kps", "ksp"), "1e-3")
    n_false = sum("never asked for" in line for line in silent.splitlines())
    return Row(f"ddic run case.toml {OPTION} 1e-3", "one warning that names it; none where it is spelt right",
               f"exit code {code}, {len(said)} line: {' '.join(said)[:SHOWN]}; spelt right: exit code {right}, "
               f"{n_false} warnings", len(said) == 1 and n_false == 0 and (code, right) == (0, 0))
