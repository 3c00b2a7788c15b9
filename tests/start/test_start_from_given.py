"""The pyramid from a given displacement."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.case.schema import StartSection
from ddic.start.binned_pair import BinnedPair
from ddic.start.coarse_displacement import CutField, evaluate_at_nodes
from ddic.start.multilevel import MultilevelStart, Pyramid, find_start_from_given
from ddic.synth.fields import Affine, DisplacementField, Translation
from support.pictures import pair_of, source, square_mesh

SIDE = 576
MESH = square_mesh(144.0, 432.0)
CENTRE = (287.5, 287.5)
STAGES = StartSection()


def _linear(gradient: list[list[float]], shift: tuple[float, float] = (0.0, 0.0)) -> Affine:
    return Affine(tuple(map(tuple, gradient)), shift, CENTRE)  # type: ignore[arg-type]


STRAINED = _linear([[0.02, 0.0], [0.0, -0.006]], (4.0, -3.0))


def _given(field: DisplacementField) -> CutField:
    return CutField(MESH, field.displacement(MESH.nodes))


def _find(given: CutField, truth: DisplacementField, stages: StartSection = STAGES) -> MultilevelStart:
    pair = pair_of(truth, SIDE, 8)
    pyramid = Pyramid(BinnedPair(source(pair.reference), source(pair.deformed), 1), MESH, "none")
    return find_start_from_given(given, pyramid, stages)


def _error(found: MultilevelStart, truth: DisplacementField) -> float:
    off = evaluate_at_nodes(found.field, MESH) - truth.displacement(MESH.nodes)  # type: ignore[arg-type]
    return float(np.sqrt((off**2).mean()))


@pytest.mark.parametrize("off", [(0.0, 0.0), (0.4, -0.3)])
def test_a_field_within_a_pixel_is_kept_as_it_is(off: tuple[float, float]) -> None:
    given = _given(_linear([[0.02, 0.0], [0.0, -0.006]], (4.0 + off[0], -3.0 + off[1])))
    found = _find(given, STRAINED)
    assert found.field is given
    assert (found.levels, found.notes, found.warnings) == ((), (), ())


def test_a_frame_that_jumps_by_50_px_moves_the_field_on() -> None:
    later = _linear([[0.025, 0.0], [0.0, -0.0075]], (44.0, 27.0))
    found = _find(_given(STRAINED), later)
    # Half a percent of strain over 288 px: the finest level alone reaches it.
    assert found.levels == (2,)
    assert "moved on by (40.0" in found.notes[1]
    assert _error(found, later) <= 0.05


def test_the_error_chooses_the_levels() -> None:
    # Without translations; 4 % of strain is 6 px at the ends, which blocks of 2 px do not reach.
    later = _linear([[0.06, 0.0], [0.0, -0.02]], (4.0, -3.0))
    found = _find(_given(STRAINED), later, StartSection(rigid=False, features=False))
    assert found.levels == (8, 4, 2)
    assert _error(found, later) <= 0.1
    nearer = _linear([[0.028, 0.0], [0.0, -0.008]], (4.0, -3.0))
    assert _find(_given(STRAINED), nearer, StartSection(rigid=False, features=False)).levels == (2,)


def test_a_field_worse_than_none_is_not_used_and_the_log_says_so() -> None:
    # Folded: half of the region to the left, half to the right.
    torn = CutField(MESH, np.where(MESH.nodes[:, :1] < 288, -90.0, 90.0) * np.ones(2))
    found = _find(torn, Translation((5.0, -2.0)))
    assert "is not used" in found.notes[1]
    assert found.rigid[0].shift == pytest.approx((5.0, -2.0), abs=0.1)
    assert _error(found, Translation((5.0, -2.0))) <= 0.05


def test_features_find_what_turns_on() -> None:
    c, s = np.cos(np.radians(40)), np.sin(np.radians(40))
    later = _linear([[c - 1, -s], [s, c - 1]], (4.0, -3.0))
    found = _find(_given(STRAINED), later)
    assert found.n_matches > 100
    assert found.notes[1] == "start: features match; the given displacement is not used"
    assert _error(found, later) <= 0.1


def test_unrelated_images_keep_what_is_given() -> None:
    reference = pair_of(STRAINED, SIDE, 8).reference
    noise = np.random.default_rng(0).uniform(0, 255, (SIDE, SIDE)).astype(np.float32)
    given = _given(STRAINED)
    pyramid = Pyramid(BinnedPair(source(reference), source(noise), 1), MESH, "none")
    found = find_start_from_given(given, pyramid, STAGES)
    assert found.field is given
    assert "nothing was found that explains the images better" in found.notes[1]


def test_half_a_region_that_is_hidden_does_not_replace_a_good_field() -> None:
    pair = pair_of(STRAINED, SIDE, 8)
    hidden = pair.deformed.astype(np.float32)
    hidden[:, :288] = np.random.default_rng(0).uniform(0, 255, (SIDE, 288))
    given = _given(STRAINED)
    pyramid = Pyramid(BinnedPair(source(pair.reference), source(hidden), 1), MESH, "none")
    assert find_start_from_given(given, pyramid, STAGES).field is given


@pytest.mark.parametrize("truth", [-37.0, 17.0, 41.0])
def test_a_repetitive_texture_is_gone_on_from_where_it_is_given(truth: float) -> None:
    y, x = np.mgrid[0:SIDE, 0:SIDE]
    number = 2 * np.pi / 12
    pictures = [127 + 100 * np.sin(number * (x - shift)) * np.sin(number * y) for shift in (0.0, truth)]
    reference, deformed = (source(picture.astype(np.float32)) for picture in pictures)
    pyramid = Pyramid(BinnedPair(reference, deformed, 1), MESH, "none")
    # A period is 12 px: whatever correlates the images finds another one as likely.
    found = find_start_from_given(_given(Translation((truth + 1.2, -0.8))), pyramid, STAGES)
    assert _error(found, Translation((truth, 0.0))) <= 0.02
    assert found.notes[1] == "start: the pyramid goes on from it"


def test_without_the_pyramid_the_translation_is_all() -> None:
    later = _linear([[0.02, 0.0], [0.0, -0.006]], (24.0, -13.0))
    found = _find(_given(STRAINED), later, StartSection(pyramid=False))
    assert found.levels == ()
    assert _error(found, later) <= 0.15
