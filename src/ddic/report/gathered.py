"""What a report is made of: a result, its summary and, where they are still there, its images."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from ddic.errors import InputError
from ddic.io import result_schema as schema
from ddic.io.image_file import ImageFile, open_image
from ddic.io.result_reader import Result

NOT_RECORDED = "not recorded"
"""In place of a value that the result does not hold."""

NOT_STATED = "not stated in the case"
"""In place of a value that only the user knows."""


@dataclass(frozen=True, eq=False)
class Gathered:
    """A result and what belongs to it.

    Attributes
    ----------
    result : Result
        What was measured.
    case : dict
        The validated case with all defaults; empty where it is not recorded.
    summary : dict
        Of the run; empty where its file is not beside the result.
    images : dict of ImageFile
        ``reference`` and ``deformed``, those of them that are still there.
    absent : tuple of str
        What could not be found, one sentence each.
    """

    result: Result
    case: Mapping[str, Any]
    summary: Mapping[str, Any]
    images: Mapping[str, ImageFile]
    absent: tuple[str, ...]

    def get_section(self, name: str) -> Mapping[str, Any]:
        """Get a section of the case, such as ``images``; empty where the case has none."""
        return self.case.get(name) or {}

    def get_attribute(self, group: str, name: str) -> Any:
        """Get an attribute of the result file; None where it is not recorded."""
        value: Any = self.result.attributes.get(group, {}).get(name)
        return value.item() if hasattr(value, "item") else value

    @cached_property
    def noise_floor(self) -> float:
        """RMS displacement that noise leaves, pixels; nan where it is not recorded."""
        for value in (self.get_attribute(schema.CASE, schema.NOISE_FLOOR), self.summary.get("noise_floor_px")):
            if value is not None:
                return float(value)
        return float("nan")

    @cached_property
    def last_residual(self) -> float:
        """Standard deviation of the residual, grey levels; nan where no table tells it."""
        if self.summary.get("residual_std_grey") is not None:
            return float(self.summary["residual_std_grey"])
        for table in (self.result.gauss_newton, self.result.corrections):
            if len(table.get("residual_std_grey", ())):
                return float(table["residual_std_grey"][-1])
        return float("nan")


def gather_all(result: Result, image: Path | None = None) -> Gathered:
    """Gather what a report on a result says, with a sentence for each thing that is no longer there.

    ``image`` is a reference image in place of the one that the result names; raises InputError where it is missing.
    """
    text = str(result.attributes.get(schema.CASE, {}).get("json", ""))
    absent: list[str] = []
    summary = _read_summary(result, absent)
    named = result.attributes.get(schema.PROVENANCE, {})
    paths = {name: Path(str(named.get(f"{name}_path", ""))) for name in ("reference", "deformed")}
    if image is not None:
        paths["reference"] = image
    images = {}
    for name, path in paths.items():
        if path.is_file():
            images[name] = open_image(path)
        elif name == "reference" and image is not None:
            raise InputError(f"{path}: no such image; check --image")
        else:
            # In place of a file's name, images of arrays are told by what they are.
            in_memory = not path.is_absolute() and not path.suffix
            where = "was in memory" if in_memory else f"is no longer at {path}"
            absent.append(f"The {name} image {where}: what it alone tells is not in this report.")
    return Gathered(result, json.loads(text) if text else {}, summary, images, tuple(absent))


def _read_summary(result: Result, absent: list[str]) -> Mapping[str, Any]:
    """The summary beside a result file, if it is this result's."""
    in_memory = result.path == Path()
    path = result.path if in_memory else schema.summary_path(result.path)
    summary: dict[str, Any] = {}
    if not in_memory and path.is_file():
        try:
            summary = json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            summary = {}
    if not summary:
        absent.append(f"The summary {path.name or 'of the run'} is not beside the result: notes, stopping criterion, "
                      "memory and the time of writing are not in this report.")
    return _pick_frame(summary, result) if "frames" in summary else summary


def _pick_frame(summary: Mapping[str, Any], result: Result) -> Mapping[str, Any]:
    """Of the summary of a series, what it says of the frame of a result, as that of a pair says it."""
    time = result.attributes[schema.TIME]["deformed"]
    record: Mapping[str, Any] = next((one for one in summary["frames"] if one["time"] == time), {})
    seconds = {"this frame of the series": record["seconds"]} if "seconds" in record else {}
    return {**record, "seconds": seconds, "stop": ""}
