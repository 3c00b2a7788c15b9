"""Element size and cut-off wavelength of a case: others in their place, and which are worth a try."""

from ddic.case.schema import Case, RegularizationSection

ELEMENT_FACTORS = (0.5, 2**-0.5, 1.0, 2**0.5, 2.0)
"""Element sizes that are tried, over that of the case."""

WAVELENGTH_FACTORS = tuple(2 ** (k / 2) for k in range(-4, 5))
"""Cut-off wavelengths that are tried, over that of the case."""

ELEMENTS_A_WAVELENGTH = 5.0
"""Elements in the cut-off wavelength about which a case without one is tried."""

_DIGITS = 3
"""Of the sizes that are tried: they are written into case files."""


def set_resolution(case: Case, element_size: float | None, wavelength: float) -> Case:
    """Put another element size and cut-off wavelength l_c, pixels, into a case, and ask for no residual image.

    All else stays. An ``element_size`` of None keeps the mesh, a ``wavelength`` of 0 leaves the regularization out. The
    case is not validated again.
    """
    section = case.regularization
    if wavelength and section is not None:
        section = section.model_copy(update={"cut_off_wavelength": wavelength, "eta": None})
    elif wavelength:
        section = RegularizationSection(cut_off_wavelength=wavelength)
    else:
        section = None
    mesh = case.mesh
    if element_size is not None and mesh.structured is not None:
        structured = mesh.structured.model_copy(update={"element_size": element_size})
        mesh = mesh.model_copy(update={"structured": structured})
    output = case.output.model_copy(update={"residual_image": False})
    return case.model_copy(update={"mesh": mesh, "regularization": section, "output": output})


def list_element_sizes(case: Case) -> list[float | None]:
    """List element sizes about that of a case, pixels, its own first; None alone without [mesh.structured]."""
    if case.mesh.structured is None:
        return [None]
    own = case.mesh.structured.element_size
    x0, y0, x1, y1 = case.mesh.structured.box
    sizes = [_round(own * factor) for factor in ELEMENT_FACTORS]
    return [own, *(size for size in sizes if size != own and size <= min(x1 - x0, y1 - y0))]


def list_wavelengths(case: Case, typical_size: float) -> list[float]:
    """List cut-off wavelengths about that of a case, pixels, its own first, and 0 for no regularization.

    ``typical_size`` is that of its elements, pixels.
    """
    section = case.regularization
    own = None if section is None else section.cut_off_wavelength
    middle = ELEMENTS_A_WAVELENGTH * typical_size if own is None else own
    others = [0.0, *(_round(middle * factor) for factor in WAVELENGTH_FACTORS)]
    return list(dict.fromkeys([*([] if own is None else [own]), *others]))


def _round(size: float) -> float:
    return float(f"{size:.{_DIGITS}g}")
