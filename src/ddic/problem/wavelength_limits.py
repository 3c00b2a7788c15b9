"""Cut-off wavelengths that elements carry."""

from __future__ import annotations

from ddic.errors import InputError

SHORTEST_WAVELENGTH = 3.0
"""Elements per cut-off wavelength below which a plane wave is not one on the mesh (aliasing)."""

LONGEST_WAVELENGTH = 1000.0
"""Elements per cut-off wavelength beyond which M is lost in A = M + eta Kbar^T Kbar, whose ratio grows as its
fourth power (1e12 here, of 1e16)."""


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
