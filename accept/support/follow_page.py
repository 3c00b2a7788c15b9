"""Do what a page says, word by word, in a copy of the repository.

Usage: python -m accept.support.follow_page FOLDER PAGE ...: FOLDER is the copy, each PAGE relative to it: Markdown, or
a script whose docstring says how it is run. Needs nothing but Python: a page may be the one that installs the rest.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path

from accept.support.compare_prints import NUMBER, find_differences
from accept.support.page_blocks import Block, read_blocks, read_script

LIMIT_S = 1800
"""Seconds after which a page counts as hanging: the first of all installs everything."""

SETTINGS = (". scripts/mpi_env.sh",)
"""Of mpiexec, before a script that says of itself how it is started."""

_MOST_LINES = 5
"""Last lines of a failed command that a fault shows."""

_BEGIN = "<begin of block {}>"


@dataclass
class Followed:
    """What came of a page, or of several.

    Attributes
    ----------
    commands : int
        Lines of shells and programs that were run.
    numbers : int
        Printed numbers that were compared.
    left_out : list of str
        Blocks that need what is not here.
    faults : list of str
        Commands that failed and lines that differ.
    """

    commands: int
    numbers: int
    left_out: list[str]
    faults: list[str]


def follow_page(folder: Path, page: str) -> Followed:
    """Do what a page says in a shell of its own, begun in the copy; an example's page ends as ``printed.txt`` says.

    Parameters
    ----------
    folder : Path
        The copy.
    page : str
        Name of the page or script in it.

    Returns
    -------
    Followed
        What came of it.
    """
    is_script = page.endswith(".py")
    blocks = read_script(folder / page) if is_script else read_blocks(folder / page)
    here = [block for block in blocks if not block.needs or (block.needs == "root" and os.geteuid() == 0)]
    followed = Followed(0, 0, [f"{page}:{block.line} needs {block.needs}" for block in blocks if block not in here], [])
    if not here:
        return followed
    code, printed = _run_blocks(folder, page, here, SETTINGS if is_script else ())
    parts = _split_output(printed, len(here))
    reached = [(block, part) for block, part in zip(here, parts, strict=True) if part is not None]
    followed.commands = sum(_count_commands(block) for block, _ in reached)
    if code != 0:
        last = [line for line in printed.splitlines() if line.strip()][-_MOST_LINES:]
        line = reached[-1][0].line if reached else here[0].line
        followed.faults.append(f"{page}:{line}: exit code {code}: {' | '.join(last)}")
    for block, part in reached:
        if block.shown is not None:
            _compare(followed, f"{page}:{block.line}", part, block)
    end = (folder / page).with_name("printed.txt")
    if end.is_file() and parts[-1] is not None:
        shown = end.read_text(encoding="utf-8")
        last_lines = "\n".join(parts[-1].splitlines()[-len(shown.splitlines()):])
        _compare(followed, f"{page}: printed.txt", last_lines, Block("console", "", 0, shown=shown))
    return followed


def _run_blocks(folder: Path, page: str, blocks: Sequence[Block], preamble: Sequence[str]) -> tuple[int, str]:
    """Exit code of a shell in which all blocks are run, and what they print."""
    work = folder / ".followed" / page.replace("/", "_")
    work.mkdir(parents=True, exist_ok=True)
    script = work / "script.sh"
    script.write_text(_write_script(blocks, work, preamble), encoding="utf-8")
    with (work / "output.txt").open("w", encoding="utf-8") as output:
        done = subprocess.run(["timeout", str(LIMIT_S), "bash", str(script)], cwd=folder, stdin=subprocess.DEVNULL,
                              stdout=output, stderr=subprocess.STDOUT, check=False)
    return done.returncode, (work / "output.txt").read_text(encoding="utf-8", errors="replace")


def _write_script(blocks: Sequence[Block], work: Path, preamble: Sequence[str]) -> str:
    """A shell script of all blocks, which stops at the first that fails."""
    # What the README says once of all that follows; settings of mpiexec are sourced where a page or an example says so.
    lines = ["set -e -o pipefail", "[[ ! -f .venv/bin/activate ]] || . .venv/bin/activate", *preamble]
    numbered = list(enumerate(blocks))
    for kind, run in groupby(numbered, key=lambda pair: pair[1].kind):
        group = list(run)
        if kind == "python":
            program = work / f"block_{group[0][0]}.py"
            program.write_text("\n".join(f"print({_BEGIN.format(number)!r}, flush=True)\n{block.text}"
                                         for number, block in group), encoding="utf-8")
            lines.append(f"MPLBACKEND=Agg PYVISTA_OFF_SCREEN=true python {shlex.quote(str(program))}")
            continue
        for number, block in group:
            lines.append(f"echo {shlex.quote(_BEGIN.format(number))}")
            if kind == "file":
                lines.append(f"cat >{shlex.quote(block.file)} <<'END OF FILE'\n{block.text}END OF FILE")
            else:
                lines.append(block.text)
    return "\n".join(lines) + "\n"


def _split_output(printed: str, n_blocks: int) -> list[str | None]:
    """What each block printed, None where it was not reached."""
    parts: list[str | None] = [None] * n_blocks
    for number in range(n_blocks):
        mark = _BEGIN.format(number) + "\n"
        if mark in printed:
            parts[number] = printed.partition(mark)[2].partition(_BEGIN.format(number + 1))[0]
    return parts


def _count_commands(block: Block) -> int:
    if block.kind in ("python", "file"):
        return 1
    return sum(bool(line.strip()) and not line.startswith("#") for line in block.text.splitlines())


def _compare(followed: Followed, where: str, printed: str, block: Block) -> None:
    shown = block.shown or ""
    followed.numbers += len(NUMBER.findall(shown))
    followed.faults += [f"{where}: {line}" for line in find_differences(printed, shown, block.differs)]


def follow_pages(folder: Path, pages: Sequence[str]) -> Followed:
    """Do what several pages say, one after the other.

    Parameters
    ----------
    folder : Path
        The copy.
    pages : sequence of str
        Names of the pages in it.

    Returns
    -------
    Followed
        What came of all of them.
    """
    each = [follow_page(folder, page) for page in pages]
    return Followed(sum(one.commands for one in each), sum(one.numbers for one in each),
                    [line for one in each for line in one.left_out], [line for one in each for line in one.faults])


if __name__ == "__main__":
    print(json.dumps(asdict(follow_pages(Path(sys.argv[1]).resolve(), sys.argv[2:]))))
