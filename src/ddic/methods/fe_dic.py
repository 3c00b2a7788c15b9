"""FE-DIC and R-DIC of a case: the method of cases that ask for no other one."""

from ddic.case.schema import Case
from ddic.check.case import check_on_mesh, check_ranks_of_subdomains
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.inputs.mesh_source import build_meshes
from ddic.mesh.mesh import Mesh
from ddic.methods.dd_dic import DecomposedSession
from ddic.methods.detect import LineSession, can_correct_lines
from ddic.methods.method import MethodSession
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.results.listener import Listener


class FiniteElements:
    """Displacements of the nodes of a mesh, with jumps across lines; a ``Method``."""

    check_ranks = staticmethod(check_ranks_of_subdomains)
    check = staticmethod(check_on_mesh)

    def build_result_mesh(self, case: Case, width: int, height: int) -> Mesh:
        """Build the mesh of the case."""
        return build_meshes(case, width, height)[0]

    def prepare(self, team: Team, inputs: Inputs, listener: Listener, clock: PhaseClock,
                first_frame: Frame | None = None) -> MethodSession:
        """Prepare M, factors and coarse space."""
        session = LineSession if can_correct_lines(inputs.case) else DecomposedSession
        return session(team, inputs, listener, clock, first_frame)


METHOD = FiniteElements()
