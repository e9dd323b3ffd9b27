"""Touches, distances, heights and images: what a fit and a diagnosis make of them."""

import dataclasses

import msgspec
import numpy as np
import pytest
from typed import refusal

from lite6jax.arms import frames
from lite6jax.arms.factory import write_factory
from lite6jax.arms.files import read_arm
from lite6jax.diagnosis.diagnose import diagnose_poses
from lite6jax.diagnosis.options import QUICK
from lite6jax.domains.pose.fit import fit_recording
from lite6jax.domains.pose.problem import pose_problem
from lite6jax.domains.predict import predict
from lite6jax.errors import InputError
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import read_recording, write_recording
from lite6jax.report.faults import fault_statement
from lite6jax.sensors.usual import READINGS
from lite6jax.simulation import simulate
from lite6jax.simulation.motions import draw_calibration

TOUCHES = ("contact", "plane", "distance", "axis")
NOTHING = Terms(), np.zeros(0)


def recording_of(folder, sensor, samples=60, seed=4, exact=True, **given):
    """A recording whose sidecar names the arm's own calibration, or not."""
    arm = read_arm("lite6")
    kinematics = draw_calibration(arm, seed)
    write_factory(kinematics, folder / "arm.yaml", overwrite=True)
    recording = simulate("lite6", sensor=sensor, samples=samples, seed=seed, kinematics=kinematics, **given)
    file = "arm.yaml" if exact else None
    settings = dataclasses.replace(recording.settings, arm="lite6", factory_calibration=file)
    return read_recording(
        write_recording(dataclasses.replace(recording, settings=settings), folder / f"{sensor}.csv", True)
    )


@pytest.mark.parametrize("sensor", TOUCHES)
def test_a_fit_finds_the_tool_within_its_standard_deviations(tmp_path, sensor):
    solution = fit_recording(recording_of(tmp_path, sensor))
    tool = np.asarray(solution.model.T_flange_tool)[:3, 3]
    std = solution.standard_deviation[-6:-3]
    assert (std > 0).all()
    assert (np.abs(tool - READINGS[sensor].usual_tool) < 4 * std).all()
    assert solution.noise.over_declared == pytest.approx(1.0, abs=0.35)
    assert solution.quality.verdict == "good"
    assert all(np.isfinite(value).all() for place in solution.places for value in place.std.values())


def test_a_fit_says_where_sockets_are(tmp_path):
    recording = recording_of(tmp_path, "contact")
    solution = fit_recording(recording)
    point = {place.name: np.array(place.values["point_m"]) for place in solution.places}
    a, b = (point[f"contact {name}"] for name in recording.settings.contact_distances[0].between)
    assert np.linalg.norm(a - b) == pytest.approx(0.05, abs=2e-4)
    # they are where the tool is while it touches them, by plain kinematics
    tools = solution.predict(recording.joint_position)[:, :3, 3]
    for k, name in enumerate(recording.readings.names):
        mean = tools[recording.readings.group == k].mean(0)
        np.testing.assert_allclose(point[f"contact {name}"], mean, atol=1e-4)


def test_nominal_geometry_is_fitted_near_nominal_only(tmp_path):
    recording = recording_of(tmp_path, "contact", samples=120, exact=False)
    solution, arm = fit_recording(recording), read_arm("lite6")
    links = [frames.transform_from_row(np.reshape(rows, (6, 6))) for rows in (solution.parameters, arm.kinematics)]
    shift, turn = frames.compare_transforms(*links)
    assert shift.max() < 5e-3  # thirty touches a socket do not bend a chain
    assert turn.max() < 0.03
    before, after = solution.nominal_errors.position_rms, solution.checked.position_rms
    assert after < 0.5 * before


def test_the_nuisance_of_touches_moves_residuals_as_its_columns_say(tmp_path):
    recording = recording_of(tmp_path, "contact", samples=24, exact=False)
    problem = pose_problem(recording)
    assert {"base", "link", "tool", "reading", "wave"} == {site[0] for site in problem.unknown if site[0] != "mass"}
    columns, step = problem.nuisance_columns(*NOTHING), 1e-6
    for k, column in enumerate(columns):
        if problem.unknown[k][0] == "mass":
            continue
        one = step * np.eye(len(problem.unknown))[k]
        slope = (problem.residual(one, *NOTHING) - problem.residual(-one, *NOTHING)) / (2 * step)
        np.testing.assert_allclose(column, slope, rtol=1e-3, atol=1e-4 * np.abs(columns).max(), err_msg=f"{k}")


@pytest.mark.parametrize("sensor", [pytest.param("fixed_camera", marks=pytest.mark.long), "flange_camera"])
def test_images_of_a_board_tell_where_camera_and_board_are(tmp_path, sensor):
    solution = fit_recording(recording_of(tmp_path, sensor, samples=50))
    tool = np.asarray(solution.model.T_flange_tool)[:3, 3]
    assert (np.abs(tool - READINGS[sensor].usual_tool) < 4 * solution.standard_deviation[-6:-3]).all()
    assert solution.noise.over_declared == pytest.approx(1.0, abs=0.35)


def test_a_lens_is_refined_beside_a_chain_that_is_fitted(tmp_path):
    recording = recording_of(tmp_path, "fixed_camera", samples=50, exact=False)
    camera = recording.settings.camera
    assert camera is not None
    off = msgspec.structs.replace(camera, fx=1.0005 * camera.fx, cx=camera.cx + 1, intrinsics="refine")
    settings = dataclasses.replace(recording.settings, camera=off)
    solution = fit_recording(recording.made_anew(settings=settings, position=None, quaternion=None))
    assert solution.noise.over_declared == pytest.approx(1.0, abs=0.35)


# ------------------------------------------------------------------ what says nothing


def test_one_point_without_a_length_is_refused(tmp_path):
    recording = recording_of(tmp_path, "contact", exact=False)
    settings = dataclasses.replace(recording.settings, contact_distances=())
    one = dataclasses.replace(recording.select(recording.readings.group == 0), settings=settings)
    assert "contact_distances" in refusal(fit_recording, one)


def test_a_plane_touched_at_one_place_is_refused(tmp_path):
    recording = recording_of(tmp_path, "plane")
    same = recording.select(np.zeros(20, int))
    q = same.joint_position + 1e-3 * np.random.default_rng(0).standard_normal(same.joint_position.shape)
    assert "three or more places" in refusal(fit_recording, dataclasses.replace(same, joint_position=q))


def test_a_plate_that_every_touch_found_at_one_point_is_refused(tmp_path):
    """The noise of the touches is no normal."""
    recording = recording_of(tmp_path, "contact", samples=80)
    readings = dataclasses.replace(recording.readings, kind="plane")
    settings = dataclasses.replace(recording.settings, plane_noise_m=2e-5, contact_distances=())
    assert "three or more places" in refusal(
        fit_recording, dataclasses.replace(recording, readings=readings, settings=settings)
    )


@pytest.mark.parametrize("task", [fit_recording, diagnose_poses])
def test_a_few_touches_and_touches_of_as_many_places_are_refused(tmp_path, task):
    recording = recording_of(tmp_path, "contact", samples=40)
    with pytest.raises(InputError, match="its 3 readings are too few; touch each socket at ten or more"):
        task(recording.select(np.arange(3)))
    names = tuple(f"p{k}" for k in range(40))
    readings = dataclasses.replace(recording.readings, names=names, group=np.arange(recording.samples))
    with pytest.raises(InputError, match=r"say nothing of .*contact p"):
        task(dataclasses.replace(recording, readings=readings))


def test_images_without_rotation_are_refused(tmp_path):
    recording = recording_of(tmp_path, "fixed_camera", samples=12)
    assert "wrist orientations" in refusal(fit_recording, recording.select(np.zeros(10, int)))


def test_distances_between_contacts_that_are_not_there_are_refused(tmp_path):
    recording = recording_of(tmp_path, "contact", exact=False)
    group, names = recording.readings.group, ("w", "x", "y", "z")
    readings = dataclasses.replace(recording.readings, names=names, group=group)
    assert "correct the names" in refusal(fit_recording, dataclasses.replace(recording, readings=readings))


# ------------------------------------------------------------------ a diagnosis


def test_heights_show_a_compliance_and_predict_it(tmp_path):
    effect = "joint_compliance:joint=2,compliance_rad_per_Nm=1.5e-4"
    found = diagnose_poses(recording_of(tmp_path, "axis", samples=90, effects=[effect]), options=QUICK)
    assert [finding.effect.label for finding in found.findings] == ["joint_compliance:joint2"]
    (estimate,) = found.findings[0].parameters.values()
    assert abs(estimate.value - 1.5e-4) < 4 * estimate.std
    assert found.verdict == "explained"
    motion = recording_of(tmp_path, "axis", samples=40, seed=4, effects=[effect])
    height = predict(found.model, motion.joint_position)[:, 2, 3]
    left = height - motion.readings.value
    assert np.std(left) < 2 * motion.settings.axis_noise_m


def with_constant(recording, constant):
    """The distances, with a constant in m that the sidecar does not declare."""
    readings = recording.readings
    return dataclasses.replace(recording, readings=dataclasses.replace(readings, value=readings.value + constant))


def test_a_wire_whose_zero_is_not_set_is_said_and_fitted(tmp_path):
    recording = recording_of(tmp_path, "distance", samples=120)
    assert fit_recording(recording).faults == ()
    for constant in (0.012, 0.001):
        solution = fit_recording(with_constant(recording, constant))
        (fault,) = solution.faults
        assert fault.code == "distance_offset"
        assert fault.numbers["constant_m"] == pytest.approx(constant, abs=4 * fault.numbers["std_m"])
        assert solution.noise.over_declared == pytest.approx(1.0, abs=0.35)
        assert "the zero of the wire is not set" in fault_statement(fault)


@pytest.mark.long
def test_a_constant_of_a_wire_is_no_physics_and_physics_is_no_constant(tmp_path):
    """Distances with a constant have no finding; a compliance stays one."""
    off = diagnose_poses(with_constant(recording_of(tmp_path, "distance", samples=120), 0.012), options=QUICK)
    assert [fault.code for fault in off.faults] == ["distance_offset"]
    assert off.findings == ()
    effect = "joint_compliance:joint=2,compliance_rad_per_Nm=2e-4"
    bent = diagnose_poses(recording_of(tmp_path, "distance", samples=120, effects=(effect,)), options=QUICK)
    assert "distance_offset" not in {fault.code for fault in bent.faults}
    assert bent.findings
