"""A mesh cut into blocks on the ranks of a team, with the residual of a pair of images in memory."""

from __future__ import annotations

import numpy as np

from ddic.functionals.correlation import read_correlation
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.functionals.view import FrameView, View
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from ddic.kinematics.nodal import NodalRegion
from ddic.mesh.mesh import Mesh
from ddic.parallel.distribution import split_evenly
from ddic.parallel.team import Team
from ddic.partition.build_subdomains import build_subdomains
from ddic.partition.split import split_by_blocks
from ddic.problem.residual_model import ResidualModel
from ddic.problem.views import FrameViews, ReferenceViews
from ddic.solvers.local_system import LocalSystem


def split_model(team: Team, reference: MaskedSource, deformed: MaskedSource, mesh: Mesh, blocks: tuple[int, int],
                correction: GreyCorrection = "none") -> ResidualModel:
    """The residual of the pair on subdomains whose numbers are those of the blocks."""
    controlled = np.zeros(mesh.n_dofs, dtype=bool)
    everything = build_subdomains(NodalRegion(mesh), split_by_blocks(mesh, blocks), controlled)
    views = []
    for k in split_evenly(np.ones(len(everything)), team.size)[team.rank]:
        subdomain = everything[k]
        view = View(read_correlation(subdomain.mesh, reference, 3), subdomain.kinematics)
        frame_view = FrameView(view, DeformedSubImage(deformed, 3))
        views.append(FrameViews(ReferenceViews(subdomain, (view,)), (frame_view,)))
    return ResidualModel(team, views, correction)


def systems_of(model: ResidualModel) -> list[LocalSystem]:
    """M_s of owned subdomains, without regularization."""
    return [LocalSystem(s.subdomain, s.reference.project([s.reference.own.assemble_hessian()]), None, np.zeros(0), 0.0)
            for s in model.views]
