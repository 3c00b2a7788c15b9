"""The mesh of a case, kept from the check for the measurement."""

from __future__ import annotations

from dataclasses import dataclass

from ddic.case.schema import Case
from ddic.mesh.mesh import Mesh
from ddic.partition.ties import Tying


@dataclass
class KeptMesh:
    """What was built of a case when it was checked: the measurement needs the same and takes it, once.

    It stays on the rank that checked: pickled, as other ranks get a case, it is empty.
    """

    _case: Case | None = None
    _built: tuple[Mesh, Tying | None] | None = None

    def keep(self, case: Case, mesh: Mesh, tying: Tying | None) -> None:
        """Keep the mesh of a case, in place of any other.

        Parameters
        ----------
        case : Case
            That it was built of.
        mesh : Mesh
            The whole mesh, pixels.
        tying : Tying or None
            How near fields' own meshes are tied in it; None where there are none.
        """
        self._case, self._built = case, (mesh, tying)

    def take(self, case: Case) -> tuple[Mesh, Tying | None] | None:
        """Give the mesh of a case away, so that its memory is the taker's.

        Parameters
        ----------
        case : Case
            That is measured.

        Returns
        -------
        tuple of Mesh and Tying or None
            As ``build_meshes`` would build it; None where no mesh of this very case is kept.
        """
        if self._case is not case:
            return None
        built, self._case, self._built = self._built, None, None
        return built

    def __reduce__(self) -> tuple[type[KeptMesh], tuple[()]]:
        return KeptMesh, ()
