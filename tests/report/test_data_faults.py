"""The sentences about data faults: whole, with the number and the remedy, from codes and numbers alone."""

import pytest

from lite6jax.recordings.fault import DataFault
from lite6jax.report.faults import fault_name, fault_statement, ruled_out_statements

COLUMNS = {"median_error_m": 0.2, "corrected_error_m": 1e-4, "alternatives": []}
COLUMN_ERRORS = {"median_error_m": 3e-4, "suspected_above_m": 7.48e-3}
JUMP = {
    "row": 62, "part": "base", "translation_m": 1.2e-3, "rotation_rad": 1e-3, "twist": [1.2e-3, 0, 0, 1e-3, 0, 0],
    "displacement_rms_m": 1.5e-3, "p_value": 1e-40,
}  # fmt: skip
REST = {"rest": 1e-4, "rest_std": 2e-6, "largest_rms_rad": 1e-4}
TURNED = [[{"fault": "joint_turns", "joint": 2, "added_rad": 3.1415926536}]]


def fault(code, *rows, **numbers):
    return DataFault(code, rows, numbers)


FOUND = [
    (fault("time_order", 11, 12, largest_step_back_s=16.0), "2 rows are out of time order"),
    (fault("repeated_rows", 6, first_rows=[5]), "(row 6 those of row 5)"),
    (fault("position_unit", 4, factor=1000.0), "1 row are a factor of 1000 too large"),
    (
        fault("commanded_joints", distinct_positions=80, grid_rad=1e-4, grid_unit="rad"),
        "all 80 joint positions are multiples of 0.0001 rad",
    ),
    (
        fault("commanded_joints", distinct_positions=90, grid_rad=1.7e-4, grid_unit="deg"),
        "multiples of 0.01 deg",
    ),
    (fault("swapped_joints", joints=[2, 3], **COLUMNS), "Joints 2 and 3 are swapped."),
    (fault("mirrored_joint", joint=4, **COLUMNS), "Joint 4 has its sign reversed."),
    (fault("joint_unit", joint=3, unit="deg", **COLUMNS), "Joint 3 is in degrees."),
    (
        fault("joint_turns", joint=2, added_rad=-1.5707963, **COLUMNS),
        "The column of joint 2 has its zero off by +90 deg.",
    ),
    (
        fault("orientation_convention", convention="scalar_last", **COLUMNS),
        "The orientations are quaternions with the scalar last (x, y, z, w).",
    ),
    (
        fault("mirrored_joint", **{**COLUMNS, "joint": 1, "alternatives": TURNED}),
        "These corrections fit about as well: the column of joint 2 has its zero off by half a turn.",
    ),
    (fault("frame_jump", 62, 63, **JUMP), "At row 62, the sensor or the base moved by 1.2 mm and 1 mrad"),
    (
        fault("unsettled_readouts", shape="move", joints=[3], all_joints=False, **REST),
        "a share of each move remained (joint 3; 0.0001 ± 2e-06 of the move",
    ),
    (
        fault("unsettled_readouts", shape="constant", joints=[1, 2], all_joints=True, log_likelihood_gap=55.0,
              rival_terms=["unnamed:joint2"], **REST),
        "Without a correction, the best explanation (unnamed:joint2) is less likely by 55 of log-likelihood.",
    ),
    (
        fault("nominal_table", declared="lite6", table="lite6_ros", decided=False, share=0.9, share_std=0.3,
              used="instead_of_file", log_likelihood_gap=40.0, rival_terms=["joint_offset:joint3"],
              chain="as_published", numbers_more=30),
        "a fit gains too little for 30 more parameters",
    ),
    (
        fault("calibration_off", sigma_m=1.5e-5, sigma_rad=1.5e-5, log_likelihood_gap=90.0,
              rival_terms=["tool_offset:tool"]),
        "Declare factory_uncertainty in the sidecar.",
    ),
    (
        fault("calibration_off", sigma_m=1.5e-5, sigma_rad=1.5e-5, log_likelihood_gap=-1.5,
              rival_terms=["tool_offset:tool"]),
        "would be more likely by 1.5 of log-likelihood, which distinguishes nothing",
    ),
    (
        fault("wandering_readout", joints=[2, 3], std_rad=[1.5e-4, 1.2e-4], memory_samples=[31.0, 12.0],
              memory_s=[40.0, 16.0], log_likelihood_gap=[200.0, 90.0]),
        "Joints 2 and 3 are read out with an error that wanders by itself: by 150, 120 µrad (one standard deviation), "
        "with a memory of 40, 16 s. Nothing that was recorded drives it.",
    ),
    (
        fault("wandering_readout", joints=[2, 3], std_rad=[1.5e-4, 7.8e-4], memory_samples=[31.0, 1.0],
              memory_s=[40.0, 1.3], log_likelihood_gap=[200.0, 90.0], remembers=[True, False]),
        "Joint 3 is read out with an error that is another one in each row, of 780 µrad (one standard deviation): "
        "noise of the encoder, or what these rows are too few to resolve.",
    ),
    (fault("no_joints", 1, 2, clock_offset_s=0.012), "2 rows were left out: the clocks differ by 0.012 s"),
    (fault("outliers", 8, 71, 134), "3 rows are outliers and have little weight."),
]  # fmt: skip
RULED_OUT = [
    (fault("time_order", samples=40, timed=False), "The 40 rows have no times"),
    (fault("repeated_rows", samples=40), "None of the 40 rows repeats"),
    (fault("swapped_joints", **COLUMN_ERRORS), "such faults are searched for above 7.48 mm"),
    (fault("mirrored_joint", **COLUMN_ERRORS, best_alternative_m=0.1), "the best correction leaves 100 mm"),
    (fault("joint_turns", outside_limits_rad=0.0), "all are within their limits"),
    (fault("frame_jump", reason="chance", p_value=1.0, samples=40), "no frame jump (p = 1)"),
    (fault("frame_jump", reason="too_few_rows", samples=20), "20 rows are too few"),
    (
        fault("frame_jump", reason="physics", candidate_rows=[80], log_likelihood_gap=20.0,
              rival_terms=["unnamed:joint5"]),
        "more likely by 20 of log-likelihood, with unnamed:joint5",
    ),
    (fault("unsettled_readouts", reason="moving", samples=40), "the arm moved"),
    (
        fault("unsettled_readouts", reason="ordered_poses", p_value=1e-9, samples=40),
        "Record some in random order.",
    ),
    (
        fault("unsettled_readouts", reason="physics", log_likelihood_gap=12.0, rival_terms=["joint_coupling:joint3"]),
        "more likely by 12 of log-likelihood, with joint_coupling:joint3",
    ),
    (fault("nominal_table", reason="single_table", declared="xarm7"), "xarm7 has only one"),
    (
        fault("nominal_table", reason="declared_fits", declared="lite6", table="lite6_ros", fitted=True,
              declared_ratio=1.0, table_ratio=3.0),
        "The chain is fitted, so that the table matters little.",
    ),
    (
        fault("calibration_off", reason="physics", sigma_m=1e-5, sigma_rad=1e-5, log_likelihood_gap=1.5,
              rival_terms=["frame_offset:link3"]),
        "The calibration file may be off everywhere, by 0.01 mm and mrad, but that is less likely by 1.5 of",
    ),
    (fault("commanded_joints", reason="declared"), "declares commanded joint positions"),
]  # fmt: skip


def ruled_out_statement(fault):
    return ruled_out_statements([fault])[0]


SAID = [*((fault_statement, *one) for one in FOUND), *((ruled_out_statement, *one) for one in RULED_OUT)]


@pytest.mark.parametrize(("stated", "fault", "words"), SAID, ids=lambda value: getattr(value, "code", ""))
def test_a_fault_found_or_ruled_out_is_stated_with_its_numbers(stated, fault, words):
    said = stated(fault)
    assert words in said
    assert said[0].isupper() or said[0].isdigit()
    assert said.endswith(".")


def test_a_code_of_another_version_has_a_name():
    assert fault_name("of_tomorrow") == "Of tomorrow"
    assert fault_statement(DataFault("of_tomorrow", (3,), {"something": 1})) == "Of tomorrow."
