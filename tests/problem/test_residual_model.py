"""The residual of a frame: what counts, and grey levels that differ between the images."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, is_collective
from ddic.functionals.correlation import read_correlation
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.functionals.view import View
from ddic.images.source import ImageSource
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from ddic.images.window import Window
from ddic.kinematics.nodal import NodalRegion
from ddic.mesh.mesh import Mesh
from ddic.parallel.field import ByView
from ddic.parallel.team import Team
from ddic.partition.sharing import build_subdomains
from ddic.problem.residual_model import ResidualModel
from ddic.solvers.correction_size import Tolerances
from ddic.synth.fields import Translation
from support.fields import field_of
from support.one_subdomain import measure_alone, model_of
from support.pictures import pair_of, rms_error, source, square_mesh

MESH = square_mesh(24.0, 168.0)
STILL = Translation((0.0, 0.0))


def model(reference: MaskedSource, deformed: MaskedSource, correction: GreyCorrection = "none",
          mesh: Mesh = MESH) -> ResidualModel:
    """The whole mesh as one subdomain."""
    return model_of(reference, deformed, mesh, correction)


def n_pixels(pair_model: ResidualModel) -> int:
    """Of the reference image."""
    return pair_model.views[0][0].n_pixels


@pytest.mark.parametrize("far", [500.0, -500.0, 1e12])
def test_no_pixel_left(far: float) -> None:
    image = source(pair_of(STILL).reference)
    with pytest.raises(ConvergenceError, match="no pixel is left") as caught:
        measure_alone(model(image, image), q=np.full(MESH.n_dofs, far))
    assert is_collective(caught.value)


def test_pixels_that_leave_the_image_are_left_out_and_counted() -> None:
    # The mesh reaches the right edge; everything moves 10 px to the right, so 10 columns leave.
    field = Translation((10.0, 0.0))
    pair = pair_of(field)
    mesh = square_mesh(47.0, 191.0)
    pair_model = model(source(pair.reference), source(pair.deformed), mesh=mesh)
    rows, columns = np.unique(MESH.nodes[:, 1]), 144
    exact = np.tile([10.0, 0.0], mesh.n_nodes)
    grey, = pair_model.evaluate(field_of(pair_model, [exact])).grey
    assert len(rows) == 10
    # Columns 47 to 190 or 191 of 144 or 145 rows, whichever the fill rule gives the edges.
    lost = n_pixels(pair_model) - grey.n_pixels
    assert lost / grey.n_pixels == pytest.approx(10 / (columns - 10), abs=0.01)
    # A whole-pixel shift needs no interpolation: what is left differs by the float32 spline's rounding.
    assert grey.residual_std < 1e-3


@pytest.mark.parametrize("correction", ["global", "element"])
def test_a_gain_and_an_offset_of_the_deformed_image_are_recovered(correction: GreyCorrection) -> None:
    field = Translation((0.3, -0.4))
    pair = pair_of(field)
    gain, offset = 1.25, -20.0
    g = (pair.deformed - offset) / gain  # f = gain g + offset
    solution = measure_alone(model(source(pair.reference), source(g), correction))
    bound = 2.6e-3 if correction == "global" else 4e-3  # two more unknowns per 256 pixels cost some certainty
    assert rms_error(solution.q[0], MESH.nodes, field) <= bound
    evaluation = model(source(pair.reference), source(g), correction).evaluate(solution.q)
    grey, = evaluation.grey
    assert grey.residual_std < 1.0  # what the spline leaves: 0.7 grey levels
    if correction == "global":
        # Residuals of 0.3 grey levels on 20000 pixels of standard deviation 50.
        assert grey.gain == pytest.approx(gain, abs=2e-3)
        assert grey.offset == pytest.approx(offset, abs=0.3)
    else:
        gains, offsets = evaluation.residuals[0][0].cell_sums.fit_gain_and_offset()
        np.testing.assert_allclose(gains, gain, rtol=0, atol=0.02)
        np.testing.assert_allclose(offsets, offset, rtol=0, atol=3.0)
    # Without it the gap of grey levels stays in the residual.
    uncorrected, = model(source(pair.reference), source(g)).evaluate(solution.q).grey
    assert uncorrected.residual_rms > 10.0


def test_a_correction_per_element_follows_uneven_light() -> None:
    field = Translation((0.3, -0.4))
    pair = pair_of(field)
    y, x = np.mgrid[:192, :192]
    light = 1.0 + 0.3 * np.sin(x / 60.0) * np.cos(y / 70.0)
    corrections: list[GreyCorrection] = ["global", "element"]
    stds = {}
    for correction in corrections:
        pair_model = model(source(pair.reference), source(pair.deformed * light), correction)
        stds[correction] = measure_alone(pair_model).records[-1].grey.residual_std
    # Within a 16 px cell the light changes by up to 0.3 x 16/60 / 2 = 4 % of 128 grey levels, over the image by 60 %.
    assert stds["element"] < 0.3 * stds["global"]


def test_saturated_pixels_and_masks_are_left_out() -> None:
    field = Translation((0.3, -0.4))
    pair = pair_of(field)
    f, g = pair.reference.copy(), pair.deformed.copy()
    g[60:75, 60:75] = 255.0  # a reflection in the deformed image alone
    f[100:110, 40:50] = 255.0
    mask = np.ones(f.shape, dtype=bool)
    mask[130:150, 130:150] = False
    f[130:150, 130:150] = 0.0  # rubbish under the mask
    good = model(source(f, mask, exclude_saturated=True), source(g, exclude_saturated=True))
    blind = model(source(f), source(g))
    found = measure_alone(good)
    with pytest.raises(ConvergenceError) as fooled:
        measure_alone(blind)
    total = n_pixels(blind)
    # With the pixels beside them, whose slopes are taken from them.
    assert n_pixels(good) == total - (400 + 4 * 20) - (100 + 4 * 10)
    # 225 pixels map onto the reflection; those whose interpolation touches it are left out as well.
    lost = n_pixels(good) - found.records[-1].grey.n_pixels
    assert lost == 18 * 18
    # The cell under the mask keeps its edge pixels alone, which costs certainty; what is left in costs the field.
    assert rms_error(found.q[0], MESH.nodes, field) <= 1.5e-2
    assert rms_error(fooled.value.last.q[0], MESH.nodes, field) > 0.05


def test_what_lies_under_a_mask_changes_nothing() -> None:
    field = Translation((0.3, -0.4))
    pair = pair_of(field)
    masks = np.ones((2, *pair.reference.shape), dtype=bool)
    masks[0, 60:100, 60:90] = False
    masks[1, 110:140, 50:80] = False
    found = []
    for garbage in (None, 0.0, 255.0):
        f, g = (image if garbage is None else np.where(mask, image, garbage)
                for image, mask in zip((pair.reference, pair.deformed), masks, strict=True))
        # M keeps what g hides, so that nodes there converge slowly.
        found.append(measure_alone(model(source(f, masks[0]), source(g, masks[1])),
                                   tolerances=Tolerances(rms=1e-2, largest=np.inf)).q[0])
    np.testing.assert_array_equal(found[1], found[0])
    np.testing.assert_array_equal(found[2], found[0])
    # Nor does the mask cost more than its pixels: beside it the field is as good as elsewhere.
    beside = np.linalg.norm(MESH.nodes - (104.0, 72.0), axis=1) < 20
    assert np.abs(found[0].reshape(-1, 2)[beside] - field.vector).max() < 0.05


class _Counted:
    """An image that counts how often it is read."""

    def __init__(self, image: ImageSource) -> None:
        self._image, self.n_reads = image, 0
        self.extent = image.extent
        self.path, self.width, self.height, self.saturation = image.path, image.width, image.height, image.saturation

    def read(self, window: Window) -> NDArray[Any]:
        self.n_reads += 1
        return np.asarray(self._image.read(window))


def test_subdomains_that_share_a_window_read_it_once_an_iteration() -> None:
    image = source(pair_of(STILL).reference)
    parts = np.repeat(np.arange(4), (MESH.n_cells + 3) // 4)[:MESH.n_cells]
    subdomains = build_subdomains(NodalRegion(MESH), parts, np.zeros(MESH.n_dofs, dtype=bool))
    counted = _Counted(image.image)
    deformed = DeformedSubImage(MaskedSource(counted), 3)
    views = ByView([View(read_correlation(s.mesh, image, 3), s.kinematics).open_frame(deformed)] for s in subdomains)
    shared = ResidualModel(Team.alone(), subdomains, views, "none")
    for n_reads, shift in enumerate((0.0, 15.0, -15.0), start=1):
        shared.evaluate(field_of(shared, [np.full(s.n_unknowns, shift) for s in subdomains]))
        assert counted.n_reads == n_reads
    # One of them alone looks into what all of them hold; where it leaves that, the window grows.
    alone = ResidualModel(Team.alone(), subdomains[1:2], ByView(views[1:2]), "none", keeps_windows=True)
    for n_reads, shift in ((3, -14.0), (4, 15.0), (4, -15.0)):
        alone.evaluate(field_of(alone, [np.full(subdomains[1].n_unknowns, shift)]))
        assert counted.n_reads == n_reads
