"""Clean pairs, which pay nothing for what is looked for in spoilt ones.

Whole commands beside an older commit, and other programs, are measured on a quiet machine alone: these rows compare
times.
"""

from __future__ import annotations

from functools import partial
from statistics import median

from accept.support.clean_pairs import (
    EQUAL_PX,
    HELD_OFF,
    LARGE,
    MORE_ITERATIONS,
    MOST_PIXELS,
    SMALL,
    WORSE,
    Compared,
    compare_all,
    list_cases,
)
from accept.table import Scale
from bench import before, peers
from bench.support.before import COMMIT
from bench.support.peer_environment import peers_are_there
from bench.support.rows import Row, append_result

LEAST_DEFAULT, LEAST_QUICKEST = 8.0, 4.0
"""CPU seconds of pyvale over ddic's, by its default search and by its quickest."""

NOISES = (0, 2)
"""Of the pairs, grey levels."""

MOST_OF_BEFORE = {"beam": (0.8, 0.7, 0.9), "tension": (0.8, 0.7, 0.9), "waves": (0.8, 0.7, 0.9),
                  "demo": (0.9, 0.9, 1.0), "openhole": (0.9, 0.9, 1.0)}
"""Wall time, CPU time and memory of the whole command, times those of the older commit."""

ROUNDS = 3
"""Times that every program runs, in turn."""


def measure_pyvale(scale: Scale) -> list[Row]:
    """Compare CPU seconds with pyvale's default and quickest search, alternated."""
    if scale.smoke and not peers_are_there():
        alone = peers.measure_ddic(peers.warm_up_pair(), peers.WAVELENGTH, 1, peers.METHODS["pyvale"])
        return [Row("pyvale: ddic alone", "runs", f"{alone.seconds:.2f} CPU s", True, judged_small=False)]
    # Compiles what the first measured job would else compile.
    peers.measure_ddic(peers.warm_up_pair(), peers.WAVELENGTH, 1, peers.METHODS["pyvale"])
    return [_compare(noise, scale) for noise in (NOISES[:1] if scale.smoke else NOISES)]


def _compare(noise: int, scale: Scale) -> Row:
    pair = peers.image_pair(*peers.SIZES["tiny" if scale.smoke else "29mpx"], noise)
    case = f"{pair.width} x {pair.height} px, 8 bit, noise {noise} grey levels"
    programs = {"ddic": partial(peers.measure_ddic, pair, peers.WAVELENGTH, 1, peers.METHODS["pyvale"]),
                "default": partial(peers.pyvale, pair, peers.SUBSETS),
                "quickest": partial(peers.pyvale, pair, peers.QUICK_SUBSETS)}
    runs = peers.alternate(case, programs, ("ddic", "default", "ddic", "quickest"), 1 if scale.smoke else ROUNDS)
    own, default, quickest = (median(run.seconds for run in runs[name]) for name in programs)
    error, most = runs["ddic"][-1].error, peers.MOST_ERROR[noise]
    append_result("clean_runs", {"case": case, "ddic": own, "default": default, "quickest": quickest, "error": error})
    counts = ", ".join(str(len(runs[name])) for name in programs)
    return Row(f"pyvale, subsets of 31 px, step 16, {case}; ddic: {peers.ELEMENT}-px Q4, l_c = {peers.WAVELENGTH} px: "
               "CPU of its default and of its quickest search over ddic's",
               f"at least {LEAST_DEFAULT:g} and {LEAST_QUICKEST:g} times at an RMS error of at most {most} px",
               f"{default / own:.1f} and {quickest / own:.1f} times ({own:.2f}, {default:.1f} and "
               f"{quickest:.1f} CPU s of ddic, default and quickest, medians of {counts}); RMS error {error:.5f} px",
               default >= LEAST_DEFAULT * own and quickest >= LEAST_QUICKEST * own and error <= most,
               judged_small=False)


def measure_whole_commands(scale: Scale) -> list[Row]:
    """Compare the whole command with the older commit's, alternated."""
    if scale.smoke:
        return [Row(f"tiny beside {COMMIT}", "runs", before.compare("tiny", rounds=1).describe(), True,
                    judged_small=False)]
    rows = []
    for name, (wall, cpu, memory) in MOST_OF_BEFORE.items():
        found = before.compare(name)
        rows.append(Row(f"whole command on {name}, 2 ranks, beside {COMMIT}, alternated", f"at most {wall:g}, "
                        f"{cpu:g} and {memory:g} times its wall time, CPU time and memory", found.describe(),
                        found.wall <= wall and found.cpu <= cpu and found.memory <= memory, judged_small=False))
    return rows


SMOKE_PAIRS = (("waves", 64.0, 2.0), ("hole", None, 0.0), ("neck", 128.0, 2.0))
"""Field, l_c and noise of the pairs of a smoke run."""


def measure_pairs(scale: Scale) -> list[Row]:
    """Measure clean pairs by defaults and with every pixel kept."""
    cases = list_cases(SMALL if scale.smoke else LARGE)
    if scale.smoke:
        cases = [case for case in cases if (case.field, case.cut_off, case.noise) in SMOKE_PAIRS]
    found = list(compare_all(cases))
    for compared in found:
        append_result("clean_runs", {**vars(compared), "misses": compared.misses})
    missed = [compared.tell() for compared in found if compared.misses]
    what = ("waves, a plate with a hole, beside a crack, a neck, waves turned by 10 degrees; l_c none, 64, 80, 128 px; "
            "noise 0, 2, 5; three speckles")
    bound = (f"no cell excluded, at most {MOST_PIXELS:g} of the pixels; equal to {EQUAL_PX:g} px where keeping is off "
             f"by less than {HELD_OFF:g} px everywhere, else RMS error at most {WORSE} times; iterations at most "
             f"{MORE_ITERATIONS} times and 3 more")
    return [Row(f"{len(cases)} clean pairs, by defaults and with every pixel kept: {what}", bound,
                "; ".join([_sum_up(found), *missed]), not missed)]


def _sum_up(found: list[Compared]) -> str:
    measured = [compared for compared in found if not compared.refusal]
    n_held_off = sum(compared.largest_keep >= HELD_OFF for compared in measured)
    n_hold = sum(not compared.misses for compared in found)
    n_cells = sum(compared.n_excluded for compared in measured)
    n_pixels = sum(compared.n_pixels_lost for compared in measured)
    most = max((compared.iterations for compared in measured), default=0)
    return (f"{n_hold} of {len(found)} hold, {len(found) - len(measured)} could not be measured; {n_held_off} are held "
            f"off by {HELD_OFF:g} px or more; {n_cells} cells and {n_pixels} pixels excluded in all; at most {most} "
            "iterations")
