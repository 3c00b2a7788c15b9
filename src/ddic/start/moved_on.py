"""Translations by which a given displacement has to be moved on: those of a frame that jumps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ddic.images.rigid import RigidShift, find_rigid_shift
from ddic.mesh.interpolation import interpolate_located, locate
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_areas
from ddic.start.binned_pair import BinnedPair, scale_mesh
from ddic.start.cut_field import CutField
from ddic.start.pieces import find_piece_of_nodes, find_pieces
from ddic.start.rigid_start import FEWEST_BLOCKS, FEWEST_OF_PIECE, LEAST_COEFFICIENT

Array = NDArray[np.float64]

AREA_RANGE = (0.2, 5.0)
"""Least and largest area of a displaced cell, times its own, with which it is drawn: others are torn."""

LARGEST_STRETCH = 10.0
"""Largest side of a displaced cell's bounding box, times that of the cell, with which it is drawn."""


@dataclass(frozen=True, eq=False)
class MovedOn:
    """A given displacement, moved on by translations.

    Attributes
    ----------
    field : CutField
        Pixels.
    translations : tuple of RigidShift
        Translations of the pieces, or that of the region; pixels of the deformed image.
    """

    field: CutField
    translations: tuple[RigidShift, ...]


@dataclass(frozen=True, eq=False)
class _Brought:
    """The reference image as the given displacement puts it into the deformed one, and the piece of each block."""

    grey: Array
    pieces: NDArray[np.int64]


def move_on(given: CutField, pair: BinnedPair) -> list[MovedOn]:
    """Find the translations between a reference image displaced as given and the deformed one.

    Parameters
    ----------
    given : CutField
        On the mesh of the region, pixels.
    pair : BinnedPair
        The images.

    Returns
    -------
    list of MovedOn
        Each piece by its own translation, where there are several pieces and one finds its own; the region by one; none
        where nothing stands out.
    """
    brought = _bring(given, pair)
    deformed = pair.deformed.read_whole()
    found = []
    whole = _find_shift(brought, deformed, brought.pieces >= 0, FEWEST_BLOCKS, pair.factor)
    n_pieces = int(brought.pieces.max(initial=-1)) + 1
    of_pieces = {}
    for piece in range(n_pieces if n_pieces > 1 else 0):
        shift = _find_shift(brought, deformed, brought.pieces == piece, FEWEST_OF_PIECE, pair.factor)
        if shift is not None:
            of_pieces[piece] = shift
    if of_pieces:
        by_node = np.tile((0.0, 0.0) if whole is None else whole.shift, (given.mesh.n_nodes, 1))
        pieces = find_piece_of_nodes(given.mesh)
        for piece, shift in of_pieces.items():
            by_node[pieces == piece] = shift.shift
        found.append(MovedOn(CutField(given.mesh, given.displacement + by_node), tuple(of_pieces.values())))
    if whole is not None:
        found.append(MovedOn(CutField(given.mesh, given.displacement + np.array(whole.shift)), (whole,)))
    return found


def _find_shift(brought: _Brought, deformed: Array, blocks: NDArray[np.bool_], fewest: float,
                factor: int) -> RigidShift | None:
    """Translation of some blocks, pixels; None where it does not stand out."""
    if blocks.sum() < fewest:
        return None
    found = find_rigid_shift(brought.grey, deformed, blocks)
    return found.scale(factor) if found.coefficient >= LEAST_COEFFICIENT else None


def _bring(given: CutField, pair: BinnedPair) -> _Brought:
    """Displace the reference image."""
    before = scale_mesh(given.mesh, pair.factor)
    after = Mesh(before.nodes + given.displacement / pair.factor, before.connectivity, before.offsets, before.types)
    # Torn and folded cells would cover everything.
    kept = np.flatnonzero(_find_drawn(before, after))
    height, width = pair.reference.extent.height, pair.reference.extent.width
    pieces = np.full((height, width), -1, dtype=np.int64)
    grey = np.zeros((height, width))
    if not kept.size:
        return _Brought(grey, pieces)
    drawn, nodes = after.create_submesh(kept)
    y, x = np.mgrid[0:height, 0:width].astype(float)
    located = locate(drawn, np.column_stack([x.ravel(), y.ravel()]))
    inside = located.cells >= 0
    origins = interpolate_located(drawn, before.nodes[nodes], located)[inside]
    reference = pair.reference.read_whole()
    places = origins[:, ::-1].T
    grey.reshape(-1)[inside] = ndimage.map_coordinates(reference, places, order=1, mode="nearest")
    counted = np.ones(len(origins), dtype=bool)
    usable = pair.reference.find_usable(pair.reference.extent)
    if usable is not None:
        row, column = np.rint(places).astype(np.int64)
        counted = usable[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)] > 0
    of_cells = find_pieces(given.mesh)[kept]
    pieces.reshape(-1)[inside] = np.where(counted, of_cells[located.cells[inside]], -1)
    return _Brought(grey, pieces)


def _find_drawn(before: Mesh, after: Mesh) -> NDArray[np.bool_]:
    """Cells that a displacement neither folds nor tears."""
    plain = Mesh(before.nodes, before.connectivity, before.offsets, before.types)
    ratio = measure_areas(after) / measure_areas(plain)
    sides = []
    for mesh in (plain, after):
        corners = mesh.nodes[mesh.connectivity]
        starts = mesh.offsets[:-1]
        sides.append(np.maximum.reduceat(corners, starts) - np.minimum.reduceat(corners, starts))
    stretch = sides[1].max(axis=1) / sides[0].max(axis=1)
    return np.asarray((ratio > AREA_RANGE[0]) & (ratio < AREA_RANGE[1]) & (stretch < LARGEST_STRETCH))
