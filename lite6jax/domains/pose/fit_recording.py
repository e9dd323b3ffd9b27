"""The fit of a recording of poses: screened for data faults first, as in a diagnosis, and fitted without them."""

from dataclasses import replace

from lite6jax.arms.arm import Arm
from lite6jax.domains.pose.screening.options import ScreeningOptions
from lite6jax.domains.pose.screening.screen import screen
from lite6jax.fitting import recording_fit
from lite6jax.fitting.chunks import MAX_STEPS
from lite6jax.fitting.problem import Geometry
from lite6jax.fitting.recognition import with_arm
from lite6jax.fitting.recording_fit import Loss
from lite6jax.fitting.solution import Solution
from lite6jax.fitting.solve import Solver
from lite6jax.recordings import Recording


def fit_recording(
    recording: Recording,
    nominal: Arm | None = None,
    *,
    geometry: Geometry = "declared",
    loss: Loss = "student_t",
    solver: Solver = "gauss_newton",
    max_steps: int = MAX_STEPS,
    options: ScreeningOptions | None = None,
) -> Solution:
    """The fit of a recording without the faults of its data; these are in `faults` of the solution.

    Args:
        recording: measured poses.
        nominal: the nominal arm; from the sidecar, or recognised, where not given.
        geometry: what is known of it, as in `fit`.
        loss: Student's t, or least squares.
        solver: as in `fit`.
        max_steps: most steps of one solve.
        options: thresholds of the screening.

    Raises:
        InputError: no measured poses, too few of them, or as `recording_problem`.
    """
    recording = recording if nominal is not None else with_arm(recording)
    # without the rigid arm, whose residuals take as much memory as the recording
    screened = replace(screen(recording, nominal, geometry, options), rigid=None)
    solution = recording_fit.fit_recording(
        screened.recording, screened.arm, geometry=geometry, loss=loss, solver=solver, max_steps=max_steps
    )
    return replace(solution, faults=screened.found)
