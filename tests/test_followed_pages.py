"""Pages are followed to the last command; one that fails and a number that differs are found."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from accept.pages import list_pages
from accept.support.follow_page import Followed, find_differences, follow_page, read_blocks, read_script

ROOT = Path(__file__).parents[1]
PAGES = [page for page in list_pages() if page.endswith(".md")]
COMMANDS = ("make", "ddic", "pip", "python", "python3", "mpiexec", "mpirun", "bash", "conda", "apt-get", "cd", ".",
            "module")


def _follow(folder: Path, text: str) -> Followed:
    (folder / "page.md").write_text(text, encoding="utf-8")
    return follow_page(folder, "page.md")


def test_a_page_is_done_in_one_shell_from_top_to_bottom(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    followed = _follow(tmp_path, (
        "<!-- file: sub/a.txt -->\n```toml\nx = 1\n```\n\n"
        "```sh\ncd sub   # stays there\nvalue=1\n```\n"
        "```text\n$ cat a.txt\nx = 1\n$ echo $value\n1\n```\n"
        "```python\ny = 2.0\n```\nand then\n```python\nprint(y / 3)\n```\nprints\n```text\n0.667\n```\n"
        "```sh\n# needs a cluster\nfalse\n```\n```text\nno command\n```\n"))
    assert followed.faults == []
    assert followed.commands == 7
    assert followed.numbers == 3
    assert followed.left_out == ["page.md:27 needs a cluster"]


@pytest.mark.parametrize(("text", "fault"), [
    ("```sh\nls no_such_file\n```\n", "page.md:1: exit code 2: .*no_such_file"),
    ("```text\n$ echo 12\n13\n```\n", "page.md:1: printed '12', shown '13'"),
    ("```text\n$ echo one\none\ntwo\n```\n", "printed '', shown 'two'"),
    ("```text\n$ printf 'one\\ntwo\\n'\none\n```\n", "printed 'two', shown ''"),
    ("```python\nprint(0.5)\n```\nprints\n```text\n0.9\n```\n", "shown '0.9'"),
    ("```python\nraise ValueError('no')\n```\n", "page.md:1: exit code 1: .*ValueError: no"),
])
def test_what_is_wrong_on_a_page_is_found(tmp_path: Path, text: str, fault: str) -> None:
    faults = _follow(tmp_path, text).faults
    assert faults
    assert re.search(fault, faults[0])


@pytest.mark.parametrize(("printed", "shown", "agree"), [
    ("u = 0.503 px", "u = 0.501 px", True), ("u = 0.505 px", "u = 0.501 px", False),
    ("4 nodes", "5 nodes", False), ("3.1e-06", "3.0e-06", True), ("3.5e-06", "3.0e-06", False),
    ("/tmp/x/a.txt", "/.../a.txt", True), ("/tmp/x/b.txt", "/.../a.txt", False),
    ("read: 9.1 s", "read: 0.2 s", True), ("read: 9.1 px", "read: 0.2 px", False),
    ("read: s 9.1", "read: s 0.2", False),
    ("memory [MiB]: 3, 4", "memory [MiB]: 1, 2", True), ("memory [kB]: 3, 4", "memory [kB]: 1, 2", False),
])
def test_numbers_agree_to_three_units_of_their_last_digit(printed: str, shown: str, agree: bool) -> None:
    assert (find_differences(printed, shown, ("s", "MiB")) == []) is agree


def test_a_line_of_seconds_may_be_missing() -> None:
    shown = "read: 0.06 s\nnodes: 12\n"
    assert find_differences("nodes: 12\n", shown, ("s",)) == []
    assert find_differences("nodes: 12\n", shown) != []
    assert find_differences("read: 0.06 s\n", shown, ("s",)) != []


def test_a_column_that_differs_leaves_the_others() -> None:
    shown = "iter  |dq|  step/s\n   1  0.50    0.12\n"
    assert find_differences(shown.replace("0.12", "9.99"), shown, ("step/s",)) == []
    assert len(find_differences(shown.replace("0.50", "0.60"), shown, ("step/s",))) == 1


@pytest.mark.parametrize("page", PAGES)
def test_commands_stand_in_blocks_that_are_followed(page: str) -> None:
    """A command that is only indented would be read over."""
    text = re.sub(r"^( *)```.*?^\1```$", "", (ROOT / page).read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    indented = re.findall(r"^ {4,}(\S+) .*$", text, re.MULTILINE)
    assert [word for word in indented if word in COMMANDS] == []


def test_every_script_says_how_it_is_run() -> None:
    scripts = [page for page in list_pages() if page.endswith(".py")]
    assert len(scripts) > 10
    assert [script for script in scripts if not read_script(ROOT / script)] == []


def test_installation_is_the_same_wherever_it_is_written() -> None:
    """README, the page and what the set-up says where it finds nothing."""
    texts = [re.sub(r"\\+\n +", "", (ROOT / name).read_text(encoding="utf-8"))
             for name in ("README.md", "docs/installation.md", "scripts/setup.sh")]
    for start in ("conda create", "PETSC_CONFIGURE_OPTIONS=", "pip install cmake",
                  "pip install --no-build-isolation petsc4py"):
        assert all(start in text for text in texts)
        assert len({re.findall(rf"{start}[^\n]*", text)[0] for text in texts}) == 1


def test_the_readme_has_something_to_do_of_every_kind() -> None:
    assert {block.kind for block in read_blocks(ROOT / "README.md")} == {"sh", "console", "python", "file"}
