from __future__ import annotations

import numpy as np

from support.guides import run_guide


def test_kinematics() -> None:
    guide = run_guide("kinematics")
    mesh, clamped, sliding = guide["mesh"], guide["clamped"], guide["sliding"]
    n_clamped = len(guide["left"]) + len(guide["right"])
    assert clamped.n_unknowns == mesh.n_dofs - 2 * n_clamped + 6
    assert sliding.n_unknowns == mesh.n_nodes
    # The left end is cut by two subdomains, which share its three unknowns.
    ends = np.arange(clamped.n_unknowns - 6, clamped.n_unknowns - 3)
    sharers = [s for s in guide["clamped_parts"] if np.isin(ends, s.numbers).any()]
    assert len(sharers) == 2
    assert all(np.isin(ends, s.numbers[s.jumps.unknowns]).all() for s in sharers)


def test_field_of_the_guide_is_rigid_at_the_clamped_ends() -> None:
    guide = run_guide("kinematics")
    for end in (guide["left"], guide["right"]):
        nodes, u = guide["mesh"].nodes[end], guide["u"][end]
        arm = nodes - nodes.mean(axis=0)
        turn = (u[:, 0] * -arm[:, 1] + u[:, 1] * arm[:, 0]).sum() / (arm**2).sum()
        rigid = u.mean(axis=0) + turn * np.stack([-arm[:, 1], arm[:, 0]], axis=1)
        assert np.abs(u - rigid).max() < 1e-9
    assert np.abs(guide["u"][guide["right"]].mean(axis=0) - [0.5, 0.32]).max() < 0.05
    assert np.abs(guide["u"][guide["left"]].mean(axis=0)).max() < 0.05


def test_checks_of_the_guide_can_fail() -> None:
    guide = run_guide("kinematics")

    class Wrong(guide["SlidingRegion"]):  # type: ignore[name-defined,misc]
        def restrict(self, part, node_ids, numbers):  # type: ignore[no-untyped-def]
            found = super().restrict(part, node_ids, numbers)
            return type(found)(part, numbers, 2 * found.matrix if node_ids[0] else found.matrix)

    try:
        guide["check_kinematics"](Wrong(guide["mesh"], guide["sliding"].directions))
    except AssertionError:
        return
    raise AssertionError("nodes torn apart were not noticed")
