"""List what docstrings of src/ddic and accept lack: numpydoc's own checks, and shapes of arrays, attributes and errors.

Usage: check_docstrings.py [files or folders]. The checks of numpydoc are those of [tool.numpydoc_validation] in
pyproject.toml. Beyond them, of everything public:

- DD01: an array among the parameters or in the result has a shape, in parentheses, or says "shape" in its description;
- DD02: a dataclass or named tuple lists its fields in a section Attributes;
- DD03: an error that the function raises itself stands in a section Raises.

One sentence is enough for a property, for a method that its base class describes, for a command, whose docstring a user
reads, and for "Return ..." of a function without parameters; and for every function that is neither offered by
``import ddic`` nor a seam that others implement (DESCRIBED), those of accept among them. Nothing is imported: files are
parsed only.
"""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from numpydoc.hooks.validate_docstrings import AstValidator
from numpydoc.validate import validate

ROOT = Path(__file__).resolve().parents[1]
ARRAYS = ("NDArray", "ndarray", "csr_matrix", "csc_matrix", "bsr_matrix", "csr_array")
"""Types in an annotation that have a shape."""
SUMMARY_CHECKS = {"GL08", "SS01", "SS02", "SS03", "SS04", "SS06"}
"""All that is asked of what another docstring describes in full."""
DESCRIBED = ("api/measure.py", "api/studies.py", "api/synthetic.py", "__init__.py",
             "kinematics/kinematics.py", "mesh/cell_type.py", "images/source.py", "solvers/linear_step.py",
             "methods/method.py")
"""Folders and files of the package whose functions have sections, whatever their first sentence says."""
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)

Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


@dataclass(frozen=True)
class Violation:
    """One thing that a docstring lacks.

    Attributes
    ----------
    file : Path
        Where.
    line : int
        Of the definition.
    name : str
        Of what is described.
    code : str
        Of the check.
    message : str
        What is missing.
    """

    file: Path
    line: int
    name: str
    code: str
    message: str

    def __str__(self) -> str:
        """Show it as a line that editors can jump to."""
        file = self.file.relative_to(ROOT) if self.file.is_relative_to(ROOT) else self.file
        return f"{file}:{self.line}: {self.code} {self.name}: {self.message}"


@dataclass(frozen=True)
class Described:
    """A definition and what stands around it.

    Attributes
    ----------
    node : ast node
        The function, method or class.
    parents : list of ast nodes
        The module, then the classes around it.
    """

    node: Definition
    parents: list[ast.AST] = field(default_factory=list)

    @property
    def name(self) -> str:
        """Name with those of the classes around it."""
        return ".".join([p.name for p in self.parents if isinstance(p, ast.ClassDef)] + [self.node.name])

    @property
    def owner(self) -> ast.ClassDef | None:
        """The class around it."""
        last = self.parents[-1]
        return last if isinstance(last, ast.ClassDef) else None


def main(arguments: list[str]) -> int:
    """Print the violations of files or folders, by default of the package and of acceptance."""
    places = [Path(argument).resolve() for argument in arguments] or [ROOT / "src" / "ddic", ROOT / "accept"]
    files = [file for place in places for file in (sorted(place.rglob("*.py")) if place.is_dir() else [place])]
    violations = list(check_files(files))
    for violation in violations:
        print(violation)
    if violations:
        print(f"{len(violations)} in {len({violation.file for violation in violations})} of {len(files)} files")
    return int(bool(violations))


def check_files(files: Iterable[Path]) -> Iterator[Violation]:
    """List the violations of files; classes may inherit descriptions from each other."""
    trees = {file: ast.parse(file.read_text(encoding="utf-8")) for file in files}
    classes = {node.name: node for tree in trees.values() for node in ast.walk(tree) if isinstance(node, ast.ClassDef)}
    checks = chosen_checks()
    for file, tree in trees.items():
        for described in public_definitions(tree):
            for code, message in check(described, file, classes, checks):
                yield Violation(file, described.node.lineno, described.name, code, message)


def chosen_checks() -> set[str]:
    """Read the chosen checks of numpydoc."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    return set(settings["tool"]["numpydoc_validation"]["checks"])


def public_definitions(tree: ast.Module) -> Iterator[Described]:
    """List public functions, classes and methods, those of private classes left out."""
    waiting = [Described(node, [tree]) for node in tree.body if isinstance(node, Definition)]
    while waiting:
        described = waiting.pop(0)
        if described.node.name.startswith("_"):
            continue
        yield described
        if isinstance(described.node, ast.ClassDef):
            inside = [node for node in described.node.body if isinstance(node, Definition)]
            waiting[:0] = [Described(node, [*described.parents, described.node]) for node in inside]


def check(described: Described, file: Path, classes: dict[str, ast.ClassDef], checks: set[str],
          ) -> Iterator[tuple[str, str]]:
    """List codes and messages of what one docstring lacks."""
    node = described.node
    validator = AstValidator(ast_node=node, filename=file, obj_name=described.name, ancestry=described.parents)
    in_short = (is_property(node) or is_command(node) or is_inherited(described, classes)
                or (is_internal(described, file) and not has_sections(validator)))
    wanted = checks & SUMMARY_CHECKS if in_short else checks
    if validator.summary.startswith("Return ") and not validator.signature_parameters:
        wanted = wanted - {"RT01"}
    for code, message in validate(validator, validator_cls=lambda obj_name: obj_name)["errors"]:
        if code in wanted:
            yield code, message
    if in_short or not validator.raw_doc:
        return
    if isinstance(node, ast.ClassDef):
        yield from missing_attributes(node, validator, classes)
    else:
        yield from missing_shapes(node, validator)
        yield from missing_errors(node, validator)


def is_internal(described: Described, file: Path) -> bool:
    """Tell whether a function of the package or of acceptance is neither offered to users nor a seam."""
    package = ROOT / "src" / "ddic"
    if isinstance(described.node, ast.ClassDef) or not file.is_relative_to(package):
        return isinstance(described.node, FUNCTIONS) and file.is_relative_to(ROOT / "accept")
    within = file.relative_to(package)
    return not any(within.is_relative_to(place) for place in DESCRIBED)


def has_sections(validator: AstValidator) -> bool:
    """Tell whether a docstring has numpydoc's sections, which must then be whole."""
    return re.search(r"^\s*-{3,}\s*$", validator.raw_doc, re.MULTILINE) is not None


def decorators(node: Definition) -> list[str]:
    """List decorators, without their arguments."""
    return [ast.unparse(d.func if isinstance(d, ast.Call) else d) for d in node.decorator_list]


def is_property(node: Definition) -> bool:
    """Tell whether something is read like an attribute."""
    return any(name.endswith("property") for name in decorators(node))


def is_command(node: Definition) -> bool:
    """Tell whether something is a command of the command line."""
    return any(name.endswith((".command", ".group")) for name in decorators(node))


def is_record(node: ast.ClassDef) -> bool:
    """Tell whether a class's fields make its constructor."""
    return any(name.endswith("dataclass") for name in decorators(node)) or "NamedTuple" in bases(node)


def bases(node: ast.ClassDef) -> list[str]:
    """List the names of a class's bases, without modules and parameters."""
    return [re.sub(r"\[.*", "", ast.unparse(base)).split(".")[-1] for base in node.bases]


def ancestors(node: ast.ClassDef, classes: dict[str, ast.ClassDef]) -> Iterator[str]:
    """List the names of all classes above one, as far as they are known."""
    for name in bases(node):
        yield name
        if name in classes and classes[name] is not node:
            yield from ancestors(classes[name], classes)


def is_settings(node: ast.ClassDef, classes: dict[str, ast.ClassDef]) -> bool:
    """Tell whether a class is a section of the case file, whose fields describe themselves."""
    return "BaseModel" in ancestors(node, classes)


def is_inherited(described: Described, classes: dict[str, ast.ClassDef]) -> bool:
    """Tell whether a base class describes a method."""
    if described.owner is None:
        return False
    above = [classes[name] for name in ancestors(described.owner, classes) if name in classes]
    methods = [node for owner in above for node in owner.body if isinstance(node, FUNCTIONS)]
    return described.node.name in {method.name for method in methods}


def has_shape(text: str, description: Iterable[str]) -> bool:
    """Tell whether a documented type, or its description, says what shape an array has."""
    return re.search(r"\([^)]*\)|shape", text) is not None or "shape" in " ".join(description)


def is_array(annotation: ast.AST | None) -> bool:
    """Tell whether an annotation speaks of an array."""
    return annotation is not None and any(re.search(rf"\b{name}\b", ast.unparse(annotation)) for name in ARRAYS)


def missing_shapes(node: ast.FunctionDef | ast.AsyncFunctionDef, validator: AstValidator) -> Iterator[tuple[str, str]]:
    """List arrays of a function without a shape."""
    every = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    arrays = {argument.arg for argument in every if is_array(argument.annotation)}
    for name, (kind, text) in validator.doc_all_parameters.items():
        if name in arrays and not has_shape(kind or "", text):
            yield "DD01", f'array "{name}" has no shape'
    returned = validator.doc["Returns"]
    shapes = [has_shape(f"{entry.name} {entry.type}", entry.desc) for entry in returned]
    in_summary = not returned and has_shape(" ".join(validator.doc["Summary"]), [])
    if is_array(node.returns) and not any(shapes) and not in_summary:
        yield "DD01", "what it returns has no shape"


def missing_attributes(node: ast.ClassDef, validator: AstValidator, classes: dict[str, ast.ClassDef],
                       ) -> Iterator[tuple[str, str]]:
    """List fields of a record that its docstring does not list, and arrays among them without a shape."""
    if not is_record(node) or is_settings(node, classes):
        return
    documented = {}
    for entry in [*validator.doc["Attributes"], *validator.doc["Parameters"]]:
        documented.update({name.strip(): entry for name in entry.name.split(",")})
    for statement in node.body:
        if not isinstance(statement, ast.AnnAssign) or not isinstance(statement.target, ast.Name):
            continue
        name = statement.target.id
        if name.startswith("_") or "ClassVar" in ast.unparse(statement.annotation):
            continue
        if name not in documented:
            yield "DD02", f'field "{name}" is not listed under Attributes'
        elif is_array(statement.annotation) and not has_shape(documented[name].type, documented[name].desc):
            yield "DD01", f'array "{name}" has no shape'


def missing_errors(node: ast.FunctionDef | ast.AsyncFunctionDef, validator: AstValidator) -> Iterator[tuple[str, str]]:
    """List errors that a function raises itself and does not name."""
    named = " ".join(f"{entry.name} {entry.type}" for entry in validator.doc["Raises"])
    for error in sorted(raised(node)):
        if not re.search(rf"\b{error}\b", named):
            yield "DD03", f"{error} is not listed under Raises"


def raised(node: ast.AST) -> set[str]:
    """Find the errors that a function creates and raises, functions inside it left out."""
    found: set[str] = set()
    for child in ast.iter_child_nodes(node):
        if isinstance(child, (*FUNCTIONS, ast.Lambda, ast.ClassDef)):
            continue
        if isinstance(child, ast.Raise) and isinstance(child.exc, ast.Call):
            name = ast.unparse(child.exc.func).split(".")[-1]
            # as_collective(error) and the like wrap an error; NotImplementedError says that a child class must do it.
            if name[0].isupper() and name != "NotImplementedError":
                found.add(name)
        found |= raised(child)
    return found


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
