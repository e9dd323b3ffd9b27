"""Commands that bring joints where they are wanted: in MuJoCo, against a plain oracle, as a command, and refused."""

import json
from dataclasses import replace

import numpy as np
import pyarrow.csv
import pytest
from test_rollout import ARMATURE, CENTERS, KINEMATICS, MASSES, TENSORS
from test_servo_fit import PENDULUM, PERIOD, SERVO, TRUE, commands_of, record
from typed import flat, refused, run

from lite6jax.arms.arm import Arm
from lite6jax.diagnosis.document import SCHEMA
from lite6jax.domains.tracking.entry import model_entry
from lite6jax.domains.tracking.fit import fit_servos
from lite6jax.effects.dynamic import CoulombFriction
from lite6jax.effects.servo import CommandDelay, CommandTimeOffset, ServoStiffness
from lite6jax.errors import InputError
from lite6jax.recordings import Recording
from tests.oracles.servos import follow

SOFT = {"kp": 150.0, "delay": 0.02, "coulomb": 0.6}
"""What the pendulum's servo is beside what is declared."""


@pytest.fixture(scope="module")
def softer():
    """The model of a servo that is softer and later than declared, with more friction."""
    effects = [ServoStiffness(1), CommandDelay(1), CoulombFriction(1)]
    return fit_servos(record(commands_of(600), SERVO, **SOFT), PENDULUM, effects).diagnosed


def rms(error):
    return np.sqrt(np.mean(np.square(error), 0))


def smooth(samples, pause=0.4):
    """A pause and sines, `(sample,)` rad."""
    t = np.maximum(np.arange(samples) * PERIOD - pause, 0.0)
    return 0.4 * (1 - np.cos(2 * np.pi * 0.5 * t)) + 0.1 * np.sin(2 * np.pi * 1.1 * t) ** 2


def test_the_oracle_follows_corrected_commands(softer):
    wanted = smooth(500)
    time = PERIOD * np.arange(500)
    found = softer.commands_for(time, wanted[:, None])
    before, after = (
        rms(follow(command, PERIOD, **(TRUE | SOFT)) - wanted) for command in (wanted, found.command[:, 0])
    )
    assert before > 0.03
    assert after < 0.02 * before
    assert found.error_before[0] == pytest.approx(before, rel=0.01)
    assert found.error_after[0] < 0.02 * before
    assert softer.predict(time, found.command).position == pytest.approx(found.after)


def test_steps_are_not_answered_by_commands_beyond_reason(softer):
    wanted = np.where(np.arange(300) < 100, 0.0, 0.3)[:, None]
    found = softer.commands_for(PERIOD * np.arange(300), wanted)
    assert found.error_after[0] < 0.6 * found.error_before[0]
    assert np.abs(found.command - wanted).max() < 0.65
    assert found.command[0] == pytest.approx(0.0, abs=1e-3)


def test_runs_and_uneven_times_are_corrected(softer):
    even = PERIOD * np.arange(300)
    scattered = even + np.random.default_rng(1).uniform(-0.2, 0.2, 300) * PERIOD
    wanted = np.interp(np.r_[even, scattered], even, smooth(300))[:, None]
    both = softer.commands_for(np.r_[even, scattered], wanted, np.repeat([0, 1], 300))
    alone = softer.commands_for(even, wanted[:300])
    assert both.command[:300] == pytest.approx(alone.command, abs=1e-9)
    error = both.after - wanted
    assert np.all(rms(error[300:]) < 0.1 * rms((both.before - wanted)[300:]))
    assert both.columns()["run"].tolist() == [0] * 300 + [1] * 300
    assert "run" not in alone.columns()


def test_rows_beyond_what_was_fitted_are_marked(softer):
    time = PERIOD * np.arange(400)
    gentle = softer.commands_for(time, 0.3 * smooth(400)[:, None])
    assert not gentle.outside.any()
    violent = softer.commands_for(time, 5 * smooth(400)[:, None])
    assert violent.outside.any()
    assert not violent.outside[:30].any()  # it rests
    assert violent.columns()["outside"].tolist() == violent.outside.astype(int).tolist()


def test_a_clock_that_drifts_agrees_at_the_first_row(softer):
    rate = 5e-3
    steady = replace(softer, interpolated=True)
    drifting = replace(steady, servo=steady.servo._replace(clock_rate=np.array([rate])))
    time = PERIOD * np.arange(400)
    line = np.maximum(time - 0.5, 0.0)[:, None]
    # the delay is of the clock of the commands
    by_its_clock = np.maximum(time * (1 + rate) + rate * SOFT["delay"] - 0.5, 0.0)[:, None]
    apart = drifting.predict(time, line).position - steady.predict(time, by_its_clock).position
    assert np.abs(apart).max() < 2e-5


# ------------------------------------------------------------------ the command


def write_diagnosis(model, path):
    """As much of a document as holds the model."""
    covariances = [np.eye(part.stop - part.start) for part in model.terms.slices]
    document = {"schema": SCHEMA, "domain": "tracking", "model": model_entry(model, covariances)}
    path.write_text(json.dumps(document))
    return path


def write_commands(path, columns):
    rows = (",".join(f"{value:.9g}" for value in row) for row in np.column_stack([*columns.values()]))
    path.write_text("\n".join([",".join(columns), *rows]) + "\n")
    return path


def test_the_command_writes_commands_and_says_what_they_are_worth(softer, tmp_path, capsys):
    diagnosis = write_diagnosis(softer, tmp_path / "d.json")
    columns = {"time_s": PERIOD * np.arange(300), "cmd1_rad": smooth(300)}
    given = write_commands(tmp_path / "commands.csv", columns)
    code, out, _ = run(capsys, "compensate", diagnosis, given, "--out", tmp_path / "corrected.csv")
    expected = softer.commands_for(columns["time_s"], columns["cmd1_rad"][:, None])
    table = pyarrow.csv.read_csv(tmp_path / "corrected.csv")
    assert code == 0
    assert table.column_names[:3] == ["time_s", "cmd1_rad", "outside"]
    assert all(name.startswith("outside_") and name.endswith("_joint1") for name in table.column_names[3:])
    assert table["cmd1_rad"].to_numpy() == pytest.approx(expected.command[:, 0], abs=1e-6)
    before, after = (f"{1e3 * float(error[0]):.4f}" for error in (expected.error_before, expected.error_after))
    assert f"joint 1 {before} {after}" in flat(out)
    assert f"300 rows of commands leave errors of {after} mrad RMS, and {before} mrad without" in flat(out)
    assert f"{expected.rows_outside} of 300 rows" in flat(out) or "No row is outside" in flat(out)
    code, out, _ = run(capsys, "compensate", diagnosis, given, "--json", "--force", "--out", tmp_path / "corrected.csv")
    document = json.loads(out)
    assert document["rms_after_rad"] == pytest.approx(expected.error_after)
    assert (document["rows"], document["outside"]) == (300, expected.rows_outside)


def test_what_cannot_be_corrected_is_refused_in_one_line(softer, tmp_path, capsys):
    diagnosis = write_diagnosis(softer, tmp_path / "d.json")
    out = tmp_path / "corrected.csv"
    time = PERIOD * np.arange(50)
    good = {"time_s": time, "cmd1_rad": smooth(50)}
    given = write_commands(tmp_path / "commands.csv", good)
    for option, value in (("--frame", "base"), ("--approach", 1), ("--column", "A=x_m")):
        said = refused(capsys, "compensate", diagnosis, given, option, value, "--out", out)
        assert said == f"{option}: is of poses, and {diagnosis} is of commands; leave it out"
    bare = write_commands(tmp_path / "joints.csv", {"time_s": time, "q1_rad": smooth(50)})
    said = refused(capsys, "compensate", diagnosis, bare, "--out", out)
    assert said == f"{bare}: has no column cmd1_rad; give time_s and cmd1_rad … of every joint"
    untimed = write_commands(tmp_path / "untimed.csv", {"cmd1_rad": smooth(50)})
    said = refused(capsys, "compensate", diagnosis, untimed, "--out", out)
    assert said == f"{untimed}: commands need times; add time_s"
    wide = write_commands(tmp_path / "wide.csv", good | {"cmd2_rad": smooth(50)})
    said = refused(capsys, "compensate", diagnosis, wide, "--out", out)
    assert said.endswith("the joint positions end with q1; add q2 or remove the column")
    assert not out.exists()
    with pytest.raises(InputError, match=r"give \(sample,\), \(sample, 1\)"):
        softer.commands_for(time, np.zeros((50, 2)))
    with pytest.raises(InputError, match="not finite; leave out such rows"):
        softer.commands_for(time, np.full((50, 1), np.nan))


# ------------------------------------------------------------------ MuJoCo

ARM = Arm(
    "three",
    KINEMATICS,
    mass=MASSES,
    center_of_mass=CENTERS,
    inertia=np.stack([np.diag(tensor) for tensor in TENSORS]),
    rotor_inertia=ARMATURE,
    viscous_friction=np.ones(3),
    coulomb_friction=np.full(3, 0.4),
)


class SoftArm:
    """The arm in MuJoCo with position actuators that are softer and later than declared, and with more friction."""

    stiffness = np.array([200.0, 250.0, 180.0])
    damping = np.array([12.0, 12.0, 12.0])
    friction = np.array([1.4, 1.6, 0.9])
    late = 3
    """Samples."""
    parts = 10
    """Steps of a sample."""

    def __init__(self, mujoco):
        self.mujoco = mujoco
        head = f'<compiler angle="radian" eulerseq="XYZ"/><option timestep="{PERIOD / self.parts}" '
        head += 'integrator="implicitfast"/>'
        motors = "".join(f'<position joint="j{i}" kp="{self.stiffness[i]}" kv="{self.damping[i]}"/>' for i in range(3))
        text = f"<mujoco>{head}<worldbody>{self.body(0)}</worldbody><actuator>{motors}</actuator></mujoco>"
        self.model = mujoco.MjModel.from_xml_string(text)

    def body(self, i):
        if i == 3:
            return ""
        x, y, z, *angles = KINEMATICS[i].tolist()
        # roll, pitch and yaw about fixed axes are yaw, pitch and roll about those that turn with the body
        turns = [(axis, angle) for axis, angle in zip(("0 0 1", "0 1 0", "1 0 0"), reversed(angles), strict=True)]
        opened = f'<body pos="{x} {y} {z}" axisangle="{turns[0][0]} {turns[0][1]}">'
        opened += "".join(f'<body axisangle="{axis} {angle}">' for axis, angle in turns[1:])
        inertia = " ".join(map(str, TENSORS[i].tolist()))
        center = " ".join(map(str, CENTERS[i].tolist()))
        return (
            f'{opened}<joint name="j{i}" axis="0 0 1" damping="1" frictionloss="{self.friction[i]}" '
            f'armature="{ARMATURE[i]}" solreffriction="0.002 1"/>'
            f'<inertial pos="{center}" mass="{MASSES[i]}" diaginertia="{inertia}"/>{self.body(i + 1)}'
            "</body></body></body>"
        )

    def follow(self, command):
        """Positions `(sample, joint)` rad by commands of that shape, from rest at the first."""
        data = self.mujoco.MjData(self.model)
        data.qpos[:] = command[0]
        held = np.vstack([np.tile(command[:1], (200 + self.late, 1)), command])
        rows = []
        for row in range(200 + len(command)):
            rows.append(data.qpos.copy())
            data.ctrl[:] = held[row]
            self.mujoco.mj_step(self.model, data, self.parts)
        return np.array(rows[200:])


def excitation(samples, seed, pause=0.5):
    """Sines of several frequencies after a pause, `(sample, joint)` rad."""
    t = np.maximum(PERIOD * np.arange(samples) - pause, 0.0)[:, None]
    rates = np.random.default_rng(seed).uniform(0.25, 0.6, 3)
    return 0.35 * np.sin(2 * np.pi * rates * t) + 0.08 * (1 - np.cos(7 * rates * t)) + np.array([0.1, -0.4, 0.3])


def test_corrected_commands_halve_the_tracking_error_of_an_arm_in_mujoco():
    arm = SoftArm(pytest.importorskip("mujoco"))
    commands = excitation(500, seed=2)
    log = Recording.from_arrays(
        arm.follow(commands) + np.random.default_rng(3).normal(0.0, 1e-4, commands.shape),
        arm=ARM,
        time=PERIOD * np.arange(500),
        commanded_position=commands,
        motion="trajectory",
        joint_noise_rad=1e-4,
        servo={"stiffness_Nm_per_rad": [300.0] * 3, "damping_Nm_s_per_rad": [12.0] * 3},
    )
    effects = [kind(joint) for kind in (ServoStiffness, CoulombFriction) for joint in (1, 2, 3)]
    model = fit_servos(log, ARM, [CommandTimeOffset(), *effects]).diagnosed
    wanted = excitation(400, seed=8)
    found = model.commands_for(PERIOD * np.arange(400), wanted)
    before = rms(arm.follow(wanted) - wanted)
    after = rms(arm.follow(found.command) - wanted)
    assert np.all(after < 0.1 * before)
    assert found.error_before == pytest.approx(before, rel=0.05)
