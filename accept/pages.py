"""The pages: where is Eq. n, do they build, and does README, tour, every example and page do what it says.

Pages are followed word by word in another folder, as root and not.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from accept.support.follow_page import LIMIT_S, Followed
from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import ROOT, NotHereError, environment

PRINTED = 400
"""Characters of a tool's last words that a row shows."""


def measure_equations(scale: Scale) -> list[Row]:
    """Run the test that opens the function of every numbered equation of [BP17]."""
    del scale
    code, printed = _run("pytest", "-q", "-p", "no:cacheprovider", "tests/test_equations.py")
    counts = re.findall(r"\d+ (?:passed|failed|error)[^\n]*", printed)
    return [Row("docs/symbols.md: numbered equations of [BP17], the function of each opened by tests/test_equations.py",
                "every equation has a row; every function says that it is it",
                counts[-1] if counts else printed[-PRINTED:], code == 0)]


def measure_docs(scale: Scale) -> list[Row]:
    """Check public docstrings; build the site and run the examples, but in smoke runs: CI does both by itself."""
    return [_docstrings()] if scale.smoke else [_docstrings(), build_site(), _examples()]


def build_site() -> Row:
    """Build the documents, links and anchors between them included."""
    code, printed = _run("mkdocs", "build", "--strict", "--quiet", "--site-dir", str(ROOT / "bench" / "data" / "site"))
    if "No module named mkdocs" in printed:
        raise NotHereError("mkdocs is not installed; make docs installs it")
    n_warnings = len(re.findall(r"^(?:WARNING|ERROR)", printed, re.MULTILINE))
    return Row("make docs", "builds without a warning", f"{n_warnings} warnings, exit code {code}"
               + (f": {printed[-PRINTED:]}" if code else ""), code == 0 and n_warnings == 0)


def _docstrings() -> Row:
    command = [sys.executable, "scripts/check_docstrings.py", "src/ddic"]
    done = subprocess.run(command, cwd=ROOT, text=True, capture_output=True, env=environment(), check=False)
    lines = (done.stdout + done.stderr).strip().splitlines()
    return Row("public names of src/ddic: shapes and units in docstrings (scripts/check_docstrings.py)",
               "nothing is missing", lines[-1][-PRINTED:] if lines else "nothing", done.returncode == 0)


def _examples() -> Row:
    code, printed = _run("pytest", "-q", "-p", "no:cacheprovider", "tests/test_examples.py")
    counts = re.findall(r"\d+ (?:passed|failed|error)[^\n]*", printed)
    return Row("examples/: every printed number", "as its page shows", counts[-1] if counts else printed[-PRINTED:],
               code == 0)


def _run(module: str, *arguments: str) -> tuple[int, str]:
    """Exit code and output of a Python tool."""
    done = subprocess.run([sys.executable, "-m", module, *arguments], cwd=ROOT, text=True, capture_output=True,
                          env=environment(), check=False)
    return done.returncode, done.stdout + done.stderr


NOBODY = 65534
"""Number of the user and of the group that own nothing."""

SMALL = ("examples/translation/README.md", "docs/guides/python.md")
"""What a smoke run follows: without a set-up of its own."""

MOST_FAULTS = 10
"""Faults that a row shows."""


def measure_followed_pages(scale: Scale) -> list[Row]:
    """Copy the repository, follow its pages there as root, and again as a user without rights."""
    if scale.smoke:
        return [measure_followed("this user", SMALL, (), link=True)]
    pages = list_pages()
    if os.geteuid() != 0:
        return [measure_followed("this user, not root", pages, ()),
                Row("the pages as root", "followed", "not possible here: this user is not root", False,
                    judged_small=False)]
    return [measure_followed("root", pages, ()), measure_followed("a user without rights", pages, _as_nobody())]


def list_pages() -> list[str]:
    """List the pages in the order in which they are followed: README and tutorials make what others go on from."""
    examples = ROOT / "examples"
    tutorials = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
    others = [page for page in sorted((ROOT / "docs").rglob("*.md")) if page not in tutorials]
    listed = [ROOT / "README.md", *tutorials, *others, *sorted(examples.glob("*/README.md")),
              *sorted(examples.glob("*.py")), ROOT / "CONTRIBUTING.md"]
    return [path.relative_to(ROOT).as_posix() for path in listed]


def _as_nobody() -> tuple[str, ...]:
    if shutil.which("setpriv") is None:
        raise NotHereError("setpriv (util-linux), which starts a command as another user")
    return ("setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups")


def measure_followed(who: str, pages: Sequence[str], launcher: tuple[str, ...], *, link: bool = False) -> Row:
    """Follow pages in a copy of the repository; ``link``: with the packages of this environment, installing nothing."""
    with tempfile.TemporaryDirectory() as outer:
        Path(outer).chmod(0o755)
        folder = copy_repository(Path(outer) / "another_folder")
        if link:
            (folder / ".venv").symlink_to(sys.prefix)
        if launcher:
            subprocess.run(["chown", "-R", f"{NOBODY}:{NOBODY}", str(folder)], check=True)
        found = _follow(folder, pages, launcher)
    held = not found.faults and found.commands > 0
    shown = "; ".join(found.faults[:MOST_FAULTS]) or "none"
    return Row(f"{len(pages)} pages followed word by word in another folder as {who}",
               "no command fails, no printed line differs",
               f"{found.commands} commands, {found.numbers} printed numbers; faults: {len(found.faults)} ({shown}); "
               f"left out: {len(found.left_out)} ({'; '.join(found.left_out) or 'none'})", held)


def copy_repository(folder: Path) -> Path:
    """Copy what git holds or would hold to a folder, which is returned."""
    listed = subprocess.run(["git", "ls-files", "-co", "--exclude-standard", "-z"], cwd=ROOT, check=True, text=True,
                            capture_output=True).stdout
    for name in listed.split("\0"):
        if name and (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


def _follow(folder: Path, pages: Sequence[str], launcher: tuple[str, ...]) -> Followed:
    """Follow the pages in processes that know nothing of this one's environment of Python and MPI."""
    (folder / ".home").mkdir()
    if launcher:
        os.chown(folder / ".home", NOBODY, NOBODY)
    if "DDIC_REAL_DATA" in os.environ:
        (folder / ".home" / "images").symlink_to(os.environ["DDIC_REAL_DATA"])
    own = Path(sys.prefix) / "bin"
    path = os.pathsep.join(part for part in os.environ["PATH"].split(os.pathsep) if Path(part) != own)
    of_python = ("PYTHON", "VIRTUAL_ENV", "OMPI_", "PMIX_", "DDIC_")
    clean = {name: value for name, value in environment().items() if not name.startswith(of_python)}
    clean |= {"PATH": path, "HOME": str(folder / ".home"), "TMPDIR": str(folder / ".home")}
    command = [*launcher, "/usr/bin/env", "python3", "-m", "accept.support.follow_page", str(folder), *pages]
    done = subprocess.run(command, cwd=folder, env=clean, text=True, capture_output=True, timeout=LIMIT_S * len(pages),
                          check=False)
    if done.returncode != 0:
        raise RuntimeError(f"the pages could not be followed, exit code {done.returncode}: {done.stderr[-1000:]}")
    return Followed(**json.loads(done.stdout))
