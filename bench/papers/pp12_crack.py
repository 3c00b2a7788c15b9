"""An inclined crack on the 16-px elements of [PP12]: corrections of PGD-DIC beside iterations of Q4-DIC, error maps."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import ddic
from bench.papers.compared import UNREAD, Compared
from bench.papers.pp12_corrections import ETA, count_below, describe_count, measure_q4
from bench.support.error_maps import MapRow, draw_maps
from bench.support.opened_pair import Crack
from bench.support.separated_cases import (
    ELEMENT,
    PUBLISHED,
    REGION,
    SIZE,
    list_pixels,
    measure_pgd,
    measure_rms,
    render,
)
from ddic.plots.canvas import save_figure

NAME = "pp12_crack"

TIP = (250.3, 250.7)
"""Near the middle of the region, pixels."""

PAPER, PAPER_Q4 = 81, 25
"""Corrections of [PP12], and its iterations of Q4-DIC."""

RUNS: dict[str, dict[str, Any]] = {
    "published": {**PUBLISHED, "max_corrections": 400},
    "with update": {**PUBLISHED, "update": True},
    "default": {},
}


def draw_corrections(found: Mapping[str, ddic.Result]) -> Figure:
    """Draw eta against the number of corrections for each way to find them."""
    figure = Figure(figsize=(6.0, 3.8), layout="tight")
    axes = figure.subplots()
    for (name, result), style in zip(found.items(), ("o-", "s-", "^-"), strict=False):
        table = result.corrections
        axes.semilogy(table["correction"], table["relative"], style, markersize=3, linewidth=1.2, label=name)
    axes.axhline(ETA, color="tab:grey", linewidth=0.8)
    axes.set(xlabel="correction [-]", ylabel="eta, both components together [-]")
    axes.grid(which="both", alpha=0.25)
    axes.legend(fontsize="small")
    return figure


def draw_fields(crack: Crack, fields: Mapping[str, ddic.Result]) -> Figure:
    """Draw u_y as it is and as measured, and what the measurements err by."""
    points, n = list_pixels(), int(REGION[3] - REGION[1])
    known = crack.displacement(points)
    measured = {name: result.at(points) for name, result in fields.items()}
    shown = {"known": known, **measured}
    return draw_maps(
        [MapRow("u_y [px]", {name: u[:, 1].reshape(n, n) for name, u in shown.items()}, signed=False),
         MapRow("error of u_y [px]", {name: (u - known)[:, 1].reshape(n, n) for name, u in measured.items()})], REGION)


def measure(folder: Path, *, smoke: bool) -> list[Compared]:
    """Measure the crack by each way to find corrections, and by Q4-DIC; a smoke run leaves out the update."""
    crack = Crack(tip=np.array(TIP))
    pair, points = render(crack, "float", SIZE), list_pixels()
    known = crack.displacement(points)
    found = {name: measure_pgd(pair, ELEMENT, pgd) for name, pgd in RUNS.items()
             if not (smoke and name == "with update")}
    q4 = measure_q4(pair, ELEMENT)
    save_figure(draw_corrections(found), folder / f"{NAME}_eta.png")
    save_figure(draw_fields(crack, {"PGD-DIC, published": found["published"], "PGD-DIC by default": found["default"],
                                    "Q4-DIC": q4}), folder / f"{NAME}_errors.png")
    setting = (f"gradient noise, 500 x 500 px, float images, region of 304 x 304 px, crack in mode I at "
               f"{np.rad2deg(crack.angle):.0f} degrees with its tip in the middle, {ELEMENT}-px elements, from a rigid "
               "translation, line not known")
    other_crack = "the images, and the crack's angle and opening, are chosen here"
    rows = []
    for name, result in found.items():
        table = result.corrections
        n, n_eta = len(table["correction"]), count_below(table["relative"])
        is_published = name == "published"
        rows.append(Compared(
            "[PP12, crack]", f"corrections, {name}", setting, f"{PAPER}" if is_published else "no such variant",
            f"{n} until it ends by itself, eta < {ETA:g}: {describe_count(n_eta)}", other_crack if is_published else "",
            f"at most {PAPER}" if is_published else "", n <= PAPER or not is_published, judged_small=True))
    errors = "; ".join(f"{name} {measure_rms(result.at(points) - known):.4f} px" for name, result in found.items())
    return [*rows,
            Compared("[PP12, crack]", "iterations of Q4-DIC", setting, f"{PAPER_Q4}",
                     f"{len(q4.gauss_newton['iteration'])}", other_crack),
            Compared("[PP12, crack]", "RMS error of the displacement", setting, UNREAD,
                     f"{errors}; Q4-DIC {measure_rms(q4.at(points) - known):.4f} px",
                     "most of it in elements that the crack cuts")]
