"""Random damage to a file's bytes."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

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
