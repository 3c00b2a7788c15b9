"""The MPI part of ``accept.frames``: measures frames in one session, prints a JSON line for each from rank 0.

Usage: frames_job TASK, a JSON object with "case" (a case file), "deformed" (an image for each frame), "keep" (frames,
from 1, whose displacement is kept), "folder" (where it goes) and "from_last" (whether a frame starts from the field of
the one before).
"""

from __future__ import annotations

import gc
import json
import resource
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from ddic.case.loader import load_case
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs, open_inputs
from ddic.methods.dd_dic import DecomposedSession
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.problem.views import open_frame_views
from ddic.results.listener import Silence
from ddic.results.measurement import Measurement
from ddic.results.publishing import gather

PAGE = resource.getpagesize()


def measure_resident() -> int:
    """Measure the resident memory of this process.

    Returns
    -------
    int
        Bytes.
    """
    gc.collect()
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * PAGE


def find_losing(inputs: Inputs, frame: Frame, session: DecomposedSession, measurement: Measurement) -> list[int]:
    """Find the owned subdomains some of whose pixels a frame does not show.

    Parameters
    ----------
    inputs : Inputs
        Settings.
    frame : Frame
        The deformed images.
    session : DecomposedSession
        With the reference's pixels.
    measurement : Measurement
        Of the frame.

    Returns
    -------
    list of int
        Their numbers.
    """
    losing = []
    views = open_frame_views(inputs.case, frame, session.problem.reference.references)
    for of_subdomain, q in zip(views, measurement.q, strict=True):
        (view,) = of_subdomain.views
        if view.without_hidden(q).n_pixels < view.view.n_pixels:
            losing.append(of_subdomain.subdomain.index)
    return losing


def measure_frames(team: Team, task: dict[str, Any]) -> None:
    """Measure all frames; collective.

    Parameters
    ----------
    team : Team
        Ranks.
    task : dict
        Of the command line.
    """
    loaded = load_case(Path(task["case"]))
    begin = time.perf_counter()
    inputs, _ = open_inputs(team, loaded)
    last: Measurement | None = None
    with DecomposedSession(team, inputs, Silence(), PhaseClock()) as session:
        preparation = time.perf_counter() - begin
        for number, deformed in enumerate(task["deformed"], start=1):
            section = loaded.case.images.model_copy(update={"deformed": Path(deformed)})
            _, frame = open_inputs(team, replace(loaded, case=loaded.case.model_copy(update={"images": section})))
            before = list(session.problem.solver.assembly.systems)
            team.wait_for_all()
            begin = time.perf_counter()
            last = session.measure(frame, last.q if last and task["from_last"] else None)
            team.wait_for_all()
            seconds = time.perf_counter() - begin
            record = describe(team, session, before)
            record |= {"frame": number, "seconds": seconds, "preparation_seconds": preparation,
                       "iterations": len(last.records),
                       "losing": team.gather_lists(find_losing(inputs, frame, session, last))}
            # Of every frame, as a user has it: what it takes must be free again with the next one.
            displacement = gather(last).displacement
            if number in task["keep"] and team.is_root:
                np.save(Path(task["folder"]) / f"session_{number}.npy", displacement)
            if team.is_root:
                print(json.dumps(record), flush=True)


def describe(team: Team, session: DecomposedSession, before: list[Any]) -> dict[str, Any]:
    """Say what a session has done so far, summed over ranks; collective.

    Parameters
    ----------
    team : Team
        Ranks.
    session : DecomposedSession
        After a frame.
    before : list
        Systems of owned subdomains before it.

    Returns
    -------
    dict
        Operators, renewed subdomains and memory.
    """
    problem = session.problem
    renewed = [system.subdomain.index for old, system in zip(before, problem.solver.assembly.systems, strict=True)
               if system is not old]
    return {"n_assembled": sum(team.gather_lists([problem.n_assembled])),
            "n_factorized": sum(team.gather_lists([problem.solver.n_factorized])),
            "renewed": team.gather_lists(renewed),
            "resident_bytes": sum(team.gather_lists([measure_resident()]))}


measure_frames(Team(MPI.COMM_WORLD), json.loads(sys.argv[1]))
