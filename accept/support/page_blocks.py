"""Blocks of a page that a reader types, runs or saves, and what the page says that they print.

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
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

Kind = Literal["sh", "console", "python", "file"]

_FENCE = re.compile(r"^(?P<indent> *)```(?P<language>\w*)[^\n]*\n(?P<text>.*?)^(?P=indent)```$",
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
    """Read what there is to do on a page, in order.

    Parameters
    ----------
    page : Path
        Markdown.

    Returns
    -------
    list of Block
        One for each block that is typed, run or saved, consoles a command each.
    """
    text = page.read_text(encoding="utf-8")
    blocks: list[Block] = []
    end = 0
    for found in _FENCE.finditer(text):
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
    """Read how a script's docstring says that it is run, and what it prints.

    Parameters
    ----------
    path : Path
        Python, whose docstring ends in the lines that it prints, indented.

    Returns
    -------
    list of Block
        One for each command.
    """
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
