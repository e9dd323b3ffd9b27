"""`lite6jax init` of logs of drives: what was commanded beside what was measured, more motors than joints, servos."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from typed import flat, refused, run

from lite6jax.cli import init
from lite6jax.recordings import read_recording, write_recording

T = 0.02 * np.arange(200)


def moved(joints, late=0.0):
    """Positions `(sample, joint)` rad and velocities of joints that swing, each in its own way."""
    k = np.arange(joints)
    phase = np.multiply.outer(T - late, 1 + 0.2 * k) + 1.7 * k
    return 0.8 * np.sin(phase), 0.8 * (1 + 0.2 * k) * np.cos(phase)


def blocks(**named):
    """Columns `name_0`, `name_1`, … of `(sample, joint)` numbers."""
    return {f"{name}_{k}": column for name, block in named.items() for k, column in enumerate(block.T)}


def table(path, columns):
    np.savetxt(
        path, np.column_stack([T, *columns.values()]), "%.7g", ",", comments="", header="time," + ",".join(columns)
    )
    return path


def columns_of(path):
    return yaml.safe_load(path.with_suffix(".yaml").read_text())["columns"]


URDF = """<robot name="{name}"><link name="base"/>{links}</robot>"""
LINK = """<joint name="{name}" type="revolute"><origin xyz="0 0 0.1" rpy="1 0 0"/><parent link="{parent}"/>
<child link="{child}"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="9" velocity="9"/></joint>
<link name="{child}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
</link>"""


def urdf(path, *chains):
    """The file of a robot with chains of joints from its base; the link that a joint moves is named after it."""
    links = [
        LINK.format(name=joint, parent="base" if not k else f"{chain[k - 1]}_link", child=f"{joint}_link")
        for chain in chains
        for k, joint in enumerate(chain)
    ]
    path.write_text(URDF.format(name=path.stem, links="".join(links)))
    return path


# ------------------------------------------------------------------ commanded and measured


def test_commands_and_measured_joints_alone_are_offered_a_diagnosis(tmp_path, capsys):
    (q, _), (late, _) = moved(6), moved(6, late=0.03)
    path = table(tmp_path / "log.csv", blocks(target_q=q, actual_q=late))
    code, out, _ = run(capsys, "init", path, "--arm", "ur5e", "--yes", width=200)
    assert code == 0
    assert "`diagnose --tracking` asks why the arm does not follow" in out
    assert "write joint_noise_rad there" in out
    assert "this is a motion" not in out
    assert f"lite6jax diagnose {path}" in out


@pytest.mark.parametrize("measured", ["actual_current", "motor_torque"])
def test_what_is_measured_comes_before_what_is_commanded(tmp_path, capsys, measured):
    (q, dq), (late, _) = moved(6), moved(6, late=0.03)
    driven = {measured: 3 * dq, "target_moment": 9 * dq}
    path = table(tmp_path / "log.csv", blocks(target_q=q, target_qd=dq, actual_q=late, **driven))
    code, out, _ = run(capsys, "init", path, "--arm", "ur5e", "--yes", width=200)
    assert code == 0
    assert "Commanded positions: target_q_0 … target_q_5, in radians (certain: the joints follow them). They" in out
    found = columns_of(path)
    assert found[f"{measured}_0"] == ("current1_A" if "current" in measured else "tau1_Nm")
    assert found["target_moment_0"] == found["target_qd_0"] == "ignore"
    recording = read_recording(path)
    np.testing.assert_allclose(recording.joint_position, late, atol=1e-6)
    np.testing.assert_allclose(recording.commanded_position, q, atol=1e-6)
    np.testing.assert_array_equal(recording.select(T < 1).commanded_position, recording.commanded_position[T < 1])
    again = read_recording(write_recording(recording, tmp_path / "again.parquet"))
    np.testing.assert_array_equal(again.commanded_position, recording.commanded_position)


# ------------------------------------------------------------------ more motors than joints

LEGS = [[f"{leg}_{part}" for part in ("hip", "thigh", "calf")] for leg in ("FL", "FR", "RL", "RR")]


def test_of_more_motors_than_joints_it_asks_which(tmp_path, capsys, monkeypatch):
    q, dq = moved(12)
    path = table(tmp_path / "log.csv", blocks(q=q, dq=dq, tau_est=9 * dq))
    leg = f"{urdf(tmp_path / 'quad.urdf', *LEGS)}#FR_calf_link"
    assert "say which as quad.urdf#FL_calf_link" in refused(
        capsys, "init", path, "--arm", tmp_path / "quad.urdf", "--yes"
    )
    said = refused(capsys, "init", path, "--arm", leg, "--yes")
    assert said == (
        f"{path}: it holds 12 joint positions (q_0 … q_11), and quad has 3 joints (FR_hip, FR_thigh, FR_calf): say "
        "which they are, such as --column q_0=q1_rad --column q_1=q2_rad --column q_2=q3_rad"
    )
    assert not path.with_suffix(".yaml").exists()
    first = said.partition("such as ")[2].split()
    for options, places in ((first, [0, 1, 2]), ([word.replace("q_2", "q_5") for word in first], [0, 1, 5])):
        assert run(capsys, "init", path, "--arm", leg, "--yes", "--force", *options)[0] == 0
        recording = read_recording(path)  # velocities and torques are those of the same motors
        for found, wanted in (
            (recording.joint_position, q),
            (recording.joint_velocity, dq),
            (recording.torques(), 9 * dq),
        ):
            np.testing.assert_allclose(found, wanted[:, places], atol=1e-5)
    answers = iter(["q_3", "q_3, q_4,q_5", "", "", ""])
    monkeypatch.setattr("builtins.input", lambda _: next(answers))
    monkeypatch.setattr(init, "_on_a_terminal", lambda: True)
    code, out, _ = run(capsys, "init", path, "--arm", leg, "--force")
    assert code == 0
    assert "write 3 of q_0, q_1, " in flat(out)
    np.testing.assert_allclose(read_recording(path).joint_position, q[:, 3:6], atol=1e-6)


def test_the_names_of_the_joints_say_which_motors_are_meant(tmp_path, capsys):
    q, dq = moved(12)
    names = [name for leg in LEGS for name in leg]
    named = {f"{name}.{kind}": column for kind, block in (("q", q), ("effort", 9 * dq))
             for name, column in zip(names, block.T, strict=True)}  # fmt: skip
    leg = f"{urdf(tmp_path / 'quad.urdf', *LEGS)}#RL_calf_link"
    path = table(tmp_path / "log.csv", named | blocks(dq=dq))
    assert run(capsys, "init", path, "--arm", leg, "--yes")[0] == 0
    recording = read_recording(path)
    np.testing.assert_allclose(recording.joint_position, q[:, 6:9], atol=1e-6)
    np.testing.assert_allclose(recording.torques(), 9 * dq[:, 6:9], atol=1e-5)
    assert recording.velocity_differentiated  # of the numbered velocities none is known to be of this leg


# ------------------------------------------------------------------ servos of a LeRobot data set

SERVOS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


def picks(folder, step):
    """A data set of an arm with a gripper whose positions change by steps of its encoders, of so many units."""
    (q, _), (late, _) = moved(6), moved(6, late=0.05)
    state = np.round(np.rad2deg(late) / step) * step
    lists = {"action": np.rad2deg(q), "observation.state": state, "observation.effort": np.round(500 * q)}
    (folder / "data").mkdir(parents=True)
    (folder / "meta").mkdir()
    columns = {name: pa.array(block.tolist(), pa.list_(pa.float32())) for name, block in lists.items()}
    pq.write_table(pa.table(columns | {"timestamp": T}), folder / "data" / "file-000.parquet")
    features = {name: {"shape": [6], "names": [f"{servo}.pos" for servo in SERVOS]} for name in lists}
    (folder / "meta" / "info.json").write_text(json.dumps({"features": features}))
    return folder, state, q


@pytest.mark.parametrize("ticks", [4096, 4095])
def test_servos_in_degrees_of_an_arm_whose_file_has_a_jaw(tmp_path, capsys, ticks):
    folder, state, q = picks(tmp_path / "picks", 360 / ticks)
    arm = urdf(tmp_path / "so101.urdf", SERVOS)
    code, out, err = run(capsys, "init", folder, "--arm", arm, "--yes", width=300)
    assert code == 0
    assert "joint 'gripper' seems to move a jaw" in err
    assert f"Note: the jaw is left out, as its column is a gripper's: the arm is {arm}#wrist_roll_link." in out
    assert "in degrees (certain: they change in steps of a servo's encoder in degrees)." in out
    assert "(assumed: whole numbers up to 400, so they may be the register of a drive and no torques)" in out
    recording = read_recording(folder)
    assert recording.settings.arm == "so101.urdf#wrist_roll_link"
    assert recording.settings.arm_reference(tmp_path) == tmp_path / "so101.urdf#wrist_roll_link"
    np.testing.assert_allclose(np.rad2deg(recording.joint_position), state[:, :5], atol=1e-4)
    np.testing.assert_allclose(recording.commanded_position, q[:, :5], atol=1e-6)
