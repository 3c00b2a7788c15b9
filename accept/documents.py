"""The documents: every code block is run or checked, every figure drawn anew by its command, every link followed."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import urllib.error
import urllib.request
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from accept.pages import MOST_FAULTS, PRINTED, SMALL, build_site, copy_repository, list_pages, measure_followed
from accept.support.follow_page import FENCE
from accept.support.unrun_blocks import ONLY_READ, find_faults, list_unrun
from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import ROOT, environment

DRAWING_S = 1800
"""Seconds in which all figures are drawn, else something hangs."""

ANSWER_S = 20
"""Seconds in which a site answers."""

UNLIKE = {"pgd_against_dual"}
"""Figures that never look the same: they show times."""


def measure_documents(scale: Scale) -> list[Row]:
    """Follow the documents, check what is not run, draw the figures, follow the links."""
    documents = [ROOT / page for page in list_pages() if page.endswith(".md")]
    rows = [_measure_unrun(documents), _measure_outer_links(documents)]
    if scale.smoke:
        return [measure_followed("this user", SMALL, (), link=True), *rows]
    return [measure_followed("this user", list_pages(), ()), *rows, _measure_figures(), build_site()]


def _measure_unrun(documents: list[Path]) -> Row:
    """Check the blocks that are not run, and the commands and names in sentences."""
    unrun = {page.relative_to(ROOT).as_posix(): list_unrun(page) for page in documents}
    n_all = sum(len(FENCE.findall(page.read_text(encoding="utf-8"))) for page in documents)
    n_unrun = sum(map(len, unrun.values()))
    checked = Counter(block.language for blocks in unrun.values() for block in blocks)
    needs = [f"{page}:{block.line} {block.needs}" for page, blocks in unrun.items() for block in blocks if block.needs]
    faults = [fault for page in documents for fault in find_faults(page)]
    return Row(f"{n_all} code blocks of {len(documents)} documents: {n_unrun} that are not run, read by the schema of "
               "cases, bash, ddic's commands and Python",
               "no fault",
               f"{len(faults)} ({_show(faults)}); " + ", ".join(f"{n} {name}" for name, n in sorted(checked.items()))
               + f"; of these need what may not be here: {'; '.join(needs)}; only read: "
               + "; ".join(f"{place} ({why})" for place, why in ONLY_READ.items()), not faults)


def _measure_figures() -> Row:
    """Draw all figures in a copy of the repository, and see which look otherwise than those kept."""
    with tempfile.TemporaryDirectory() as outer:
        folder = copy_repository(Path(outer) / "ddic")
        source = os.pathsep.join([str(folder / "src"), str(folder)])
        changes = {"PYTHONPATH": source, "DDIC_BENCH_DATA": f"{outer}/data"}
        done = subprocess.run([sys.executable, "scripts/tour_pictures.py"], cwd=folder, env=environment(changes),
                              text=True, capture_output=True, timeout=DRAWING_S, check=False)
    replaced = re.findall(r"^replaced: (.*)$", done.stdout, re.MULTILINE)
    left = re.findall(r"^left as .*$", done.stdout, re.MULTILINE)
    n_kept = len(list((ROOT / "docs" / "pictures").iterdir()))
    shown = (f"exit code {done.returncode}: {done.stderr[-PRINTED:]}" if done.returncode
             else "; ".join([f"others: {', '.join(replaced) or 'none'}", *left]))
    return Row(f"{n_kept} figures of the documents, drawn anew (make pictures)",
               f"look as before, but for {', '.join(UNLIKE)}", shown,
               done.returncode == 0 and set(replaced) <= UNLIKE)


def _measure_outer_links(documents: list[Path]) -> Row:
    """Ask for every page of others that the documents name; where no site answers there is no network."""
    links = sorted({link for page in documents for link in list_outer_links(page)})
    found = {link: _ask(link) for link in links}
    dead = [f"{link}: {answer}" for link, answer in found.items() if answer.isdigit() and int(answer) >= 400]
    silent = [f"{link}: {answer}" for link, answer in found.items() if not answer.isdigit()]
    alone = len(silent) == len(links)
    shown = f"not asked: no network here ({silent[0]})" if alone else _show([*dead, *silent])
    return Row(f"{len(links)} links of the documents to other sites", "all answer, where there is a network", shown,
               alone or not (dead or silent))


def list_outer_links(page: Path) -> Iterator[str]:
    """List addresses of other sites on a page."""
    for link in re.findall(r"https?://[^\s<>`\"'\])]+", page.read_text(encoding="utf-8")):
        if "localhost" not in link:
            yield link.rstrip(".,;:")


def _ask(link: str) -> str:
    """Status that a site answers with, or why it does not."""
    request = urllib.request.Request(link, headers={"User-Agent": "Mozilla/5.0"})
    try:
        with urllib.request.urlopen(request, timeout=ANSWER_S) as answer:
            return str(answer.status)
    except urllib.error.HTTPError as error:
        return str(error.code)
    except OSError as error:
        return str(getattr(error, "reason", error))


def _show(faults: list[str]) -> str:
    return "; ".join(faults[:MOST_FAULTS]) or "none"
