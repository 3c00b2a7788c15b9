"""The recipes of containers fit one another and the set-up that they run; no container is built."""

from __future__ import annotations

import re
import shutil
import subprocess
import tomllib
from fnmatch import fnmatch
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]
RECIPES = ROOT / "scripts" / "container"
DOCKERFILE, APPTAINER, INSTALL = ((RECIPES / name).read_text(encoding="utf-8")
                                  for name in ("Dockerfile", "ddic.def", "install.sh"))
SETUP = (ROOT / "scripts" / "setup.sh").read_text(encoding="utf-8")
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def find(pattern: str, text: str) -> str:
    """The one place where a pattern fits."""
    (found,) = re.findall(pattern, text, re.MULTILINE)
    return str(found)


def pinned() -> dict[str, str]:
    """Versions of constraints/debian.txt by package."""
    lines = (ROOT / "constraints" / "debian.txt").read_text(encoding="utf-8").splitlines()
    pairs = [line.split("==") for line in lines if line and not line.startswith("#")]
    return {canonicalize_name(name): version for name, version in pairs}


@pytest.mark.parametrize("script", [RECIPES / "install.sh", ROOT / "scripts" / "setup.sh"], ids=lambda path: path.name)
def test_scripts_are_bash(script: Path) -> None:
    subprocess.run(["bash", "-n", str(script)], check=True)
    checker = shutil.which("shellcheck")
    if checker is not None:
        subprocess.run([checker, "--severity=warning", str(script)], check=True)


def test_both_recipes_do_the_same() -> None:
    system = find(r"^FROM (\S+)$", DOCKERFILE)
    assert find(r"^From: (\S+)$", APPTAINER) == system
    name, _, version = system.partition(":")
    # Of another system the set-up would take whatever Python has petsc4py, and find none.
    assert f'"${{ID:-}}" == {name} && "${{VERSION_ID:-}}" == {version}' in SETUP
    place = find(r"^COPY \. (\S+)$", DOCKERFILE)
    assert find(r"^%files\n    \. (\S+)$", APPTAINER) == place
    for recipe in (DOCKERFILE, APPTAINER):
        assert f"bash {place}/scripts/container/install.sh" in recipe
        assert f"PATH={place}/.venv/bin:$PATH" in recipe
        assert "OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1" in recipe


def test_what_the_set_up_needs_is_copied() -> None:
    ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8").split()
    needed = ["Makefile", "constraints/debian.txt", "scripts/setup.sh", "scripts/mpi_env.sh",
              "scripts/container/install.sh", "src/ddic/__init__.py", "pyproject.toml", PYPROJECT["project"]["readme"],
              *PYPROJECT["project"].get("license-files", [])]
    for path in needed:
        assert (ROOT / path).is_file(), path
        parts = ["/".join(path.split("/")[:n]) for n in range(1, path.count("/") + 2)]
        assert not [pattern for pattern in ignored for part in parts if fnmatch(part, pattern)], path


def list_installed_needs(asked: list[Requirement]) -> set[str]:
    """Packages that requirements bring along, by what is installed here; what is not installed brings none."""
    found: set[str] = set()
    while asked:
        requirement = asked.pop()
        extras = requirement.extras or {""}
        try:
            lines = metadata.requires(requirement.name) or []
        except metadata.PackageNotFoundError:
            continue
        if canonicalize_name(requirement.name) in found:
            continue
        found.add(canonicalize_name(requirement.name))
        brought = [Requirement(line) for line in lines]
        asked += [each for each in brought
                  if each.marker is None or any(each.marker.evaluate({"extra": extra}) for extra in extras)]
    return found


def test_every_version_is_pinned_and_as_ddic_asks_for() -> None:
    versions, project = pinned(), PYPROJECT["project"]
    asked = [Requirement(line) for line in (*project["dependencies"], *project["optional-dependencies"]["dev"])]
    for requirement in asked:
        version = versions.get(canonicalize_name(requirement.name), "none")
        assert version != "none", f"{requirement}: no version in constraints/debian.txt"
        assert requirement.specifier.contains(version), f"{requirement}: {version} in constraints/debian.txt"
    assert list_installed_needs(asked) - set(versions) == set()


def test_the_documents_name_the_versions_of_the_recipe() -> None:
    petsc = ".".join(pinned()["petsc4py"].split(".")[:2])
    clusters = (ROOT / "docs" / "clusters.md").read_text(encoding="utf-8")
    assert find(r"Debian's Open MPI \S+ and PETSc (\S+) into an image", clusters) == petsc
    packages = find(r"^readonly DEBIAN_PACKAGES=\((.+)\)$", SETUP)
    installation = (ROOT / "docs" / "installation.md").read_text(encoding="utf-8")
    assert f"apt-get install --no-install-recommends {packages}\n" in installation


@pytest.mark.skipif(shutil.which("dpkg-query") is None, reason="not a Debian")
def test_debian_has_the_petsc_that_is_pinned() -> None:
    shown = subprocess.run(["dpkg-query", "-W", "-f=${db:Status-Status} ${Version}", "python3-petsc4py-real"],
                           check=False, capture_output=True, text=True)
    state, _, version = shown.stdout.partition(" ")
    if state != "installed" or "VERSION_ID=\"12\"" not in Path("/etc/os-release").read_text(encoding="utf-8"):
        pytest.skip("not Debian 12 with its petsc4py")
    assert version.split("-")[0] == pinned()["petsc4py"]
