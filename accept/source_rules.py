"""Rules of the source that a reader feels: how large it is, how its modules hang together, how densely it is written.

None of these bounds is an aim by itself: a module that is split, joined or packed to meet one reads worse.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
import tomllib
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from statistics import median
from typing import TypeGuard

from accept.table import Scale
from bench.support.before import checkout_before
from bench.support.rows import Row
from bench.support.runs import ROOT

SOURCE = ROOT / "src" / "ddic"
MOST_CODE_LINES, LONG_BY_NATURE = 400, ("pixel_kernels", "voxel_kernels", "schema")
"""Of a module: lines of code; and modules that are one list or one kernel from end to end."""

MOST_FILES, MOST_IN_PACKAGE, MOST_CODE, MOST_DOCUMENTED = 250, 18, 31_600, 12_500
"""Files, modules of one package, lines of code and of docstrings."""

LEAST_MEDIAN, SHORT, MOST_SHORT = 90, 40, 0.12
"""Lines of code of the middle module; of a short one, and the share of the modules that may be shorter."""

MOST_DENSE, FEWEST_LINES = 6.8, 20
"""Nodes of the syntax tree a line of code, in the middle of the modules that have so many lines or more."""

MOST_IMPORTS, MOST_ALONE, MOST_TWICE = 0.09, 25, 4
"""Share of import statements in the code; modules with one importer, which stands beside them; public names defined
twice."""

MOST_READ = 10
"""Modules from a beginning to what it comes down to."""

WAYS = {"solve_frame to a linear step": (("methods/dd_dic", "solvers/dual/dual_step"),),
        "main to the pixel kernels": (("cli/entry", "cli/app"), ("cli/run", "functionals/pixel_kernels"))}
"""Ways of a reader, in parts: the command line imports its commands by their names."""

RAW_COMM = re.compile(r"\b_?comm\.\w+\(")
"""A call of a communicator's own method."""

LOOKS_AT_FRAMES, MORE_CODE_AT = ("problem", "methods", "start"), "f43a80d"
"""Packages that look at frames, and the commit that they were last too large at."""

SPLIT_OFF = ("inputs", "check", "visibility")
"""Packages that hold what was in these then."""


def measure_source(scale: Scale) -> list[Row]:
    """Look for what breaks the rules."""
    del scale
    source = read_source(SOURCE)
    raw = [found for path in SOURCE.rglob("*.py") if "parallel" not in path.parts for found in _raw_calls(path)]
    return [*_judge_sizes(source), *_judge_words(source), *_judge_imports(source),
            Row("calls of a communicator outside parallel/", "none", _listed(raw), not raw)]


@dataclass(frozen=True)
class Module:
    """A file of the source.

    Attributes
    ----------
    tree : Module
        Its syntax tree.
    code, documented : frozenset of int
        Numbers of its lines that hold code, and docstrings.
    """

    tree: ast.Module
    code: frozenset[int]
    documented: frozenset[int]

    @property
    def density(self) -> float:
        """Nodes of the syntax tree a line of code, those of docstrings left out."""
        lines = (getattr(node, "lineno", None) for node in ast.walk(self.tree))
        n_nodes = sum(line is not None and line not in self.documented for line in lines)
        return n_nodes / max(len(self.code), 1)

    @property
    def imports(self) -> list[ast.Import | ast.ImportFrom]:
        """Import statements at the top."""
        return [node for node in self.tree.body if isinstance(node, ast.Import | ast.ImportFrom)]

    @property
    def public_names(self) -> list[str]:
        """Functions and classes that it defines for others."""
        defined = [node.name for node in self.tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)]
        return [name for name in defined if not name.startswith("_")]


@dataclass(frozen=True)
class Source:
    """All files of a package.

    Attributes
    ----------
    files : mapping
        By path without ending, ``mesh/raster`` for instance.
    """

    files: Mapping[str, Module]

    @cached_property
    def modules(self) -> dict[str, Module]:
        """All but those that only name a package."""
        return {name: module for name, module in self.files.items() if not name.endswith("__init__")}

    @cached_property
    def imported(self) -> dict[str, set[str]]:
        """What each module imports at its top."""
        return {name: self._follow(name, module.tree.body) for name, module in self.modules.items()}

    @cached_property
    def reached(self) -> dict[str, set[str]]:
        """What each module imports, anywhere in it."""
        return {name: self._follow(name, ast.walk(module.tree)) for name, module in self.modules.items()}

    def _follow(self, name: str, nodes: Iterable[ast.AST]) -> set[str]:
        named: set[str] = set()
        for node in nodes:
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("ddic"):
                base = (node.module or "").replace(".", "/").removeprefix("ddic").lstrip("/")
                named |= {base, *(f"{base}/{alias.name}".lstrip("/") for alias in node.names)}
        return {other for other in named if other in self.modules and other != name}


def read_source(folder: Path) -> Source:
    """Parse all files of a package."""
    return Source({path.relative_to(folder).with_suffix("").as_posix(): _parse(path.read_text(encoding="utf-8"))
                   for path in sorted(folder.rglob("*.py"))})


def _parse(text: str) -> Module:
    tree = ast.parse(text)
    documented = _documented_lines(tree)
    rows = enumerate((row.strip() for row in text.splitlines()), start=1)
    code = {number for number, row in rows if row and not row.startswith("#")}
    return Module(tree, frozenset(code - documented), frozenset(documented))


def _judge_sizes(source: Source) -> list[Row]:
    sizes = {name: len(module.code) for name, module in source.modules.items()}
    of_packages = Counter(_package(name) for name in source.modules)
    (crowded, n_crowded), = of_packages.most_common(1)
    n_code, n_documented = (sum(len(lines) for lines in of_files) for of_files in (
        [module.code for module in source.files.values()], [module.documented for module in source.files.values()]))
    middle = median(sizes.values())
    short = sum(size < SHORT for size in sizes.values()) / len(sizes)
    others = {name: size for name, size in sizes.items() if name.rpartition("/")[2] not in LONG_BY_NATURE}
    largest = max(others, key=others.__getitem__)
    return [
        _judge("files of src/", len(source.files), MOST_FILES),
        Row("modules in one package", f"at most {MOST_IN_PACKAGE}", f"{crowded or 'ddic'}: {n_crowded}",
            n_crowded <= MOST_IN_PACKAGE),
        _judge("lines of code in src/", n_code, MOST_CODE),
        _judge("lines of docstrings in src/", n_documented, MOST_DOCUMENTED),
        Row("lines of code of the middle module of src/", f"at least {LEAST_MEDIAN}", f"{middle:g}",
            middle >= LEAST_MEDIAN),
        Row(f"modules of src/ below {SHORT} lines of code", f"at most {MOST_SHORT:.0%}", f"{short:.1%}",
            short <= MOST_SHORT),
        Row(f"largest module of src/ but {' and '.join(LONG_BY_NATURE)}", f"at most {MOST_CODE_LINES} lines of code",
            f"{largest}: {others[largest]}", others[largest] <= MOST_CODE_LINES),
    ]


def _judge_words(source: Source) -> list[Row]:
    dense = median(module.density for module in source.modules.values() if len(module.code) >= FEWEST_LINES)
    defined = Counter(name for module in source.modules.values() for name in module.public_names)
    twice = sorted(name for name, count in defined.items() if count > 1)
    return [
        Row("nodes of the syntax tree a line of code, in the middle of the modules of src/", f"at most {MOST_DENSE}",
            f"{dense:.2f}", dense <= MOST_DENSE, judged_small=False),
        Row("public names that src/ defines twice", f"at most {MOST_TWICE}",
            f"{len(twice)}: {', '.join(twice) or 'none'}", len(twice) <= MOST_TWICE,
            judged_small=False),
    ]


def _judge_imports(source: Source) -> list[Row]:
    n_imports = sum((node.end_lineno or node.lineno) - node.lineno + 1
                    for module in source.files.values() for node in module.imports)
    share = n_imports / sum(len(module.code) for module in source.files.values())
    importers: dict[str, list[str]] = {name: [] for name in source.modules}
    for name, others in source.imported.items():
        for other in others:
            importers[other].append(name)
    alone = [name for name, by in importers.items() if len(by) == 1 and _package(by[0]) == _package(name)]
    circles = find_circles(source.imported)
    upward = list(_find_upward(source.imported))
    ways = [_judge_way(what, [find_way(source.reached, begin, end) for begin, end in parts])
            for what, parts in WAYS.items()]
    return [
        Row("import statements of src/, lines of all code", f"at most {MOST_IMPORTS:.0%}", f"{share:.1%}",
            share <= MOST_IMPORTS, judged_small=False),
        _judge("modules of src/ that one module of their own package imports, and no other", len(alone), MOST_ALONE),
        Row("circles of modules that import each other", "none", _listed([" ".join(one) for one in circles]),
            not circles),
        Row("imports upwards through the layers", "none", _listed(upward), not upward),
        *ways,
    ]


def _judge(what: str, count: int, most: int) -> Row:
    return Row(what, f"at most {most:,}", f"{count:,}", count <= most, judged_small=False)


def _judge_way(what: str, parts: list[list[str]]) -> Row:
    read = [name for part in parts for name in part]
    is_known = all(parts)
    return Row(f"modules that are read from {what}", f"at most {MOST_READ}",
               f"{len(read)}: {', '.join(read)}" if is_known else "no way of imports leads there",
               is_known and len(read) <= MOST_READ)


def find_circles(imported: Mapping[str, set[str]]) -> list[list[str]]:
    """Find the sets of modules that import each other, directly or through others."""
    reached = {name: _reach(imported, name) for name in imported}
    circles = {frozenset(other for other in reached[name] if name in reached[other])
               for name in imported if name in reached[name]}
    return [sorted(circle) for circle in circles]


def _reach(imported: Mapping[str, set[str]], begin: str) -> set[str]:
    """All modules that a module imports, directly or through others."""
    seen: set[str] = set()
    ahead = list(imported[begin])
    while ahead:
        name = ahead.pop()
        if name not in seen:
            seen.add(name)
            ahead += imported[name]
    return seen


def find_way(imported: Mapping[str, set[str]], begin: str, end: str) -> list[str]:
    """Find the shortest way of imports from one module to another; empty where there is none."""
    ways = deque([[begin]])
    seen = {begin}
    while ways:
        way = ways.popleft()
        if way[-1] == end:
            return way
        for name in sorted(imported.get(way[-1], set()) - seen):
            seen.add(name)
            ways.append([*way, name])
    return []


def _find_upward(imported: Mapping[str, set[str]]) -> Iterator[str]:
    """Imports of a layer above, by the layers of the import contract."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contract = next(one for one in project["tool"]["importlinter"]["contracts"] if one["type"] == "layers")
    height = {package.strip().removeprefix("ddic."): -depth for depth, line in enumerate(contract["layers"])
              for package in line.split(":")}
    for name, others in imported.items():
        own = height.get(name.split("/")[0])
        for other in others:
            of_other = height.get(other.split("/")[0])
            if own is not None and of_other is not None and of_other > own:
                yield f"{name} imports {other}"


def _package(name: str) -> str:
    return name.rpartition("/")[0]


def measure_frame_code(scale: Scale) -> list[Row]:
    """Count the code lines of what looks at frames."""
    del scale
    before = checkout_before(MORE_CODE_AT) / "src" / "ddic"
    packages = (*LOOKS_AT_FRAMES, *SPLIT_OFF)
    now, then = _count_packages(SOURCE, packages), _count_packages(before, LOOKS_AT_FRAMES)
    listed = ", ".join(f"{name} {count} for {then.get(name, 0)}" for name, count in now.items())
    n_now, n_then = sum(now.values()), sum(then.values())
    return [Row("code lines of what looks at frames: " + ", ".join(f"{name}/" for name in packages),
                f"fewer than the {n_then} of {MORE_CODE_AT}", f"{n_now} ({listed})", n_now < n_then,
                judged_small=False)]


def _count_packages(source: Path, packages: Sequence[str]) -> dict[str, int]:
    return {name: count_code(source / name) for name in packages}


def count_code(source: Path) -> int:
    """Count the lines of code of all modules below a folder."""
    return sum(count_code_lines(path.read_text(encoding="utf-8")) for path in source.rglob("*.py"))


def count_code_lines(text: str) -> int:
    """Count lines that hold code: no blank ones, comments or docstrings."""
    documented = _documented_lines(ast.parse(text))
    no_code = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
    coded = {line for token in tokenize.generate_tokens(io.StringIO(text).readline) if token.type not in no_code
             for line in range(token.start[0], token.end[0] + 1)}
    return len(coded - documented)


def _documented_lines(tree: ast.Module) -> set[int]:
    """Numbers of the lines of docstrings."""
    return {line for node in ast.walk(tree) if _is_bare_text(node)
            for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)}


def _is_bare_text(node: ast.AST) -> TypeGuard[ast.Expr]:
    """Docstrings, and texts that describe what stands above them."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _raw_calls(path: Path) -> Iterator[str]:
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        if RAW_COMM.search(line):
            yield f"{path.relative_to(SOURCE)}:{number}"


def _listed(found: list[str]) -> str:
    return "; ".join(found) or "none breaks it"
