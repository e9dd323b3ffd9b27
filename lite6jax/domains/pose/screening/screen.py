"""The screening of pose recordings: faults of the data are found and corrected before any physics is estimated.

A screen finds a fault in a recording that all earlier screens have corrected, and corrects it before the next looks.
The coarsest come first: faults of rows are found without an arm, those of columns with the nominal arm and frames in
closed form, and those of the size of the sensor's noise with a fitted arm. A new fault is one entry here, its function,
and its sentences in `report.faults`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, final

import numpy as np
from threadpoolctl import threadpool_limits

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.calibration.problem import Geometry
from lite6jax.domains.pose.rigid_arm import rigid_arm
from lite6jax.domains.pose.screening import frame_jumps, hypotheses, rows, settling
from lite6jax.domains.pose.screening.options import ScreeningOptions
from lite6jax.domains.pose.screening.screened import Corrections, Screened
from lite6jax.errors import InputError
from lite6jax.recordings import Recording, require_radians, require_samples
from lite6jax.recordings.fault import DataFault


@final
@dataclass(frozen=True)
class Screen:
    """One kind of fault, and what its correction costs.

    Attributes:
        codes: those of the faults that it reports.
        needs: the recording alone, the rigid arm as well, or that arm fitted.
        run: returns the state with its faults found and corrected, or with the numbers that rule them out.
        estimated: how many continuous quantities the correction of a fault estimates, whose cost a comparison with
            physics includes; none where the screen decides alone.
        located: whether that cost includes the choice of a row too.
    """

    codes: tuple[str, ...]
    needs: Literal["recording", "arm", "fit"]
    run: Callable[[Screened, ScreeningOptions], Screened]
    estimated: Callable[[DataFault], int] = lambda fault: 0
    located: bool = False


SCREENS = (
    Screen(("time_order",), "recording", rows.sort_rows),
    Screen(("repeated_rows",), "recording", rows.drop_repeats),
    Screen(("position_unit",), "recording", rows.convert_positions),
    Screen(("commanded_joints",), "arm", rows.note_commanded),
    Screen((*hypotheses.CODES, "undecided", "other_arm", "unexplained"), "arm", hypotheses.correct_mismatch),
    Screen(("computed_pose",), "arm", rows.note_computed),
    Screen(("joint_turns",), "arm", rows.remove_turns),
    Screen(("frame_jump",), "fit", frame_jumps.remove_jumps, estimated=lambda fault: 6, located=True),
    Screen(("unsettled_readouts",), "fit", settling.settle_joints, estimated=settling.count_numbers),
    Screen(("nominal_table",), "fit", hypotheses.use_other_table),
)
"""All screens, in order."""


def price(screened: Screened, numbers: float, samples: int) -> float:
    """Log-likelihood that the corrections made must gain over physics: ½ log n a quantity (Schwarz), log samples a row.

    Args:
        screened: with the faults found.
        numbers: how many were measured, n: rows times samples.
        samples: how many.
    """
    found = [(screen, fault) for screen in SCREENS for fault in screened.found if fault.code in screen.codes]
    quantities = sum(screen.estimated(fault) for screen, fault in found)
    located = sum(screen.located for screen, _ in found)
    return 0.5 * quantities * float(np.log(numbers)) + located * float(np.log(samples))


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
            poses of another arm, or as `recording_problem`.
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
        state = entry.run(state, options)
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
            state = entry.run(state, options)
    return state
