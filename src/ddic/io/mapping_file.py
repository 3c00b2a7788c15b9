"""Mapping files: the mapping of a near camera and how well it is known, as TOML."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array
from ddic.errors import InputError
from ddic.images.camera import CameraMapping
from ddic.io.replace_on_exit import replaced_on_exit
from ddic.io.text_files import parse_toml, read_text


@dataclass(frozen=True, eq=False)
class MappingFile:
    """What a mapping file holds.

    Attributes
    ----------
    mapping : CameraMapping
        From far to near px.
    far_size, near_size : (int, int)
        Width and height of the images that it belongs to, px.
    homography_std, radial_std : (3, 3) and (2,) array
        Standard deviations of the homography's numbers, and of k1 and k2; 0 where one is given and not measured.
    position_std : float
        Near px, the largest at the near image's corners and centre.
    coefficient : float or None
        Correlation coefficient of the two images, None where it was not measured.
    """

    mapping: CameraMapping
    far_size: tuple[int, int]
    near_size: tuple[int, int]
    homography_std: Array = field(default_factory=lambda: np.zeros((3, 3)))
    radial_std: Array = field(default_factory=lambda: np.zeros(2))
    position_std: float = 0.0
    coefficient: float | None = None


def write_mapping(path: Path, content: MappingFile) -> None:
    """Write a mapping file; numbers are read back to the last bit.

    Raises InputError if its folder is not there or cannot be written to, OSError if the disk does not take it.
    """
    mapping = content.mapping
    lines = [
        "# Near camera: homography from pixels X of the far reference image to near pixels x_u, then",
        "# x = centre + (x_u - centre) (1 + k1 r^2 + k2 r^4), r = |x_u - centre| / radius. Pixel centres at integers.",
        f"homography = {_rows(mapping.homography)}",
        "",
        "[images]",
        f"far_size = {_row(content.far_size)}      # width, height, px",
        f"near_size = {_row(content.near_size)}",
        "",
        "[distortion]",
        f"centre = {_row(mapping.centre)}      # near px",
        f"radius = {float(mapping.radius)!r}",
        f"radial = {_row(mapping.radial)}      # k1, k2",
        "",
        "[quality]      # standard deviations",
        f"homography_std = {_rows(content.homography_std)}",
        f"radial_std = {_row(content.radial_std)}",
        f"position_std = {float(content.position_std)!r}      # near px, largest at corners and centre",
    ]
    if content.coefficient is not None:
        lines.append(f"correlation_coefficient = {float(content.coefficient)!r}")
    with replaced_on_exit(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_mapping_file(path: Path) -> MappingFile:
    """Read a mapping file; ``[distortion]`` and ``[quality]`` may be missing.

    Raises InputError with the file, the key, the value and what is expected, one line per problem.
    """
    data = parse_toml(read_text(path, "mapping file", "check the path, or make it with ddic calibrate"), path)
    if not get_close_matches("homography", data):
        raise InputError(f"{path}: this is no mapping file, for it holds no homography; make one with ddic calibrate")
    values = _read_values(data, path)
    radius, position_std, coefficient = (float(values[key]) for key in ("distortion.radius", "quality.position_std",
                                                                        "quality.correlation_coefficient"))
    try:
        mapping = CameraMapping(values["homography"], values["distortion.centre"], radius, values["distortion.radial"])
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    (far_width, far_height), (near_width, near_height) = (values[f"images.{name}"].tolist()
                                                          for name in ("far_size", "near_size"))
    return MappingFile(mapping, (far_width, far_height), (near_width, near_height), values["quality.homography_std"],
                       values["quality.radial_std"], position_std, None if math.isnan(coefficient) else coefficient)


_KINDS = {
    "number": ((), "a finite number"),
    "pair": ((2,), "two finite numbers, [a, b]"),
    "matrix": ((3, 3), "three rows of three finite numbers, [[a, b, c], [d, e, f], [g, h, 1.0]]"),
    "size": ((2,), "width and height in whole px, for instance [1392, 1040]"),
}
"""Shape of numbers, and how it is said."""

_KEYS: Mapping[str, Mapping[str, tuple[str, float | None]]] = {
    "": {"homography": ("matrix", None)},
    "images": {"far_size": ("size", None), "near_size": ("size", None)},
    "distortion": {"centre": ("pair", 0.0), "radius": ("number", 1.0), "radial": ("pair", 0.0)},
    "quality": {"homography_std": ("matrix", 0.0), "radial_std": ("pair", 0.0), "position_std": ("number", 0.0),
                "correlation_coefficient": ("number", math.nan)},
}
"""Keys by section: their kind, and what their numbers are where they are left out; None of those that are needed."""


def _read_values(data: Mapping[str, Any], path: Path) -> dict[str, NDArray[Any]]:
    """Numbers of all keys by section.key; raises InputError with all that is wrong."""
    unknown, wrong, values = [], [], {}
    for section, keys in _KEYS.items():
        inside = data.get(section, {}) if section else data
        if not isinstance(inside, Mapping):
            unknown.append(f"{section} = {inside!r}: expected a section, [{section}] with keys below it")
            inside = {}
        prefix = f"{section}." if section else ""
        valid = list(keys) if section else [*keys, *filter(None, _KEYS)]
        unknown += [f"{prefix}{key}: unknown key; valid here: {', '.join(valid)}" for key in inside.keys() - set(valid)]
        for key, (kind, default) in keys.items():
            name, value = f"{prefix}{key}", inside.get(key)
            shape, expected = _KINDS[kind]
            if value is None and default is None:
                wrong.append(f"{name}: this key is missing; it has no default")
            elif value is None:
                values[name] = np.full(shape, default)
            elif not _has_shape(value, shape) or (kind == "size" and not all(map(_is_size, value))):
                wrong.append(f"{name} = {value!r}: expected {expected}")
            else:
                values[name] = np.array(value, dtype=np.int64 if kind == "size" else np.float64)
    if unknown or wrong:
        raise InputError([f"{path}: {problem}" for problem in (*unknown, *wrong)])
    return values


def _is_size(value: Any) -> bool:
    return isinstance(value, int) and value > 0


def _has_shape(value: Any, shape: tuple[int, ...]) -> bool:
    """Whether a value of TOML is finite numbers in nested lists of this shape."""
    if not shape:
        return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return isinstance(value, list) and len(value) == shape[0] and all(_has_shape(item, shape[1:]) for item in value)


def _row(values: Iterable[Any]) -> str:
    """Numbers as a list of TOML, to the last bit."""
    return "[" + ", ".join(repr(v) if isinstance(v, int) else repr(float(v)) for v in values) + "]"


def _rows(values: Array) -> str:
    """Rows of numbers as a list of lists of TOML."""
    return "[\n" + "".join(f"    {_row(row)},\n" for row in values) + "]"
