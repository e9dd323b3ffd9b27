"""The chain of a diagnosis of poses as simulators read it: forward kinematics of Pinocchio and MuJoCo, to 1e-9."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis.recorded import LITE6, Made, static_motion
from domains.pose.documents import document, stored
from typed import flat, refused, run

from lite6jax.arms.files import read_arm, write_arm, write_urdf
from lite6jax.cli.command import list_inputs
from lite6jax.diagnosis.document import model_from_document
from lite6jax.diagnosis.export import diagnosed_chain
from lite6jax.domains.pose.predict import predict
from lite6jax.recordings import write_recording
from lite6jax.simulation import simulate
from tests.oracles.chains import six_parameter_poses

OFFSETS = (
    "joint_offset:joint=2,offset_rad=2e-3",
    "frame_offset:link=3,x_m=1e-3,y_m=-5e-4,z_m=2e-4,rx_rad=1e-3,ry_rad=-2e-3,rz_rad=5e-4",
    "frame_offset:x_m=2e-3,y_m=0,z_m=-1e-3,rx_rad=0,ry_rad=3e-3,rz_rad=1e-3",
    "frame_offset:link=6,x_m=1e-4,y_m=0,z_m=0,rx_rad=2e-3,ry_rad=0,rz_rad=0",
    "tool_offset:x_m=3e-3,y_m=-1e-3,z_m=2e-3",
)
MOVING = (
    "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5",
    "joint_harmonic:joint=4,order=1,amplitude_rad=5e-4,phase_rad=3",
)


def positions():
    return static_motion(4, 20)["joint_position"]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return Made(tmp_path_factory.mktemp("arm"), seed=3)


@pytest.fixture
def diagnosis(made, tmp_path):
    return stored(tmp_path, document(made, (*OFFSETS, *MOVING)))


def measured(made, q):
    """What the sensor would show of the displacements that do not move, by the library's own prediction."""
    return predict(model_from_document(document(made, OFFSETS)), q)


def pinocchio_tip(path, q):
    import pinocchio as pin

    model = pin.buildModelFromUrdf(str(path))
    data, frame, poses = model.createData(), model.getFrameId("flange"), []
    for row in q:
        pin.framesForwardKinematics(model, data, row)
        poses.append(data.oMf[frame].homogeneous)
    return np.array(poses)


def mujoco_tip(path, q):
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(path))
    data, body, poses = mujoco.MjData(model), model.body("flange").id, []
    for row in q:
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
        poses.append(T)
    return np.array(poses)


@pytest.mark.parametrize(
    ("name", "tip"),
    [
        ("arm.urdf", pinocchio_tip),
        ("arm.xml", mujoco_tip),
        (
            "arm.yaml",
            lambda path, q: six_parameter_poses((arm := read_arm(str(path))).kinematics, q) @ arm.T_joint_flange,
        ),
    ],
)
def test_the_written_arm_stands_where_it_was_measured(made, diagnosis, tmp_path, capsys, name, tip):
    code, said, _ = run(capsys, "convert", diagnosis, tmp_path / name)
    assert code == 0
    q = positions()
    np.testing.assert_allclose(tip(tmp_path / name, q), measured(made, q), rtol=0, atol=1e-9)
    assert "joint compliance at joint2; joint harmonic at joint4" in flat(said)


def test_a_sensor_somewhere_and_a_tool_are_no_part_of_the_arm(tmp_path_factory):
    made = Made(tmp_path_factory.mktemp("arm"), seed=2, frame=True, tool=True)
    arm, left_out = diagnosed_chain(model_from_document(document(made, OFFSETS[:1])))
    q = positions()
    shown = predict(model_from_document(document(made, OFFSETS[:1])), q)
    tip = six_parameter_poses(arm.kinematics, q) @ arm.T_joint_flange
    np.testing.assert_allclose(tip, np.linalg.inv(made.T_sensor_base) @ shown, rtol=0, atol=1e-9)
    assert left_out == (
        "where the base stands in the frame of the sensor",
        "the nominal flange (the chain ends at the point that was measured)",
    )
    assert arm.inertia is not None


MESH = '<visual><geometry><mesh filename="package://lite6/base.stl"/></geometry></visual>'


@pytest.fixture
def robot(tmp_path):
    """A URDF with names, meshes, efforts and a comment of its own, and joints about other axes than z."""
    path = write_urdf(LITE6, tmp_path / "robot.urdf")
    text = path.read_text()
    named = {
        'name="joint': 'name="lite6_joint',
        'effort="1000.0"': 'effort="50.0"',
        'velocity="1000.0"': 'velocity="3.14"',
        '<link name="base_link">': f'<!-- mine --><link name="base_link">{MESH}',
    }
    for before, after in named.items():
        assert before in text
        text = text.replace(before, after)
    path.write_text(text)
    return path


def test_an_existing_urdf_keeps_all_but_the_numbers(made, robot, tmp_path, capsys):
    diagnosis = stored(tmp_path, document(made, (*OFFSETS[:4], *MOVING)))
    out = tmp_path / "new.urdf"
    code, said, _ = run(capsys, "convert", diagnosis, out, "--into", robot)
    assert code == 0
    text = out.read_text()
    for kept in ("<!-- mine -->", "package://lite6/base.stl", 'effort="50.0"', 'velocity="3.14"', '"lite6_joint3"'):
        assert kept in text
    before, after = read_arm(str(robot)), read_arm(str(out))
    np.testing.assert_array_equal(after.joint_limits, before.joint_limits)
    np.testing.assert_array_equal(after.mass, before.mass)
    np.testing.assert_array_equal(after.inertia, before.inertia)
    q = positions()
    shown = predict(model_from_document(document(made, OFFSETS[:3])), q)
    np.testing.assert_allclose(pinocchio_tip(out, q), shown, rtol=0, atol=1e-9)
    assert "joint compliance at joint2" in flat(said)


def test_a_urdf_of_another_arm_is_refused(made, robot, diagnosis, tmp_path, capsys):
    robot.write_text(robot.read_text().replace('xyz="0.2 ', 'xyz="0.3 ', 1))
    message = refused(capsys, "convert", diagnosis, tmp_path / "new.urdf", "--into", robot)
    assert "which is no deviation of one arm; give the URDF of the description that was diagnosed" in message
    message = refused(capsys, "convert", diagnosis, tmp_path / "new.xml", "--into", robot, "--to", "mjcf")
    assert "--into writes a URDF, and --to asks for mjcf" in message
    message = refused(capsys, "convert", diagnosis, tmp_path / "new.yaml", "--into", robot)
    assert "what is written into a URDF is one; let the name end in .urdf" in message


def test_the_inertia_of_an_own_arm_is_that_of_its_file(tmp_path, capsys):
    """A diagnosis of poses holds none: it is from the file that the recording's sidecar names, or from --arm."""
    pytest.importorskip("mujoco")
    made = Made(tmp_path, seed=2)
    described = write_arm(replace(LITE6, name="mine", dh=None), tmp_path / "mine.yaml")
    recording = simulate(LITE6, samples=10)
    settings = replace(recording.settings, arm="mine.yaml")
    run7 = write_recording(replace(recording, settings=settings), tmp_path / "run7.csv")
    found = document(made, MOVING)
    found = {**found, "model": {**found["model"], "arm": "mine"}, "inputs": list_inputs(run7)}
    diagnosis = stored(tmp_path, found)
    assert run(capsys, "convert", diagnosis, tmp_path / "arm.xml")[0] == 0
    np.testing.assert_allclose(read_arm(str(tmp_path / "arm.xml")).mass, LITE6.mass, rtol=1e-12)
    described.write_text(described.read_text() + "# another file now\n")
    message = refused(capsys, "convert", diagnosis, tmp_path / "other.xml")
    assert "a diagnosis of poses lacks; add --arm with the URDF, MJCF or description of mine that has them" in message
    assert run(capsys, "convert", diagnosis, tmp_path / "other.xml", "--arm", described)[0] == 0
    run7.unlink()
    assert "add --arm" in refused(capsys, "convert", diagnosis, tmp_path / "third.xml")
