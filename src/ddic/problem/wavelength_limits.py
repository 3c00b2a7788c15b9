"""Cut-off wavelengths that elements carry."""

from __future__ import annotations

import math

from ddic.errors import InputError

SHORTEST_WAVELENGTH = 3.0
"""Elements per cut-off wavelength below which a plane wave is not one on the mesh (aliasing)."""

LONGEST_WAVELENGTH = 1000.0
"""Elements per cut-off wavelength beyond which M is lost in A = M + eta Kbar^T Kbar, whose ratio grows as its
fourth power (1e12 here, of 1e16)."""

NO_INNER_NODE = ("the mesh has no interior node, so no wavelength can be given a weight; use a finer mesh or give "
                 "regularization.eta")
"""What is said of a mesh all of whose nodes lie on its boundary."""


def check_weight_fits(eta: float, modulus: float, texture: float, size: float) -> None:
    """Check that the images are not lost beside the weight of the equilibrium gap.

    A weight stands for the wavelength 2 pi / k at which eta (modulus size k^2)^2 / 2, the gap of a plane wave per
    pixel, equals texture / 4, what its images say, both means over the wave's phase and direction.

    Parameters
    ----------
    eta : float
        Of the case, (grey levels / px)^2.
    modulus : float
        Of a strain in one direction, that of Young being 1.
    texture : float
        Mean of |grad f|^2, (grey level / px)^2.
    size : float
        Of the elements, pixels.

    Raises
    ------
    InputError
        Where that wavelength is longer than LONGEST_WAVELENGTH elements.
    """
    # A node's share of the gap is an element's force, hence size^2; its square is per node, hence 1 / size^2.
    largest = texture * size**2 / 2 * (LONGEST_WAVELENGTH / (2 * math.pi)) ** 4 / modulus**2
    if eta > largest:
        raise InputError(f"regularization.eta = {eta:g}: it stands for a cut-off wavelength of more than "
                         f"{LONGEST_WAVELENGTH:g} elements of {size:.3g} px, where rounding hides the images; give at "
                         f"most {largest:.2g}, or regularization.cut_off_wavelength")


def check_wavelength_fits(wavelength: float, size: float) -> None:
    """Check that elements carry a cut-off wavelength.

    Parameters
    ----------
    wavelength : float
        Of the case, pixels.
    size : float
        Of the elements, pixels.

    Raises
    ------
    InputError
        Where it is shorter than SHORTEST_WAVELENGTH elements or longer than LONGEST_WAVELENGTH.
    """
    if wavelength < SHORTEST_WAVELENGTH * size:
        raise InputError(f"regularization.cut_off_wavelength = {wavelength:g}: the mesh, of elements of {size:.3g} px, "
                         f"carries no wave shorter than {SHORTEST_WAVELENGTH:g} elements; give at least "
                         f"{SHORTEST_WAVELENGTH * size:.3g}, or leave the regularization out")
    if wavelength > LONGEST_WAVELENGTH * size:
        raise InputError(f"regularization.cut_off_wavelength = {wavelength:g}: more than {LONGEST_WAVELENGTH:g} "
                         f"elements of {size:.3g} px, where rounding hides the images (eta grows as its fourth "
                         f"power); give at most {LONGEST_WAVELENGTH * size:.3g}")
