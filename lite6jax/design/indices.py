"""Observability indices: one number for how well a set of poses determines a model."""

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.errors import InputError


@final
@dataclass(frozen=True)
class Observability:
    """The five indices of Y. Sun and J. Hollerbach, "Observability index selection for robot calibration", ICRA 2008.

    With σ₁ ≥ … ≥ σ_L the singular values of the identification Jacobian of m poses; higher is better. They depend on
    how the parameters are scaled, O1's ranking of pose sets excepted.

    Attributes:
        O1: (σ₁ … σ_L)^(1/L) / √m, the volume of the ellipsoid of the observable parameters (J. Borm, C. Menq,
            IJRR 10(5), 1991): D-optimality.
        O2: σ_L / σ₁, the inverse of the condition number (M. Driels, U. Pathre, J. Robotic Systems 7(2), 1990).
        O3: σ_L, the smallest singular value (A. Nahvi, J. Hollerbach, V. Hayward, ICRA 1994): E-optimality.
        O4: σ_L² / σ₁, the noise amplification index (A. Nahvi, J. Hollerbach, ICRA 1996).
        O5: 1 / Σ 1/σᵢ, the harmonic mean over L (Sun and Hollerbach): close to A-optimality.
        condition: σ₁ / σ_L.
        noise_amplification: 1 / σ_L, how much of a unit of noise the worst direction of the parameters receives.
    """

    O1: float
    O2: float
    O3: float
    O4: float
    O5: float
    condition: float
    noise_amplification: float


def observability(singular_values: ArrayLike, samples: int) -> Observability:
    """The indices of the determined singular values `(rank,)` of `samples` poses.

    Raises:
        InputError: no singular value, one that is not positive, or no sample.
    """
    s = np.sort(np.asarray(singular_values, float).ravel())[::-1]
    if not len(s) or not (np.isfinite(s) & (s > 0)).all():
        raise InputError(f"singular values {s}: give those that are determined, above 0")
    if samples < 1:
        raise InputError(f"{samples} samples: give the number of poses, at least 1")
    return Observability(
        O1=float(np.exp(np.mean(np.log(s))) / np.sqrt(samples)),
        O2=float(s[-1] / s[0]),
        O3=float(s[-1]),
        O4=float(s[-1] ** 2 / s[0]),
        O5=float(1 / np.sum(1 / s)),
        condition=float(s[0] / s[-1]),
        noise_amplification=float(1 / s[-1]),
    )
