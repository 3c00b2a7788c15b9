"""The batch scripts of ``scripts/``, their three places edited as a user does."""

from __future__ import annotations

import re
from pathlib import Path

from bench.support.runs import ROOT, ddic_command


def edit_job_script(system: str, case_file: Path, changes: dict[str, str] | None = None,
                    program: str | None = None) -> Path:
    """Copy a batch script beside a case, with the program and the case filled in.

    Parameters
    ----------
    system : str
        "slurm", "pbs" or "mpirun".
    case_file : Path
        The case; paths in it are relative to it.
    changes : dict, optional
        Other texts of the script and what stands in their place.
    program : str, optional
        Path of the program; the command line of this environment by default.

    Returns
    -------
    Path
        The copy, ``job.sh``.

    Raises
    ------
    ValueError
        Where the script has not three places, or lacks a text.
    """
    text = (ROOT / "scripts" / system / "job.sh").read_text(encoding="utf-8")
    places = re.findall(r"^# EDIT (\d) of 3: ", text, flags=re.MULTILINE)
    if places != ["1", "2", "3"]:
        raise ValueError(f"scripts/{system}/job.sh: places to edit are {places}")
    filled = {"ddic=/path/to/ddic/.venv/bin/ddic": f"ddic={program or ddic_command()}",
              "case_file=/path/to/measurement/case.toml": f"case_file={case_file}", **(changes or {})}
    for old, new in filled.items():
        if text.count(old) != 1:
            raise ValueError(f"scripts/{system}/job.sh: {old!r} stands there {text.count(old)} times")
        text = text.replace(old, new)
    script = case_file.parent / "job.sh"
    script.write_text(text, encoding="utf-8")
    return script
