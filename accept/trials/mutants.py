"""Damaged files of every format that is read, as trials: random damage to their bytes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from accept.trials.trial import CASE_FILE, NEAR, OF_MESH_FILE, ON_CASE, PAIR, Trial

MOST_BITS, LONGEST_BLOCK = 16, 3000
"""Bits that are flipped; bytes of a block that is zeroed, removed, doubled or spliced. More is damage that is found
sooner."""


def _flip_bits(data: bytearray, rng: np.random.Generator) -> bytearray:
    for _ in range(rng.integers(1, MOST_BITS + 1)):
        data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
    return data


def _choose_block(data: bytearray, rng: np.random.Generator) -> slice:
    length = min(len(data), int(rng.integers(1, LONGEST_BLOCK + 1)))
    begin = int(rng.integers(len(data) - length + 1))
    return slice(begin, begin + length)


def _zero(data: bytearray, rng: np.random.Generator) -> bytearray:
    block = _choose_block(data, rng)
    data[block] = bytes(block.stop - block.start)
    return data


def _remove(data: bytearray, rng: np.random.Generator) -> bytearray:
    del data[_choose_block(data, rng)]
    return data


def _double(data: bytearray, rng: np.random.Generator) -> bytearray:
    block = _choose_block(data, rng)
    return data[:block.stop] + data[block] + data[block.stop:]


def _truncate(data: bytearray, rng: np.random.Generator) -> bytearray:
    return data[:int(rng.integers(len(data)))]


def _splice(data: bytearray, rng: np.random.Generator) -> bytearray:
    """Write one place over another one."""
    source, target = _choose_block(data, rng), _choose_block(data, rng)
    data[target] = data[source][:target.stop - target.start]
    return data


MUTATIONS: Mapping[str, Callable[[bytearray, np.random.Generator], bytearray]] = {
    "flipped bits": _flip_bits, "zeroed": _zero, "removed": _remove, "doubled": _double, "truncated": _truncate,
    "spliced": _splice,
}


def mutate(content: bytes, seed: int) -> tuple[str, bytes]:
    """Damage a file's content.

    Parameters
    ----------
    content : bytes
        Of a good file.
    seed : int
        Which of the mutants; the same one gives the same bytes.

    Returns
    -------
    kind : str
        Of the damage.
    damaged : bytes
        Another content, in most cases.
    """
    rng = np.random.default_rng(seed)
    kind = list(MUTATIONS)[seed % len(MUTATIONS)]
    return kind, bytes(MUTATIONS[kind](bytearray(content), rng))


Commands = tuple[tuple[str, ...], ...]


def _start_from(name: str) -> Mapping[str, Any]:
    return {**PAIR, "start": {"from_result": name}}


def _of_png() -> Mapping[str, Any]:
    return {**PAIR, "images": {"reference": "reference.png", "deformed": "deformed.png"}}


def _of_partition() -> Mapping[str, Any]:
    return {**OF_MESH_FILE, "solver": {"method": "dual", "partition": "file", "partition_file": "partition.txt"}}


def _look_at(name: str) -> Commands:
    return (("info", name), *ON_CASE, ("plot", name, "--output", "pictures"))


DAMAGED: Mapping[str, tuple[tuple[str, Mapping[str, Any], Commands], ...]] = {
    "TOML": ((CASE_FILE, PAIR, ON_CASE),),
    "TIFF": (("reference.tif", PAIR, (("info", "reference.tif"), *ON_CASE)),),
    "PNG": (("reference.png", _of_png(), (("info", "reference.png"), *ON_CASE)),),
    "msh": (("mesh.msh", OF_MESH_FILE, ON_CASE),),
    "partition": (("partition.txt", _of_partition(), ON_CASE),),
    "mapping": (("mapping.toml", NEAR, ON_CASE),),
    "HDF5": tuple((f"earlier.{name}.vtkhdf", _start_from(f"earlier.{name}.vtkhdf"), _look_at(f"earlier.{name}.vtkhdf"))
                  for name in ("pair", "series", "pgd")),
}
"""Files by format, each with the case that uses it and the commands that read it."""


def list_mutants(kind: str, n_mutants: int, first_seed: int = 0) -> list[Trial]:
    """List damaged files of a format."""
    trials = []
    for seed in range(first_seed, first_seed + n_mutants):
        name, case, commands = DAMAGED[kind][seed % len(DAMAGED[kind])]
        trials.append(Trial(f"{kind} {seed}: {name}", case, (partial(_damage, name, seed),), commands, "ends"))
    return trials


def _damage(name: str, seed: int, folder: Path) -> None:
    path = folder / name
    path.write_bytes(mutate(path.read_bytes(), seed)[1])
