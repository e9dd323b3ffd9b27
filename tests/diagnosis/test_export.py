"""The arm of a diagnosis of torques, as simulators read it."""

from dataclasses import replace
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
from diagnosis.recorded import LITE6, Made, static_motion
from domains.pose.documents import document, stored
from domains.torque.moved import GRAVITY, motion_of, setup_of
from typed import flat, refused, run

from lite6jax.arms.dynamics import base_parameters, inverse_dynamics, is_consistent, link_parameters
from lite6jax.arms.files import convert_file, read_arm, write_arm, write_urdf
from lite6jax.cli.command import list_inputs
from lite6jax.diagnosis.document import model_from_document
from lite6jax.diagnosis.export import diagnosed_arm, diagnosed_chain
from lite6jax.domains.predict import predict
from lite6jax.domains.torque.predict import DiagnosedMotors
from lite6jax.effects.catalogue import TORQUE_EFFECTS
from lite6jax.effects.dynamic import CoulombFriction, Friction, UnnamedTorque
from lite6jax.effects.effect import Coordinate, final_effect
from lite6jax.effects.serialization import parse_effect
from lite6jax.estimation.terms import Terms, join
from lite6jax.recordings import Recording, write_recording
from lite6jax.simulation import simulate
from tests.oracles.chains import six_parameter_poses
from tests.oracles.pinocchio_arm import urdf_link_pose


def model_with(*texts):
    """A Lite 6 with these effects."""
    _, arm = setup_of(2)
    pairs = [parse_effect(text, TORQUE_EFFECTS) for text in texts]
    links = np.asarray(link_parameters(arm))
    terms, values = Terms(tuple(e for e, _ in pairs)), join(v for _, v in pairs)
    return arm, DiagnosedMotors(arm, links, np.zeros(3), GRAVITY, terms, values, 25.0)


def test_friction_without_a_name_is_exported_as_far_as_simulators_hold_it():
    _, model = model_with()
    drivers = "speed of joint 2 and direction of motion of joint 2"
    curve = UnnamedTorque(2, drivers, 0.0, 1.5, "cubic*line", (-1.0, 1.0))
    # the straight line 0.4 + 0.2 |v| as such a process
    speeds, sign = np.tile(np.linspace(0.0, 1.5, 50), 2), np.repeat([-1.0, 1.0], 50)
    functions = np.asarray(curve.functions_at(np.stack([speeds, sign])))
    values = np.linalg.lstsq(functions.T, sign * (0.4 + 0.2 * speeds), rcond=None)[0]
    wide = CoulombFriction(3, 0.2)
    model = replace(model, terms=Terms((curve, wide)), values=np.concatenate([values, [0.5]]))
    found, left_out = diagnosed_arm(model)
    assert found.coulomb_friction[1] == pytest.approx(0.4, abs=0.02)
    assert found.viscous_friction[1] == pytest.approx(0.2, abs=0.02)
    assert found.coulomb_friction[2] == pytest.approx(0.5)
    assert [phrase.split(" at ")[-1] for phrase in left_out] == [
        "joint2, which its viscous and Coulomb friction leave",
        "joint3, 0.2 rad/s",
    ]


@final_effect
class CubicFriction(Friction):
    """τ += c·q̇³."""

    name: ClassVar[str] = "cubic_friction"
    quantities: ClassVar[tuple] = ("velocity",)
    numbers: ClassVar[tuple] = (Coordinate("cubic_Nm_s3_per_rad3", "Nm·s³/rad³", 0.1),)

    def at_joint(self, values, dynamics):
        return values[0] * dynamics.velocity(self.joint) ** 3


def test_a_law_of_friction_that_is_new_is_exported_without_a_change_elsewhere():
    _, model = model_with()
    recorded = SimpleNamespace(velocities=np.tile([-1.0, 1.0], (6, 1)))
    model = replace(
        model,
        terms=Terms((CubicFriction(2),)),
        values=np.array([0.5]),
        uncertainty=SimpleNamespace(recorded=recorded),
    )
    found, (phrase,) = diagnosed_arm(model)
    assert found.viscous_friction[1] == pytest.approx(0.5 * 3 / 5, rel=0.05)  # of the least squares of v³ by v
    assert "of what is cubic friction at joint2, which its viscous and Coulomb friction leave" in phrase


@pytest.mark.parametrize("suffix", [".urdf", ".xml", ".yaml"])
def test_what_was_found_stands_in_the_file(tmp_path, suffix):
    _, model = model_with(
        "viscous_friction:joint=2,viscous_Nm_s_per_rad=0.8",
        "coulomb_friction:joint=3,coulomb_Nm=0.5",
        "rotor_inertia:joint=5,inertia_kg_m2=0.02",
        "torque_offset:joint=1,offset_Nm=0.3",
        "link_mass:link=3,mass_kg=0.2",
        "joint_spring:joint=2,stiffness_Nm_per_rad=4.0,rest_rad=0.3",
        "joint_spring:joint=4,stiffness_Nm_per_rad=-0.5,rest_rad=0",
    )
    if suffix == ".xml":
        pytest.importorskip("mujoco")
    arm, left_out = diagnosed_arm(model)
    assert left_out == ("torque offset at joint1", "joint spring at joint4")  # one that pushes away is none
    done = convert_file(arm, tmp_path / f"arm{suffix}", left_out=left_out)
    again = read_arm(str(done.path))
    assert again.viscous_friction[1] == pytest.approx(0.8)
    assert again.coulomb_friction[2] == pytest.approx(0.5)
    assert again.mass[2] == pytest.approx(model.links[2, 0] + 0.2)
    np.testing.assert_allclose(again.spring_stiffness, [0, 4.0, 0, 0, 0, 0], rtol=1e-12)
    np.testing.assert_allclose(again.spring_rest, [0, 0.3, 0, 0, 0, 0], rtol=1e-12)
    phrases = {"rotor inertia", "springs, but for Gazebo's extension <gazebo reference=…>"}
    assert set(done.left_out) - set(left_out) == (phrases if suffix == ".urdf" else set())
    if suffix != ".urdf":
        assert again.rotor_inertia[4] == pytest.approx(0.02)
    assert done.difference < 1e-9


def test_the_arm_that_is_written_declares_what_was_found(tmp_path):
    """The torques of a model with effects are those of its arm, which declares them; and a second diagnosis adds up."""
    effects = (
        "viscous_friction:joint=2,viscous_Nm_s_per_rad=0.8",
        "coulomb_friction:joint=3,coulomb_Nm=0.5",
        "rotor_inertia:joint=5,inertia_kg_m2=0.02",
        "joint_spring:joint=4,stiffness_Nm_per_rad=2,rest_rad=0.3",
    )
    _, model = model_with(*effects)
    arm, left_out = diagnosed_arm(model)
    assert left_out == ()
    motion = motion_of(setup_of(2)[0], 1, rate=50.0, seconds=5.0)
    recording = Recording.from_arrays(motion.q, time=motion.time, joint_velocity=motion.dq, motion="trajectory")
    nothing = replace(model, arm=arm, terms=Terms(), values=np.zeros(0))
    declared = predict(nothing, recording)
    np.testing.assert_allclose(declared, predict(model, recording), rtol=0, atol=1e-9)
    assert np.abs(declared - predict(replace(nothing, arm=model.arm), recording)).max() > 0.5
    convert_file(arm, tmp_path / "arm.yaml")
    again = predict(replace(nothing, arm=read_arm(str(tmp_path / "arm.yaml"))), recording)
    np.testing.assert_allclose(again, declared, rtol=0, atol=1e-9)
    twice, _ = diagnosed_arm(replace(model, arm=arm))
    assert twice.viscous_friction[1] == pytest.approx(1.6)
    assert twice.coulomb_friction[2] == pytest.approx(1.0)
    assert (twice.spring_stiffness[3], twice.spring_rest[3]) == pytest.approx((4.0, 0.3))
    less, _ = diagnosed_arm(replace(model, arm=arm, values=-2 * model.values))
    assert less.viscous_friction[1] == 0.0  # no simulator takes less


def test_links_that_are_no_bodies_become_such_with_the_same_torques():
    declared, model = model_with()
    base = base_parameters(declared.kinematics, GRAVITY)
    silent = np.linalg.svd(base.basis.T)[2][base.size :]  # directions that no torque shows
    along = np.random.default_rng(0).normal(0, 1, len(silent)) @ silent
    size = next(s for s in np.geomspace(1e-3, 10, 60) if not is_consistent(model.links + s * along.reshape(-1, 10)))
    impossible = model.links + 2 * size * along.reshape(-1, 10)
    arm, left_out = diagnosed_arm(replace(model, links=impossible))
    found = np.asarray(link_parameters(arm))
    assert is_consistent(found)
    assert left_out == ()
    motion = motion_of(setup_of(2)[0], 1, rate=10.0, seconds=5.0)
    asked, has = (
        np.asarray(inverse_dynamics(arm.kinematics, links, motion.q.T, motion.dq.T, motion.ddq.T, GRAVITY))
        for links in (impossible, found)
    )
    np.testing.assert_allclose(has, asked, rtol=0, atol=1e-6 * np.abs(asked).max())


# ------------------------------------------------------------------ the chain of a diagnosis of poses


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
    return np.array([*map(urdf_link_pose(path, "flange"), q)])


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
