"""The fit of one arm, from its calibration or from a recording; the latter is screened for data faults first."""

from pathlib import Path

from numpy.typing import ArrayLike

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.fitting.calibration_fit import calibration_of_array, fit_calibration
from lite6jax.fitting.chunks import MAX_STEPS
from lite6jax.fitting.problem import Geometry
from lite6jax.fitting.recording_fit import Loss
from lite6jax.fitting.sampling import SAMPLES
from lite6jax.fitting.solution import Solution
from lite6jax.fitting.solve import Solver
from lite6jax.fitting.source import load_nominal, read_source
from lite6jax.recordings import Recording


def fit(
    source: str | Path | FactoryCalibration | Recording | ArrayLike,
    nominal: Arm | str | None = None,
    *,
    geometry: Geometry = "declared",
    loss: Loss = "student_t",
    solver: Solver = "gauss_newton",
    samples: int = SAMPLES,
    seed: int = 0,
    max_steps: int = MAX_STEPS,
) -> Solution:
    """Fits one arm.

    Args:
        source: a calibration (file, `FactoryCalibration` or `(joint, 6)` numbers in m and rad), or a recording (file or
            `Recording`).
        nominal: the arm's type, an `Arm` or a bundled name; recognised, or taken from the sidecar, where not given.
        geometry: of a recording; `declared` is what its sidecar declares.
        loss: of a recording; Student's t is 97 % efficient on Gaussian noise and robust to outliers.
        solver: `gauss_newton` is the fast one, `levenberg_marquardt` optimistix'. They agree to 1e-12 by least squares;
            with Student's t to 1e-5 standard deviations, where rounding exceeds the decrease of the cost.
        samples: of a calibration: joint positions to fit at, uniform inside the joint limits.
        seed: of the random joint positions.
        max_steps: most steps of one solve.

    Raises:
        InputError: the source cannot be used; see `read_factory`, `read_recording` and `recording_problem`.
    """
    arm = load_nominal(nominal)
    if isinstance(source, str | Path):
        source = read_source(source, arm)
    if isinstance(source, Recording):
        # the screening takes as long to import as a calibration takes to fit
        from lite6jax.domains.pose.fit_recording import fit_recording

        return fit_recording(source, arm, geometry=geometry, loss=loss, solver=solver, max_steps=max_steps)
    if not isinstance(source, FactoryCalibration):
        source = calibration_of_array(source, arm)
    return fit_calibration(source, solver=solver, samples=samples, seed=seed, max_steps=max_steps)
