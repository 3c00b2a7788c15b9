"""Pixels of a rectangle in bands of rows: integrals over them along either direction, and the residual."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray, IntArray
from ddic.functionals.grey_statistics import GreySums
from ddic.images.spline import PADDING, GradientImage, SplineImage
from ddic.images.sub_image import DeformedSubImage
from ddic.images.window import Window
from ddic.separated import separated_kernels as kernels
from ddic.separated.field import BandSums, LineElements, SeparatedField

Grey = NDArray[np.float32]

CHUNK = 1 << 17
"""Pixels whose displacement is held at once: 2 MB, of the second-level cache."""

SAMPLES = 33
"""Places along a side at which a field is looked at to guess which window of g it needs."""

_NOTHING_EXCLUDED = np.zeros((0, 0), dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class ReferenceBand:
    """Rows of the reference image.

    Attributes
    ----------
    rows : range
        Of the image.
    values : (n_rows, width) float32 array
        f, grey levels; nan where a pixel is left out.
    by_x, by_y : (n_rows, width) float32 array
        grad f, grey levels per pixel; 0 where a pixel is left out.
    """

    rows: range
    values: Grey
    by_x: Grey
    by_y: Grey


@dataclass(frozen=True, eq=False)
class ReferenceBands:
    """The reference image in a rectangle, as one rank sees it.

    Attributes
    ----------
    along_x, along_y : LineElements
        Of the rectangle.
    bands : list of ReferenceBand
        Owned ones, in order.
    extent : Window
        The whole image.
    sums : BandSums
        Over the bands of all ranks.
    """

    along_x: LineElements
    along_y: LineElements
    bands: list[ReferenceBand]
    extent: Window
    sums: BandSums

    def sum_texture(self, component: int, of_columns: Array, of_rows: Array) -> float:
        """Sum f_a^2 p(x) q(y) over the pixels of all ranks, grey levels squared times the units of p and q.

        ``component`` is a, ``of_columns`` (width,) are p and ``of_rows`` (height,) q.
        """
        found = []
        for band in self.bands:
            slope = (band.by_x, band.by_y)[component].astype(np.float64)
            found.append(np.atleast_1d(of_rows[self.locate(band.rows)] @ (slope**2 @ of_columns)))
        return float(self.sums.add_up(found)[0])

    def locate(self, rows: range) -> slice:
        """Locate rows of the image among those of the rectangle."""
        first = self.along_y.pixels.start
        return slice(rows.start - first, rows.stop - first)


def cut_bands(reference: GradientImage, along_x: LineElements, rows: Sequence[range]) -> list[ReferenceBand]:
    """Cut bands of rows out of a window that holds them; their columns are the pixels of ``along_x``."""
    bands = []
    for of_band in rows:
        window = Window((along_x.pixels.start, of_band.start), (along_x.pixels.stop, of_band.stop))
        part = reference.restrict(window)
        values, by_x, by_y = (np.ascontiguousarray(array, dtype=np.float32) for array in (part.values, *part.slopes))
        if part.usable is not None:
            left_out = part.usable == 0
            values[left_out], by_x[left_out], by_y[left_out] = np.nan, 0.0, 0.0
        bands.append(ReferenceBand(of_band, values, by_x, by_y))
    return bands


def count_usable(bands: Sequence[ReferenceBand]) -> int:
    """Count the pixels of one rank's bands that are not left out."""
    return sum(int(np.isfinite(band.values).sum()) for band in bands)


@dataclass(eq=False)
class FrameBand:
    """Rows of both images; what the deformed one hides is left out of the slopes too.

    Attributes
    ----------
    reference : ReferenceBand
        Of the reference image.
    by_x, by_y : (n_rows, width) float32 array
        grad f; 0 where a pixel is hidden.
    residual : (n_rows, width) float32 array
        f - g(x + u), grey levels; 0 where a pixel does not count.
    absent : (n_rows, width) array of bool or None
        Pixels that do not count at the last displacement; None where all do.
    """

    reference: ReferenceBand
    by_x: Grey
    by_y: Grey
    residual: Grey
    absent: BoolArray | None = None

    def draw_residual(self, gain: float, offset: float) -> Grey:
        """Draw f - gain g(x + u) - offset; nan where a pixel does not count."""
        image = self.residual - (gain - 1.0) * (self.reference.values - self.residual) - offset
        image = image.astype(np.float32)
        return image if self.absent is None else np.where(self.absent, np.float32(np.nan), image)


@dataclass(eq=False)
class FramePixels:
    """Both images in a rectangle, as one rank sees them, at the displacement that was evaluated last.

    Attributes
    ----------
    reference : ReferenceBands
        The reference image.
    deformed : DeformedSubImage
        g.
    bands : list of FrameBand
        Owned ones.
    """

    reference: ReferenceBands
    deformed: DeformedSubImage
    bands: list[FrameBand] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.bands = [FrameBand(band, band.by_x, band.by_y, np.zeros_like(band.values))
                      for band in self.reference.bands]

    def integrate_over_y(self, functions: Array) -> Array:
        """Integrate Eq. (19) of [PP12] over the rows, for both components in one sweep.

        ``functions`` (2, height) are Y of both components in each row, the sums (5, width) those of f_x^2 Y1^2, f_x f_y
        Y1 Y2, f_y^2 Y2^2, r f_x Y1 and r f_y Y2.
        """
        found = []
        for band in self.bands:
            sums = np.zeros((kernels.N_SUMS, band.by_x.shape[1]))
            of_band = np.ascontiguousarray(functions[:, self.reference.locate(band.reference.rows)])
            kernels.sum_over_rows(band.by_x, band.by_y, band.residual, of_band, sums)
            found.append(sums)
        return self.reference.sums.add_up(found)

    def integrate_over_x(self, functions: Array) -> Array:
        """Integrate Eq. (19) of [PP12] over the columns, for both components in one sweep.

        ``functions`` (2, width) are X of both components in each column, the sums (5, height) those of f_x^2 X1^2, f_x
        f_y X1 X2, f_y^2 X2^2, r f_x X1 and r f_y X2.
        """
        functions = np.ascontiguousarray(functions)
        found = []
        for band in self.bands:
            sums = np.empty((kernels.N_SUMS, band.by_x.shape[0]))
            kernels.sum_over_columns(band.by_x, band.by_y, band.residual, functions, sums)
            found.append(sums)
        return self.reference.sums.join(found)

    def integrate_pairs(self, functions: Array, *, along_y: bool) -> tuple[Array, Array]:
        """Integrate all pairs of several functions against the slopes, and each against the residual.

        ``functions`` (n_modes, 2, height or width) are those of the direction that is integrated over, at its pixels;
        with ``along_y`` what is left is a function of y, and integrals are over x. Returns (2 n_modes, 2 n_modes, n)
        sums of f_c f_d v w for v of component c and w of component d, function k of component c being 2 k + c, and (2
        n_modes, n) sums of r f_c v.
        """
        sums = self.reference.sums
        of_bands = self._integrate_bands(functions, along_y=along_y)
        rows = sums.join(of_bands) if along_y else sums.add_up(of_bands)
        m = 2 * len(functions)
        return rows[:m * m].reshape(m, m, -1), rows[m * m:]

    def _integrate_bands(self, functions: Array, *, along_y: bool) -> Iterator[Array]:
        """Integrals over the pixels of each owned band: all pairs, row by row, then the single ones, (m^2 + m, n)."""
        n_modes = len(functions)
        m = 2 * n_modes
        for band in self.bands:
            given = functions if along_y else functions[..., self.reference.locate(band.reference.rows)]
            images = (band.by_x.astype(np.float64), band.by_y.astype(np.float64), band.residual)
            # What is integrated over comes first.
            *slopes, residual = (image.T if along_y else image for image in images)
            n = residual.shape[1]
            found = np.empty((m * m + m, n))
            pairs, single = found[:m * m].reshape(n_modes, 2, n_modes, 2, n), found[m * m:].reshape(n_modes, 2, n)
            for c in range(2):
                single[:, c] = given[:, c] @ (slopes[c] * residual)
                for d in range(c, 2):
                    products = (given[:, None, c] * given[None, :, d]).reshape(n_modes**2, -1)
                    pairs[:, c, :, d] = (products @ (slopes[c] * slopes[d])).reshape(n_modes, n_modes, n)
            pairs[:, 1, :, 0] = pairs[:, 0, :, 1].swapaxes(0, 1)
            yield found

    def sum_blocks(self, edges_x: IntArray, edges_y: IntArray) -> Array:
        """Sum the residual against grad f over blocks of pixels: r f_x and r f_y, (2, n_y, n_x).

        ``edges_x`` and ``edges_y`` (n + 1,) are columns and rows where blocks begin, counted from the rectangle's first
        ones.
        """
        found = []
        for band in self.bands:
            sums = np.zeros((2, len(edges_y) - 1, len(edges_x) - 1))
            first = self.reference.locate(band.reference.rows).start
            kernels.sum_blocks(band.by_x, band.by_y, band.residual, first, edges_y, edges_x, sums)
            found.append(sums)
        return self.reference.sums.add_up(found)

    def evaluate(self, displacement: SeparatedField) -> GreySums:
        """Evaluate the residual at a displacement, and its sums over the pixels of all ranks that count."""
        sums = self.reference.sums
        return GreySums(sums.add_up(sums.together(lambda: self._fill(displacement))))

    def correct_grey_levels(self, gain: float, offset: float) -> None:
        """Turn the residual f - g(x + u) into f - gain g(x + u) - offset, the offset in grey levels."""
        for band in self.bands:
            r = band.residual.astype(np.float64)
            corrected = r - (gain - 1.0) * (band.reference.values - r) - offset
            band.residual[:] = corrected if band.absent is None else np.where(band.absent, 0.0, corrected)

    def compute_residual_rows(self, displacement: SeparatedField, gain: float,
                              offset: float) -> list[tuple[range, Grey]]:
        """Compute rows and residual f - gain g(x + u) - offset of each owned band; nan where a pixel does not count."""
        def compute() -> list[tuple[range, Grey]]:
            self._fill(displacement)
            return [(band.reference.rows, band.draw_residual(gain, offset)) for band in self.bands]

        return self.reference.sums.together(compute)

    def _fill(self, displacement: SeparatedField) -> list[Array]:
        """Fill the residual of all bands; returns their grey sums."""
        if not self.bands:
            return []
        x = self.reference.along_x.evaluate_at_pixels(displacement.scaled_x)
        y = self.reference.along_y.evaluate_at_pixels(displacement.y)
        window = self._guess_window(x, y)
        self.deformed.hold(window)
        return [self._fill_band(band, x, y, window) for band in self.bands]

    def _fill_band(self, band: FrameBand, x: Array, y: Array, window: Window) -> Array:
        rows = band.reference.rows
        of_rows = y[..., self.reference.locate(rows)]
        report = self._fill_pixels(band, x, of_rows, self.deformed.get_spline(window))
        if report[kernels.N_GREY] > 0:
            # Some pixels are displaced beyond the window that was guessed.
            report = self._fill_pixels(band, x, of_rows, self.deformed.get_spline(self._find_window(rows, x, of_rows)))
        if int(report[0]) < band.residual.size:
            self._leave_out(band)
        else:
            band.by_x, band.by_y, band.absent = band.reference.by_x, band.reference.by_y, None
        return report[:kernels.N_GREY]

    def _fill_pixels(self, band: FrameBand, x: Array, y: Array, spline: SplineImage) -> Array:
        report = np.zeros(kernels.N_GREY + 1)
        rows = band.reference.rows
        x0, extent = self.reference.along_x.pixels.start, self.reference.extent
        usable = _NOTHING_EXCLUDED if spline.usable is None else spline.usable
        step = max(CHUNK // x.shape[-1], 1)
        for begin in range(0, len(rows), step):
            part = slice(begin, min(begin + step, len(rows)))
            ux, uy = (np.ascontiguousarray(y[:, c, part].T) @ x[:, c] for c in range(2))
            kernels.fill_residual(band.reference.values[part], ux, uy, x0, rows.start + begin, spline.coefficients,
                                  spline.degree, spline.window.x0, spline.window.y0, usable,
                                  extent.sizes, band.residual[part], report)
        return report

    def _leave_out(self, band: FrameBand) -> None:
        """Pixels that do not count leave the integrals."""
        band.absent = absent = np.isnan(band.residual)
        band.residual[absent] = 0.0
        is_hidden = bool((absent & np.isfinite(band.reference.values)).any())
        slopes = (band.reference.by_x, band.reference.by_y)
        band.by_x, band.by_y = (np.where(absent, np.float32(0), slope) if is_hidden else slope for slope in slopes)

    def _guess_window(self, x: Array, y: Array) -> Window:
        """The window of g that a sample of the pixels of all owned bands is displaced to."""
        rows = range(self.bands[0].reference.rows.start, self.bands[-1].reference.rows.stop)
        own = y[..., self.reference.locate(rows)]
        i = np.linspace(0, x.shape[-1] - 1, SAMPLES).round().astype(int)
        j = np.linspace(0, len(rows) - 1, SAMPLES).round().astype(int)
        return self._bound(np.array(rows)[j], i, x[..., i], own[..., j])

    def _find_window(self, rows: range, x: Array, y: Array) -> Window:
        """The window of g that all pixels of a band are displaced to."""
        return self._bound(np.array(rows), np.arange(x.shape[-1]), x, y)

    def _bound(self, rows: IntArray, columns: IntArray, x: Array, y: Array) -> Window:
        ux, uy = (y[:, c].T @ x[:, c] for c in range(2))
        right = self.reference.along_x.pixels.start + columns[None, :] + ux
        down = rows[:, None] + uy
        lower, upper = np.floor([right.min(), down.min()]), np.ceil([right.max(), down.max()])
        window = Window.between(lower, upper + 1).grow(PADDING[self.deformed.degree])
        clipped = window.intersection(self.reference.extent)
        # Where nothing of it is in the image, any window will do: no pixel counts.
        return clipped if clipped.n_pixels else Window.of_size(1, 1)
