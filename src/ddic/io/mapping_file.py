"""Mapping files: the mapping of a near camera and how well it is known, as TOML."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

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
    reader = _Reader(data, path)
    reader.refuse_others()
    homography = reader.numbers("homography", (3, 3), None)
    centre = reader.numbers("distortion.centre", (2,), np.zeros(2))
    radius = reader.numbers("distortion.radius", (), np.ones(()))
    radial = reader.numbers("distortion.radial", (2,), np.zeros(2))
    far_size, near_size = (reader.size(f"images.{name}") for name in ("far_size", "near_size"))
    homography_std = reader.numbers("quality.homography_std", (3, 3), np.zeros((3, 3)))
    radial_std = reader.numbers("quality.radial_std", (2,), np.zeros(2))
    position_std = reader.numbers("quality.position_std", (), np.zeros(()))
    coefficient = reader.numbers("quality.correlation_coefficient", (), np.full((), np.nan))
    if reader.problems:
        raise InputError(reader.problems)
    try:
        mapping = CameraMapping(homography, centre, float(radius), radial)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    return MappingFile(mapping, far_size, near_size, homography_std, radial_std, float(position_std),
                       None if math.isnan(float(coefficient)) else float(coefficient))


_KEYS = {
    "": ("homography", "images", "distortion", "quality"),
    "images": ("far_size", "near_size"),
    "distortion": ("centre", "radius", "radial"),
    "quality": ("homography_std", "radial_std", "position_std", "correlation_coefficient"),
}


@dataclass(frozen=True, eq=False)
class _Reader:
    """The parsed file; what is wrong with it is gathered."""

    data: Mapping[str, Any]
    path: Path
    problems: list[str] = field(default_factory=list)

    def refuse_others(self) -> None:
        """Note keys that mean nothing, and sections that are none."""
        for section, keys in _KEYS.items():
            inside = self.data.get(section, {}) if section else self.data
            if not isinstance(inside, Mapping):
                self._note(section, f"{inside!r}: expected a section, [{section}] with keys below it")
                continue
            for key in inside.keys() - set(keys):
                self.problems.append(f"{self.path}: {f'{section}.{key}' if section else key}: unknown key; "
                                     f"valid here: {', '.join(keys)}")

    def numbers(self, key: str, shape: tuple[int, ...], default: Array | None) -> Array:
        """Finite numbers of a shape."""
        value = self._value(key)
        if value is None:
            if default is None:
                self.problems.append(f"{self.path}: {key}: this key is missing; it has no default")
            return np.zeros(shape) if default is None else default
        wanted = {(): "a finite number", (2,): "two finite numbers, [a, b]",
                  (3, 3): "three rows of three finite numbers, [[a, b, c], [d, e, f], [g, h, 1.0]]"}[shape]
        if not _has_shape(value, shape):
            self._note(key, f"{value!r}: expected {wanted}")
            return np.zeros(shape)
        return np.array(value, dtype=np.float64)

    def size(self, key: str) -> tuple[int, int]:
        """Width and height of an image."""
        value = self._value(key)
        if value is None:
            self.problems.append(f"{self.path}: {key}: this key is missing; it has no default")
            return 1, 1
        if not _has_shape(value, (2,)) or not all(isinstance(n, int) and n > 0 for n in value):
            self._note(key, f"{value!r}: expected width and height in whole px, for instance [1392, 1040]")
            return 1, 1
        return int(value[0]), int(value[1])

    def _value(self, key: str) -> Any:
        *section, name = key.split(".")
        inside: Any = self.data.get(section[0], {}) if section else self.data
        return inside.get(name) if isinstance(inside, Mapping) else None

    def _note(self, key: str, problem: str) -> None:
        self.problems.append(f"{self.path}: {key} = {problem}")


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
