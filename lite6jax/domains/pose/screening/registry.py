"""The faults of pose recordings that are screened for, in the order in which they are detected and corrected.

A screen detects a fault in a recording that all earlier screens have corrected, and corrects it before the next looks.
The coarsest come first: faults of rows are detected without an arm, those of columns with the nominal arm and frames in
closed form, and those of the size of the sensor's noise with a fitted arm. A new fault is one entry here, its two
functions, and its sentences in `report.data_faults`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, final

import numpy as np

from lite6jax.domains.pose.screening import frame_jumps, hypotheses, nominal_table, rows, settling
from lite6jax.domains.pose.screening.options import ScreeningOptions
from lite6jax.domains.pose.screening.screened import Detection, Screened
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
