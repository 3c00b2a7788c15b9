"""Rows of acceptance tables, JSON lines, and runs of the command line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ddic.io.source_tree import source_commit

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "bench" / "data"
RESULTS = ROOT / "bench" / "results"
TIMEOUT = "900"


@dataclass(frozen=True)
class Row:
    """One line of an acceptance table: the check, its bound, what was measured, whether it holds."""

    check: str
    bound: str
    measured: str
    holds: bool


def append_result(name: str, record: dict[str, Any]) -> None:
    """Append a JSON line to bench/results/NAME.jsonl."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    stamped = {"commit": source_commit(), "date": datetime.now(UTC).isoformat(timespec="seconds"), **record}
    with (RESULTS / f"{name}.jsonl").open("a", encoding="utf-8") as file:
        file.write(json.dumps(stamped) + "\n")


def mpirun(n_ranks: int, *command: str) -> str:
    """Run a command on some ranks with an outer time limit; returns its standard output."""
    launcher = os.environ.get("MPIEXEC", "mpiexec")
    done = subprocess.run(["timeout", TIMEOUT, launcher, "-n", str(n_ranks), *command], cwd=ROOT, text=True,
                          capture_output=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} on {n_ranks} ranks ended with {done.returncode}:\n"
                           f"{done.stdout[-2000:]}{done.stderr[-4000:]}")
    return done.stdout


def ddic_run(case: str, folder: Path, n_ranks: int, name: str = "result") -> dict[str, Any]:
    """Run a case text through the command line; returns the summary. The result is folder/NAME.vtkhdf."""
    folder.mkdir(parents=True, exist_ok=True)
    case_file = folder / f"{name}.toml"
    case_file.write_text(f'{case}\n[output]\nfile = "{name}.vtkhdf"\n', encoding="utf-8")
    mpirun(n_ranks, str(Path(sys.executable).with_name("ddic")), "run", str(case_file))
    summary: dict[str, Any] = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    return summary


def ddic(*arguments: str) -> None:
    """Run the command line on one rank."""
    subprocess.run([str(Path(sys.executable).with_name("ddic")), *arguments], check=True, stdout=subprocess.DEVNULL)


def images(*arguments: str, folder: Path) -> Path:
    """Make an image pair with ``ddic synth`` unless the same one is there already; returns its folder."""
    stamp = folder / "arguments.json"
    wanted = json.dumps([*arguments, source_version()])
    if not stamp.is_file() or stamp.read_text(encoding="utf-8") != wanted:
        folder.mkdir(parents=True, exist_ok=True)
        ddic("synth", *arguments, "--output", str(folder))
        stamp.write_text(wanted, encoding="utf-8")
    return folder


def source_version() -> str:
    """Changes with the generator's source, so that images are never those of an older one."""
    import hashlib

    digest = hashlib.sha256()
    for path in sorted((ROOT / "src" / "ddic" / "synth").glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def real_data() -> Path:
    """The folder of real images; raises RuntimeError where DDIC_REAL_DATA names none."""
    folder = os.environ.get("DDIC_REAL_DATA")
    if not folder or not Path(folder).is_dir():
        raise RuntimeError("set DDIC_REAL_DATA to the folder of real images")
    return Path(folder).resolve()


def accept(table: str, names: Sequence[str], checks: Iterable[str], measured: Callable[[str], Sequence[Row]],
           runs: str | None = None) -> int:
    """Measure the named checks (all where none is named) of ``make accept-TABLE``, print and keep their rows.

    runs: result file that the checks write, begun afresh. A check that cannot be measured is a row that does not
    hold. Returns the exit code: 1 where a bound is missed, 2 where there is no such check.
    """
    known = list(checks)
    unknown = sorted(set(names) - set(known))
    if unknown:
        print(f"no such check: {', '.join(unknown)}; there are: {', '.join(known)}", file=sys.stderr)
        return 2
    if runs is not None:
        (RESULTS / f"{runs}.jsonl").unlink(missing_ok=True)
    held = True
    for name in names or known:
        try:
            rows = measured(name)
        except (RuntimeError, OSError, ImportError) as error:
            rows = [Row(name, "measured", f"could not be measured: {error}", False)]
        for row in rows:
            append_result(f"accept_{table}", {"name": name, **asdict(row)})
            held &= row.holds
            print(f"{'holds' if row.holds else 'FAILS'}  {row.check}\n       bound     {row.bound}\n"
                  f"       measured  {row.measured}\n       command   make accept-{table} CHECK={name}", flush=True)
    print("every bound holds" if held else "some bounds do not hold")
    return 0 if held else 1


def main(name: str, measure: Callable[[], Sequence[Row]]) -> None:
    """Measure, print the rows, append them to bench/results, and exit with 1 where a bound is missed."""
    rows = measure()
    for row in rows:
        append_result(name, asdict(row))
        print(f"{'holds ' if row.holds else 'FAILS '} {row.check}\n        bound: {row.bound}\n        measured: "
              f"{row.measured}", flush=True)
    sys.exit(0 if all(row.holds for row in rows) else 1)
