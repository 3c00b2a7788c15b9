"""What a cut-off wavelength means: which waves keep half of their amplitude."""

from __future__ import annotations

from dataclasses import dataclass

from ddic.functionals.elasticity import Material


@dataclass(frozen=True)
class HalfAmplitudes:
    """Wavelengths at which a wave of the displacement is measured with half of its amplitude.

    Attributes
    ----------
    shear : float
        Of waves across their direction, pixels.
    longitudinal : float
        Of waves along it, pixels.
    """

    shear: float
    longitudinal: float

    def describe(self) -> str:
        """Say it to the user.

        Returns
        -------
        str
            For the log and ``ddic check``.
        """
        return (f"waves of {self.shear:.4g} px (shear) and {self.longitudinal:.4g} px (longitudinal) keep half of "
                "their amplitude")


def find_half_amplitudes(material: Material, wavelength: float) -> HalfAmplitudes:
    """Find the wavelengths that eta of a cut-off wavelength halves, where texture and mechanics count alike.

    A wave of the length l_c loads its nodes in proportion to c, c = lambda + 2 mu along its direction and mu across it,
    and one of another length in proportion to c (l_c / l)^2. As eta is the mean over both of v^T M v / |K v|^2, a wave
    is halved where c^2 (l_c / l)^4 mean(1 / c^2) = 1.

    Parameters
    ----------
    material : Material
        Of the regularization.
    wavelength : float
        l_c, pixels.

    Returns
    -------
    HalfAmplitudes
        On a mesh that is fine beside them, for texture without a direction.
    """
    lame, mu = material.lame
    shear, longitudinal = mu, lame + 2.0 * mu
    mean = (shear**-2 + longitudinal**-2) / 2.0
    return HalfAmplitudes(*(wavelength * (c**2 * mean) ** 0.25 for c in (shear, longitudinal)))
