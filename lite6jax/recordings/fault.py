"""A fault of the data as a code, rows and numbers; every sentence about one is made in `report.faults`."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, final

import numpy as np

from lite6jax.array_types import Integers


@final
@dataclass(frozen=True)
class DataFault:
    """A fault of the data that was found, or one that was tested for and ruled out.

    The numbers are plain JSON values in SI units; joints count from 1, rows as in the file. Numbers of a fault that was
    found, by code (those marked * are added where it is compared with physics):

        placeholder             array ("joint_position", "position", "joint_torque" or "motor_current"), value (none
                                where several repeat together), unit, column (where it is one)
        time_order              largest_step_back_s
        repeated_rows           first_rows: the rows that `rows` repeat
        position_unit           factor: by which the rows are too large
        commanded_joints        grid_rad, grid_unit, distinct_positions
        swapped_joints          joints, and those of a mismatch
        mirrored_joint          joint, and those of a mismatch
        joint_unit              joint, unit of its column ("deg" or "rad"), and those of a mismatch
        joint_turns             joints (whole turns); or joint, added_rad, and those of a mismatch
        orientation_convention  convention ("inverted", "scalar_last" or "inverted_scalar_last"), and the same
        coupled_joint           joint, added_joint, factor (±1), and those of a mismatch
        inverted_poses          those of a mismatch
        mirrored_sensor         axes (reversed, such as "z", or exchanged, such as "xy"), and those of a mismatch
        sensor_scale            factor, by which positions are too large; of a board declared_m and square_m; and the
                                same
        declared_frame          translation_m and rotation_rad of the base in it, and those of a mismatch
        declared_tool           translation_m on the flange, and those of a mismatch
        (mismatch)              of the last of several: median_error_m, corrected_error_m, and alternatives, lists of
                                faults that fit as well
        undecided               those of a mismatch; nothing was corrected
        other_arm               declared, arm, median_error_m, corrected_error_m
        unexplained             median_error_m, fitted_error_m, best_alternative_m
        arm_deviation           distance_m of the fitted arm from the nominal one, factor: times what is granted,
                                granted_m, granted_rad; of the furthest frame its number, axis, largest_m or
                                largest_rad, and largest_share of what is granted
        computed_orientation    error_rad, chain as below, position_error_m
        computed_pose           median_error_m, chain ("nominal", "factory" or "fitted")
        frame_jump              row, run (where one begins there), part ("base" or "tool"), translation_m, rotation_rad,
                                twist, displacement_rms_m, p_value, log_likelihood_gap*, rival_terms*
        unsettled_readouts      shape ("move", "velocity" or "constant"), joints, all_joints, rest (a share, s
                                or rad by the shape), rest_std, largest_rms_rad, log_likelihood_gap*, rival_terms*
        distance_offset         constant_m, std_m, log_likelihood_gap*, rival_terms*
        nominal_table           declared, table, used ("table", "instead_of_file" or "none"), decided, share and
                                share_std or declared_ratio and table_ratio, log_likelihood_gap*, rival_terms*, chain*
                                ("as_published" or "fitted"), numbers_more*
        calibration_off         sigma_m, sigma_rad, log_likelihood_gap (below zero where physics is likelier and not
                                distinguished), rival_terms
        wandering_readout       joints, and of each std_rad, memory_samples, remembers (false where the error is
                                another one after a few rows), memory_s (None without times) and log_likelihood_gap
        no_joints               clock_offset_s
        outliers                none

    and of torques:

        uneven_times            reason ("stamps" or "samples"), from_s, to_s, rate_Hz; of samples gaps and rms_Nm
        velocity_bias           joints, bias_rad_per_s
        velocity_dead_zone      joints, width_rad_per_s
        joint_axis              joint, axis ("x", "-x", "y" or "-y"); the recording is refused
        torque_spikes           joints, count
        estimated_torque        reason: "no_friction" where there is none; nothing where torques are constant at rest
        swapped_torques         joints, columns that hold their torques
        swapped_positions       joints; swapped_columns likewise, of positions and torques
        reversed_torque         joints; reversed_positions, reversed_joint (both) and reversed_sign
                                (of either) likewise
        coupled_positions       joint, added_joint, factor (±1)
        joint_zero              joint, added_rad
        wrong_gravity           declared_m_per_s2, found_m_per_s2, tilt_rad
        no_gravity              declared_m_per_s2
        wrong_torque_constant   joints, factors (measured over true), constants_Nm_per_A (None where not of currents)
        undecided_torques       alternatives: lists of faults that explain the torques alike; nothing was corrected
        held_by_friction        joints, std_Nm, prismatic_joints
        contact                 joints, from_s, to_s, largest_Nm or largest_N

    of commands and measured joints:

        repeated_stamps         count
        time_gaps               count, longest_s
        moving_start            count, of rows that were left out; runs
        time_goes_back          count, largest_step_back_s
        uneven_rate             from_s, to_s, rate_Hz
        other_clock             shift_s, drift_s_per_s, count (rows that have no command)
        joints_swapped          joints, side ("measured" or "commanded": the columns that were exchanged)
        joint_sign              joints, side
        degrees                 joints, side, decided: whether the log shows which side is wrong
        gear                    joints, side, decided, ratio of read-outs to commands
        stale_rows              count
        saturated_readout       joints, end_rad, count
        torque_off              joints, from_s, to_s, count
        zero_per_run            joints, zeros_rad of the runs, that were taken away

    Numbers of a fault that was ruled out:

        time_order              samples, timed
        repeated_rows           samples
        position_unit           largest_distance_m, median_distance_m: from the middle of all
        commanded_joints        reason: "declared" or "not_round" (share, grid_rad, grid_unit)
        (mismatch)              median_error_m, suspected_above_m, one_point, best_alternative_m (where others were
                                tried)
        arm_deviation           reason: "known", or "granted" with the numbers above
        computed_orientation    reason: "declared", "positions" (both are computed) or "measured" (error_rad)
        computed_pose           reason: "declared" or "measured" (median_error_m, of a fitted table)
        joint_turns             outside_limits_rad: 0 where all are inside
        frame_jump              reason: "chance", "gradual", "too_few_rows" or "physics" (candidate_rows,
                                log_likelihood_gap, rival_terms); samples, p_value
        unsettled_readouts      reason: "moving", "chance", "too_few_rows", "ordered_poses" or "physics"
                                (log_likelihood_gap, rival_terms); samples, p_value
        calibration_off         reason: "physics" (sigma_m, sigma_rad, log_likelihood_gap, rival_terms)
        nominal_table           reason: "own_chain", "single_table", "indistinguishable" or "declared_fits"; declared,
                                table, fitted, likelier, and shares or ratios as above

    Attributes:
        code: which fault.
        rows: of the file, from 1, in order; empty where all are concerned.
        numbers: as listed above.
    """

    code: str
    rows: tuple[int, ...] = ()
    numbers: Mapping[str, Any] = field(default_factory=dict)

    def with_numbers(self, **numbers: Any) -> "DataFault":
        """The fault with more numbers."""
        return replace(self, numbers={**self.numbers, **numbers})

    def to_dict(self) -> dict[str, Any]:
        """As in `lite6jax/diagnosis/3`."""
        return {"fault": self.code, "rows": list(self.rows), "numbers": dict(self.numbers)}


def row_numbers(rows: Integers) -> tuple[int, ...]:
    """Row numbers in order, as plain integers."""
    return tuple(int(row) for row in np.sort(rows))
