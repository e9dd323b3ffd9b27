"""Data faults of logs of commands: each is located in a simulated log, and none is in a log of strong physics."""

from dataclasses import replace

import numpy as np
import pytest

from lite6jax.arms.description import load_bundled
from lite6jax.domains.tracking.screening import screen_tracking
from lite6jax.errors import InputError
from lite6jax.recordings import Recording
from lite6jax.recordings.settings import ServoSettings
from lite6jax.report.faults import fault_statement
from lite6jax.simulation import draw_commands, simulate_tracking
from tests.domains.tracking.test_servo_fit import PENDULUM, SERVO, record

LITE6 = load_bundled("lite6")
NOISE = 2e-5
RUNS = 3
SAMPLES = 1200
PERIOD = 0.01
DECLARED = ServoSettings(
    stiffness_Nm_per_rad=tuple(SERVO["stiffness_Nm_per_rad"]), damping_Nm_s_per_rad=tuple(SERVO["damping_Nm_s_per_rad"])
)


def simulated(*effects, known=True, seed=0):
    return simulate_tracking(
        LITE6, effects=effects, runs=RUNS, samples=SAMPLES, joint_noise=NOISE, servo_known=known, seed=seed
    ).recording


@pytest.fixture(scope="module")
def clean():
    return simulated()


@pytest.fixture(scope="module")
def unknown():
    return simulated(known=False)


def with_columns(log, measured=None, commanded=None):
    """The log with other columns, and velocities of these."""
    return Recording.assembled(
        log.joint_position if measured is None else measured,
        time=log.time,
        commanded_position=log.commanded_position if commanded is None else commanded,
        payload=log.payload,
        run=log.run,
        settings=log.settings,
    )


def screened(log, arm=LITE6):
    return screen_tracking(log, arm)


def other_faults(result):
    """The faults of a screened log, but that it begins in motion."""
    return [fault for fault in result.found if fault.code != "moving_start"]


def the_fault(log, arm=LITE6, begins_in_motion=False):
    """The only fault of a log, and the screened log."""
    result = screened(log, arm)
    if begins_in_motion:
        result = replace(result, found=other_faults(result))
    assert [fault.code for fault in result.found] == [result.found[0].code]
    assert fault_statement(result.found[0])
    assert result.found[0].code not in {fault.code for fault in result.ruled_out}
    return result.found[0], result


def times(joint, factor):
    return np.where(np.arange(6) == joint, factor, 1.0)


def test_a_clean_log_has_no_fault_and_says_what_was_looked_for(clean, unknown):
    for log in (clean, unknown):
        result = screened(log)
        assert result.found == ()
        assert not result.unusable.any()
        assert {fault.code for fault in result.ruled_out} == {
            *("other_clock", "joints_swapped", "joint_sign", "degrees", "gear"),
            *("stale_rows", "saturated_readout", "torque_off", "zero_per_run"),
        }


@pytest.mark.parametrize(
    "effect",
    [
        "time_offset:offset_s=0.3",
        "command_delay:joint=2,delay_s=0.3",
        "torque_limit:joint=2,torque_Nm=14",
        "backlash:joint=2,half_width_rad=0.05",
        "dead_band:joint=3,half_width_rad=0.05",
        "encoder_offset:joint=3,offset_rad=0.2",
        "encoder_scale:joint=2,scale=0.2",
        "coulomb_friction:joint=3,coulomb_Nm=15",
        "servo_stiffness:joint=2,ratio=0.15",
        "payload_error:mass_kg=3",
        "rate_limit:joint=2,velocity_rad_per_s=0.25",
        "command_filter:joint=2,time_constant_s=0.5",
    ],
)
@pytest.mark.parametrize("known", [True, False])
def test_strong_physics_is_no_fault_of_the_data(effect, known):
    assert not other_faults(screened(simulated(effect, known=known, seed=1)))  # an arm still sags where runs begin


def test_the_past_of_a_run_that_begins_in_motion_is_not_known(clean):
    parts = np.arange(clean.samples) // 150
    cut = Recording.assembled(
        clean.joint_position,
        time=clean.time,
        commanded_position=clean.commanded_position,
        payload=clean.payload,
        run=clean.run * 10 + parts,
        settings=clean.settings,
    )
    result = screened(cut)
    (fault,) = result.found
    assert fault.code == "moving_start"
    assert "what it was commanded before is not known" in fault_statement(fault).lower()
    begins = np.flatnonzero(np.r_[True, np.diff(cut.run) != 0])
    known = np.r_[True, np.diff(clean.run) != 0][begins]
    moving = np.abs(cut.joint_position[begins + 2] - cut.joint_position[begins]).max(1) > 4e-3
    left_out = result.unusable[begins]
    assert fault.numbers["runs"] == left_out.sum() > 0
    assert not left_out[known].any()
    assert left_out[~known & moving].all()
    for first in begins[left_out]:
        assert result.unusable[first : first + 50].all()
        assert not result.unusable[first + 50 : first + 60].any()


def repeated(motion, seconds, lag, joints=6, reversed_joints=()):
    """A log of joints that repeat one motion over and over, each `lag` s behind its command."""
    time = np.arange(0, seconds, PERIOD)
    angle = {
        "sine": lambda t: np.sin(3 * t),
        "fast sine": lambda t: np.sin(8 * t),
        "harmonics": lambda t: np.sin(3 * t) + 0.6 * np.sin(6 * t),
        "strokes": lambda t: np.clip(3 * np.sin(1.7 * t), -1, 1),
    }[motion]
    size = np.linspace(0.2, 0.5, joints)
    sign = np.where(np.isin(np.arange(joints), reversed_joints), -1.0, 1.0)
    noise = np.random.default_rng(7).normal(scale=1e-4, size=(len(time), joints))
    return Recording.assembled(
        np.outer(angle(time - lag), size) + noise,
        time=time,
        commanded_position=np.outer(angle(time), size * sign),
        settings=replace(simulated(known=False).settings, servo="unknown"),
    )


@pytest.mark.parametrize("motion", ["sine", "fast sine", "harmonics", "strokes"])
@pytest.mark.parametrize("seconds", [6, 20, 60])
@pytest.mark.parametrize("lag", [0.01, 0.03, 0.1])
def test_a_motion_that_repeats_itself_tells_of_no_other_clock_and_no_sign(motion, seconds, lag):
    assert not other_faults(screened(repeated(motion, seconds, lag)))


def test_a_joint_that_moves_to_and_fro_against_its_command_is_reversed():
    fault, _ = the_fault(repeated("fast sine", 20, 0.03, reversed_joints=[2]), begins_in_motion=True)
    assert (fault.code, fault.numbers["joints"]) == ("joint_sign", [3])


@pytest.mark.parametrize("side", ["measured", "commanded"])
@pytest.mark.parametrize("joints", [[3], [1, 2, 3, 4, 5, 6]])
def test_degrees_are_converted(unknown, side, joints):
    factor = np.where(np.isin(np.arange(6) + 1, joints), np.rad2deg(1.0), 1.0)
    if side == "measured":
        log = with_columns(unknown, measured=unknown.joint_position * factor)
    else:
        log = with_columns(unknown, commanded=unknown.commanded_position * factor)
    fault, result = the_fault(log)
    assert (fault.code, fault.numbers["joints"], fault.numbers["side"]) == ("degrees", joints, side)
    assert pytest.approx(unknown.joint_position, abs=1e-9) == result.data.measured.T
    assert result.data.recording.commanded_position == pytest.approx(unknown.commanded_position)


@pytest.mark.parametrize(("side", "factor"), [("measured", 2.0), ("commanded", 2.0), ("measured", 0.5)])
def test_a_gear_is_taken_away_on_the_side_that_the_weight_tells(clean, side, factor):
    if side == "measured":
        log = with_columns(clean, measured=clean.joint_position * times(1, factor))
    else:
        log = with_columns(clean, commanded=clean.commanded_position * times(1, factor))
    fault, result = the_fault(log)
    assert fault.code == "gear"
    ratio = factor if side == "measured" else 1 / factor
    assert fault.numbers == {"joints": [2], "side": side, "decided": True, "ratio": ratio}
    assert pytest.approx(clean.joint_position, abs=1e-9) == result.data.measured.T


def test_a_gear_without_masses_leaves_the_side_open(unknown):
    massless = replace(
        LITE6, **dict.fromkeys(("mass", "center_of_mass", "inertia", "rotor_inertia", "viscous_friction"))
    )
    massless = replace(massless, coulomb_friction=None)
    fault, _ = the_fault(with_columns(unknown, measured=unknown.joint_position * times(1, 2.0)), massless)
    assert fault.numbers == {"joints": [2], "side": "measured", "decided": False, "ratio": 2.0}
    assert "does not show in this log" in fault_statement(fault)


@pytest.mark.parametrize(("log", "off"), [("clean", 2e-4), ("unknown", 3e-3)])
def test_zeros_of_runs_are_taken_away(log, off, request):
    log = request.getfixturevalue(log)
    zeros = np.array([0.0, 0.03, -0.02])
    shifted = log.joint_position.copy()
    shifted[:, 1] += zeros[log.run]
    fault, result = the_fault(with_columns(log, measured=shifted))
    assert (fault.code, fault.numbers["joints"]) == ("zero_per_run", [2])
    assert fault.numbers["zeros_rad"] == pytest.approx(zeros, abs=off)
    assert pytest.approx(log.joint_position, abs=off) == result.data.measured.T


QUANTUM = 2 * np.pi / 2**15


def coarse(command):
    """A log of read-outs that are whole steps of an encoder."""
    log = record(command, SERVO, sigma=5e-5)
    return with_columns(log, measured=np.round(log.joint_position / QUANTUM) * QUANTUM)


def test_a_joint_that_rests_and_then_starts_has_no_stale_row():
    log = coarse(0.2 * (np.arange(800) // 100 % 2))
    q = log.joint_position[:, 0]
    repeats = np.flatnonzero((np.diff(q[:-1]) == 0) & (np.abs(np.diff(q[1:])) > 4 * QUANTUM))
    assert len(repeats) >= 3
    assert other_faults(screened(log, PENDULUM)) == []


def test_rows_that_repeat_in_a_motion_are_left_out():
    log = coarse(0.4 * np.sin(np.arange(800) * 0.02))
    q = log.joint_position.copy()
    q[[300, 450, 451]] = q[[299, 449, 449]]
    fault, result = the_fault(with_columns(log, measured=q), PENDULUM)
    assert fault.code == "stale_rows"
    assert np.flatnonzero(result.unusable).tolist() == [300, 450, 451]


@pytest.mark.parametrize(("joint", "sign", "noise"), [(1, 1, 0.0), (4, -1, NOISE)])
def test_rows_at_the_end_of_a_read_out_are_left_out(clean, joint, sign, noise):
    measured = sign * clean.joint_position
    end = np.percentile(measured[:, joint], 92)
    clipped = measured[:, joint] > end
    measured[:, joint] = np.minimum(measured[:, joint], end)
    measured += np.random.default_rng(1).normal(0.0, noise, measured.shape)
    fault, result = the_fault(with_columns(clean, measured=sign * measured))
    assert (fault.code, fault.numbers["joints"]) == ("saturated_readout", [joint + 1])
    assert fault.numbers["end_rad"] == pytest.approx(sign * end, abs=1e-4)
    assert np.all(result.unusable[clipped])
    assert np.mean(result.unusable & ~clipped) < 0.01
    assert fault.numbers["count"] == len(fault.rows) == result.unusable.sum()


@pytest.mark.parametrize("shift", [0.7, -0.2, -0.7])
def test_commands_of_another_clock_are_shifted(unknown, shift):
    rows = round(shift / PERIOD)
    shifted = unknown.commanded_position.copy()
    for number in range(RUNS):
        members = np.flatnonzero(unknown.run == number)
        shifted[members] = unknown.commanded_position[np.clip(members + rows, members[0], members[-1])]
    fault, result = the_fault(with_columns(unknown, commanded=shifted), begins_in_motion=True)
    assert fault.code == "other_clock"
    assert fault.numbers["shift_s"] == pytest.approx(shift, abs=0.03)
    assert fault.numbers["drift_s_per_s"] == 0.0
    assert result.data.commands.samples == SAMPLES - fault.numbers["count"]


def test_a_clock_that_drifts_is_followed():
    log = simulate_tracking(LITE6, samples=5000, joint_noise=NOISE, servo_known=False, seed=3).recording
    rate = 0.02
    rows = np.clip(np.round(log.time * (1 + rate) / PERIOD).astype(int), 0, log.samples - 1)
    fault, _ = the_fault(with_columns(log, commanded=log.commanded_position[rows]))
    assert fault.code == "other_clock"
    assert fault.numbers["drift_s_per_s"] == pytest.approx(rate, abs=2e-3)
    assert "ms a second" in fault_statement(fault)


def test_a_stop_of_all_joints_is_left_out(clean):
    measured = clean.joint_position.copy()
    stop = np.arange(500, 600)
    rng = np.random.default_rng(1)
    measured[stop] = measured[500] + rng.normal(0.0, NOISE, (len(stop), 6))
    fault, result = the_fault(with_columns(clean, measured=measured))
    assert fault.code == "torque_off"
    left_out = np.flatnonzero(result.unusable)
    assert set(range(530, 600)) <= set(left_out.tolist())
    assert left_out.min() > 440
    assert left_out.max() < 660


def test_a_joint_that_falls_in_one_run_is_left_out_and_in_all_runs_refused(clean):
    time, command, run = draw_commands(LITE6, SAMPLES, runs=RUNS, seed=4)
    logs = [
        simulate_tracking(LITE6, command, time=time, run=run, effects=effects, joint_noise=NOISE, seed=4).recording
        for effects in ([], ["servo_stiffness:joint=2,ratio=1e-6"])
    ]
    falls = run == 1
    measured = np.where(falls[:, None], logs[1].joint_position, logs[0].joint_position)
    result = screened(with_columns(logs[0], measured=measured))
    assert [fault.code for fault in result.found] == ["torque_off"]
    assert 2 in result.found[0].numbers["joints"]
    assert np.mean(result.unusable[falls]) > 0.5
    assert not result.unusable[~falls].any()
    with pytest.raises(InputError, match="q2_rad moves as if its servo did not act while its command moves"):
        screened(logs[1])


@pytest.mark.parametrize("limit", [1.7, 2.5])
def test_a_pendulum_that_its_servo_cannot_lift_further_is_not_saturated(limit):
    # it stalls again and again at the angle that its torque can hold
    t = PERIOD * np.arange(1000)
    command = 1.2 * np.sin(2 * np.pi * 0.3 * np.maximum(t - 0.3, 0.0))
    log = simulate_tracking(
        PENDULUM,
        command[:, None],
        effects=[f"torque_limit:joint=1,torque_Nm={limit}"],
        servo=DECLARED,
        joint_noise=NOISE,
    ).recording
    assert np.abs(log.joint_position).max() < 1.15
    assert screened(log, PENDULUM).found == ()
