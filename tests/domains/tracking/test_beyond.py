"""Rows of a predicted motion that the log does not support: of which joint, and by its speed, load or reversals."""

import json
from dataclasses import replace

import numpy as np
import pyarrow.csv
import pytest
from test_corrected_commands import write_commands, write_diagnosis
from test_servo_fit import PERIOD, SERVO
from typed import flat, run

from lite6jax import read_model
from lite6jax.arms.arm import Arm
from lite6jax.domains.tracking.fit import fit_servos
from lite6jax.recordings import Recording

SAMPLES = 500
TIME = PERIOD * np.arange(SAMPLES)
MASS = 1.2
LEVER = 0.15
TWO = Arm(
    "two pendulums",
    np.array([[0.0, 0.0, 0.0, np.pi / 2, 0.0, 0.0], [0.4, 0.0, 0.0, 0.0, 0.0, 0.0]]),
    mass=np.array([MASS, MASS]),
    center_of_mass=np.array([[0.0, 0.0, 0.0], [0.0, -LEVER, 0.0]]),
    inertia=np.repeat(1e-4 * np.eye(3)[None], 2, 0),
    rotor_inertia=np.array([0.1, 0.1]),
    viscous_friction=np.array([0.5, 0.5]),
    coulomb_friction=np.array([0.0, 0.0]),
)
"""Its second joint hangs from the end of the first, whose link lies along its own axis of gravity."""


def swing(amplitude, frequency, begins=0.5, time=TIME):
    """A pause, then a cosine from zero to twice the amplitude and back, rad: it reverses each half period."""
    t = np.maximum(time - begins, 0.0)
    return amplitude * (1 - np.cos(2 * np.pi * frequency * t))


@pytest.fixture(scope="module")
def model():
    """Of two joints that swing by 0.4 rad with periods of 2 s and 1.25 s; measured as commanded but for a lag."""
    command = np.stack([swing(0.2, 0.5), swing(0.2, 0.8)], 1)
    measured = np.stack([np.interp(TIME - 0.04, TIME, column) for column in command.T], 1)
    log = Recording.from_arrays(
        measured + np.random.default_rng(1).normal(0.0, 1e-3, measured.shape),
        arm=TWO,
        time=TIME,
        commanded_position=command,
        motion="trajectory",
        joint_noise_rad=1e-3,
        servo={name: values * 2 for name, values in SERVO.items()},
    )
    return fit_servos(log, TWO, []).diagnosed


def test_the_log_itself_is_inside(model):
    command = np.stack([swing(0.2, 0.5), swing(0.2, 0.8)], 1)
    assert not model.predict(TIME, command).outside.any()
    assert model.predict(TIME, command).beyond.counts == {}


def test_the_joint_that_is_faster_is_named_where_it_is_faster(model):
    # 1.5 times as far in the same time
    command = np.stack([swing(0.3, 0.5), swing(0.2, 0.8)], 1)
    found = model.predict(TIME, command)
    velocity = np.gradient(found.position[:, 0], PERIOD)
    limit = 2 * np.pi * 0.5 * 0.2
    assert found.beyond.speed[np.abs(velocity) > 1.1 * limit, 0].all()
    assert not found.beyond.speed[np.abs(velocity) < 0.95 * limit, 0].any()
    assert not found.beyond.speed[:, 1].any()
    assert not found.beyond.reversal.any()


def test_the_joint_that_carries_more_is_named_where_it_does(model):
    # slowly to where joint 2 is further from hanging than ever in the log
    ramp = 0.9 * (1 - np.cos(np.pi * np.clip((TIME - 0.5) / 4.0, 0, 1))) / 2
    found = model.predict(TIME, np.stack([0 * TIME, ramp], 1))
    torque = 9.81 * MASS * LEVER * np.sin(found.position.sum(1))
    most = 9.81 * MASS * LEVER * np.sin(0.8)
    assert found.beyond.load[torque > 1.05 * most, 1].all()
    assert not found.beyond.load[torque < 0.9 * most, 1].any() or model.ranges.weight[1, 1] < 0.9 * most


def test_a_joint_that_reverses_sooner_is_named_between_its_reversals(model):
    # small and fast, so that neither its speed nor its load is new
    command = np.stack([swing(0.02, 2.0), 0 * TIME], 1)
    found = model.predict(TIME, command)
    assert not found.beyond.speed.any()
    assert not found.beyond.load.any()
    assert not found.beyond.reversal[:, 1].any()
    assert not found.beyond.reversal[:70, 0].any()  # it rests, and goes until it first reverses
    assert found.beyond.reversal[90:470, 0].all()
    assert found.outside[90:470].all()
    # as seldom as in the log
    slow = model.predict(TIME, np.stack([swing(0.02, 0.5), 0 * TIME], 1))
    assert not slow.outside.any()


def test_a_joint_that_never_reversed_is_named_from_its_first_reversal_on(model):
    ranges = replace(model.ranges, reversal=np.array([np.inf, 0.1]))
    found = replace(model, ranges=ranges).predict(TIME, np.stack([swing(0.1, 0.5), 0 * TIME], 1))
    reversed_at = int(np.argmax(found.position[:, 0] > found.position[:, 0].max() - 1e-6))
    assert found.beyond.reversal[reversed_at + 1 :, 0].all()
    assert not found.beyond.reversal[: reversed_at - 1, 0].any()


def test_ranges_of_runs_do_not_hold_the_jump_between_them(model):
    command = np.stack([swing(0.1, 0.5), swing(0.1, 0.5)], 1)
    runs = np.repeat([0, 1], SAMPLES)
    both = np.vstack([command, command + 0.7])
    followed = model.predict(PERIOD * np.arange(2 * SAMPLES), both, runs).position
    log = Recording.from_arrays(
        followed + np.random.default_rng(2).normal(0.0, 1e-3, both.shape),
        arm=TWO,
        time=PERIOD * np.arange(2 * SAMPLES),
        commanded_position=both,
        run=runs,
        motion="trajectory",
        joint_noise_rad=1e-3,
        servo={name: values * 2 for name, values in SERVO.items()},
    )
    ranges = fit_servos(log, TWO, []).diagnosed.ranges
    assert np.abs(ranges.velocity).max() < 1.2 * 2 * np.pi * 0.5 * 0.1
    assert ranges.reversal == pytest.approx([1.0, 1.0], abs=0.03)


def test_predicted_tables_name_joint_and_quantity_row_by_row(model, tmp_path, capsys):
    diagnosis = write_diagnosis(model, tmp_path / "d.json")
    columns = {"time_s": TIME, "cmd1_rad": swing(0.3, 0.5), "cmd2_rad": swing(0.02, 2.0)}
    given = write_commands(tmp_path / "commands.csv", columns)
    code, out, _ = run(capsys, "predict", diagnosis, given, "--out", tmp_path / "p.csv")
    assert code == 0
    table = pyarrow.csv.read_csv(tmp_path / "p.csv")
    by_joint = ["outside_speed_joint1", "outside_reversal_joint2"]
    assert table.column_names == ["q1_rad", "q2_rad", "outside", *by_joint]
    outside = table["outside"].to_numpy()
    speed, reversal = (table[name].to_numpy() for name in by_joint)
    assert np.array_equal(speed | reversal, outside)
    assert (speed & reversal).any()
    assert (speed != reversal).any()
    count = int(outside.sum())
    said = (
        f"{count} of {SAMPLES} rows are outside what was recorded, by the speed of joint 1 and the reversals of joint 2"
    )
    assert said in flat(out)
    code, out, _ = run(capsys, "predict", diagnosis, given, "--json", "--force", "--out", tmp_path / "p.csv")
    document = json.loads(out)
    assert document["outside"] == count
    assert document["beyond"] == {"speed_joint1": int(speed.sum()), "reversal_joint2": int(reversal.sum())}
    # corrected commands have the same columns, and are commands again
    code, _, _ = run(capsys, "compensate", diagnosis, given, "--out", tmp_path / "c.csv")
    assert code == 0
    assert pyarrow.csv.read_csv(tmp_path / "c.csv").column_names[-3:] == ["outside", *by_joint]
    code, _, err = run(capsys, "predict", diagnosis, tmp_path / "c.csv", "--force", "--out", tmp_path / "p.csv")
    assert (code, err) == (0, "")


def test_a_diagnosis_without_times_of_reversals_is_read_and_marks_none(model, tmp_path):
    path = write_diagnosis(model, tmp_path / "d.json")
    document = json.loads(path.read_text())
    assert document["model"].pop("shortest_reversal_s") == pytest.approx([1.0, 0.625], abs=0.03)
    path.write_text(json.dumps(document))
    command = np.stack([swing(0.02, 2.0), 0 * TIME], 1)
    assert not read_model(path).predict(TIME, command).outside.any()
