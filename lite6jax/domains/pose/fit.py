"""The fit of one arm, from its calibration or from a recording; the latter is screened for data faults first."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast, overload

from numpy.typing import ArrayLike, NDArray

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.calibration import fit as plain
from lite6jax.calibration.fit import Loss, calibration_from_array, fit_calibration
from lite6jax.calibration.problem import Geometry
from lite6jax.calibration.solution import Solution
from lite6jax.calibration.solve import MAX_STEPS, Solver
from lite6jax.calibration.source import load_nominal, read_source, with_arm
from lite6jax.calibration.start import SAMPLES
from lite6jax.domains.pose.rigid_arm import require_determined
from lite6jax.domains.pose.screening.options import ScreeningOptions
from lite6jax.domains.pose.screening.screen import screen
from lite6jax.domains.pose.touch_fit import fit_touches
from lite6jax.errors import wrong_type
from lite6jax.recordings import Recording
from lite6jax.recordings.units import real_array

Source = str | Path | FactoryCalibration | Recording
"""A file, or what one holds."""


@overload
def fit(
    source: Source | NDArray[Any] | Sequence[Sequence[float]],
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
        each = cast(Sequence[Source], source)
        return tuple(fit(one, arm, **given, seed=seed, max_steps=max_steps) for one in each)
    if isinstance(source, str | Path):
        source = read_source(source, arm)
    if isinstance(source, Recording):
        return fit_recording(source, arm, geometry=geometry, loss=loss, solver=solver, max_steps=max_steps)
    if isinstance(source, list | tuple) or hasattr(source, "__array__"):
        source = calibration_from_array(real_array("source", cast(ArrayLike, source)), arm)
    if not isinstance(source, FactoryCalibration):
        raise wrong_type("source", source, "a file or a list of files, a Recording, or (joint, 6) numbers in m and rad")
    return fit_calibration(source, solver=solver, samples=samples, seed=seed, max_steps=max_steps)


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
    """The fit of a recording without the faults of its data, as in a diagnosis; these are in `faults` of the solution.

    Args:
        recording: measured poses.
        nominal: the nominal arm; from the sidecar, or recognised, where not given.
        geometry, loss, solver, max_steps: as in `fit`.
        options: thresholds of the screening.

    Raises:
        InputError: no measured poses, too few of them, or as `recording_problem`.
    """
    recording = recording if nominal is not None else with_arm(recording)
    if recording.touches is not None:
        return fit_touches(screen(recording, nominal, geometry, options).rigid_arm)
    # without the rigid arm, whose residuals take as much memory as the recording
    screened = screen(recording, nominal, geometry, options)
    require_determined(screened.rigid_arm)
    screened = replace(screened, rigid=None)
    solution = plain.fit_recording(
        screened.recording, screened.arm, geometry=geometry, loss=loss, solver=solver, max_steps=max_steps
    )
    return replace(solution, faults=screened.found)
