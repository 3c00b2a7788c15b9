"""All inputs of a case validated without solving, in one order, near-field images too, and for the ranks at hand."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ddic.case.loader import LoadedCase, list_unused_keys, load_case_leniently
from ddic.case.methods import find_method
from ddic.case.named_files import list_cameras, list_named_files
from ddic.case.own_outputs import check_output
from ddic.check.images import check_decodable, check_images
from ddic.check.mesh import CheckReport, check_most_ranks
from ddic.errors import InputError, Problems
from ddic.images.source import ImageSource
from ddic.inputs.inputs import StartPoints, check_start_points, load_start_points
from ddic.io.input_file import FileStamps
from ddic.io.result_reader import require_known_displacement
from ddic.io.series_reader import read_frame_or_last


def load_checked_case(path: Path, n_ranks: int, output: Path | None = None) -> LoadedCase:
    """Load a case file and check everything that it names, free of communication.

    ``output`` is the result file, None for the one that the case names. Raises InputError with all problems, one line
    each.
    """
    loaded, of_keys = _load_readable_keys(path)
    if output is not None:
        loaded = loaded.with_output(output)
    # Before they are checked: what changes afterwards was not.
    stamps = FileStamps.take(list_named_files(loaded.case, path.parent))
    check_case(loaded, n_ranks, of_keys)
    return replace(loaded, stamps=stamps)


def check_case_file(path: Path) -> CheckReport:
    """Check a case file and everything that it names. Raises InputError with all problems, one line each."""
    loaded, of_keys = _load_readable_keys(path)
    report = check_case(loaded, None, of_keys)
    problems = Problems()
    for section in list_cameras(loaded.case):
        check_decodable(section, problems)
    problems.require_none()
    return report


def _load_readable_keys(path: Path) -> tuple[LoadedCase, list[str]]:
    """The case as far as it can be read, and what is wrong with its keys; raises InputError where that leaves none."""
    loaded, of_keys = load_case_leniently(path)
    if loaded is None:
        raise InputError(of_keys)
    return loaded, of_keys


def check_case(loaded: LoadedCase, n_ranks: int | None = None, of_keys: Sequence[str] = ()) -> CheckReport:
    """Check everything that a case names, and whether it can run, free of communication.

    ``of_keys`` is what was found wrong before. Without ``n_ranks`` it is told of what would fail on any number of
    ranks. Raises InputError with all problems, one line each.
    """
    case, problems = loaded.case, Problems()
    for line in list_unused_keys(case):
        warnings.warn(f"{loaded.path}: {line}", UserWarning, stacklevel=2)
    reference, *_ = [check_images(section, problems) for section in list_cameras(case)]
    with problems.gathered(loaded.path):
        check_output(loaded)
    with problems.gathered():
        if case.start.from_result is not None:
            require_known_displacement(read_frame_or_last(case.start.from_result, case.start.frame, "start.frame =")[0])
    points = _check_start_points(loaded, reference, problems)
    report: CheckReport | None = find_method(case).check(loaded, reference, points, problems)
    with problems.gathered():
        check_ranks(loaded, 1 if n_ranks is None else n_ranks)
    if report is None or problems.lines or of_keys:
        raise InputError([*of_keys, *problems.lines])
    if n_ranks is not None:
        check_most_ranks(loaded, report.most_ranks, n_ranks)
    return report


def _check_start_points(loaded: LoadedCase, reference: ImageSource | None, problems: Problems) -> StartPoints | None:
    """The points that the case starts from; None where there are none, or they are wrong."""
    # A table of points is named by what is said of it.
    with problems.gathered(None if loaded.case.start.points is None else loaded.path):
        points = load_start_points(loaded.case.start)
        if points is not None and reference is not None:
            check_start_points(points, reference.width, reference.height)
        return points
    return None


def check_ranks(loaded: LoadedCase, n_ranks: int) -> None:
    """Refuse, with an InputError, a number of ranks on which the case's method cannot measure it."""
    find_method(loaded.case).check_ranks(loaded, n_ranks)
