"""Draw chapters and bring docs/papers.md up to date; see the package.

Usage: python -m bench.papers [--smoke] [--only-measure] [NAME ...]
"""

from __future__ import annotations

import argparse
import importlib
import re
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from bench.papers.compared import Compared, format_tables
from bench.support.rows import show
from bench.support.runs import DATA, ROOT
from scripts.tour_pictures import keep_picture

PAGE = ROOT / "docs" / "papers.md"

CHAPTERS = ("bp17_beam", "bp17_preconditioner", "bp17_near_far", "bp17_minres", "pp12_corrections", "pp12_elements",
            "pp12_crack", "pp12_pixels", "rhr08_bolted", "rhr08_bands", "rrh07_crack")
"""Modules here, in the order of docs/papers.md, where each has its place between <!-- NAME --> and <!-- end -->."""


def find_folder(name: str, *, smoke: bool) -> Path:
    """Give the folder of a chapter's pictures and of what it runs."""
    folder = DATA / "smoke" / "papers" / name if smoke else DATA / "papers" / name
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def measure(name: str, *, smoke: bool = False) -> list[Compared]:
    """Measure and draw a chapter."""
    found: list[Compared] = importlib.import_module(f"bench.papers.{name}").measure(find_folder(name, smoke=smoke),
                                                                                    smoke=smoke)
    return found


def put_into_page(text: str, name: str, found: Sequence[Compared]) -> str:
    """Replace the tables of a chapter in the text of the page."""
    place = re.compile(rf"(<!-- {name} -->\n).*?(<!-- end -->)", re.DOTALL)
    if not place.search(text):
        raise RuntimeError(f"{PAGE}: has no <!-- {name} --> and <!-- end --> between which its tables stand")
    return place.sub(lambda ends: f"{ends[1]}{format_tables(found)}\n{ends[2]}", text, count=1)


def keep(name: str, found: Sequence[Compared]) -> None:
    """Put a chapter's pictures, those that look otherwise than before, and its tables into the documentation."""
    for drawn in sorted(find_folder(name, smoke=False).glob(f"{name}*.png")):
        if not drawn.name.endswith(".small.png"):
            for replaced in keep_picture(drawn, drawn.stem):
                print(f"       drawn     {replaced.relative_to(ROOT)}")
    PAGE.write_text(put_into_page(PAGE.read_text(encoding="utf-8"), name, found), encoding="utf-8")


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.papers", description="the papers' figures and tables")
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(CHAPTERS))
    parser.add_argument("--smoke", action="store_true", help="tiny cases; the documentation stays as it is")
    parser.add_argument("--only-measure", action="store_true", help="the documentation stays as it is")
    chosen = parser.parse_args()
    unknown = sorted(set(chosen.names) - set(CHAPTERS))
    if unknown:
        parser.error(f"no such chapter: {', '.join(unknown)}; there are: {', '.join(CHAPTERS)}")
    held = True
    for name in chosen.names or CHAPTERS:
        begin = time.perf_counter()
        found = measure(name, smoke=chosen.smoke)
        for one in found:
            show(one.to_row())
            held &= one.holds or chosen.smoke
        print(f"       {name}: {time.perf_counter() - begin:.0f} s", flush=True)
        if not (chosen.smoke or chosen.only_measure):
            keep(name, found)
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
