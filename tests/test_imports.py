from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "ddic"
SERIAL_LAYERS = ("images", "mesh", "kinematics", "functionals", "partition", "calibration", "case", "synth", "io")
COMMANDS = ("run", "synth", "info", "plot", "check")
SLOW_TO_IMPORT = ("matplotlib", "cv2", "numba", "meshio", "vtk", "scipy")


def run_python(*arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "COLUMNS": "100"}
    command = [sys.executable, *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)


def test_serial_layers_import_without_mpi4py_and_petsc4py() -> None:
    finished = run_python(str(ROOT / "scripts" / "import_serial_layers.py"))

    assert finished.returncode == 0, finished.stderr
    found = re.match(r"imported (\d+) modules", finished.stdout)
    assert found
    files = [file for layer in SERIAL_LAYERS for file in (SOURCE / layer).rglob("*.py")]
    # One module a file, and errors.py: none was skipped.
    assert int(found[1]) == len(files) + 1


def test_import_blocker_blocks() -> None:
    code = (
        "import import_serial_layers as script, importlib\n"
        "script.block(('petsc4py',))\n"
        "importlib.import_module('petsc4py')\n"
    )
    finished = run_python("-c", f"import sys; sys.path.insert(0, {str(ROOT / 'scripts')!r})\n{code}")

    assert finished.returncode == 1
    assert "ModuleNotFoundError" in finished.stderr


def test_help_lists_the_commands() -> None:
    script = Path(sys.executable).with_name("ddic")
    finished = subprocess.run(
        [str(script), "--help"], capture_output=True, text=True, timeout=120, check=False
    )

    assert finished.returncode == 0, finished.stderr
    listed = re.findall(r"^\W*([a-z]+)\s", finished.stdout, flags=re.MULTILINE)
    assert set(COMMANDS) <= set(listed), finished.stdout


def test_command_line_starts_without_the_slow_imports() -> None:
    finished = run_python(
        "-c",
        f"import sys, ddic.cli.app; print(*sorted(set({SLOW_TO_IMPORT!r}) & set(sys.modules)))",
    )

    assert finished.returncode == 0, finished.stderr
    assert finished.stdout.split() == []


def test_a_run_of_a_pair_imports_no_other_recipe() -> None:
    # scipy.ndimage brings scipy.special, together a tenth of a second: images are looked at by cv2, volumes by it.
    others = ("scipy.ndimage", "scipy.special", "ddic.methods.pgd_dic", "ddic.methods.series",
              "ddic.separated.separated_kernels", "ddic.detection.find_lines", "ddic.detection.lines_of_case",
              "ddic.results.field_uncertainty")
    finished = run_python("-c", "import sys, ddic.methods.run, ddic.results.console; "
                                f"print(*sorted(set({others!r}) & set(sys.modules)))")

    assert finished.returncode == 0, finished.stderr
    assert finished.stdout.split() == []
