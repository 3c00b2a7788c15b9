"""Fields of small cases against those recorded before a restructuring, and by defaults against those of a later commit.

Usage: python -m accept.recorded [--source SRC] [--defaults] [CASE ...] records all cases, or the named ones, anew with
the package in the folder SRC, by default that of the commit whose fields they are. ``make accept-house CHECK=recorded``
compares.
"""

from __future__ import annotations

import argparse
import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accept.recorded_cases import CASES, DEFAULTS_OF, RecordedCase
from accept.support.settings import describe_settings
from accept.table import Scale
from bench.support.before import checkout_before
from bench.support.rows import Row
from bench.support.runs import ddic, ddic_command, mpirun
from ddic.io.result_reader import read_result

RECORDED = Path(__file__).parent / "recorded"
"""A compressed file a case and way: an array for each run, and the images' digests."""

DIGESTS = "digests"
"""Key of the digests in a recorded file."""

SMOKE = ("grey",)
"""Cases of a smoke run, on one rank."""

Fields = Mapping[str, NDArray[np.float64]]
"""Displacement of each run's nodes by global node number, (n_nodes, 2), pixels; and motions of near set-ups."""


@dataclass(frozen=True)
class Source:
    """A package to measure with.

    Attributes
    ----------
    folder : Path, optional
        Folder that holds the package; None for the one that this process imports.
    """

    folder: Path | None = None

    @property
    def environment(self) -> dict[str, str]:
        """Variables of the processes that measure with it."""
        return {} if self.folder is None else {"PYTHONPATH": str(self.folder)}


def make_inputs(case: RecordedCase, folder: Path) -> list[str]:
    """Make the images of a case and what else it reads."""
    for name, arguments in case.synth:
        (folder / name).mkdir(parents=True, exist_ok=True)
        ddic("synth", *arguments.split(), "--output", str(folder / name))
    if case.prepare is not None:
        case.prepare(folder)
    # Grey levels, not files: a header may hold a date.
    return [f"{path.relative_to(folder)} {_digest(path)}" for path in sorted(folder.rglob("*.tif"))]


def _digest(path: Path) -> str:
    import tifffile

    return hashlib.sha256(np.ascontiguousarray(tifffile.imread(path)).tobytes()).hexdigest()[:16]


def use_all_pixels(text: str) -> str:
    """Let all pixels count as they are, and edges follow them alone, as the code before did: it knew nothing else."""
    keys = 'spoilt_pixels = "keep"\n' + ("" if "grey_correction" in text else 'grey_correction = "none"\n')
    text = text.replace("[regularization]\n", "[regularization]\nedge_wavelength = 0\n")
    if "[correlation]\n" in text:
        return text.replace("[correlation]\n", f"[correlation]\n{keys}")
    return f"{text}\n[correlation]\n{keys}"


@dataclass(frozen=True)
class Way:
    """How the cases are measured.

    Attributes
    ----------
    edit : callable
        Makes the present code's case file of a run's text; the code before takes that as it is.
    ending : str
        Of the recorded files.
    choose_commit : callable
        Whose fields are recorded of a case.
    """

    edit: Callable[[str], str]
    ending: str
    choose_commit: Callable[[RecordedCase], str]

    def path(self, case: RecordedCase) -> Path:
        """Give the recorded file of a case."""
        return RECORDED / f"{case.name}{self.ending}"


ALL_PIXELS = Way(use_all_pixels, ".npz", lambda case: case.commit)
BY_DEFAULT = Way(lambda text: text, ".defaults.npz", lambda case: DEFAULTS_OF)


def measure_fields(case: RecordedCase, folder: Path, n_ranks: int, source: Source,
                   way: Way) -> dict[str, NDArray[np.float64]]:
    """Run a case through the command line, but for runs that are not for this number of ranks; as ``Fields`` says."""
    found = {}
    for run in case.runs:
        if n_ranks not in run.ranks:
            continue
        output = f'\n[output]\nfile = "{run.name}.vtkhdf"\nresidual_image = false\n'
        text = run.text if source.folder is not None else way.edit(run.text)
        (folder / f"{run.name}.toml").write_text(text + output, encoding="utf-8")
        mpirun(n_ranks, ddic_command(), "run", str(folder / f"{run.name}.toml"), changes=source.environment)
        result = read_result(folder / f"{run.name}.vtkhdf")
        found[run.name] = result.displacement
        for number in range(1, run.text.count("[[near]]") + 1):
            motion = result.attributes[f"near_{number}"]
            found[f"{run.name} near_{number}"] = np.array([*motion["alpha_px"], float(motion["theta_rad"])])
    return found


def record_case(case: RecordedCase, folder: Path, source: Source, way: Way) -> None:
    """Record the fields of a case on one rank in ``accept/recorded``.

    Parameters
    ----------
    case : RecordedCase
        The case.
    folder : Path
        Where its files go.
    source : Source
        The package to measure with.
    way : Way
        With all pixels as they are, or by defaults.
    """
    digests = make_inputs(case, folder)
    fields = measure_fields(case, folder, 1, source, way)
    RECORDED.mkdir(exist_ok=True)
    np.savez_compressed(way.path(case), **{DIGESTS: np.array(digests)}, **fields)


def recorded_fields(case: RecordedCase, folder: Path, digests: Sequence[str], way: Way) -> tuple[Fields, str]:
    """Read the recorded fields of a case.

    Where its images are not those of then, rendered on another machine perhaps, the code before measures them anew.

    Parameters
    ----------
    case : RecordedCase
        The case, whose inputs are there.
    folder : Path
        Where its files are.
    digests : sequence of str
        Of its images.
    way : Way
        With all pixels as they are, or by defaults.

    Returns
    -------
    fields : Fields
        The fields before.
    origin : str
        Where they come from.
    """
    with np.load(way.path(case)) as file:
        if file[DIGESTS].tolist() == list(digests):
            return {name: file[name] for name in file.files if name != DIGESTS}, "recorded"
    before = Source(checkout_before(way.choose_commit(case)) / "src")
    return measure_fields(case, folder, 1, before, way), "measured now by the code before"


def compare_case(case: RecordedCase, scale: Scale, way: Way) -> Row:
    """Measure a case with the present code and compare its fields with those before.

    Parameters
    ----------
    case : RecordedCase
        The case.
    scale : Scale
        A smoke run measures on one rank.
    way : Way
        With all pixels as they are, or by defaults.

    Returns
    -------
    Row
        Largest difference, over ranks, in each run.
    """
    folder = scale.folder("recorded") / case.name
    digests = make_inputs(case, folder)
    before, origin = recorded_fields(case, folder, digests, way)
    ranks = sorted({n for run in case.runs for n in run.ranks})[: 1 if scale.smoke else None]
    largest: dict[str, float] = {}
    for n_ranks in ranks:
        for name, field in measure_fields(case, folder, n_ranks, Source(), way).items():
            difference = _largest_difference(field, before[name])
            largest[name] = max(largest.get(name, 0.0), difference)
    bounds = {run.name: run.bound for run in case.runs}
    settings = "; ".join(f"{run.name}: {describe_settings(way.edit(run.text))}" for run in case.runs)
    return Row(f"{case.name}: {case.what}; {' and '.join(map(str, ranks))} rank{'s' * (len(ranks) > 1)} against the "
               f"field of {way.choose_commit(case)} {origin}; {settings}",
               "largest difference " + _listed(bounds), _listed(largest),
               all(value <= bounds[name.split()[0]] for name, value in largest.items()))


def _largest_difference(field: NDArray[np.float64], before: NDArray[np.float64]) -> float:
    """Largest difference of a component, infinite where nodes are others."""
    return float(np.abs(field - before).max()) if field.shape == before.shape else float("inf")


def _listed(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.1e} px" for name, value in values.items())


def recorded(scale: Scale) -> list[Row]:
    """Compare all recorded cases, with all pixels as they are and by defaults, a row each."""
    rows = []
    for name in SMOKE if scale.smoke else CASES:
        for way in (ALL_PIXELS, BY_DEFAULT):
            try:
                rows.append(compare_case(CASES[name], scale, way))
            except Exception as error:
                if scale.smoke:
                    raise
                rows.append(Row(f"{name}: {CASES[name].what}", "measured", f"could not be measured: {error}", False))
    return rows


def main() -> None:
    """Record the cases that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="CASE", help=", ".join(CASES))
    parser.add_argument("--source", type=Path, help="folder that holds the package ddic to record with")
    parser.add_argument("--defaults", action="store_true", help="record what defaults give")
    chosen = parser.parse_args()
    way = BY_DEFAULT if chosen.defaults else ALL_PIXELS
    for case in (CASES[name] for name in chosen.names or CASES):
        folder = chosen.source or checkout_before(way.choose_commit(case)) / "src"
        record_case(case, Scale().folder("recorded") / case.name, Source(Path(os.path.abspath(folder))), way)
        print(f"{way.path(case).name}: {way.path(case).stat().st_size / 1024:.0f} kB", flush=True)


if __name__ == "__main__":
    main()
