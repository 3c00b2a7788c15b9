"""Damaged files of every format that is read, as trials."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from accept.trials.good_case import NEAR, OF_MESH_FILE, PAIR
from accept.trials.mutate import mutate
from accept.trials.trial import CASE_FILE, ON_CASE, Trial

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
    """List damaged files of a format.

    Parameters
    ----------
    kind : str
        Of DAMAGED.
    n_mutants : int
        How many.
    first_seed : int, optional
        Of the first; the others follow it.

    Returns
    -------
    list of Trial
        Of which no more is expected than that commands end in order.
    """
    trials = []
    for seed in range(first_seed, first_seed + n_mutants):
        name, case, commands = DAMAGED[kind][seed % len(DAMAGED[kind])]
        trials.append(Trial(f"{kind} {seed}: {name}", case, (partial(_damage, name, seed),), commands, "ends"))
    return trials


def _damage(name: str, seed: int, folder: Path) -> None:
    path = folder / name
    path.write_bytes(mutate(path.read_bytes(), seed)[1])
