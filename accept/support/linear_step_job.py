"""The MPI part of bench/linear_step.py: prints one JSON line per variant from rank 0."""

from __future__ import annotations

import json
import sys

import numpy as np
from bench.support.step_problem import (
    distributed_problem,
    dof_multiplicity,
    monolithic_correction,
    relative_difference,
    whole_problem,
)
from mpi4py import MPI

from ddic.case.schema import Case
from ddic.parallel.team import Team
from ddic.problem.linear_solver import linear_step

PARTITIONS = {"blocks": {4: [2, 2], 9: [3, 3], 16: [4, 4]}, "metis": {4: 4, 9: 9, 16: 16}}
VARIANTS = {"consistent": 64.0, "paper": 64.0, "unregularized": None}


def main(folder: str) -> None:
    team = Team(MPI.COMM_WORLD)
    for variant, wavelength in VARIANTS.items():
        base = {
            "images": {"reference": f"{folder}/reference.tif", "deformed": f"{folder}/deformed.tif"},
            "mesh": {"structured": {"region": [20, 20, 492, 492], "element_size": 10}},
        }
        if wavelength is not None:
            base["regularization"] = {"cut_off_wavelength": wavelength}
        pair, whole = whole_problem(Case.model_validate(base))
        rng = np.random.default_rng(0)
        q = rng.normal(scale=0.1, size=whole.mesh.n_dofs)
        b = whole.assembly.systems[0].hessian @ rng.normal(size=whole.mesh.n_dofs)
        for kind, sizes in PARTITIONS.items():
            for count, split in sizes.items():
                if count < team.size:
                    continue
                solver = {"partition": kind, "tolerance": 1e-12, "blocks" if kind == "blocks" else "subdomains": split,
                          "weighting": "paper" if variant == "paper" else "consistent"}
                case = Case.model_validate({**base, "solver": solver})
                problem = distributed_problem(team, case, pair, whole.mesh)
                shared = dof_multiplicity(whole.mesh, problem)
                reference = monolithic_correction(whole, case.regularization, q, b,
                                                  shared if variant == "paper" else None)
                step, _ = linear_step(team, case.solver, problem.assembly, problem.operators)
                result = step.solve([q[d] for d in problem.dofs], [b[d] / shared[d] for d in problem.dofs])
                difference = relative_difference(problem, result.dq, reference)
                step.destroy()
                for operator in problem.operators:
                    operator.destroy()
                if team.is_root:
                    print(json.dumps({"variant": variant, "partition": kind, "subdomains": count, "ranks": team.size,
                                      "relative_difference": difference,
                                      "iterations": result.krylov_iterations}), flush=True)


main(sys.argv[1])
