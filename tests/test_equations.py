"""What docstrings and docs/symbols.md say of numbered equations agrees with what the papers have under these numbers.

The tables below were read from the papers, number by number. A citation by a wrong number fails: the sentences around
it have to name what the paper has there. Every equation of [BP17] has a row in docs/symbols.md, and the function of a
row says that it is it.
"""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SYMBOLS = (ROOT / "docs" / "symbols.md").read_text(encoding="utf-8")

TABLES = {
    # number | what the paper has there | phrases, of which one at least stands where the number is cited
    "BP17": """
        1   | f(x) = g(x + u) | conservation; reference image; deformed image; displacement field
        2   | Phi_cor, with the factor 1/2 | Phi_cor; residual
        3   | a(delta u, v) = l(v) | weak form
        4   | the forms with grad g(x + u) | grad g; gradient of g; gradient of the deformed image
        5   | the forms with grad f, continuous | continuous; its gradient
        6   | M dq = b | M dq = b; shape functions; unknowns
        7   | M_ij and b_j | sum_px; M and b; Assemble M; Assemble b; Assemble b_s; M, b; M_e; shape functions; unknowns
        8   | Phi_reg = 1/2 norm(Kbar q)^2 | Phi_reg
        9   | Kbar = P K | P K; P diag; P of; P; stiffness; the K of; controlled
        10  | Phi_tot, eta(l_c) | Phi_tot; weight; weight of
        11  | the R-DIC step | dq; M + eta Kbar^T Kbar; b - eta Kbar^T Kbar q; A of; Solves; solve; iteration
        12  | coupled functional | coupling; coupled functional
        13  | Lambda^T (C_1 q_1 + C_2 q_2) | Lambda
        14  | weak form | weak form
        15  | saddle point, Lambda alone | saddle point
        16  | norm of the sum | LambdaBar; norm of the sum
        17  | norm of the sum, split by LambdaBar | LambdaBar
        18  | norm of the sum, split by LambdaBar | LambdaBar
        19  | regularised saddle point | LambdaBar; regularised saddle point
        20  | u_n - u_f + alpha = 0 | alpha; u_n - u_f + alpha = 0
        21  | system of 20 | saddle point; rows of alpha; motion of the subdomain's camera; alpha's equation
        22  | R^T R alpha0 = -R^T (C_n q_n0 + C_f q_f0), start of alpha | start of alpha; independent fields; alpha
        23  | system 21 with regularisation, LambdaBar | LambdaBar; alpha
        24a | local solve | dq_s; A_s^-1; b_s - eta Kbar_s^T Kbar_s q_s; Cholesky; C_s; jumps; reactions; Correct
        24b | interface constraints | jumps are zero
        25  | S Lambda_tot = t | S_tot
        26  | its blocks | S_tot
        27a | block of S | S_tot; blocks
        27b | block of S | S_tot; blocks
        27c | block of S | S_tot; blocks; H_s; Cbar_s Cbar_s^T
        27d | t | t_tot
        27e | tbar | t_tot
        28  | Krylov subspace | Krylov
        29  | v = (v, vbar) | vbar
        30  | the product | product; S_tot; H_s
        31  | its two local systems | product; S_tot; two blocks; G_s
        32  | M + eta K of a subdomain | M_s + eta Kbar_s^T Kbar_s
        33  | constraints C_s = A_s c_s | B_s; T_s
        34  | S = sum A_s S_s A_s^T | B_s S_s B_s^T
        35  | its blocks | S_s
        36a | entry of S_s | S_s
        36b | entry of S_s | S_s
        36c | entry of S_s, misprinted | S_s
        37  | P = sum A_s S_s^-1 A_s^T | preconditioner; preconditioners; P r; P
        38  | local inverse by blocks, misprinted | S_s^-1; Invert S_s; inverse; inverses
        39  | D_s | S_s^-1; Invert S_s; inverse
        40  | inverse of the first block = primal Schur complement | S_s^-1; Invert S_s; inverse; preconditioner
        41  | Err = norm(q_DD - q_mono) / norm(q_mono) | Err
    """,
    "PP12": """
        1   | conservation | conservation
        2   | phi^2 | phi^2
        3   | Taylor | Taylor
        4   | linearised | linearised
        5   | weak form | weak form
        6   | basis | basis
        7   | M q = b | M q = b
        8   | J | J of a sum
        9   | orthogonality | orthogonality
        10  | SVD eigenproblem | eigenproblem
        11  | SVD eigenproblem | eigenproblem
        12  | SVD eigenproblem | eigenproblem
        13  | e_svd | e_svd
        14  | separated u | sum of products; functions of x and of y
        15  | enrichment | enrichment
        16  | fixed terms | fixed terms
        17  | weak form | weak form
        18  | test field | test field
        19  | four coupled equations | coupled; integrals; Integrate; rank-one correction
        20  | problem in x | problem in x
        21  | problem in y | coupled
        22  | FE interpolation of alpha(x) | interpolation
        23  | A q = B | rank-one correction
        24  | C q = D | rank-one correction
        25  | e | stagnation
        26  | Delta u = 0 | Laplace's; Tikhonov; Tikhonov's
        27  | its weak form | Laplace's; Tikhonov; Tikhonov's
        28  | separated gradient | Laplace's; Tikhonov; Tikhonov's
    """,
    "RRH07": """
        1   | conservation | conservation
        2   | Phi^2 | Phi^2
        3   | eta^2 | eta^2
        4   | basis | basis
        5   | M a = b | M a = b
        6   | M | M
        7   | b | b
        8   | partition of unity | partition of unity
        9   | enriched u | enriched
        10  | enriched u with H and C_j | singular displacements; root of the distance; root of r
        11  | H_e | H_e
    """,
    "RHR08": """
        1   | conservation | conservation
        2   | eta^2 | eta^2
        3   | Phi^2 | Phi^2
        4   | Newton | Newton
        5   | Newton | Newton
        6   | Newton | Newton
        7   | basis | basis
        8   | M a = b | M a = b
        9   | M a = b | M a = b
        10  | M a = b | M a = b
        11  | restriction | restriction
        12  | prolongation | prolongation
        13  | partition of unity | partition of unity
        14  | partition of unity | partition of unity
        15  | H_n | H_n
        16  | enriched u | enriched
        17  | Tresca | Tresca
        18  | Radon | Radon
        19  | sigma_u | sigma_u
    """,
}


@dataclass(frozen=True)
class Equation:
    content: str
    phrases: tuple[str, ...]

    def is_named_in(self, text: str) -> bool:
        plain = " ".join(text.replace("\\|", "|").split())
        return any(re.search(rf"(?<!\w){re.escape(phrase)}(?!\w)", plain) for phrase in self.phrases)


def read_table(text: str) -> dict[str, Equation]:
    rows = [[cell.strip() for cell in line.split(" | ")] for line in text.strip().splitlines()]
    return {number: Equation(content, tuple(phrases.split("; "))) for number, content, phrases in rows}


PAPERS = {paper: read_table(text) for paper, text in TABLES.items()}

NUMBER = r"\(?\d+[a-z]?\)?"
NUMBERS = rf"{NUMBER}(?:(?:-|,\s|\sand\s){NUMBER}|(?:-|,\s)[a-z]\b)*"
CITATION = re.compile(rf"\bEqs?\.\s+({NUMBERS})(?:\sof\s\[(\w+)\])?|\[(\w+),\sEqs?\.\s({NUMBERS})\]")


@dataclass(frozen=True)
class Citation:
    """One mention of equations: "24a-25 of [BP17]"; the paper is None where none is named beside them."""

    numbers: str
    paper: str | None
    begin: int

    def find_ends(self) -> list[str]:
        """Single numbers, and first and last ones of ranges: "27a-c, 30" has 27a, 27c and 30."""
        found: list[str] = []
        for number, letter in re.findall(r"(\d*)([a-z]?)(?:\W|$)", self.numbers):
            if number or letter:
                found.append((number or re.sub(r"[a-z]", "", found[-1])) + letter)
        return found

    def find_equations(self) -> list[Equation]:
        """What the paper has at the ends; lettered lines are one equation where they are cited without a letter."""
        table = PAPERS[self.paper or ""]
        equations = []
        for number in self.find_ends():
            lines = [table[key] for key in table if key == number or key[:-1] == number]
            content = "; ".join(line.content for line in lines)
            assert lines, f"[{self.paper}] has no Eq. {number}"
            equations.append(Equation(f"{number}: {content}", tuple(p for line in lines for p in line.phrases)))
        return equations

    def find_wrong(self, text: str) -> list[str]:
        """Equations that a text cites and does not name."""
        return [equation.content for equation in self.find_equations() if not equation.is_named_in(text)]


def find_citations(text: str) -> list[Citation]:
    return [Citation(m[1] or m[4], m[2] or m[3], m.start()) for m in CITATION.finditer(text)]


def spanned(text: str) -> set[int]:
    """Numbers of "24-27", "24a" or "30, 31"."""
    found: set[int] = set()
    for first, last in re.findall(r"(\d+)\)?[a-z]?(?:\s*-\s*\(?(\d+))?", text):
        found |= set(range(int(first), int(last or first) + 1))
    return found


def named_equations(docstring: str) -> set[int]:
    """Numbers after "Eq." in a docstring."""
    return set().union(*(spanned(citation.numbers) for citation in find_citations(docstring)))


def read_rows(text: str) -> list[list[str]]:
    """Cells of the rows of the tables in a text, heads left out."""
    rows = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
            for line in text.splitlines() if line.startswith("|") and not line.startswith("|---")]
    return [row for row in rows if row[0] not in {"symbol", "equation"}]


def symbol_rows() -> Iterator[tuple[str, list[str]]]:
    """Rows of tables of symbols, each with the paper whose numbers they are."""
    for section in SYMBOLS.split("## Equations of [BP17]")[0].split("\n## ")[1:]:
        paper = "PP12" if section.startswith("Separated") else "BP17"
        yield from ((paper, row) for row in read_rows(section) if row[2].startswith("Eq."))


ROWS = read_rows(SYMBOLS.split("## Equations of [BP17]")[1].split("\n## ")[0])
IMPLEMENTED = [row for row in ROWS if row[2]]


def docstrings() -> Iterator[tuple[str, str]]:
    """Each docstring of src that cites equations, and where it is."""
    for file in sorted((ROOT / "src" / "ddic").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Expr) or not isinstance(node.value, ast.Constant):
                continue
            text = node.value.value
            if isinstance(text, str) and find_citations(text):
                yield f"{file.relative_to(ROOT)}:{node.lineno}", text


DOCSTRINGS = list(docstrings())


def test_numbers_are_read() -> None:
    assert named_equations("Assemble M, Eq. 5 of [BP17].") == {5}
    assert named_equations("Solve, Eq. (24a) of [BP17]; Eq. 30-31 of [BP17].") == {24, 30, 31}
    assert named_equations("Twelve, 12 and 13.") == set()
    assert named_equations("As in [BP17, Eq. 5-7] and Eq. (19)-(21) of [PP12], (5, 3).") == {5, 6, 7, 19, 20, 21}
    assert [c.paper for c in find_citations("[RRH07, Eq. 10]; Eq. 3 of\n[PP12]; Eq. 4")] == ["RRH07", "PP12", None]
    assert Citation("25-26, 27a-c, 30", "BP17", 0).find_ends() == ["25", "26", "27a", "27c", "30"]
    assert Citation("27d, e", "BP17", 0).find_ends() == ["27d", "27e"]
    assert Citation("(19)-(24)", "PP12", 0).find_ends() == ["19", "24"]


def test_wrong_number_is_found() -> None:
    assert Citation("7", "BP17", 0).find_wrong("b_j = sum_px N_j . grad f (f - g(x + u))") == []
    assert Citation("5", "BP17", 0).find_wrong("b_j = sum_px N_j . grad f (f - g(x + u))") != []
    assert Citation("41", "BP17", 0).find_wrong("the mean of the copies") != []
    assert Citation("36-37", "BP17", 0).find_wrong("T_s A_s^-1 T_s^T - D_s is S_s") != []


def test_papers_are_listed() -> None:
    papers = SYMBOLS.split("## Papers")[1]
    assert {*PAPERS, "PPS15", "LPHR11"} <= set(re.findall(r"^- \[(\w+)\]:", papers, re.MULTILINE))


def test_every_equation_has_a_row() -> None:
    assert set().union(*(spanned(row[0]) for row in ROWS)) == set().union(*(spanned(key) for key in PAPERS["BP17"]))
    # A row without a function says why.
    assert [row[0] for row in ROWS if not row[2] and "not implemented" not in row[1]] == []


@pytest.mark.parametrize(("paper", "row"), list(symbol_rows()), ids=lambda x: x if isinstance(x, str) else x[0])
def test_symbol_is_in_its_equation(paper: str, row: list[str]) -> None:
    for citation in find_citations(row[2]):
        of_paper = Citation(citation.numbers, paper, 0)
        assert of_paper.find_wrong(f"{row[0]} | {row[1]}") == [], f"docs/symbols.md: {row[0]} is said to be in {row[2]}"


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row[0]} {row[1][:30]}")
def test_row_says_what_the_paper_has(row: list[str]) -> None:
    # Rows of an equation's lines name them: "(27d, e) t_tot".
    lines = re.match(r"\((\d+[a-z][^)]*)\) ", row[1])
    citation = Citation(lines[1] if lines else row[0], "BP17", 0)
    assert citation.find_wrong(row[1]) == [], f"docs/symbols.md: Eq. {row[0]} is said to be {row[1]}"


@pytest.mark.parametrize(("place", "text"), DOCSTRINGS, ids=[place for place, _ in DOCSTRINGS])
def test_docstring_names_what_it_cites(place: str, text: str) -> None:
    citations = find_citations(text)
    papers = {citation.paper for citation in citations} - {None}
    for citation in citations:
        assert citation.paper or len(papers) == 1, f"{place}: Eq. {citation.numbers} of which paper?"
        of_paper = Citation(citation.numbers, citation.paper or papers.copy().pop(), 0)
        begin = text.rfind("\n\n", 0, citation.begin) + 1
        paragraph = text[begin:].lstrip("\n").split("\n\n")[0]
        summary = text.split("\n\n", maxsplit=1)[0]
        wrong = of_paper.find_wrong(f"{summary} {paragraph}")
        assert wrong == [], f"{place} cites Eq. {citation.numbers} and names another thing"


@pytest.mark.parametrize("folder", ["accept", "bench", "docs", "examples", "tests"])
def test_cited_equations_exist(folder: str) -> None:
    files = [path for ending in ("md", "py") for path in sorted((ROOT / folder).rglob(f"*.{ending}"))]
    # What measurements have left there, checkouts of other commits among it, is not of this one.
    for file in (path for path in files if ROOT / "bench" / "data" not in path.parents):
        for citation in find_citations(file.read_text(encoding="utf-8")):
            assert citation.paper is None or citation.find_equations(), file


@pytest.mark.parametrize("row", IMPLEMENTED, ids=lambda row: f"{row[0]} {row[2]}".replace("`", ""))
def test_function_of_an_equation_names_it(row: list[str]) -> None:
    name, file = row[2].strip("`"), row[3].strip("`")
    assert (ROOT / file).is_file(), f"docs/symbols.md: Eq. {row[0]} is said to be in {file}, which does not exist"
    module = importlib.import_module(file.removeprefix("src/").removesuffix(".py").replace("/", "."))
    try:
        function = reduce(getattr, name.split("."), module)
    except AttributeError:
        pytest.fail(f"docs/symbols.md: Eq. {row[0]} is said to be {name}, which {file} does not hold")
    owner = reduce(getattr, name.split(".")[:-1], module)
    said = named_equations(function.__doc__ or "") | (named_equations(owner.__doc__ or "") if "." in name else set())
    missing = spanned(row[0]) - said
    assert not missing, f"{file}: the docstring of {name} does not say 'Eq. {sorted(missing)[0]} of [BP17]'"
