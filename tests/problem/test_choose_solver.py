"""What solver.method = "auto" takes: what narrows it, what it leaves, and what a run tells of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ddic.case.loader import load_case
from ddic.inputs.cameras import open_cameras
from ddic.inputs.inputs import Inputs, SolverChoice
from ddic.inputs.mesh_source import build_meshes
from ddic.io.image_file import open_image
from ddic.io.result_reader import read_result
from ddic.kinematics.linear import LinearRegion
from ddic.mesh.mesh import Mesh
from ddic.methods.run import run_case
from ddic.parallel.team import Team
from ddic.problem import choose_solver as choosing
from ddic.problem.choose_solver import weigh_candidates
from ddic.problem.region_mesh import build_region_mesh
from support.cases import Ears, largest_difference, write_case, write_images
from support.measuring import measure, whole_field

PLENTY = 2**40
SHORT = "[regularization]\ncut_off_wavelength = 64\n"
LONG = "[regularization]\ncut_off_wavelength = 144\n"


def choose(folder: Path, solver: str = "", more: str = "", n_ranks: int = 2, memory: int = PLENTY,
           **changes: Any) -> SolverChoice:
    """The choice for 9 x 9 cells of 16 px."""
    if not (folder / "f.tif").exists():
        write_images(folder)
    case = load_case(write_case(folder, f"[solver]\n{solver}\n{more}")).case
    cameras = open_cameras(case, open_image)
    image = cameras[0].reference.image
    inputs = Inputs(case, cameras, lambda: build_meshes(case, image.extent), **changes)
    return weigh_candidates(inputs, build_region_mesh(inputs).measure_sizes(), n_ranks, memory)


def costs_of(choice: SolverChoice) -> set[str]:
    """Methods that the note names."""
    return {name for name in ("dual", "assembled", "conjugate_gradient", "monolithic")
            if f" {name} " in choice.note.replace(";", " ")}


def test_all_methods_are_weighed_and_the_note_tells(tmp_path: Path) -> None:
    choice = choose(tmp_path, more=SHORT)
    assert costs_of(choice) == {"dual", "assembled", "conjugate_gradient"}
    assert costs_of(choose(tmp_path, n_ranks=1, more=SHORT)) == {"assembled", "conjugate_gradient", "monolithic"}
    assert "200 unknowns, l_c of 4 cells, 5 steps, ranks: 2" in choice.note
    assert "\n" not in choice.note
    assert (choice.asked.solver.method, choice.case.solver.method) == ("auto", choice.note.split()[4])


@pytest.mark.parametrize(("solver", "more"), [
    ('weighting = "paper"', SHORT), ('preconditioner = "none"', ""), ("recycle = false", SHORT),
    ('local_inverse = "sparse"', SHORT)])
def test_who_gives_a_key_of_the_dual_method_gets_it(tmp_path: Path, solver: str, more: str) -> None:
    for n_ranks in (1, 2):
        choice = choose(tmp_path, solver, more, n_ranks)
        assert choice.case.solver.method == "dual"
        assert costs_of(choice) == {"dual"}
    key = solver.split(maxsplit=1)[0]
    assert getattr(choice.case.solver, key) == getattr(choice.asked.solver, key)


@pytest.mark.parametrize("solver", ['partition = "blocks"\nblocks = [3, 1]', "subdomains = 3",
                                    'partition = "file"\npartition_file = "parts.txt"'])
def test_a_given_number_of_subdomains_stays(tmp_path: Path, solver: str) -> None:
    (tmp_path / "parts.txt").write_text("\n".join(str(s % 3) for s in range(81)), encoding="utf-8")
    choice = choose(tmp_path, solver + '\nrecycle = false', SHORT, n_ranks=1)
    assert (choice.case.solver.method, "subdomains: 3" in choice.note) == ("dual", True)
    assert choice.case.solver.subdomains == (3 if solver.startswith("subdomains") else None)
    # One subdomain would be another number.
    assert "monolithic" not in costs_of(choose(tmp_path, solver, SHORT, n_ranks=1))


@pytest.mark.parametrize("more", [
    "[regularization]\neta = 1e4\n", "[[discontinuity]]\nvertices = [[0.0, 90.5], [192.0, 92.5]]\n"])
def test_iterations_that_cannot_be_predicted_are_not_relied_on(tmp_path: Path, more: str) -> None:
    assert "conjugate_gradient" not in costs_of(choose(tmp_path, more=more))


def test_own_kinematics_are_factorised(tmp_path: Path) -> None:
    def stretch(mesh: Mesh) -> LinearRegion:
        return LinearRegion(mesh, np.column_stack([np.repeat(axis, 2) for axis in mesh.nodes.T]))

    assert "conjugate_gradient" not in costs_of(choose(tmp_path, choose_kinematics=stretch))


def test_without_mumps_nothing_is_assembled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(choosing, "is_mumps_missing", lambda prefix: True)
    choice = choose(tmp_path, more=SHORT)
    assert costs_of(choice) == {"dual", "conjugate_gradient"}
    # There is nothing to take their place.
    assert choice.most_iterations is None


def test_a_factor_that_does_not_fit_is_not_chosen(tmp_path: Path) -> None:
    """The images take about 24 bytes x 81 x 1256 of each rank; what is beyond is too little for a factor."""
    roomy = choose(tmp_path, more=LONG)
    assert roomy.case.solver.method == "assembled"
    tight = choose(tmp_path, more=LONG, memory=0)
    assert tight.case.solver.method == "conjugate_gradient"
    # The least of what does not fit.
    assert tight.note.count("(does not fit into 0 GiB)") == 3
    # Nothing can take their place: they may iterate as long as is predicted, and longer.
    assert tight.most_iterations is None
    assert tight.case.solver.max_iterations >= 1000


def test_frames_that_share_factors_are_counted(tmp_path: Path) -> None:
    assert "5 steps" in choose(tmp_path).note
    assert "50 steps" in choose(tmp_path, n_frames=10).note
    assert "20 steps" in choose(tmp_path, "frames = 4", n_frames=10).note


def test_the_dual_method_is_split_as_is_fastest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    costs = choosing.predict_costs
    monkeypatch.setattr(choosing, "SIDES", {2: (3,)})
    monkeypatch.setattr(choosing, "predict_costs", lambda task, candidate: replace(
        costs(task, candidate), set_up=0.0 if candidate.preconditioner == "two_level" else 3600.0))
    chosen = choose(tmp_path, more=LONG, n_ranks=2).case.solver
    # 9 subdomains of 3 x 3 cells, and one more for two ranks to have as many.
    assert (chosen.method, chosen.subdomains, chosen.preconditioner) == ("dual", 10, "two_level")


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("more", ["", LONG], ids=["alone", "regularized"])
def test_the_field_is_that_of_a_stated_method(shared_path: Path, more: str) -> None:
    team = Team.world()
    if team.is_root:
        write_images(shared_path)
        for name, method in (("auto", ""), ("stated", 'method = "assembled"\n')):
            path = write_case(shared_path, f"[solver]\n{method}{more}")
            path.rename(shared_path / f"{name}.toml")
    team.wait_for_all()
    fields = [whole_field(measure(team, shared_path / f"{name}.toml")) for name in ("auto", "stated")]
    # Both leave at most 5e-6 px RMS in the last step (gauss_newton.rms_tolerance / 20), after steps of 1e-4 at most.
    assert largest_difference(*fields) <= 1e-4


@pytest.mark.parallel([1, 3])
def test_result_and_summary_say_what_was_asked_and_what_was_used(shared_path: Path) -> None:
    team = Team.world()
    if team.is_root:
        write_images(shared_path)
        write_case(shared_path, f'[solver]\npreconditioner = "scaled"\nsubdomains = 3\n{SHORT}')
    team.wait_for_all()
    run_case(team, shared_path / "case.toml", Ears())
    team.wait_for_all()
    summary = json.loads((shared_path / "result.json").read_text(encoding="utf-8"))
    stored = read_result(shared_path / "result.vtkhdf").attributes
    for asked, used in ((summary["case"], summary), (json.loads(stored["case"]["json"]), stored["provenance"])):
        assert asked["solver"]["method"] == "auto"
        assert (used["method"], used["preconditioner"], used["n_subdomains"]) == ("dual", "scaled", 3)
    assert sum(line.startswith('solver.method = "auto" takes dual') for line in summary["notes"]) == 1


@pytest.mark.parallel([1, 3])
def test_conjugate_gradients_that_take_too_long_give_way_to_a_factor(shared_path: Path,
                                                                     monkeypatch: pytest.MonkeyPatch) -> None:
    """Two iterations are never enough; they are chosen because factors are said to take an hour."""
    costs = choosing.predict_costs
    monkeypatch.setattr(choosing, "predict_costs", lambda task, candidate: replace(
        costs(task, candidate), set_up=0.0 if candidate.method == "conjugate_gradient" else 3600.0))
    team, ears = Team.world(), Ears()
    if team.is_root:
        write_images(shared_path)
        write_case(shared_path, f"[solver]\nmax_iterations = 2\n{LONG}")
    team.wait_for_all()
    measured = measure(team, shared_path / "case.toml", ears)
    (note,) = [line for line in ears.notes if "takes their place" in line]
    assert note in measured.notes
    assert 'takes conjugate_gradient' in next(line for line in ears.notes if line.startswith("solver.method"))
    assert measured.method == "assembled"
    if team.is_root:
        (shared_path / "case.toml").write_text(
            (shared_path / "case.toml").read_text().replace("[solver]", '[solver]\nmethod = "assembled"'))
    team.wait_for_all()
    # The same factor from the first step on: rounding alone, of fields of a pixel.
    assert largest_difference(whole_field(measured), whole_field(measure(team, shared_path / "case.toml"))) <= 1e-10
