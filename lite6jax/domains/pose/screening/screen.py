"""The screening of pose recordings: faults of the data are found and corrected before any physics is estimated.

A screen detects a fault in a recording that all earlier screens have corrected, and corrects it before the next looks.
The coarsest come first: faults of rows are detected without an arm, those of columns with the nominal arm and frames in
closed form, and those of the size of the sensor's noise with a fitted arm. A new fault is one entry here, its two
functions, and its sentences in `report.data_faults`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, final

import numpy as np
from threadpoolctl import threadpool_limits

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.calibration.problem import Geometry
from lite6jax.domains.pose.rigid_arm import rigid_arm
from lite6jax.domains.pose.screening import frame_jumps, hypotheses, nominal_table, rows, settling
from lite6jax.domains.pose.screening.options import ScreeningOptions
from lite6jax.domains.pose.screening.screened import Corrections, Detection, Screened
from lite6jax.errors import InputError
from lite6jax.recordings import Recording, require_radians, require_samples
from lite6jax.recordings.fault import DataFault


@final
@dataclass(frozen=True)
class Screen:
    """One kind of fault: how it is detected, how it is corrected, and what the correction costs.

    Attributes:
        codes: those of the faults that it reports.
        needs: the recording alone, the rigid arm as well, or that arm fitted.
        detect: returns the evidence for the fault, or the numbers that rule it out.
        correct: returns the recording without the fault, which is added to those found.
        rounds: how often it runs at most, each time on what the last correction left.
        estimated: how many continuous quantities the correction of a fault estimates, whose cost a comparison with
            physics includes; none where the detector decides alone.
        located: whether that cost includes the choice of a row too.
    """

    codes: tuple[str, ...]
    needs: Literal["recording", "arm", "fit"]
    detect: Callable[[Screened, ScreeningOptions], Detection]
    correct: Callable[[Screened, Any, ScreeningOptions], Screened]
    rounds: Callable[[Screened, ScreeningOptions], int] = lambda state, options: 1
    estimated: Callable[[DataFault], int] = lambda fault: 0
    located: bool = False

    def price(self, fault: DataFault, numbers: float, samples: int) -> float:
        """Log-likelihood that a correction must gain over physics: ½ log n a quantity (Schwarz), log samples for a row.

        Args:
            fault: that was corrected.
            numbers: how many were measured, n: rows times samples.
            samples: how many.
        """
        quantities = 0.5 * self.estimated(fault) * float(np.log(numbers))
        return quantities + (float(np.log(samples)) if self.located else 0.0)


def _jump_rounds(state: Screened, options: ScreeningOptions) -> int:
    known, most = state.corrections.known_jumps, state.corrections.jumps
    if known is not None:
        return len(known)
    return options.most_jumps if most is None else most


SCREENS = (
    Screen(("time_order",), "recording", rows.detect_time_order, rows.sort_rows),
    Screen(("repeated_rows",), "recording", rows.detect_repeats, rows.drop_repeats),
    Screen(("position_unit",), "recording", rows.detect_position_unit, rows.convert_positions),
    Screen(("commanded_joints",), "arm", rows.detect_commanded, rows.note_commanded),
    Screen(
        (*hypotheses.CODES, "undecided", "other_arm", "unexplained"),
        "arm",
        hypotheses.detect_mismatch,
        hypotheses.correct_mismatch,
    ),
    Screen(("computed_pose",), "arm", rows.detect_computed, rows.note_computed),
    Screen(("joint_turns",), "arm", rows.detect_turns, rows.remove_turns),
    Screen(
        ("frame_jump",),
        "fit",
        frame_jumps.detect_jump,
        frame_jumps.remove_jump,
        _jump_rounds,
        estimated=lambda fault: 6,
        located=True,
    ),
    Screen(
        ("unsettled_readouts",), "fit", settling.detect_unsettled, settling.settle_joints, estimated=settling.estimated
    ),
    Screen(("nominal_table",), "fit", nominal_table.detect_other_table, nominal_table.use_other_table),
)
"""All screens, in order."""


def price(screened: Screened, numbers: float, samples: int) -> float:
    """Log-likelihood that the corrections made must gain over physics, as in `Screen.price`."""
    found = ((screen, fault) for screen in SCREENS for fault in screened.found if fault.code in screen.codes)
    return sum(screen.price(fault, numbers, samples) for screen, fault in found)


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
