"""A user's environment is weighed by the files of what ddic needs, whatever else is installed beside it."""

from __future__ import annotations

from pathlib import Path

from accept.environment import find_installed, weigh_needs


def install(folder: Path, name: str, n_bytes: int, *needs: str) -> None:
    """What pip leaves of a package of one module: it, the compiled one, and what it says of them."""
    (folder / f"{name}.py").write_bytes(b"#" * n_bytes)
    (folder / f"{name}.pyc").write_bytes(b"#" * 1000)
    about = folder / f"{name}-1.dist-info"
    about.mkdir()
    lines = [f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\n", *(f"Requires-Dist: {need}\n" for need in needs)]
    (about / "METADATA").write_text("".join(lines), encoding="utf-8")
    (about / "RECORD").write_text(f"{name}.py,,\n{name}.pyc,,\nabsent.py,,\n", encoding="utf-8")


def test_only_what_ddic_needs_is_weighed(tmp_path: Path) -> None:
    not_asked = ('tests; extra == "dev"', 'old; python_version < "3"', "elsewhere")
    install(tmp_path, "ddic", 1, "Arrays>=2", "figures", *not_asked)
    install(tmp_path, "arrays", 30, "figures")
    install(tmp_path, "figures", 500, "arrays")
    for name in ("tests", "old", "unrelated"):
        install(tmp_path, name, 70)
    weights = weigh_needs(find_installed(tmp_path))
    assert list(weights.items()) == [("figures", 500), ("arrays", 30), ("ddic", 1)]
