"""Figures and tables of [BP17], [PP12], [RHR08] and [RRH07] beside ours: every number that ``make papers`` shows."""

from __future__ import annotations

import time

from accept.source_rules import count_code
from accept.table import Scale
from bench.papers.__main__ import CHAPTERS, measure
from bench.support.before import checkout_before
from bench.support.rows import Row

FEWEST_ROWS, MOST_MINUTES = 30, 20
"""Numbers that stand beside the papers'; minutes that all chapters take on two cores."""

CODE_BEFORE, WITH_FIGURES, MOST_MORE = 31_829, "e96c963b", 600
"""Lines of code in src/ of commit 192da243, before the papers' figures were drawn; the commit that has them all; how
many more they may need."""


def measure_figures(scale: Scale) -> list[Row]:
    """Measure and draw every chapter, without touching the documentation."""
    begin, rows = time.perf_counter(), []
    for name in CHAPTERS:
        rows += [one.to_row() for one in measure(name, smoke=scale.smoke)]
    minutes = (time.perf_counter() - begin) / 60
    return [*rows,
            Row("numbers of the four papers that stand beside ours, what differs said", f"at least {FEWEST_ROWS}",
                str(len(rows)), len(rows) >= FEWEST_ROWS, judged_small=False),
            Row("make papers: all chapters measured and drawn", f"at most {MOST_MINUTES} minutes on 2 cores",
                f"{minutes:.1f} minutes", minutes <= MOST_MINUTES, judged_small=False)]


def measure_source(scale: Scale) -> list[Row]:
    """Count what the papers' figures added to the source."""
    more = count_code(checkout_before(WITH_FIGURES) / "src") - CODE_BEFORE
    return [Row("lines of code in src/ more than before the papers' figures", f"at most {MOST_MORE}", str(more),
                more <= MOST_MORE)]
