"""An arm with a prismatic joint from its recording to its diagnosis: columns, units, fit, effects, predictions."""

from dataclasses import replace

import numpy as np
import pytest

from lite6jax.arms.chains import six_parameter_fk
from lite6jax.arms.dh import six_parameter_to_hayati
from lite6jax.arms.factory import write_factory
from lite6jax.arms.urdf import read_urdf
from lite6jax.cli import main
from lite6jax.diagnosis.document import read_model
from lite6jax.domains.pose.compensate import compensate
from lite6jax.domains.pose.fit import fit
from lite6jax.domains.predict import predict
from lite6jax.errors import InputError
from lite6jax.recordings import Recording, read_recording, write_recording
from lite6jax.simulation import simulate
from tests.oracles.sliding_arms import ARMS

EFFECTS = ("joint_scale:joint=3,scale=1e-3", "joint_backlash:joint=3,gap_m=4e-4")


@pytest.fixture(scope="module")
def scara(tmp_path_factory):
    """The folder of an arm whose third joint is prismatic."""
    folder = tmp_path_factory.mktemp("scara")
    (folder / "scara.urdf").write_text(ARMS["scara"])
    return folder


def simulated(folder, effects=(), noise=2e-5, **given):
    arm = read_urdf(folder / "scara.urdf")
    recording = simulate(
        arm,
        effects=effects,
        samples=60,
        sensor="tracker_6d",
        position_noise=noise,
        orientation_noise=5 * noise,
        **given,
    )
    return arm, replace(recording, settings=replace(recording.settings, arm=str(folder / "scara.urdf")))


def test_columns_have_the_units_of_their_joints(scara, tmp_path):
    arm, recording = simulated(scara, motion="trajectory")
    names = list(recording.columns())
    assert names[1:9] == [
        *("q1_rad", "q2_rad", "q3_m", "q4_rad"),
        *("dq1_rad_per_s", "dq2_rad_per_s", "dq3_m_per_s", "dq4_rad_per_s"),
    ]
    path = write_recording(recording, tmp_path / "run.csv")
    back = read_recording(path, dof=4, joint_limits=arm.joint_limits)
    assert back.sliding == arm.sliding == (2,)
    np.testing.assert_array_equal(back.joint_position, recording.joint_position)
    np.testing.assert_array_equal(back.joint_velocity, recording.joint_velocity)
    text = path.read_text()
    for file, old, new, message in (
        ("mm.csv", "q3_m", "q3_mm", None),
        ("rad.csv", "q3_m,", "q3_rad,", "column dq3_m_per_s does not fit q3_rad; write dq3_rad_per_s or dq3_deg_per_s"),
        (
            "dq.csv",
            "dq3_m_per_s",
            "dq3_rad_per_s",
            "column dq3_rad_per_s does not fit q3_m; write dq3_m_per_s or",
        ),
    ):
        (tmp_path / file).write_text(text.replace(old, new, 1))
        if message is None:
            read = read_recording(tmp_path / file, dof=4)
            np.testing.assert_array_equal(read.joint_position[:, 2], recording.joint_position[:, 2] / 1000)
            continue
        with pytest.raises(InputError, match=message):
            read_recording(tmp_path / file, dof=4)
    (tmp_path / "far.csv").write_text("q1_rad,q2_rad,q3_m,q4_rad\n0,0,150,0\n0,0,170,0\n")
    with pytest.raises(InputError, match="are these millimetres\\? name the column q3_mm"):
        read_recording(tmp_path / "far.csv", dof=4, joint_limits=arm.joint_limits)


def test_an_angle_is_no_length(scara):
    arm, recording = simulated(scara)
    turned = replace(recording, sliding=())
    with pytest.raises(
        InputError, match="q3 is an angle, but joint 3 of arm is prismatic; name the column q3_m or q3_mm"
    ):
        fit(turned)
    q, position = recording.joint_position, recording.position
    assert Recording.from_arrays(q, position, arm=arm).sliding == (2,)
    with pytest.raises(InputError, match="q1 is a length, but joint 1 of arm is revolute; name the column q1_rad"):
        Recording.from_arrays(q, position, arm=arm, sliding=(0, 2))
    for effect, message in (
        ("joint_offset:joint=3,offset_rad=1e-3", "the key 'offset_rad' is unknown; the keys are joint, offset_m"),
        ("joint_offset:joint=1,offset_m=1e-3", "the key 'offset_m' is unknown; the keys are joint, offset_rad"),
    ):
        with pytest.raises(InputError, match=message):
            simulate(arm, effects=[effect], samples=5)


def test_a_fit_recovers_the_effective_model(scara):
    arm = read_urdf(scara / "scara.urdf")
    kinematics = arm.kinematics + np.random.default_rng(2).normal(0, 1e-3, (arm.dof, 6))
    _, recording = simulated(scara, noise=1e-9, kinematics=kinematics)
    found = fit(recording, geometry="free")
    np.testing.assert_allclose(
        found.parameters[: arm.form.size], six_parameter_to_hayati(arm.form, kinematics, arm.hayati), rtol=0, atol=1e-6
    )
    assert found.checked.position_rms < 1e-7


def test_a_slide_is_diagnosed_predicted_and_compensated(scara, tmp_path, capsys):
    _, recording = simulated(scara, EFFECTS, tool=[0.05, 0.02, 0.1, 0, 0, 0])
    write_factory(read_urdf(scara / "scara.urdf").kinematics, tmp_path / "own.yaml")
    settings = replace(recording.settings, factory_calibration="own.yaml")
    path = write_recording(replace(recording, settings=settings), tmp_path / "run.csv")
    assert main(["diagnose", str(path), "--quick", "--out", str(tmp_path / "d.json")]) == 0
    said = capsys.readouterr().out
    assert "Joint backlash at joint3, a function of the direction of motion of joint 3" in " ".join(said.split())
    model = read_model(tmp_path / "d.json")
    assert model.sliding == (2,)
    reported = dict(zip((e.label for e in model.physics.effects), model.physics.reported(model.values), strict=True))
    assert set(reported) == {"joint_scale:joint3", "joint_backlash:joint3"}
    assert reported["joint_scale:joint3"]["scale"].value == pytest.approx(1e-3, abs=1e-4)
    assert reported["joint_backlash:joint3"]["gap_m"].value == pytest.approx(4e-4, abs=3e-5)

    fresh = np.random.default_rng(1).uniform(-0.5, 0.5, (6, 4))
    poses = predict(model, fresh)
    rigid = np.asarray(six_parameter_fk(np.asarray(model.model.geometry).reshape(-1, 6), fresh, (2,)))
    expected = rigid.copy()  # the tool, and what the joint is off along its axis
    off = 1e-3 * fresh[:, 2] - 0.5 * 4e-4 * np.sign(np.diff(fresh[:, 2], prepend=0))
    expected[:, :3, 3] += off[:, None] * rigid[:, :3, 2]
    expected = expected @ np.asarray(model.model.T_flange_tool)
    np.testing.assert_allclose(poses[:, :3, 3], expected[:, :3, 3], rtol=0, atol=3e-5)
    found = compensate(model, poses, start=fresh + 1e-3)
    assert found.reached.all()
    np.testing.assert_allclose(found.joint_position, fresh, rtol=0, atol=1e-8)
    assert main(["identify", str(scara / "scara.urdf"), "--torque"]) == 0
    assert "of prismatic joints, P: N·s/m, N, N, kg" in " ".join(capsys.readouterr().out.split())


def test_a_table_with_names_of_its_own_is_read_after_init(scara, tmp_path, capsys):
    _, recording = simulated(scara)
    names = [*(f"axis_{k}" for k in range(4)), "tcp_x", "tcp_y", "tcp_z"]
    table = np.hstack([recording.joint_position * [180 / np.pi, 180 / np.pi, 1e3, 180 / np.pi], recording.position])
    path = tmp_path / "mine.csv"
    np.savetxt(path, table, "%.9f", ",", header=",".join(names), comments="")
    assert main(["init", str(path), "--arm", str(scara / "scara.urdf")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Joint positions: axis_0, axis_1, axis_3, in degrees (certain: the arm's kinematics agree" in said
    assert "Slide positions: axis_2, in millimetres (certain: the arm's kinematics agree" in said
    back = read_recording(path, dof=4)
    assert back.sliding == (2,)
    np.testing.assert_allclose(back.joint_position, recording.joint_position, atol=1e-8)
