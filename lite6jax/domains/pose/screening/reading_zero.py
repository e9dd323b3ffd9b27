"""The zero of a wire: a constant in all distances, in the place of a zero that is declared or taken for granted.

With the rigid arm, its geometry under its prior, the distances with a free constant are compared with those without.
The constant is a fault where it is clearly likelier and leaves no more than the sensor's noise; what else the arm may
have in its place is weighed in the diagnosis.
"""

from dataclasses import replace

import numpy as np

from lite6jax.domains.pose.rigid_arm import rigid_arm
from lite6jax.domains.pose.screening.screened import ScreenedPoses
from lite6jax.domains.pose.screening.thresholds import AS_NOISE_RATIO, MOST_FITTED
from lite6jax.estimation.projection import scaled_inverse
from lite6jax.recordings.fault import DataFault


def free_constant(state: ScreenedPoses) -> ScreenedPoses:
    """With a constant of the distances that is fitted, where it is a fault or was decided to be one."""
    recording = state.recording
    decision = state.corrections.constant
    readings = recording.touches
    settings = recording.settings
    if readings is None or readings.kind != "distance" or settings.distance_offset == "unknown":
        return state
    if decision is False:
        return state
    freed = replace(recording, settings=replace(settings, distance_offset="unknown"))
    free = rigid_arm(freed, state.rigid_arm.arm, state.geometry, state.factory)
    fitted = free.fitted(MOST_FITTED)
    J = fitted.frame_columns.reshape(len(fitted.unknown), -1) / fitted.scale
    covariance = scaled_inverse(J @ J.T + np.diag(fitted.precision))
    constant = float(fitted.measured.constant[0])  # type: ignore[attr-defined]
    std = float(np.sqrt(covariance[-1, -1]))
    if not decision:
        plain = state.rigid_arm.fitted(MOST_FITTED)
        scale = min(fitted.scale, plain.scale)
        gain = fitted.log_likelihood(scale) - plain.log_likelihood(scale)
        price = 0.5 * np.log(recording.samples) + state.prior.cost("distance_constant")
        declared = settings.distance_noise_m
        noisy = False
        if declared:
            noisy = fitted.scale * fitted.noise[0] > AS_NOISE_RATIO * declared
        if gain < price or noisy:
            return state.rule_out("distance_offset", reason="unsupported", log_likelihood_gain=float(gain))
    numbers = {"constant_m": constant, "std_m": std}
    return state.corrected(DataFault("distance_offset", (), numbers), rigid=fitted)
