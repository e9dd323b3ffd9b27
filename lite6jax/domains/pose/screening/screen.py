"""The screening of pose recordings: faults of the data are found and corrected before any physics is estimated."""

from dataclasses import replace

from threadpoolctl import threadpool_limits

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.calibration.problem import Geometry
from lite6jax.domains.pose.rigid_arm import rigid_arm
from lite6jax.domains.pose.screening.options import ScreeningOptions
from lite6jax.domains.pose.screening.registry import SCREENS, Screen
from lite6jax.domains.pose.screening.screened import Corrections, Screened
from lite6jax.errors import InputError
from lite6jax.recordings import Recording, require_radians, require_samples


# a second thread gains little on matrices of this size, and costs many times as much where another job has a core
@threadpool_limits.wrap(limits=1, user_api="blas")
def screen(
    recording: Recording,
    arm: Arm | None = None,
    geometry: Geometry = "declared",
    options: ScreeningOptions | None = None,
    corrections: Corrections | None = None,
    factory: FactoryCalibration | None = None,
    allow_undecided: bool = False,
    coarse: bool = False,
) -> Screened:
    """The recording without the faults of its data, and those faults.

    Args:
        recording: measured poses.
        arm: the nominal arm; from the sidecar where not given.
        geometry: what is known of it, as in `fit`.
        options: the thresholds.
        corrections: of faults that resemble physics; all where not given.
        factory: the arm's calibration; from the sidecar where not given.
        allow_undecided: whether poses may miss the arm grossly for one of several reasons that fit alike.
        coarse: whether only faults that show without a fit are looked for.

    Raises:
        InputError: no measured poses, joint positions that are degrees in all columns, an undecided mismatch,
            poses of another arm, or as
            `recording_problem`.
    """
    require_samples(recording, 1)
    options = options or ScreeningOptions()
    state = Screened(recording, arm, geometry, corrections or Corrections(), factory=factory)
    if recording.touches is not None:  # all faults that are screened for are of poses
        rigid = rigid_arm(recording, arm, geometry, factory)
        require_radians(recording.joint_position, rigid.arm.joint_limits, f"{recording.source}: joint_position")
        return replace(state, rigid=rigid, arm=rigid.arm)
    fitted = False
    for entry in SCREENS:
        if coarse and entry.needs == "fit":
            break
        if entry.needs != "recording" and state.rigid is None:
            rigid = rigid_arm(state.recording, arm, geometry, factory)
            state = replace(state, rigid=rigid, arm=rigid.arm)
        if entry.needs == "fit" and not fitted:
            state, fitted = replace(state, rigid=state.rigid_arm.fitted(options.most_fitted)), True
        state = _applied(entry, state, options)
        if state.count("other_arm") and not allow_undecided:
            n = state.found[-1].numbers
            raise InputError(
                f"{recording.source}: its poses are not those of a {n['declared']} (off by "
                f"{1e3 * n['median_error_m']:.4g} mm, median) but of a {n['arm']} ({1e3 * n['corrected_error_m']:.3g} "
                f"mm); name that arm with --arm, or in the sidecar"
            )
        if state.count("undecided") and not allow_undecided:
            error = 1e3 * state.found[-1].numbers["median_error_m"]
            raise InputError(
                f"{recording.source}: its poses miss the arm by {error:.4g} mm (median), for one of several reasons "
                "that fit alike; see them with `lite6jax check`, and correct the file"
            )
    assert state.arm is not None
    require_radians(state.recording.joint_position, state.arm.joint_limits, f"{recording.source}: joint_position")
    return state


def screen_rows(recording: Recording, options: ScreeningOptions) -> Screened:
    """The recording in order, each row once and positions in m: the screens that need no arm."""
    require_samples(recording, 1)
    state = Screened(recording, None, "declared", Corrections())
    for entry in SCREENS:
        if entry.needs == "recording" and (recording.touches is None or entry.codes == ("time_order",)):
            state = _applied(entry, state, options)
    return state


def _applied(entry: Screen, state: Screened, options: ScreeningOptions) -> Screened:
    """The state after one screen: its fault corrected, as often as it is detected, or ruled out."""
    for _ in range(entry.rounds(state, options)):
        detection = entry.detect(state, options)
        if detection.evidence is None:
            return state.cleared(detection.ruled_out)
        state = entry.correct(state, detection.evidence, options)
    return state
