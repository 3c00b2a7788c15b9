"""A mesh cut into blocks on the ranks of a team, with the residual of a pair of images in memory."""

from __future__ import annotations

import numpy as np

from ddic.functionals.correlation import read_correlation
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.functionals.view import View
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from ddic.kinematics.nodal import NodalRegion
from ddic.mesh.mesh import Mesh
from ddic.parallel.distribution import split_evenly
from ddic.parallel.field import ByView
from ddic.parallel.team import Team
from ddic.partition.sharing import build_subdomains
from ddic.partition.split import split_by_blocks
from ddic.problem.reference_problem import project_hessians
from ddic.problem.residual_model import ResidualModel
from ddic.solvers.local_system import LocalSystem


def split_model(team: Team, reference: MaskedSource, deformed: MaskedSource, mesh: Mesh, blocks: tuple[int, int],
                correction: GreyCorrection = "none") -> ResidualModel:
    """The residual of the pair on subdomains whose numbers are those of the blocks."""
    controlled = np.zeros(mesh.n_dofs, dtype=bool)
    everything = build_subdomains(NodalRegion(mesh), split_by_blocks(mesh, blocks), controlled)
    own = [everything[k] for k in split_evenly(np.ones(len(everything)), team.size)[team.rank]]
    views = ByView([View(read_correlation(s.mesh, reference, 3), s.kinematics)] for s in own)
    return ResidualModel(team, own, views.map(lambda view: view.open_frame(DeformedSubImage(deformed, 3))), correction)


def systems_of(model: ResidualModel) -> list[LocalSystem]:
    """M_s of owned subdomains, without regularization."""
    hessians = project_hessians(model.views, model.views.map(View.assemble_hessian))
    return [LocalSystem(s, m, None, np.zeros(0), 0.0) for s, m in zip(model.subdomains, hessians, strict=True)]
