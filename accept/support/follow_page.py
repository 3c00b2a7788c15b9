"""Do what a page says, word by word, in a copy of the repository, and compare what is printed.

Usage: python -m accept.support.follow_page FOLDER PAGE ...: FOLDER is the copy, each PAGE relative to it: Markdown, or
a script whose docstring says how it is run. Needs nothing but Python: a page may be the one that installs the rest.

Blocks of a page that a reader types, runs or saves, and what the page says that they print:

- ```` ```sh ```` is typed into a shell, block after block. Where its first line is a comment that says what it
  ``needs``, it is left out unless that is there.
- ```` ```text ```` of lines that begin with ``$``: commands, each followed by all that it prints.
- ```` ```python ```` is run; blocks without commands between them are one program. What one ``needs`` is as above.
- ``<!-- file: NAME -->`` above a block: it is saved as NAME.
- ```` ```text ```` after a line that ends in "prints": the last lines that the block before it prints.
- ``<!-- differs: WORD, WORD -->`` above it: numbers of these units differ from run to run.

All other blocks are only read.
"""

from __future__ import annotations

import ast
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from decimal import Decimal
from itertools import groupby, zip_longest
from pathlib import Path
from typing import Literal

NUMBER = re.compile(r"-?(?<![A-Za-z])\d+(?:\.\d+)?(?:e[-+]\d+)?")

_ROUNDING = 1e-9
"""Difference of two numbers of rounding errors, which have no digits to compare: that to which methods agree, px."""


def allow_difference(number: str) -> float:
    """Give the difference that a printed number may have from the one that a page shows.

    Three units of its last digit; none where it is whole, for it is counted or chosen. Images come from fixed seeds;
    libraries and partitions move a field by less than Gauss-Newton's tolerance, an RMS of 1e-4 px.
    """
    if "." not in number:
        return _ROUNDING if "e" in number else 0.0
    exponent = Decimal(number).as_tuple().exponent
    if not isinstance(exponent, int):
        raise TypeError(f"{number} is no finite number")
    return 3.0 * 10.0**exponent


def find_differences(printed: str, shown: str, differs: Sequence[str] = ()) -> list[str]:
    """Compare what was printed with what a page shows, line by line; "..." stands for anything."""
    differences = []
    columns: list[int] = []
    for found, expected in zip_longest(_lines(printed, differs), _lines(shown, differs), fillvalue=""):
        headings = re.split(r"  +", expected.strip())
        if len(headings) > 2 and set(headings) & set(differs):
            columns = [place - len(headings) for place, heading in enumerate(headings) if heading in differs]
        if not _agree(_mask(found, differs, columns), _mask(expected, differs, columns)):
            differences.append(f"printed {found.strip()!r}, shown {expected.strip()!r}")
    return differences


def _lines(text: str, differs: Sequence[str]) -> list[str]:
    """Lines but those that say no more than that something took some seconds."""
    units = "|".join(re.escape(word) for word in differs)
    only = re.compile(rf"[^:]+: {NUMBER.pattern} (?:{units})" if units else r"(?!)")
    return [line for line in text.rstrip().splitlines() if not only.fullmatch(line)]


def _mask(line: str, differs: Sequence[str], columns: Sequence[int]) -> str:
    """A line without the numbers that may differ, and with single blanks."""
    label = line.partition(":")[0]
    if any(re.search(rf"(?<!\w){re.escape(word)}(?!\w)", label) for word in differs) and ":" in line:
        return NUMBER.sub("*", " ".join(line.split()))
    words = line.split()
    if columns and words and all(NUMBER.fullmatch(word) for word in words):
        for column in columns:
            words[column] = "*"
    masked = " ".join(words)
    for word in differs:
        masked = re.sub(rf"{NUMBER.pattern} {re.escape(word)}(?![\w/])", f"* {word}", masked)
    return masked


def _agree(found: str, expected: str) -> bool:
    pattern = ".*".join(re.escape(NUMBER.sub("#", part)) for part in expected.split("..."))
    if not re.fullmatch(pattern, NUMBER.sub("#", found)):
        return False
    if "..." in expected:
        return True
    numbers = zip(NUMBER.findall(found), NUMBER.findall(expected), strict=True)
    return all(abs(float(a) - float(b)) <= allow_difference(b) for a, b in numbers)


Kind = Literal["sh", "console", "python", "file"]

FENCE = re.compile(r"^(?P<indent> *)```(?P<language>\w*)[^\n]*\n(?P<text>.*?)^(?P=indent)```$",
                    re.MULTILINE | re.DOTALL)
_MARK = re.compile(r"<!-- (file|differs): (.+?) -->\s*$")


@dataclass(frozen=True)
class Block:
    """Something to do on a page.

    Attributes
    ----------
    kind : str
        "sh", "console", "python" or "file".
    text : str
        What is typed, run or saved.
    line : int
        Of the page, from 1.
    needs : str
        What has to be there, "" for nothing.
    file : str
        Name under which it is saved.
    shown : str or None
        What the page says that it prints.
    differs : tuple of str
        Units of numbers that differ from run to run.
    """

    kind: Kind
    text: str
    line: int
    needs: str = ""
    file: str = ""
    shown: str | None = None
    differs: tuple[str, ...] = ()


def read_blocks(page: Path) -> list[Block]:
    """Read what there is to do on a page, in order."""
    text = page.read_text(encoding="utf-8")
    blocks: list[Block] = []
    end = 0
    for found in FENCE.finditer(text):
        before = text[end:found.start()]
        end = found.end()
        content = re.sub(rf"^{found['indent']}", "", found["text"], flags=re.MULTILINE)
        line = text.count("\n", 0, found.start()) + 1
        marks = dict(_MARK.findall(before.rstrip(" ")))
        differs = tuple(word.strip() for word in marks.get("differs", "").split(",")) if "differs" in marks else ()
        spoken = re.sub(r"<!--.*?-->", "", before, flags=re.DOTALL).rstrip().rstrip(":")
        if "file" in marks:
            blocks.append(Block("file", content, line, file=marks["file"]))
        elif found["language"] == "text" and content.startswith("$ "):
            blocks += _split_console(content, line, differs)
        elif found["language"] == "text" and spoken.endswith("prints") and blocks:
            blocks[-1] = replace(blocks[-1], shown=content, differs=differs)
        elif found["language"] == "sh":
            blocks.append(Block("sh", content, line, needs=_find_needs(content)))
        elif found["language"] == "python":
            blocks.append(Block("python", content, line, needs=_find_needs(content)))
    return blocks


def read_script(path: Path) -> list[Block]:
    """Read how a script's docstring says that it is run, and what it prints."""
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    *_, last = docstring.split("\n\n")
    shown = "".join(f"{line.strip()}\n" for line in last.splitlines())
    commands = re.findall(r"^    (.*\bpython .*\.py.*)$", docstring, re.MULTILINE)
    # What stands in brackets may be left out.
    return [Block("console", re.sub(r" \[.*?\]", "", command) + "\n", 1, shown=shown) for command in commands]


def _find_needs(content: str) -> str:
    first = content.partition("\n")[0]
    return first.partition("needs")[2].strip() if first.startswith("#") else ""


def _split_console(content: str, line: int, differs: tuple[str, ...]) -> list[Block]:
    parts = re.split(r"^\$ ", content, flags=re.MULTILINE)[1:]
    commands = [part.partition("\n") for part in parts]
    return [Block("console", f"{command}\n", line, shown=shown, differs=differs) for command, _, shown in commands]


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
    """Do what a page says in a shell of its own, begun in the copy; an example's page ends as ``printed.txt`` says."""
    is_script = page.endswith(".py")
    blocks = read_script(folder / page) if is_script else read_blocks(folder / page)
    here = [block for block in blocks if _is_here(block.needs)]
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


def _is_here(needs: str) -> bool:
    """Whether what a block needs is there."""
    return (not needs or (needs == "root" and os.geteuid() == 0)
            or (needs == "real images in ~/images" and (Path.home() / "images").is_dir()))


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
    """Do what several pages say, one after the other."""
    each = [follow_page(folder, page) for page in pages]
    return Followed(sum(one.commands for one in each), sum(one.numbers for one in each),
                    [line for one in each for line in one.left_out], [line for one in each for line in one.faults])


if __name__ == "__main__":
    print(json.dumps(asdict(follow_pages(Path(sys.argv[1]).resolve(), sys.argv[2:]))))
