"""What chapters about lines share: residuals in per cent of the dynamic range, openings along a line, points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

import ddic

Array = NDArray[np.float64]

BAND = 2.0
"""Standard deviations on either side of a curve."""

BLOCK = 4
"""Side, pixels, of the squares whose root mean square residual is one point of a map."""

BRIGHTEST = 99.5
"""Percentile of a map at which its colours end."""


def find_dynamic_range(image: NDArray[Any]) -> float:
    """Find the largest grey level of an image less its least one."""
    return float(image.max()) - float(image.min())


def describe_noise(noise: float, image: NDArray[Any]) -> str:
    """Say what noise of both images, of that many grey levels of 256, leaves at whole pixels."""
    levels = noise / 255.0 * float(np.iinfo(image.dtype).max)
    return f"noise alone leaves {100.0 * levels * np.sqrt(2.0) / find_dynamic_range(image):.2f} % at whole pixels"


def find_residual(result: ddic.Result) -> Array:
    """Read the residual image, grey levels, nan where no pixel counts."""
    image = result.residual_image
    if image is None:
        raise RuntimeError("a result without a residual image; leave output.residual_image on")
    return image.astype(np.float64)


def measure_residual(result: ddic.Result, image: NDArray[Any]) -> float:
    """Measure the residual's standard deviation in per cent of the reference image's dynamic range."""
    return 100.0 * float(np.nanstd(find_residual(result))) / find_dynamic_range(image)


def draw_residuals(results: Mapping[str, ddic.Result], image: NDArray[Any]) -> Figure:
    """Draw maps of the residual, per cent of the dynamic range, beside each other, with the same colours."""
    maps = {name: _average_squares(find_residual(result)) * 100.0 / find_dynamic_range(image)
            for name, result in results.items()}
    largest = float(np.nanpercentile(np.concatenate([one.ravel() for one in maps.values()]), BRIGHTEST))
    figure = Figure(figsize=(4.4 * len(maps), 4.2), layout="constrained")
    for axes, (name, values) in zip(figure.subplots(1, len(maps), squeeze=False)[0], maps.items(), strict=True):
        height, width = BLOCK * np.array(values.shape) - 0.5
        shown = axes.imshow(values, cmap="viridis", vmin=0.0, vmax=largest, extent=(-0.5, width, height, -0.5))
        axes.set(title=f"{name}: {measure_residual(results[name], image):.2f} %", xlabel="x [px]", ylabel="y [px]")
    figure.colorbar(shown, ax=figure.axes, label="RMS residual [% of the dynamic range]", extend="max")
    return figure


def _average_squares(residual: Array) -> Array:
    """Root of the mean square over squares of BLOCK pixels; nan where none of their pixels counts."""
    rows, columns = (n - n % BLOCK for n in residual.shape)
    squares = residual[:rows, :columns].reshape(rows // BLOCK, BLOCK, columns // BLOCK, BLOCK) ** 2
    n_pixels = np.isfinite(squares).sum(axis=(1, 3))
    return np.where(n_pixels > 0, np.sqrt(np.nansum(squares, axis=(1, 3)) / np.maximum(n_pixels, 1)), np.nan)


@dataclass(frozen=True, eq=False)
class OpeningCurve:
    """One component of an opening along a line, what noise leaves in it, and what is known of it, (n,) each, pixels."""

    distance: Array
    values: Array
    sigma: Array | None
    known: Array

    def keep(self, places: NDArray[np.bool_]) -> OpeningCurve:
        """Keep some places, (n,)."""
        sigma = None if self.sigma is None else self.sigma[places]
        return OpeningCurve(self.distance[places], self.values[places], sigma, self.known[places])

    def count_within(self) -> float:
        """Share of places that are known within BAND standard deviations."""
        if self.sigma is None:
            return float("nan")
        return float(np.nanmean(np.abs(self.values - self.known) <= BAND * self.sigma))

    @property
    def rms_error(self) -> float:
        """RMS difference to what is known, pixels."""
        return float(np.sqrt(np.nanmean((self.values - self.known) ** 2)))

    @property
    def rms_sigma(self) -> float:
        """RMS standard deviation, pixels."""
        return float("nan") if self.sigma is None else float(np.sqrt(np.nanmean(self.sigma**2)))

    def describe(self) -> str:
        """Say how well it is known."""
        return (f"{self.rms_error:.4f} px RMS error, {self.rms_sigma:.4f} px told; {self.count_within():.0%} of the "
                f"places within {BAND:g} standard deviations")

    def draw(self, axes: Axes, colour: str, label: str) -> None:
        """Draw it with its band, and what is known."""
        axes.plot(self.distance, self.values, color=colour, linewidth=1.2, label=label)
        if self.sigma is not None:
            axes.fill_between(self.distance, self.values - BAND * self.sigma, self.values + BAND * self.sigma,
                              color=colour, alpha=0.25, linewidth=0.0)
        # What is known of several curves is one entry of the legend.
        is_named = "known" in axes.get_legend_handles_labels()[1]
        axes.plot(self.distance, self.known, color="black", linewidth=0.8, linestyle="--",
                  label="_known" if is_named else "known")
        axes.set(xlabel="distance along the line [px]")
        axes.grid(alpha=0.25)
        axes.legend(fontsize="small")


def compare_opening(opening: ddic.Opening, known: Array, distance: Array) -> dict[str, OpeningCurve]:
    """Compare both components with those known, (n, 2), tangential and normal, at distances (n,) along the line."""
    return {"along": OpeningCurve(distance, opening.tangential, opening.sigma_tangential, known[:, 0]),
            "across": OpeningCurve(distance, opening.normal, opening.sigma_normal, known[:, 1])}


def draw_openings(curves: Mapping[str, OpeningCurve], what: str) -> Figure:
    """Draw both components, one panel below the other."""
    figure = Figure(figsize=(6.4, 5.2), layout="constrained")
    for axes, (name, curve), colour in zip(figure.subplots(len(curves), 1), curves.items(),
                                           ("tab:orange", "tab:blue"), strict=True):
        curve.draw(axes, colour, f"{what} {name} the line, with {BAND:g} standard deviations")
        axes.set_ylabel(f"{what} {name} [px]")
    return figure
