"""The files that a case names: what it reads; its deformed images, one or a series, in order and with their times."""

import os
import re
from collections.abc import Iterator, Mapping
from glob import glob
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel

from ddic.case.methods import find_method_section
from ddic.case.schema import CameraSection, Case, OutputSection, find_section_in
from ddic.errors import InputError
from ddic.io.input_file import DATASET, find_real_path, split_dataset, split_numbers

PATTERN = re.compile(r"[*?\[]")
"""What makes a path a pattern."""


def list_named_files(data: Any, folder: Path, section: type[BaseModel] = Case) -> Iterator[Path]:
    """List the files that a case names and no run replaces: all but its output, in the order of the schema.

    ``data`` is a case, or what a case file holds, wherever else it is wrong, whose paths are relative to ``folder``.
    """
    if isinstance(data, list | tuple):
        for item in data:
            yield from list_named_files(item, folder, section)
    if not isinstance(data, BaseModel | Mapping):
        return
    for key, value in dict(data).items():
        field = section.model_fields.get(key)
        inner = None if field is None else find_section_in(field.annotation)
        if inner is not None and inner is not OutputSection:
            yield from list_named_files(value, folder, inner)
        elif field is not None and _takes_path(field.annotation):
            items = value if isinstance(value, list | tuple) else [value]
            yield from (item if isinstance(item, Path) else find_real_path(folder / item)
                        for item in items if isinstance(item, str | Path))


def _takes_path(annotation: Any) -> bool:
    return annotation is Path or any(_takes_path(inner) for inner in get_args(annotation))


def is_series(case: Case) -> bool:
    """Tell whether a case from ``find_frames`` names several deformed images, measured in turn, be it a list of one."""
    return isinstance(case.imaging.deformed, tuple)


def list_cameras(case: Case) -> list[CameraSection]:
    """List what a case says of each camera's images, the far camera first."""
    return [case.imaging, *case.near]


def list_deformed(section: CameraSection) -> tuple[Path, ...]:
    """List the deformed images of a camera of a case from ``find_frames``, as they are measured: one if no series."""
    return section.deformed if isinstance(section.deformed, tuple) else (section.deformed,)


def list_times(case: Case) -> tuple[float, ...]:
    """List the times of the deformed images of a case from ``find_frames``, in units chosen by the user.

    Without any it is the number of each image after the reference's time.
    """
    images = case.imaging
    if isinstance(images.deformed_time, tuple):
        return images.deformed_time
    if not is_series(case):
        return (images.deformed_time,)
    step = 1.0 if images.frame_interval is None else images.frame_interval
    return tuple(images.reference_time + step * (k + 1) for k in range(len(list_deformed(images))))


def find_frames(case: Case, file: Path) -> Case:
    """Put the files that exist in the place of patterns, and check that a series makes sense.

    The case has absolute paths; with a series it comes back with a tuple of images. ``file`` is the case file, for
    messages. Raises InputError with one line a problem.
    """
    images, problems = _expand(case.imaging, case.imaging_name, file)
    near = []
    for number, section in enumerate(case.near, start=1):
        expanded, of_section = _expand(section, f"near, entry {number}", file)
        near.append(expanded)
        problems += of_section
    expanded_case = case.model_copy(update={case.imaging_name: images, "near": tuple(near)})
    if not problems:
        problems = [f"{file}: {line}" for line in _list_contradictions(expanded_case)]
    if problems:
        raise InputError(problems)
    # A copy is said to give every key that it changes.
    return expanded_case if near else case.model_copy(update={case.imaging_name: images})


def _expand(section: CameraSection, name: str, file: Path) -> tuple[CameraSection, list[str]]:
    """A section with files in place of patterns, and what is wrong."""
    given = section.deformed
    if isinstance(given, Path) and not is_pattern(given):
        return section, []
    found: list[Path] = []
    problems = []
    for path in given if isinstance(given, tuple) else (given,):
        # In the order in which people number them: 2 before 10.
        matches = find_matches(path) if is_pattern(path) else [path]
        found += matches
        if not matches:
            problems.append(f"{file}: {name}: deformed = \"{path}\": no file matches this pattern; check the folder")
    return section.model_copy(update={"deformed": tuple(found)}), problems


def is_pattern(path: Path) -> bool:
    """Tell whether an absolute path stands for all files that match it: not where a file is called so."""
    file, _ = split_dataset(path)
    return PATTERN.search(str(file)) is not None and not os.path.exists(file)


def find_matches(pattern: Path) -> list[Path]:
    """Find what matches a pattern, in the order of the numbers in names; an array in each file where it names one."""
    file, name = split_dataset(pattern)
    found = [f"{match}{DATASET}{name}" if name else match for match in glob(str(file))]
    return sorted(map(Path, found), key=split_numbers)


def _list_contradictions(case: Case) -> Iterator[str]:
    """What does not go together in a case with or without a series, a line each."""
    yield from _list_wrong_forces(case)
    if not is_series(case):
        yield from _list_idle_keys(case)
        return
    images, name = case.imaging, case.imaging_name
    n_frames = len(list_deformed(images))
    for number, section in enumerate(case.near, start=1):
        n_near = len(list_deformed(section))
        if n_near != n_frames:
            yield (f"near, entry {number}: deformed: {n_near} images, but images.deformed has {n_frames}; give one of "
                   "each camera for every frame")
    times = images.deformed_time
    if isinstance(times, tuple):
        if len(times) != n_frames:
            yield f"{name}.deformed_time: {len(times)} times for {n_frames} images; give one of each"
        elif any(b <= a for a, b in pairwise(times)):
            yield f"{name}.deformed_time: times have to grow; put the images in order"
        if images.frame_interval is not None:
            yield f"{name}.frame_interval and a list in {name}.deformed_time: give one of them"
    elif "deformed_time" in images.model_fields_set:
        yield f"{name}.deformed_time: one time for {n_frames} images; give a list, or {name}.frame_interval"
    yield from _list_for_one_pair(case)
    if case.series.incremental != "never":
        yield from _list_refused_by_updates(case)
    yield from _list_refused_by_groups(case, n_frames)


def _list_wrong_forces(case: Case) -> Iterator[str]:
    """Forces that are not one for each image."""
    n_frames = len(list_deformed(case.imaging))
    for number, force in enumerate(() if case.identification is None else case.identification.force, start=1):
        n_values = len(force.value) if isinstance(force.value, tuple) else 1
        if n_values != n_frames:
            yield (f"identification.force, entry {number}: value: {n_values} for {n_frames} images; give one for each "
                   f"of {case.imaging_name}.deformed")


def _list_for_one_pair(case: Case) -> Iterator[str]:
    """What is done with one image alone."""
    method = find_method_section(case)
    if method is not None:
        yield f"images.deformed: [{method}] measures one pair at a time; give one image"
    if any(line.vertices is None for line in case.discontinuity):
        yield ("images.deformed: a line that is looked for needs one pair; find it on one image first, and give "
               "discontinuity.vertices")
    if case.output.independent_fields:
        yield "output.independent_fields: frames of a series start from the one before; leave it out, or give one image"


def _list_refused_by_groups(case: Case, n_frames: int) -> Iterator[str]:
    """What does not go with frames that groups of ranks measure."""
    n_groups = case.series.groups
    if n_groups > n_frames:
        yield f"series.groups: {n_groups} groups for {n_frames} images; ask for fewer"
    if n_groups > 1 and case.near:
        yield "series.groups: the first frame of all weights the cameras by its noise; leave groups or [[near]] out"


def _list_refused_by_updates(case: Case) -> Iterator[str]:
    """What does not go with later frames that take the place of the reference image."""
    refused = [
        (case.near, "goes with one camera; leave [[near]] out"),
        (case.discontinuity, "lines would have to move with the specimen; leave [[discontinuity]] out"),
        (case.regularization is not None and case.regularization.is_orthotropic,
         "axes of a composite would have to turn with it; leave regularization.young_ratio and shear_ratio out"),
        (case.output.uncertainty, "uncertainties would be of the last update; leave output.uncertainty out"),
        ("residual_image" in case.output.model_fields_set and case.output.residual_image,
         "pixels of the residual would be those of the last update; leave output.residual_image out"),
        ((case.imaging.reference_mask is not None or case.imaging.masked) and case.imaging.deformed_mask is None,
         "a later frame is masked by images.deformed_mask; give one beside images.reference_mask and images.masked"
         if case.dim == 2 else "masks of volumes do not move with the specimen; leave volumes.mask out"),
    ]
    for is_there, reason in refused:
        if is_there:
            yield f"series.incremental: {reason}"


def _list_idle_keys(case: Case) -> Iterator[str]:
    name = case.imaging_name
    if isinstance(case.imaging.deformed_time, tuple):
        yield f"{name}.deformed_time: a list goes with several {name}.deformed; give one number"
    if case.imaging.frame_interval is not None:
        yield f"{name}.frame_interval goes with several {name}.deformed; give {name}.deformed_time"
    if "series" in case.model_fields_set:
        yield f'[series] goes with several {name}.deformed: a list, or a pattern such as "frame_*.tif"'
    for number, section in enumerate(case.near, start=1):
        if isinstance(section.deformed, tuple):
            yield f"near, entry {number}: deformed: several images beside one images.deformed; give as many"


def choose_frame(case: Case, number: int) -> Case:
    """Give the case of one frame, numbered from 0, of a series, as ``find_frames`` gives it.

    It has one deformed image of each camera and its time, and no residual images, unless they are asked for.
    """
    if not is_series(case):
        return case
    images = case.imaging.model_copy(update={
        "deformed": list_deformed(case.imaging)[number], "deformed_time": list_times(case)[number],
        "frame_interval": None})
    near = tuple(section.model_copy(update={"deformed": list_deformed(section)[number]}) for section in case.near)
    changes: dict[str, object] = {case.imaging_name: images, "near": near}
    if "residual_image" not in case.output.model_fields_set:
        changes["output"] = case.output.model_copy(update={"residual_image": False})
    return case.model_copy(update=changes)
