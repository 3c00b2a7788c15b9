"""Two methods beside each other, by size of the region."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure


def draw_comparison(sides: Sequence[float], found: Mapping[str, Sequence[Mapping[str, float]]]) -> Figure:
    """Draw CPU times of PGD-DIC and Q4 R-DIC, and how far their displacements are apart, as Fig. 17 of [PP12].

    Parameters
    ----------
    sides : sequence of float
        Of the region, pixels.
    found : mapping of sequence of mapping
        By kind of images, for each side: ``pgd_cpu_s``, ``q4_cpu_s``, ``difference_px``, ``pgd_error_px``,
        ``q4_error_px``.

    Returns
    -------
    Figure
        The page.
    """
    figure = Figure(figsize=(9.0, 5.0), layout="tight")
    times, apart = figure.subplots(1, 2)
    for style, (kind, of_sides) in zip(("-", "--", ":"), found.items(), strict=False):
        for axes, keys in ((times, {"pgd_cpu_s": "PGD-DIC", "q4_cpu_s": "Q4 R-DIC, dual solver"}),
                           (apart, {"difference_px": "difference", "pgd_error_px": "error of PGD-DIC",
                                    "q4_error_px": "error of Q4 R-DIC"})):
            for colour, (key, label) in zip(("tab:blue", "tab:orange", "tab:green"), keys.items(), strict=False):
                axes.loglog(sides, [one[key] for one in of_sides], style, color=colour, marker="o", markersize=3,
                            linewidth=1.4, label=f"{label}, {kind}")
    times.set_ylabel("CPU time [s]")
    apart.set_ylabel("RMS displacement [px]")
    for axes in (times, apart):
        axes.set_xlabel("side of the region [px]")
        axes.grid(which="both", alpha=0.25)
        axes.set_xticks(list(sides), [f"{side:g}" for side in sides])
        axes.set_xticks([], minor=True)
        axes.legend(fontsize="x-small", loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2)
    return figure
