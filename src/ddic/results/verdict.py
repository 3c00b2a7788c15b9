"""Whether a measured field can be trusted, in plain words: what speaks against it, where, and what to do about it.

The field's cells speak: those that are excluded or doubtful, and those that the frame shows where the field puts them.
A few excluded cells are a place to look at. A field of which most is not known, or that is torn from edge to edge, is
not to be trusted, though Gauss-Newton has converged: it has, in what is left.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ddic.arrays import BoolArray, IntArray
from ddic.io.result_schema import DISTRUST, LOOK, TRUST, Verdict
from ddic.parallel.team import Team
from ddic.partition.sharing import find_largest, share_among_copies
from ddic.partition.split import join_pairs
from ddic.partition.subdomain import Subdomain
from ddic.visibility.cell_errors import MarkedCells
from ddic.visibility.exclusions import BLANK, HELD_OFF, MASKED, SPOILT, UNSEEN, Exclusions, find_excluded

MOST_LOST = 0.5
"""Share of the cells that are excluded or doubtful above which a field is not trusted: most of it is a guess."""

FEW_DOUBTFUL = 0.02
"""Share of the cells that may be doubtful, though they count, without a word: real images have some at edges."""

MOST_HELD = 0.05
"""Share of the cells held off by the regularization above which a field is not trusted: what mechanics hold of a clean
pair is less, and a crack that they smear is more."""

MOST_MASKED = 0.1
"""Share of the cells that may lie under a mask of the reference image without a word: the field there is a guess."""

LEAST_SHOWN = 0.5
"""Share of the cells that must be seen where the field puts them, whatever is excluded."""

LARGE = 0.05
"""Share of the cells from which on a piece of the mesh is a part of the specimen, not a corner that was cut off."""

SAME_IMAGE = 3e-6
"""Standard deviation of the residual, of the dynamic range, below which both images are one: single precision leaves
1e-7, the filter of volumes 1e-6, and two pictures of which either has 16 bits differ by 6e-6 at least."""

REMEDIES = {
    BLANK: "have no texture: move the region onto the pattern (x, the column, comes before y, the row), or mask what "
           "bears none",
    SPOILT: "show something else than the reference: look there for what hides the specimen, a reflection, or damage",
    UNSEEN: "hold too few pixels that both images show: the specimen leaves the image there, or something hides it",
    MASKED: "hold no pixel of the reference image that counts, masked or saturated: the field there is a guess; draw "
            "the region without them",
    HELD_OFF: "are held by the regularization beside where the images show them: a shorter "
              "regularization.cut_off_wavelength follows them",
}


@dataclass(frozen=True)
class Evidence:
    """What speaks for or against a field.

    Attributes
    ----------
    n_cells, n_doubtful : int
        Of the whole mesh; doubtful ones, with those that are excluded.
    marked : sequence of MarkedCells
        Cells that are excluded or held off, and where.
    shown_share : float
        Share of the cells that the frame shows where the field puts them.
    is_torn : bool
        Whether what shows something else parts the mesh in two.
    residual : float
        Its standard deviation, beyond what rounding leaves of it, over the dynamic range.
    may_be_saturated : bool
        Whether pixels of the reference image are left out that nobody has masked.
    """

    n_cells: int
    n_doubtful: int
    marked: Sequence[MarkedCells] = ()
    shown_share: float = 1.0
    is_torn: bool = False
    residual: float = 1.0
    may_be_saturated: bool = False

    def count(self, state: int) -> int:
        """Count the cells that are marked by a state."""
        return sum(marked.n_cells for marked in self.marked if marked.state == state)

    @property
    def n_meant(self) -> int:
        """Cells under a mask, which speak against nothing; none where they may be saturated."""
        return 0 if self.may_be_saturated else self.count(MASKED)

    @property
    def n_rest(self) -> int:
        """Cells that a frame could show."""
        return self.n_cells - self.n_meant


def choose_verdict(evidence: Evidence, failure: str = "") -> Verdict:
    """Judge a field by what speaks against it; ``failure`` says why it is no result, empty where it converged."""
    if failure:
        return Verdict(DISTRUST, (" ".join(failure.split()),))
    grave, others = _list_grave(evidence), _list_places(evidence)
    if grave:
        return Verdict(DISTRUST, (*grave, *others))
    return Verdict(LOOK if others else TRUST, tuple(others))


def _list_grave(evidence: Evidence) -> list[str]:
    """Why a field is not trusted at all."""
    n_rest, reasons = evidence.n_rest, []
    n_held, n_lost = evidence.count(HELD_OFF), evidence.n_doubtful - evidence.n_meant
    shown_share = evidence.shown_share * evidence.n_cells / max(n_rest, 1)
    if n_lost > MOST_LOST * n_rest:
        reasons.append(f"{n_lost / n_rest:.0%} of the cells are excluded or doubtful")
    if shown_share < LEAST_SHOWN:
        reasons.append(f"only {shown_share:.0%} of the cells are seen where the field puts them")
    if evidence.is_torn:
        reasons.append("what shows something else runs through the whole mesh and parts it: if it is a crack, measure "
                       "it as a [[discontinuity]]; strains across it are not the specimen's")
    if n_held > MOST_HELD * n_rest:
        reasons.append(f"the regularization holds {n_held / n_rest:.0%} of the cells off what the images show")
    return reasons


def _list_places(evidence: Evidence) -> list[str]:
    """What to look at, and where."""
    n_cells = evidence.n_cells
    is_meant = 0 < evidence.n_meant <= MOST_MASKED * n_cells
    reasons = [f"{marked.n_cells} of {n_cells} cells {REMEDIES[marked.state]} ({marked.places})"
               for marked in evidence.marked if marked.state != MASKED or not is_meant]
    n_excluded = sum(marked.n_cells for marked in evidence.marked if marked.state != HELD_OFF)
    n_doubtful = evidence.n_doubtful - n_excluded
    if n_doubtful > FEW_DOUBTFUL * evidence.n_rest:
        reasons.append(f"{n_doubtful} of {n_cells} cells count but are doubtful (cell field \"doubtful\"): noise or "
                       "a wrong displacement; try larger elements or a longer regularization.cut_off_wavelength")
    if evidence.residual < SAME_IMAGE:
        reasons.append("the deformed image is the reference image itself: is it the right file?")
    return reasons


def find_tear(team: Team, subdomains: Sequence[Subdomain], excluded: Exclusions) -> bool:
    """Tell whether what shows something else, not blank or masked, parts the mesh in more large pieces; collective."""
    everywhere = [np.ones(subdomain.mesh.n_cells, dtype=bool) for subdomain in subdomains]
    are_kept = [~find_excluded(states) | np.isin(states, (BLANK, MASKED)) for states, *_ in excluded.cells]
    return _count_large_pieces(team, subdomains, are_kept) > _count_large_pieces(team, subdomains, everywhere)


def _count_large_pieces(team: Team, subdomains: Sequence[Subdomain], are_chosen: Sequence[BoolArray]) -> int:
    """Number of pieces of some cells, connected by nodes, that hold a share LARGE of all cells; collective."""
    piece_of_node = [_label_nodes(subdomain, chosen) for subdomain, chosen in zip(subdomains, are_chosen, strict=True)]
    n_pieces = [int(pieces.max()) + 1 for pieces in piece_of_node]
    first = team.offset(sum(n_pieces)) + np.cumsum([0, *n_pieces])
    numbered = [np.where(pieces < 0, -1, pieces + offset)
                for pieces, offset in zip(piece_of_node, first[:-1], strict=True)]

    # At a shared node all pieces that have it learn of the one with the largest number.
    shared = [(subdomain.node_multiplicity > 1) & (pieces >= 0)
              for subdomain, pieces in zip(subdomains, numbered, strict=True)]
    nodes, own = (np.concatenate([values[at] for values, at in zip(of_subdomains, shared, strict=True)])
                  for of_subdomains in ([subdomain.node_ids for subdomain in subdomains], numbered))
    other = share_among_copies(team, nodes, own[:, None], find_largest)[:, 0]
    pairs = np.unique(np.column_stack([own, other]), axis=0)

    n_cells = [np.bincount(pieces[subdomain.mesh.connectivity[subdomain.mesh.offsets[:-1]]][chosen], minlength=n)
               for subdomain, pieces, chosen, n in zip(subdomains, piece_of_node, are_chosen, n_pieces, strict=True)]
    of_ranks = team.gather_lists([(pairs, np.concatenate(n_cells))])
    all_pairs, sizes = (np.concatenate(parts) for parts in zip(*of_ranks, strict=True))
    joined = np.bincount(join_pairs(all_pairs[:, 0], all_pairs[:, 1], len(sizes)), weights=sizes)
    n_all = team.sum(sum(subdomain.mesh.n_cells for subdomain in subdomains))
    return int((joined >= LARGE * n_all).sum())


def _label_nodes(subdomain: Subdomain, chosen: BoolArray) -> IntArray:
    """Piece of each node of a subdomain, from 0, that some of its cells connect; -1 at nodes of none of these."""
    mesh = subdomain.mesh
    corner_counts = np.diff(mesh.offsets)
    cell_of_corner = np.repeat(np.arange(mesh.n_cells), corner_counts)
    counts = chosen[cell_of_corner]
    cells, nodes = cell_of_corner[counts], mesh.connectivity[counts]
    labels = join_pairs(nodes, mesh.n_nodes + cells, mesh.n_nodes + mesh.n_cells)[:mesh.n_nodes]
    pieces = np.full(mesh.n_nodes, -1)
    used = np.unique(nodes)
    pieces[used] = np.unique(labels[used], return_inverse=True)[1]
    return pieces
