"""A measurement as a job of a real Slurm on this machine: the result of mpirun, and a clean stop ahead of the limit."""

from __future__ import annotations

import shutil
import warnings
from pathlib import Path

import ddic
from accept.support.job_script import edit_job_script
from accept.support.one_machine_slurm import Slurm, one_machine_slurm
from accept.support.same_datasets import find_unequal_datasets
from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import ddic_command, images, mpirun

LAUNCHERS = ("mpirun", "srun --mpi=pmix")

LONGEST_S = 400.0
"""Seconds after which a job counts as hanging."""

STOP_OPTIONS = ("--time=00:03:00", "--signal=B:USR1@120")
"""Slurm looks every 30 s, hence signals between 30 and 60 s from the beginning: the run must iterate then, or be about
to, and iterates once at least; it has two minutes left."""

_ENDLESS = "[gauss_newton]\ntolerance = 1e-300\nrms_tolerance = 1e-300\nlargest_tolerance = 1e-300\n"


def measure_slurm_job(scale: Scale) -> list[Row]:
    """Run the batch script of ``scripts/slurm`` with two tasks, under either launcher.

    Parameters
    ----------
    scale : Scale
        A smoke run has smaller images, so that no signal finds it running.

    Returns
    -------
    list of Row
        Equal results, and the clean stop, of each launcher.
    """
    folder = scale.folder("slurm")
    case = _write_case(folder / "mpirun", 600 if scale.smoke else 1200, 15)
    mpirun(2, ddic_command(), "run", str(case))
    with one_machine_slurm() as slurm:
        rows = [_compare(slurm, launcher, case) for launcher in LAUNCHERS]
        case = _write_case(folder / "long", 600 if scale.smoke else 3600, 6, _ENDLESS)
        rows += [_stop(slurm, launcher, case) for launcher in LAUNCHERS]
    return rows


def _write_case(folder: Path, side: int, element_size: int, more: str = "") -> Path:
    """A plate with a hole in tension, of two subdomains a rank, with nothing left in its folder."""
    shutil.rmtree(folder, ignore_errors=True)
    images("kirsch", "--size", f"{side}x{side}", "--strain", "0.005", "--radius", str(side // 12), "--noise", "2",
           "--seed", "1", folder=folder / "images")
    centre = (side - 1) / 2
    (folder / "case.toml").write_text(
        '[images]\nreference = "images/reference.tif"\ndeformed = "images/deformed.tif"\n'
        f"[mesh.structured]\nregion = [50, 50, {side - 50}, {side - 50}]\nelement_size = {element_size}\n"
        f"circles = [{{ center = [{centre}, {centre}], radius = {side // 12} }}]\n"
        "[regularization]\ncut_off_wavelength = 200\n"
        'not_controlled = ["left", "right", "top", "bottom"]\n[solver]\nmethod = "dual"\nsubdomains = 8\n'
        f'{more}[output]\nfile = "result.vtkhdf"\n', encoding="utf-8")
    return folder / "case.toml"


def _submit(slurm: Slurm, launcher: str, case: Path, *options: str) -> tuple[dict[str, str], str]:
    """State of a finished job, and its log."""
    export = f"--export=ALL,DDIC_LAUNCH={launcher}"
    job = slurm.submit(edit_job_script("slurm", case), export, *options)
    state = slurm.wait(job, LONGEST_S)
    return state, (case.parent / f"ddic-{job}.log").read_text(encoding="utf-8")


def _compare(slurm: Slurm, launcher: str, case: Path) -> Row:
    """A row on the same case as mpirun had outside of Slurm."""
    inside = case.parent.with_name("job")
    shutil.rmtree(inside, ignore_errors=True)
    inside.mkdir()
    shutil.copytree(case.parent / "images", inside / "images")
    state, log = _submit(slurm, launcher, Path(shutil.copy(case, inside)))
    result = inside / "result.vtkhdf"
    if not result.is_file():
        return Row(f"Slurm job, 2 tasks, {launcher}", "same result as mpirun", f"none: {log[-400:]}", False)
    n_compared, unequal = find_unequal_datasets(case.parent / "result.vtkhdf", result)
    measured = (f"{state['JobState']}, exit code {state['ExitCode']}; of {n_compared} datasets {len(unequal)} differ "
                f"in any bit {' '.join(unequal)}").strip()
    on_two = "on 2 ranks" in log
    return Row(f"Slurm job, 2 tasks, {launcher}", "same result as mpirun outside of Slurm", measured,
               on_two and not unequal and state["ExitCode"] == "0:0")


def _stop(slurm: Slurm, launcher: str, case: Path) -> Row:
    """A row on a job that Slurm signals ahead of the end of its time."""
    for left in (*case.parent.glob("result*"), *case.parent.glob("ddic-*")):
        left.unlink()
    state, log = _submit(slurm, launcher, case, *STOP_OPTIONS)
    kept = case.parent / "result.not_converged.vtkhdf"
    said = next((line for line in log.splitlines() if line.startswith("stopped by a signal")), "no stop")
    is_kept = kept.is_file() and _is_readable(kept)
    rubbish = [path.name for path in case.parent.glob(".*")]
    measured = (f"{state['JobState']}, exit code {state['ExitCode']} after {state['RunTime']}; "
                f"{said.split(';')[0]}; last field {'kept and marked' if is_kept else 'lost'}; "
                f"{len(rubbish)} temporary files left")
    return Row(f"walltime signal, {launcher}", "clean stop: exit code 3, last field kept, before the limit of 3 min",
               measured, is_kept and state["ExitCode"] == "3:0" and not rubbish, judged_small=False)


def _is_readable(kept: Path) -> bool:
    with warnings.catch_warnings():
        # That it did not converge is what is asked here.
        warnings.simplefilter("ignore", UserWarning)
        return not ddic.open(kept).converged
