"""What figures show of a diagnosis, as tables: explained shares of variance, spectra of orders, remaining residuals."""

import numpy as np

from lite6jax.diagnosis.result import Diagnosis
from lite6jax.effects.effect import Estimate
from lite6jax.effects.nonparametric import Unnamed


def peak_to_peak(found: Diagnosis, k: int) -> Estimate:
    """The range of a nonparametric finding's curve where it was measured, m or rad, and its standard deviation.

    The ends of the driver's range, where few samples are, do not count.

    Args:
        found: the diagnosis.
        k: which of its findings.
    """
    problem, finding = found.problem, found.findings[k]
    effect = finding.effect
    assert isinstance(effect, Unnamed)
    motion = problem.time_shifted
    driver = np.asarray(effect.drivers[0].values(motion, problem.loads))
    low, high = np.percentile(driver, (2, 98))
    basis = np.asarray(effect.basis(driver, motion.run))[:, (driver >= low) & (driver <= high)]
    curve = finding.values @ basis
    apart = basis[:, np.argmax(curve)] - basis[:, np.argmin(curve)]
    variance = float(apart @ finding.covariance @ apart)
    return Estimate(float(apart @ finding.values), float(np.sqrt(max(variance, 0.0))))
