"""The near and far images of a real foam, ratio 4, and the meshes on them; default settings throughout.

The far images are the 4 x 4 means of full-resolution ones, the near images a part of these at full resolution.
"""

from __future__ import annotations

from pathlib import Path

from accept.support.near_far_case import Pair, joint_case
from bench.support.runs import real_data
from ddic.images.camera import identity, similarity

RATIO, OFFSET = 4, (-358.5, -838.5)
REGION = (74, 10, 370, 530)
HOLES = ((159, 30, 73), (261, 179, 72), (153, 298, 72), (281, 405, 72), (222, 552, 68))


def foam_pairs() -> tuple[Pair, Pair]:
    """Find the images of both cameras.

    Returns
    -------
    far, near : Pair
        Without given noise.

    Raises
    ------
    NotHereError
        Where there are no real images.
    """
    folder = real_data() / "nearfar_foam"
    far, near = (Pair(folder / f"{name}_ref.tif", folder / f"{name}_def.tif", mapping) for name, mapping in (
        ("far", identity()), ("near", similarity(float(RATIO), 0.0, OFFSET))))
    return far, near


def foam_case(far: Pair, near: Pair, size: int, offset: tuple[int, int] = (0, 0), rest: str = "", *,
              use_far: bool = False) -> str:
    """Write a case with elements of one size, by default with nothing but default settings.

    Parameters
    ----------
    far, near : Pair
        Images.
    size : int
        Side of the elements, far px.
    offset : tuple of int
        By which the mesh begins further in, along x and y, far px.
    rest : str
        Further sections.
    use_far : bool
        Whether the far images measure the near camera's elements as well.

    Returns
    -------
    str
        TOML text.
    """
    holes = ", ".join(f"{{ center = [{x}, {y}], radius = {r} }}" for x, y, r in HOLES)
    region = [REGION[0] + offset[0], REGION[1] + offset[1], *REGION[2:]]
    mesh = f"[mesh.structured]\nregion = {region}\nelement_size = {size}\ncircles = [{holes}]\n"
    case = joint_case(far, near, mesh, rest)
    return case.replace("[[near]]\n", "[[near]]\nuse_far = true\n") if use_far else case


def name_pair(pair: Pair, folder: Path, name: str) -> Pair:
    """Name images of one camera that are to be written.

    Parameters
    ----------
    pair : Pair
        Whose mapping and noise they have.
    folder : Path
        Where they go.
    name : str
        Of the camera.

    Returns
    -------
    Pair
        With paths of TIFF files.
    """
    return Pair(folder / f"{name}_ref.tif", folder / f"{name}_def.tif", pair.mapping, pair.noise)
