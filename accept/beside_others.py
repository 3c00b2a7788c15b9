"""CPU seconds on the 29-megapixel pair beside pyvale's, and the whole command beside that of an older commit."""

from __future__ import annotations

from functools import partial
from statistics import median

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
    """Compare CPU seconds with pyvale's default and quickest search, alternated.

    Parameters
    ----------
    scale : Scale
        A smoke run takes a small pair once, and ddic alone where the peers are not installed.

    Returns
    -------
    list of Row
        One for each noise.
    """
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
    """Compare the whole command with the older commit's, alternated.

    Parameters
    ----------
    scale : Scale
        A smoke run takes a tiny case once.

    Returns
    -------
    list of Row
        One for each case.
    """
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
