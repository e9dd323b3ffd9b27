"""The fit of one arm, from its calibration or from a recording; the latter is screened for data faults first."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast, overload

from numpy.typing import ArrayLike

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.errors import wrong_type
from lite6jax.fitting.calibration_fit import calibration_of_array, fit_calibration
from lite6jax.fitting.chunks import MAX_STEPS
from lite6jax.fitting.problem import Geometry
from lite6jax.fitting.recording_fit import Loss
from lite6jax.fitting.sampling import SAMPLES
from lite6jax.fitting.solution import Solution
from lite6jax.fitting.solve import Solver
from lite6jax.fitting.source import load_nominal, read_source
from lite6jax.recordings import Recording
from lite6jax.recordings.units import real_array

Source = str | Path | FactoryCalibration | Recording
"""A file, or what one holds."""


@overload
def fit(
    source: Source | ArrayLike,
    nominal: Arm | str | Path | None = None,
    *,
    geometry: Geometry = ...,
    loss: Loss = ...,
    solver: Solver = ...,
    samples: int = ...,
    seed: int = ...,
    max_steps: int = ...,
) -> Solution: ...
@overload
def fit(
    source: Sequence[Source],
    nominal: Arm | str | Path | None = None,
    *,
    geometry: Geometry = ...,
    loss: Loss = ...,
    solver: Solver = ...,
    samples: int = ...,
    seed: int = ...,
    max_steps: int = ...,
) -> tuple[Solution, ...]: ...
def fit(
    source: Source | Sequence[Source] | ArrayLike,
    nominal: Arm | str | Path | None = None,
    *,
    geometry: Geometry = "declared",
    loss: Loss = "student_t",
    solver: Solver = "gauss_newton",
    samples: int = SAMPLES,
    seed: int = 0,
    max_steps: int = MAX_STEPS,
) -> Solution | tuple[Solution, ...]:
    """Fits one arm, or several one after the other.

    Args:
        source: a calibration (file, `FactoryCalibration` or `(joint, 6)` numbers in m and rad), or a recording (file or
            `Recording`). Or a list of files, calibrations and recordings: each is fitted by itself.
        nominal: the arm's type, an `Arm`, a bundled name or a file; recognised, or from the sidecar, where not given.
        geometry: of a recording; `declared` is what its sidecar declares.
        loss: of a recording; Student's t is 97 % efficient on Gaussian noise and robust to outliers.
        solver: `gauss_newton` is the fast one, `levenberg_marquardt` optimistix'. They agree to 1e-12 by least squares;
            with Student's t to 1e-5 standard deviations, where rounding exceeds the decrease of the cost.
        samples: of a calibration: joint positions to fit at, uniform inside the joint limits.
        seed: of the random joint positions.
        max_steps: most steps of one solve.

    Returns:
        the solution; a tuple of one for each entry of a list.

    Raises:
        InputError: the source cannot be used; see `read_factory`, `read_recording` and `recording_problem`.
    """
    arm = load_nominal(nominal)
    if isinstance(source, list | tuple) and any(isinstance(each, Source) for each in source):
        given: dict[str, Any] = {"geometry": geometry, "loss": loss, "solver": solver, "samples": samples}
        return tuple(fit(each, arm, **given, seed=seed, max_steps=max_steps) for each in source)
    if isinstance(source, str | Path):
        source = read_source(source, arm)
    if isinstance(source, Recording):
        # the screening takes as long to import as a calibration takes to fit
        from lite6jax.domains.pose.fit_recording import fit_recording

        return fit_recording(source, arm, geometry=geometry, loss=loss, solver=solver, max_steps=max_steps)
    if isinstance(source, FactoryCalibration):
        calibration = source
    elif isinstance(source, list | tuple) or hasattr(source, "__array__"):
        calibration = calibration_of_array(real_array("source", cast(ArrayLike, source)), arm)
    else:
        raise wrong_type("source", source, "a file or a list of files, a Recording, or (joint, 6) numbers in m and rad")
    return fit_calibration(calibration, solver=solver, samples=samples, seed=seed, max_steps=max_steps)
