"""What is wrong with blocks of a page that are not run, and with the commands and names in its sentences.

Blocks that a page has run, and whose output it compares, are ``follow_page``'s. Of all others a case, or a part of one,
is validated by its schema; of commands every word must exist, the command itself and its options, targets of make; of
programs what they name of ddic, with its keywords. The few that are left are listed in ONLY_READ, with the reason.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import shlex
import subprocess
import tempfile
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import click

import ddic
from accept.support.follow_page import FENCE, Block, read_blocks
from accept.tables import TABLES
from bench.support.runs import ROOT
from ddic.case.loader import convert_shorthand, convert_to_case
from ddic.case.schema import Case, find_section, list_sections
from ddic.cli.app import command_line
from ddic.errors import InputError
from ddic.io.mapping_file import read_mapping_file
from ddic.io.text_files import read_point_table
from ddic.probes.probes import parse_probes

ONLY_READ = {
    "docs/faq.md: matlab": "MATLAB is not here",
    "docs/tutorials/page.md: text": "an address with a token, another one each time",
}
"""Blocks that nothing checks, by page and language, and why."""

REST_OF_CASE: dict[str, Any] = {
    "images": {"reference": "f.tif", "deformed": "g.tif"},
    "mesh": {"structured": {"region": [100, 100, 900, 900], "element_size": 16}},
}
"""What a case needs and a part of one leaves out."""

LAUNCHERS = ("mpiexec", "mpirun", "srun")

OF_SIDECAR = {"shape", "type", "byte_order", "offset"}
"""Keys of the file beside raw numbers of a volume."""

PROBES = {"point", "line", "gauge", "extensometer"}


@dataclass(frozen=True)
class Unrun:
    """A block that is not run.

    Attributes
    ----------
    language : str
        Of its fence.
    text : str
        The block.
    line : int
        Of the page, from 1.
    needs : str
        What a command or a program needs that is not here; "" for other blocks.
    """

    language: str
    text: str
    line: int
    needs: str = ""


def list_unrun(page: Path) -> list[Unrun]:
    """List the blocks of a page that are neither run nor output of those that are; files that it has saved too."""
    blocks = {block.line: block for block in read_blocks(page)}
    shown = {block.shown for block in blocks.values()}
    text = page.read_text(encoding="utf-8")
    found = []
    for fence in FENCE.finditer(text):
        line = text.count("\n", 0, fence.start()) + 1
        content = re.sub(rf"^{fence['indent']}", "", fence["text"], flags=re.MULTILINE)
        block: Block | None = blocks.get(line)
        is_output = block is None and content in shown
        if not is_output and (block is None or block.needs or block.kind == "file"):
            found.append(Unrun(fence["language"], content, line, block.needs if block else ""))
    return found


def find_faults(page: Path) -> list[str]:
    """Find what is wrong with the blocks of a page that are not run, and in its sentences: a line each."""
    name = page.relative_to(ROOT).as_posix()
    faults = [f"{name}:{block.line}: {fault}" for block in list_unrun(page)
              if f"{name}: {block.language}" not in ONLY_READ for fault in CHECKS[block.language](block.text)]
    spoken = FENCE.sub("", page.read_text(encoding="utf-8"))
    for code in re.findall(r"`([^`\n]+)`", spoken):
        faults += [f"{name}: `{code}`: {fault}" for fault in find_spoken_faults(code)]
    return faults


def find_spoken_faults(code: str) -> list[str]:
    """Find what is wrong with code in a sentence: a command, a name of ddic, a section or a key of a case."""
    if re.match(r"(ddic|make) ", code):
        return _find_command_faults(code)
    return [*_find_name_faults(code), *_find_key_faults(code)]


def _find_toml_faults(text: str) -> list[str]:
    """Validate a sidecar, a file of probes, a mapping file, or a case, of which only a part may be given."""
    data = tomllib.loads(text)
    if "shape" in data:
        return [f"a sidecar has no key {key}" for key in data if key not in OF_SIDECAR]
    try:
        if PROBES.issuperset(data):
            parse_probes(text, Path("probes.toml"))
        elif "homography" in data:
            _read_as_file(read_mapping_file, text)
        else:
            name = "volumes" if "volumes" in data else "images"
            images = {**REST_OF_CASE["images"], **data.get(name, {})}
            convert_to_case({"mesh": REST_OF_CASE["mesh"], **convert_shorthand(data), name: images}, "case.toml")
    except InputError as error:
        return str(error).splitlines()
    return []


def _find_table_faults(text: str) -> list[str]:
    try:
        _read_as_file(read_point_table, text)
    except InputError as error:
        return str(error).splitlines()
    return []


def _read_as_file(read: Callable[[Path], object], text: str) -> None:
    with tempfile.NamedTemporaryFile("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        read(Path(file.name))


def _find_output_faults(text: str) -> list[str]:
    """What an example prints is compared with its printed.txt by the tests."""
    printed = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "examples").glob("*/printed.txt"))
    return [f"no example prints {line!r}" for line in text.splitlines() if line not in printed]


def _find_shell_faults(text: str) -> list[str]:
    """Let the shell read commands, and find words of ddic and make that do not exist."""
    read = subprocess.run(["bash", "-n"], input=text, text=True, capture_output=True, check=False)
    lines = text.replace("\\\n", " ").splitlines()
    return [*read.stderr.splitlines(), *(fault for line in lines for fault in _find_command_faults(line))]


def _find_command_faults(line: str) -> list[str]:
    faults = []
    for words in _split_commands(line):
        names = [Path(word).name for word in words]
        if "ddic" in names and names[0] in ("ddic", *LAUNCHERS):
            faults += _find_option_faults(words[names.index("ddic") + 1:])
        elif names[:1] == ["make"]:
            faults += _find_target_faults(words[1:])
    return faults


def _find_target_faults(words: list[str]) -> list[str]:
    """Find targets, and checks of acceptance tables, that make does not know."""
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    asked = [word for word in words if re.fullmatch(r"[a-z-]+", word)]
    tables = [TABLES[word.removeprefix("accept-")] for word in asked if word.removeprefix("accept-") in TABLES]
    checks = [word.removeprefix("CHECK=") for word in words if re.fullmatch(r"CHECK=[a-z_]+", word)]
    return [f"make knows no {word}"
            for word in [*(word for word in asked if word not in targets),
                         *(check for check in checks if not any(check in table for table in tables))]]


def _split_commands(line: str) -> Iterator[list[str]]:
    """Words of each command of a line."""
    reader = shlex.shlex(line, posix=True, punctuation_chars=";|&")
    reader.whitespace_split = True
    words: list[str] = []
    for word in [*reader, ";"]:
        if set(word) <= set(";|&"):
            yield words
            words = []
        else:
            words.append(word)


def _find_option_faults(words: list[str]) -> list[str]:
    """Find options that a command does not take; ``words`` are those after ``ddic``."""
    command: click.Command = command_line
    for word in words:
        if not isinstance(command, click.Group) or word.startswith("-"):
            break
        inner = command.get_command(click.Context(command), word)
        if inner is None:
            return [f"ddic knows no {word}"]
        command = inner
    known = {"--help", *(option for parameter in command.params for option in parameter.opts)}
    # -word is an option of PETSc.
    options = [word.partition("=")[0] for word in words if re.match(r"--[a-z]|-[a-z]$", word)]
    return [f"{' '.join(['ddic', *words[:1]])} takes no {option}" for option in options if option not in known]


def _find_key_faults(code: str) -> list[str]:
    """Find sections and keys of a case that do not exist, of ``[section]`` and ``key = value``; else no faults."""
    section = re.fullmatch(r"\[{1,2}([a-z_.]+)\]{1,2}", code)
    if section is not None:
        project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        is_known = find_section(tuple(section[1].split("."))) or section[1] in project["optional-dependencies"]
        return [] if is_known else [f"there is no section {section[1]}"]
    key = re.fullmatch(r"([a-z_.]+) = .+", code)
    if key is None:
        return []
    *place, name = key[1].split(".")
    homes = [home for home in [((), Case), *list_sections()] if name in home[1].model_fields]
    is_there = any(list(keys[len(keys) - len(place):]) == place for keys, _ in homes)
    return [] if is_there else [f"there is no key {key[1]}"]


def _find_name_faults(code: str) -> list[str]:
    """Find names of ddic that do not exist, and keywords that its functions do not take; other text has no faults."""
    try:
        tree = ast.parse(code)
    except SyntaxError:
        return []
    faults = []
    for node in ast.walk(tree):
        dotted = ast.unparse(node) if isinstance(node, ast.Attribute) else ""
        if re.fullmatch(r"ddic(\.\w+)+", dotted) and _look_up(dotted) is None:
            faults.append(f"there is no {dotted}")
        if isinstance(node, ast.Call) and callable(function := _look_up(ast.unparse(node.func))):
            taken = inspect.signature(function).parameters
            # Functions that take sections of a case take them by name.
            known = {*taken, *(Case.model_fields if any(one.kind is one.VAR_KEYWORD for one in taken.values()) else ())}
            faults += [f"{ast.unparse(node.func)} takes no {keyword.arg}" for keyword in node.keywords
                       if keyword.arg is not None and keyword.arg not in known]
    return faults


def _find_program_faults(text: str) -> list[str]:
    ast.parse(text)
    return _find_name_faults(text)


def _look_up(dotted: str) -> Any:
    """What a dotted name of ddic stands for; None where there is no such thing, or it is no name of ddic."""
    first, *rest = dotted.split(".")
    found: Any = ddic if first == "ddic" else None
    for place, name in enumerate(rest, start=1):
        if isinstance(found, ModuleType) and not hasattr(found, name):
            try:
                importlib.import_module(".".join([first, *rest[:place]]))
            except ModuleNotFoundError:
                return None
        found = getattr(found, name, None)
    return found


CHECKS: dict[str, Callable[[str], list[str]]] = {
    "toml": _find_toml_faults, "csv": _find_table_faults, "text": _find_output_faults, "sh": _find_shell_faults,
    "python": _find_program_faults}
"""By the language of a fence."""
