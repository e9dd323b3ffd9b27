"""`lite6jax init` of logs of commands as controllers and tools write them, and what then reads them."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from typed import flat, refused, run

from lite6jax import cli
from lite6jax.arms.description import write_arm
from lite6jax.cli.diagnose import DiagnoseCommand
from lite6jax.diagnosis.diagnose import domains_of
from lite6jax.recordings import read_recording
from lite6jax.recordings.ros import UR_JOINTS
from tests.domains.tracking.test_servo_fit import PENDULUM, PERIOD, SERVO, TRUE, commands_of
from tests.oracles.servos import follow

ROWS = 240
NAMES = [f"{part}_joint" for part in UR_JOINTS]
ALPHABETICAL = np.argsort(NAMES)
SERVOS = [f"{name}.pos" for name in ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")]
EPOCH = 1_760_000_000


def motion(joints, rate=50.0, rows=ROWS, late=0.03):
    """Times s, commands rad and measured joints rad that follow, each joint in its own way."""
    t = np.arange(rows) / rate
    k = np.arange(joints)

    def swing(times):
        return 0.6 * np.sin(np.multiply.outer(times, 1 + 0.3 * k) + 1.7 * k)

    return t, swing(t), swing(t - late)


def rates(joints, rate=50.0, late=0.03):
    """The velocities of the measured joints."""
    t = np.arange(ROWS) / rate - late
    k = np.arange(joints)
    return 0.6 * (1 + 0.3 * k) * np.cos(np.multiply.outer(t, 1 + 0.3 * k) + 1.7 * k)


def numbered(stem, block, form="{}_{}"):
    return {form.format(stem, k): column for k, column in enumerate(block.T)}


def bracketed(stem, block):
    return numbered(stem, block, "{}[{}]")


def text(path, columns, separator=",", header=None, form="%.9g"):
    values = np.column_stack([*columns.values()])
    names = (header or separator).join(columns)
    np.savetxt(path, values, form, separator, comments="", header=names)
    return path


def initiated(capsys, *arguments):
    """What `init` prints, on one line."""
    code, out, err = run(capsys, "init", *arguments, "--yes", width=200)
    assert code == 0, err
    return flat(out)


def is_tracked(path, u, y, t=None, atol=2e-8):
    """Whether a file with its sidecar is these commands beside these joints, and diagnosed by them."""
    recording = read_recording(path)
    assert "tracking" in domains_of(recording, "tracking")
    np.testing.assert_allclose(recording.commanded_position, u, atol=atol)
    np.testing.assert_allclose(recording.joint_position, y, atol=atol)
    if t is not None:
        np.testing.assert_allclose(recording.time - recording.time[0], t - t[0], atol=1e-6)
    return recording


# ------------------------------------------------------------------ controllers


@pytest.mark.parametrize("separator", [" ", ","])
def test_rtde(tmp_path, capsys, separator):
    t, u, y = motion(6, 125.0)
    columns = {"timestamp": 1234.5 + t, **numbered("target_q", u), **numbered("actual_q", y)}
    path = text(tmp_path / "robot_data.csv", columns, separator)
    assert f"`lite6jax init {path}` names columns as they are" in refused(capsys, "diagnose", path, "--arm", "ur5e")
    said = initiated(capsys, path, "--arm", "ur5e")
    assert "Commanded positions: target_q_0 … target_q_5, in radians (certain: the joints follow them)." in said
    assert "write joint_noise_rad there" in said
    assert said.endswith(f"lite6jax diagnose {path} --out diagnosis.json")
    assert domains_of(is_tracked(path, u, y, t)) == ("tracking",)


def test_rtde_with_currents_is_diagnosed_by_both(tmp_path, capsys):
    t, u, y = motion(6, 125.0)
    v = rates(6, 125.0)
    columns = {"timestamp": t, **numbered("target_q", u), **numbered("target_qd", v), **numbered("actual_q", y)}
    columns |= numbered("actual_qd", v) | numbered("actual_current", 2 * v) | {"payload": np.full(ROWS, 0.5)}
    path = text(tmp_path / "robot_data.csv", columns, " ")
    said = initiated(capsys, path, "--arm", "ur5e")
    assert "joint_noise_rad" in said
    assert said.endswith(f"lite6jax diagnose {path} --out diagnosis.json")
    assert domains_of(is_tracked(path, u, y, t)) == ("torques", "tracking")
    assert refused(capsys, "diagnose", path) == (
        f"{path}: has motor currents without torque constants; declare torque_constant_Nm_per_A in the sidecar, one "
        "number per joint, or diagnose its commands alone (--tracking or domain='tracking')"
    )


def test_libfranka(tmp_path, capsys):
    """Its log is in ms; the command of a motion that is not one of joints is zero, and the twist is no pose."""
    t, u, y = motion(7, 1000.0)
    v = rates(7, 1000.0)
    columns = {"time": np.round(1e3 * t) + 98765, "success_rate": np.ones(ROWS)}
    columns |= bracketed("state.q", y) | bracketed("state.q_d", u) | bracketed("state.dq", v)
    columns |= bracketed("state.dq_d", v) | bracketed("state.tau_J", 3 * v) | bracketed("cmd.q_d", 0 * u)
    columns |= bracketed("cmd.O_T_EE_d", np.zeros((ROWS, 16))) | bracketed("cmd.O_dP_EE_d", np.zeros((ROWS, 6)))
    path = text(tmp_path / "log.csv", columns)
    said = initiated(capsys, path)
    assert "Joint positions: state.q[0] … state.q[6], in radians" in said
    assert "Commanded positions: state.q_d[0] … state.q_d[6], in radians (certain: the joints follow them)." in said
    assert "Time: time, in milliseconds" in said
    assert "Tool position" not in said
    is_tracked(path, u, y, t)


def test_libfranka_before_its_names_had_prefixes(tmp_path, capsys):
    t, u, y = motion(7, 1000.0)
    columns = {"duration": np.round(1e3 * t), " success rate": np.ones(ROWS)}
    columns |= {f" {name}": column for name, column in (bracketed("q", y) | bracketed("q_d", u)).items()}
    path = text(tmp_path / "log.csv", columns)
    assert "Time: duration, in milliseconds" in initiated(capsys, path)
    is_tracked(path, u, y, t)


def test_the_state_of_a_controller_in_plotjuggler(tmp_path, capsys):
    t, u, y = motion(6)
    topic = "/scaled_joint_trajectory_controller/controller_state"
    columns = {"__time": EPOCH + t}
    for part, block in (("error", u - y), ("feedback", y), ("reference", u)):
        columns |= {f"{topic}/{part}/positions/{NAMES[k]}": block[:, k] for k in ALPHABETICAL}
    path = text(tmp_path / "plot.csv", columns, form="%.15g")
    said = initiated(capsys, path, "--arm", "ur5e")
    assert "'…/controller_state/error/positions/elbow_joint'"[-30:] in said
    is_tracked(path, u, y, t)


def echoed(names, parts):
    """Messages of `ros2 topic echo`, of one state of a controller each."""
    t, u, y = motion(6)
    blocks = {"reference": u, "desired": u, "feedback": y, "actual": y}
    messages = []
    for k, time in enumerate(t):
        point = {"velocities": [], "time_from_start": {"sec": 0, "nanosec": 0}}
        points = {part: {"positions": blocks[part][k, names].tolist(), **point} for part in parts}
        stamp = {"sec": int(time), "nanosec": round((time % 1) * 1e9)}
        listed = [NAMES[place] for place in names]
        messages.append({"header": {"stamp": stamp, "frame_id": ""}, "joint_names": listed, **points})
    return "---\n".join(yaml.safe_dump(message, sort_keys=False) for message in messages) + "---\n"


@pytest.mark.parametrize("parts", [("reference", "feedback"), ("desired", "actual")])
def test_the_state_of_a_controller_echoed_names_its_joints(tmp_path, capsys, parts):
    t, u, y = motion(6)
    path = tmp_path / "state.txt"
    path.write_text(echoed(ALPHABETICAL, parts))
    said = initiated(capsys, path, "--arm", "ur5e")
    assert f"Commanded positions: {parts[0]}.positions.{NAMES[0]} … {parts[0]}.positions.{NAMES[5]}" in said
    is_tracked(path, u, y, t)


def test_the_state_of_a_controller_as_rostopic_writes_it_names_its_joints(tmp_path, capsys):
    t, u, y = motion(6)
    names = ["%time"] + [f"field.joint_names{k}" for k in range(6)]
    names += [f"field.{part}.positions{k}" for part in ("desired", "actual") for k in range(6)]
    lines = [",".join(names)]
    for k, time in enumerate(t):
        numbers = [*u[k, ALPHABETICAL], *y[k, ALPHABETICAL]]
        cells = [str(EPOCH * 10**9 + round(time * 1e9)), *(NAMES[place] for place in ALPHABETICAL)]
        lines.append(",".join([*cells, *(f"{number:.9g}" for number in numbers)]))
    path = tmp_path / "state.csv"
    path.write_text("\n".join(lines) + "\n")
    said = initiated(capsys, path, "--arm", "ur5e")
    assert "the cells of field.joint_names0 … field.joint_names5 say whose the numbers beside them are" in said
    is_tracked(path, u, y)


# ------------------------------------------------------------------ learning and simulators


def dataset(folder, joints, commands):
    """A LeRobot data set of three episodes whose last joint is a gripper, in the numbers that are given."""
    kind = pa.list_(pa.float32(), 6)
    frame = np.concatenate([np.arange(ROWS // 3)] * 3)
    table = pa.table(
        {
            "observation.state": pa.array(joints.astype(np.float32).tolist(), kind),
            "action": pa.array(commands.astype(np.float32).tolist(), kind),
            "timestamp": pa.array(frame / 30, pa.float32()),
            "frame_index": frame,
            "episode_index": np.repeat(np.arange(3), ROWS // 3),
        }
    )
    (folder / "data" / "chunk-000").mkdir(parents=True)
    path = folder / "data" / "chunk-000" / "file-000.parquet"
    pq.write_table(table, path)
    (folder / "meta").mkdir()
    feature = {"dtype": "float32", "shape": [6], "names": [*SERVOS, "gripper.pos"]}
    features = {"observation.state": feature, "action": feature}
    (folder / "meta" / "info.json").write_text(json.dumps({"codebase_version": "v3.0", "features": features}))
    return path


def test_a_part_of_a_lerobot_data_set_has_the_names_of_the_set(tmp_path, capsys):
    _, u, y = motion(6, 30.0)
    steps = np.round(np.rad2deg(y) * 4096 / 360) * 360 / 4096
    path = dataset(tmp_path / "picks", steps, np.rad2deg(u))
    for source in (path, tmp_path / "picks"):
        said = initiated(capsys, source)
        assert f"Commanded positions: action.{SERVOS[0]} … action.{SERVOS[-1]}, in degrees (certain: the" in said
        assert "Not used: 'observation.state.gripper.pos', 'action.gripper.pos'" in said
        recording = is_tracked(source, u[:, :5], np.deg2rad(steps[:, :5]), atol=1e-6)
        assert recording.run.tolist() == np.repeat([0, 1, 2], ROWS // 3).tolist()


def test_percent_of_lerobot_is_no_angle(tmp_path, capsys):
    _, u, y = motion(6, 30.0)
    path = dataset(tmp_path / "picks", 140 * y, 140 * u)
    assert "look like LeRobot's normalised values (-100 to 100 of each joint's calibrated range)" in refused(
        capsys, "init", path, "--yes"
    )


JAW = """<mujoco><worldbody><body name="base">{open}{close}</body></worldbody></mujoco>"""
SERVO_BODY = '<body name="{name}_link" pos="0 0 0.1"><joint name="{name}" axis="{axis}"/><geom size="0.02"/>'


def test_the_jaw_of_an_mjcf_is_left_out_where_the_log_has_a_gripper(tmp_path, capsys):
    pytest.importorskip("mujoco", reason="the package of the extra `mjcf` is not installed")
    names = [name.partition(".")[0] for name in SERVOS] + ["gripper"]
    opened = [SERVO_BODY.format(name=name, axis="0 0 1" if k % 2 else "1 0 0") for k, name in enumerate(names)]
    arm = tmp_path / "arm.xml"
    arm.write_text(JAW.format(open="".join(opened), close="</body>" * len(names)))
    _, u, y = motion(6, 30.0)
    steps = np.round(np.rad2deg(y) * 4096 / 360) * 360 / 4096
    path = dataset(tmp_path / "picks", steps, np.rad2deg(u))
    said = initiated(capsys, path, "--arm", arm)
    assert "the jaw is left out, as its column is a gripper's: the arm is " in said
    assert is_tracked(path, u[:, :5], np.deg2rad(steps[:, :5]), atol=1e-6).settings.arm.endswith("#wrist_roll_link")


@pytest.mark.parametrize(
    ("measured", "commanded", "form"),
    [
        ("qpos", "ctrl", "{}[{}]"),
        ("dof_pos", "des_dof_pos", "{}_{}"),
        ("joint_pos", "joint_pos_target", "{}_{}"),
        ("q_meas", "q_sp", "{}_{}"),
        ("left_arm/q", "left_arm/q_cmd", "{}[{}]"),
    ],
)
def test_names_of_simulators_and_of_labs(tmp_path, capsys, measured, commanded, form):
    t, u, y = motion(6)
    path = text(tmp_path / "log.csv", {"time": t} | numbered(measured, y, form) | numbered(commanded, u, form))
    initiated(capsys, path, "--arm", "lite6")
    assert domains_of(is_tracked(path, u, y, t)) == ("tracking",)


def test_arrays_of_actuator_gap_tests(tmp_path, capsys):
    t, u, y = motion(6)
    np.savez(tmp_path / "chirp.npz", time=t, dof_pos=y, des_dof_pos=u)
    initiated(capsys, tmp_path / "chirp.npz", "--arm", "lite6")
    is_tracked(tmp_path / "chirp.npz", u, y, t)
    (tmp_path / "chirp.pt").write_bytes(b"PK")
    for command in ("init", "diagnose"):
        assert refused(capsys, command, tmp_path / "chirp.pt") == (
            f"{tmp_path / 'chirp.pt'}: holds tensors of PyTorch, which is not needed here; write it as chirp.npz, "
            "`d = torch.load('chirp.pt'); numpy.savez('chirp.npz', **{k: v.numpy() for k, v in d.items() if "
            "torch.is_tensor(v)})`"
        )


# ------------------------------------------------------------------ two files, and two rates in one


def sage(folder, apart=0.0, late=0.003):
    """A pair of files of SAGE: lists in cells, and times in microseconds."""
    t, u, y = motion(6)
    v = rates(6)

    def cells(row):
        return '"[' + ", ".join(f"{number:.9g}" for number in row) + ']"'

    sent = [f"CONTROL,{1e6 * time:.3f},{cells(row)}" for time, row in zip(t, u, strict=True)]
    moved = [
        f"STATE_MOTOR,{1e6 * (time + late + apart):.3f},{cells(y[k])},{cells(v[k])},{cells(0.1 * v[k])}"
        for k, time in enumerate(t)
    ]
    (folder / "control.csv").write_text("\n".join(["type,timestamp,positions", *sent]) + "\n")
    (folder / "state_motor.csv").write_text("\n".join(["type,timestamp,positions,velocities,torques", *moved]) + "\n")
    return folder / "control.csv", folder / "state_motor.csv", u, y


@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1)])
def test_a_pair_of_sage_becomes_one_table(tmp_path, capsys, order):
    control, state, u, y = sage(tmp_path)
    first, second = (control, state)[order]
    said = initiated(capsys, first, second, "--arm", "lite6")
    joined = tmp_path / f"{first.stem}_{second.stem}.csv"
    assert (
        "240 commands of control.csv are held, each until the next, at 240 joint states of state_motor.csv: their "
        "times are taken for those of one clock."
    ) in said
    assert "Commanded positions: commanded.positions[0] … commanded.positions[5], in radians" in said
    recording = is_tracked(joined, u, y)
    assert domains_of(recording) == ("torques", "tracking")
    assert recording.time[0] == pytest.approx(0.003)


def test_a_pair_needs_no_arm_to_be_joined(tmp_path, capsys):
    control, state, u, y = sage(tmp_path)
    assert "Arm: unknown." in initiated(capsys, control, state)
    is_tracked(tmp_path / "control_state_motor.csv", u, y)


def test_commands_at_another_rate_are_held(tmp_path, capsys):
    sent, u, _ = motion(6, 30.0, 120)
    moved, _, y = motion(6, 125.0, 500)
    moved = moved + 0.0011
    first = text(tmp_path / "sent.csv", {"timestamp": sent + 0.01} | numbered("target_q", u))
    second = text(tmp_path / "moved.csv", {"timestamp": moved} | numbered("actual_q", y))
    said = initiated(capsys, first, second, "--arm", "lite6")
    number = (sent[None] + 0.01 <= moved[:, None]).sum(1) - 1
    usable = (number >= 0) & (moved <= sent[-1] + 0.01 + 2 / 30)
    early = int((number < 0).sum())
    assert f"dropped {early} joint states before the first command" in said
    is_tracked(tmp_path / "sent_moved.csv", u[number][usable], y[usable], moved[usable])


def test_runs_of_a_pair_keep_their_own_commands(tmp_path, capsys):
    t, u, y = motion(6)
    half = ROWS // 2
    clock = np.concatenate([t[:half], t[:half]])
    run_number = np.repeat([1, 2], half)
    later = clock + 0.001
    first = text(tmp_path / "control.csv", {"time": clock, "run": run_number} | numbered("q", u))
    second = text(tmp_path / "state.csv", {"time": later, "run": run_number} | numbered("q", y))
    initiated(capsys, first, second, "--arm", "lite6")
    recording = is_tracked(tmp_path / "control_state.csv", u, y)
    assert recording.run.tolist() == run_number.tolist()


def test_pairs_that_are_none(tmp_path, capsys):
    control, state, _, _ = sage(tmp_path, apart=100.0)
    assert refused(capsys, "init", control, state, "--yes") == (
        f"{control} and {state}: no joint state lies between commands (commands 0.000 to 4.780 s, joints 100.003 to "
        "104.783 s); stamp both by one clock"
    )
    t, u, y = motion(6)
    untimed = text(tmp_path / "command.csv", numbered("q", u))
    state = text(tmp_path / "state.csv", {"time": t} | numbered("q", y))
    assert refused(capsys, "init", untimed, state, "--yes") == (
        f"{untimed}: has no times, by which commands and joints are joined; say which column they are, --column "
        "NAME=time_s"
    )
    five = text(tmp_path / "commands.csv", {"time": t} | numbered("q", u[:, :5]))
    assert refused(capsys, "init", five, state, "--yes") == (
        f"{five}: has 5 joints and {state} 6; leave out what is no joint by --column NAME=ignore"
    )
    unsaid = text(tmp_path / "other.csv", {"time": t} | numbered("q", u))
    assert refused(capsys, "init", unsaid, state, "--arm", "lite6", "--yes") == (
        f"{unsaid} and {state}: both have joint positions; if one has the commands, call it commands.csv, else say "
        "which are none by --column NAME=ignore"
    )


def sparse(path, run_number=False):
    """A table of two topics, as PlotJuggler exports them: cells are empty where the other topic spoke."""
    sent, u, _ = motion(6, 20.0, 80)
    moved, _, y = motion(6, 50.0, 200)
    moved = moved + 0.0007
    gap = np.nan
    time = np.concatenate([sent + 0.01, moved])
    block = np.vstack([np.hstack([u, np.full_like(u, gap)]), np.hstack([np.full_like(y, gap), y])])
    order = np.argsort(time)
    names = [f"/position_controller/commands/data[{k}]" for k in range(6)]
    names += [f"/joint_states/position[{k}]" for k in range(6)]
    lines = [",".join(["__time", *names])]
    for at, row in zip(time[order], block[order], strict=True):
        lines.append(",".join([f"{at:.6f}", *("" if np.isnan(number) else f"{number:.9g}" for number in row)]))
    path.write_text("\n".join(lines) + "\n")
    number = (sent[None] + 0.01 <= moved[:, None]).sum(1) - 1
    usable = (number >= 0) & (moved <= sent[-1] + 0.01 + 0.1)
    return u[number][usable], y[usable], moved[usable]


def test_commands_in_other_rows_are_held(tmp_path, capsys):
    u, y, t = sparse(tmp_path / "plot.csv")
    said = initiated(capsys, tmp_path / "plot.csv", "--arm", "lite6")
    assert (
        "Note: 80 commands and 200 joint states stand in different rows: each command is held until the next." in said
    )
    assert "Note: dropped 1 joint states before the first command." in said
    recording = is_tracked(tmp_path / "plot.csv", u, y, t)
    assert domains_of(recording) == ("tracking",)
    assert recording.row[0] == 3  # of the file, below its first command


# ------------------------------------------------------------------ what is not certain


def test_commands_with_empty_cells_are_commands(tmp_path, capsys):
    t, u, y = motion(6)
    u[60] = np.nan
    y[100:103] = np.nan
    path = text(tmp_path / "log.csv", {"timestamp_ms": 1e3 * t} | numbered("target_q", u) | numbered("actual_q", y))
    initiated(capsys, path, "--arm", "lite6")
    kept = np.isfinite(u).all(1) & np.isfinite(y).all(1)
    recording = is_tracked(path, u[kept], y[kept], t[kept])
    assert "dropped 4 rows with NaN, infinite or empty fields, the first is row 61" in recording.notes


def test_microseconds_since_the_start_of_a_controller_are_no_clock(tmp_path, capsys):
    """As large as seconds since 1970, but joints would creep."""
    t, u, y = motion(6)
    path = text(tmp_path / "log.csv", {"timestamp": 1e6 * (t + 1200)} | numbered("q_cmd", u) | numbered("q", y))
    assert "Time: timestamp, in microseconds (likely: rows would be 0.02 s apart)." in initiated(capsys, path)
    is_tracked(path, u, y, t)


def test_two_exchanged_joints_are_left_to_the_diagnosis_and_said(tmp_path, capsys):
    t, u, y = motion(6)
    u[:, [1, 2]] = u[:, [2, 1]]
    path = text(tmp_path / "log.csv", {"time": t} | numbered("target_q", u) | numbered("actual_q", y))
    said = initiated(capsys, path, "--arm", "lite6")
    assert "in radians (likely: most joints follow them, but not joint 2 and joint 3)." in said
    is_tracked(path, u, y, t)


def test_commands_that_no_joint_follows_are_said_and_can_be_given(tmp_path, capsys):
    t, u, y = motion(6)
    path = text(tmp_path / "log.csv", {"time": t} | numbered("target_q", -u) | numbered("actual_q", y))
    said = initiated(capsys, path, "--arm", "lite6")
    assert (
        "Commanded by name: target_q_0 … target_q_5. The joints follow them in no unit, so they are not used; if they "
        "are the positions that were commanded, say so for each: --column target_q_0=cmd1_rad --column "
        "target_q_1=cmd2_rad"
    ) in said
    given = [f"--column=target_q_{k}=cmd{k + 1}_rad" for k in range(6)]
    assert "Commanded by name" not in initiated(capsys, path, "--arm", "lite6", "--force", *given)
    is_tracked(path, -u, y, t)


def test_commanded_velocities_are_recognised_where_no_positions_were_commanded(tmp_path, capsys):
    t, u, y = motion(6)
    rate = rates(6)
    path = text(tmp_path / "log.csv", {"time": t} | numbered("target_qd", rate) | numbered("actual_q", y))
    said = initiated(capsys, path, "--arm", "lite6")
    assert "Commanded velocities: target_qd_0 … target_qd_5, rad/s" in said.replace("in rad/s", "rad/s")
    assert "command: velocity" in path.with_suffix(".yaml").read_text()
    travel = np.concatenate([np.zeros((1, 6)), np.cumsum(rate[:-1] * np.diff(t)[:, None], 0)])
    assert read_recording(path).commanded_position == pytest.approx(y[0] + travel, abs=1e-6)
    both = text(tmp_path / "both.csv", {"time": t} | numbered("target_qd", rate) | numbered("target_q", u)
                | numbered("actual_q", y))  # fmt: skip
    initiated(capsys, both, "--arm", "lite6")
    assert "command: velocity" not in both.with_suffix(".yaml").read_text()
    assert read_recording(both).commanded_position == pytest.approx(u, abs=1e-6)


def test_commanded_torques_are_said(tmp_path, capsys):
    t, _, y = motion(6)
    path = text(tmp_path / "log.csv", {"time": t} | numbered("cmd_tau", rates(6)) | numbered("actual_q", y))
    said = initiated(capsys, path, "--arm", "lite6")
    assert (
        "Commanded torques: cmd_tau_0 … cmd_tau_5. Commands are diagnosed where they are positions or velocities: log "
        "these, or diagnose the torques (--column NAME=tau1_Nm and so on)."
    ) in said
    assert read_recording(path).commanded_position is None


# ------------------------------------------------------------------ to the end


@pytest.mark.long
def test_a_log_of_a_controller_is_diagnosed_by_its_commands(tmp_path, capsys):
    """From the file of a controller to the finding, by the commands that `init` prints."""
    write_arm(PENDULUM, tmp_path / "arm.yaml")
    u = commands_of(300)
    y = follow(u, PERIOD, **(TRUE | {"delay": 0.023})) + np.random.default_rng(5).normal(0.0, 2e-4, 300)
    path = text(tmp_path / "log.csv", {"timestamp": PERIOD * np.arange(300), "target_q_0": u, "actual_q_0": y}, " ")
    declared = [f"--set=servo={json.dumps(SERVO)}", "--set=joint_noise_rad=2.0e-4"]
    said = initiated(capsys, path, "--arm", tmp_path / "arm.yaml", "--set=payload_com_m=[0, -0.1, 0]", *declared)
    assert said.endswith(f"lite6jax diagnose {path} --out diagnosis.json")
    out = tmp_path / "diagnosis.json"
    assert cli.main(["diagnose", str(path), "--out", str(out), "--quick"]) == 0
    document = json.loads(out.read_text())
    assert document["domain"] == "tracking"
    assert [(finding["effect"], finding["site"]) for finding in document["findings"]] == [("time_offset", "clock")]
    assert "All joints are late" in flat(capsys.readouterr().out)


def test_a_diagnosis_of_poses_names_the_one_of_commands(tmp_path):
    """The line beside what is diagnosed, without the diagnosis."""
    t, u, y = motion(6)
    columns = (
        {"time_s": t} | {f"q{k + 1}_rad": y[:, k] for k in range(6)} | {f"cmd{k + 1}_rad": u[:, k] for k in range(6)}
    )
    path = text(tmp_path / "log.csv", columns | {f"{axis}_m": rates(6)[:, k] for k, axis in enumerate("xyz")})
    recording = read_recording(path)
    (said,) = DiagnoseCommand(path)._of_other_domains(recording)
    assert said == (
        f"the poses are diagnosed, and not the commands beside them; `lite6jax diagnose {path} --tracking` asks why "
        "the joints do not follow"
    )
    assert DiagnoseCommand(path, tracking=True)._of_other_domains(recording) == []
    both = text(tmp_path / "both.csv", columns | {f"tau{k + 1}_Nm": rates(6)[:, k] for k in range(6)})
    assert DiagnoseCommand(both)._of_other_domains(read_recording(both)) == []
