"""A user's environment: how large it is, what weighs in it, and that the demo needs no more."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Iterable, Mapping
from dataclasses import replace
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from accept.demo_pairs import MOST_FLOORS, number_after
from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import ROOT, environment

MOST_GB = 0.6

OF_DEVELOPERS = frozenset({"mkdocs", "mypy", "pytest", "pyvista", "ruff", "sphinx", "vtk"})
"""Packages that no user needs."""

N_SHOWN = 6
"""Heaviest packages that a row names."""


def measure_environment(scale: Scale) -> list[Row]:
    """Install a fresh clone as a user does, weigh its environment and run the demo in it; tiny: weigh what is here."""
    if scale.smoke:
        weights = weigh_needs(find_installed(Path(sysconfig.get_path("purelib"))))
        return [_judge_size("packages that ddic needs, in this environment", sum(weights.values()), weights, weights)]
    with tempfile.TemporaryDirectory() as outer:
        clone = Path(outer) / "ddic"
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
        begin = time.perf_counter()
        _make("install", clone)
        seconds = time.perf_counter() - begin
        counted = subprocess.run(["du", "-sb", ".venv"], cwd=clone, check=True, text=True, capture_output=True).stdout
        installed = find_installed(next((clone / ".venv" / "lib").glob("python*/site-packages")))
        size = _judge_size("make install in a fresh clone: du -sb .venv", int(counted.split()[0]), installed,
                           weigh_needs(installed))
        return [replace(size, measured=f"{size.measured}; {seconds:.0f} s"), _judge_demo(_make("demo", clone))]


def find_installed(folder: Path) -> dict[str, metadata.Distribution]:
    """Find the packages in a folder ``site-packages``, by name."""
    return {canonicalize_name(found.name): found for found in metadata.distributions(path=[str(folder)])}


def weigh_needs(installed: Mapping[str, metadata.Distribution]) -> dict[str, int]:
    """Weigh ddic and every package that it needs, of those that are installed.

    Parameters
    ----------
    installed : mapping
        Packages by name.

    Returns
    -------
    dict
        Bytes by name, the heaviest first, compiled modules of Python left out.
    """
    asked, weights = ["ddic"], {}
    while asked:
        name = canonicalize_name(asked.pop())
        if name in weights or name not in installed:
            continue
        files = [Path(str(file.locate())) for file in installed[name].files or () if file.suffix != ".pyc"]
        weights[name] = sum(file.stat().st_size for file in files if file.is_file())
        needs = [Requirement(line) for line in installed[name].requires or ()]
        asked += [need.name for need in needs if need.marker is None or need.marker.evaluate({"extra": ""})]
    return dict(sorted(weights.items(), key=lambda weight: -weight[1]))


def _judge_size(what: str, size: int, names: Iterable[str], weights: Mapping[str, int]) -> Row:
    needless = sorted(OF_DEVELOPERS.intersection(names))
    heaviest = ", ".join(f"{name} {weights[name] / 1e6:.0f}" for name in list(weights)[:N_SHOWN])
    return Row(what, f"<= {MOST_GB} GB, none of {', '.join(sorted(OF_DEVELOPERS))}",
               f"{size / 1e9:.3f} GB; {', '.join(needless) or 'none of them'}; of it in MB: {heaviest}",
               size <= MOST_GB * 1e9 and not needless)


def _judge_demo(printed: str) -> Row:
    rms = number_after(r"known field: ([\d.]+) px", printed)
    floor = number_after(r"in both images: ([\d.]+) px", printed)
    return Row("make demo there: RMS error against the known field", f"<= {MOST_FLOORS} noise floors",
               f"{rms:.5f} px = {rms / floor:.2f} x {floor:.5f} px", rms <= MOST_FLOORS * floor)


def _make(target: str, folder: Path) -> str:
    """What a target prints, made in processes that know nothing of this one's environment."""
    here = Path(sys.executable).parent
    outside = [place for place in os.environ["PATH"].split(os.pathsep) if Path(place) != here]
    changes = {"PATH": os.pathsep.join(outside), "PYTHONPATH": "", "VIRTUAL_ENV": "", "MAKEFLAGS": ""}
    done = subprocess.run(["make", target], cwd=folder, text=True, capture_output=True, env=environment(changes),
                          check=False)
    if done.returncode != 0:
        raise RuntimeError(f"make {target} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    return done.stdout
