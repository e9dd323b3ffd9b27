"""What motions determine of base parameters and friction, against Pinocchio's regressor and plain least squares."""

import re

import numpy as np
import pytest
from domains.torque import slid

from lite6jax.arms.arm import Arm
from lite6jax.arms.description import load_bundled, write_arm
from lite6jax.cli import main
from lite6jax.design.motions import Motion
from lite6jax.design.torques import identify_torques, torque_model
from lite6jax.errors import InputError
from lite6jax.report.study import torque_identification_report
from tests.oracles.arms import random_kinematics
from tests.oracles.pinocchio_dynamics import pinocchio_model, pinocchio_regressor

GRAVITY = (0.0, 0.0, -9.81)
PLANAR = np.array([[0.0, 0, 0, 0, 0, 0], [0.4, 0, 0, 0, 0, 0], [0.3, 0, 0, 0, 0, 0]])


def random_states(dof, samples=200, seed=1):
    return Motion(*(2 * np.random.default_rng(seed).standard_normal((3, dof, samples))))


def oracle(kinematics, motion, gravity=GRAVITY):
    """Pinocchio's regressor `(joint · sample, 10 joint)`, joint after joint."""
    dof = len(kinematics)
    model = pinocchio_model(kinematics, np.ones(dof), np.zeros((dof, 3)), np.tile(np.eye(3), (dof, 1, 1)), gravity)
    return pinocchio_regressor(model, *motion).transpose(0, 2, 1).reshape(-1, 10 * dof)


def with_friction(kinematics, motion, gravity=GRAVITY):
    """The same with viscous, Coulomb, offset and rotor columns of each joint, written out."""
    dof, samples = motion.q.shape
    joints = np.zeros((dof, samples, dof, 4))
    for i in range(dof):
        joints[i, :, i] = np.stack([motion.dq[i], np.sign(motion.dq[i]), np.ones(samples), motion.ddq[i]], 1)
    return np.hstack([oracle(kinematics, motion, gravity), joints.reshape(dof * samples, -1)])


def chain(dof, seed=0):
    return random_kinematics(np.random.default_rng(seed), dof)


@pytest.mark.parametrize(
    ("kinematics", "gravity", "known"),
    [
        (load_bundled("lite6").kinematics, GRAVITY, 36),
        (load_bundled("xarm7").kinematics, GRAVITY, 43),
        (chain(3), GRAVITY, None),
        (PLANAR, GRAVITY, 7),  # gravity along the axes: Izz, m·cx, m·cy of each link, but m·c of the first
        (PLANAR, (0.0, -9.81, 0.0), 9),
    ],
    ids=["lite6", "xarm7", "3R", "planar along gravity", "planar across gravity"],
)
def test_the_number_of_base_parameters(kinematics, gravity, known):
    found = torque_model(Arm("an arm", kinematics), gravity=gravity)
    rank = np.linalg.matrix_rank(oracle(kinematics, random_states(len(kinematics)), gravity), rtol=1e-9)
    assert sum(item.name.startswith("link") for item in found.base) == rank
    if known is not None:
        assert rank == known
    with_joints = with_friction(kinematics, random_states(len(kinematics)), gravity)
    assert len(found.base) == np.linalg.matrix_rank(with_joints, rtol=1e-9)


def test_base_parameters_give_all_torques():
    """What the words say is the whole truth: torques of any link parameters follow from the combinations alone."""
    kinematics, motion = load_bundled("lite6").kinematics, random_states(6, 60)
    model = torque_model(Arm("an arm", kinematics))
    found = model
    x = np.random.default_rng(3).standard_normal(len(model.names))
    place = {name: i for i, name in enumerate(model.names)}
    beta = np.array([sum(factor * x[place[name]] for name, factor in item.terms) for item in found.base])
    W = with_friction(kinematics, motion)
    np.testing.assert_allclose(W[:, found.possible.free] @ beta, W @ x, atol=1e-8)


def test_standard_deviations_are_those_of_least_squares():
    kinematics, noise = chain(2), np.array([0.3, 0.05])
    motion = random_states(2, 150)
    found = identify_torques(torque_model(Arm("an arm", kinematics), noise), motion)
    W = with_friction(kinematics, motion)[:, found.model.possible.free]
    sigma = np.repeat(noise, motion.q.shape[1])
    draws = np.random.default_rng(5).standard_normal((len(W), 4000))
    spread = np.linalg.lstsq(W / sigma[:, None], draws, rcond=None)[0].std(1)
    np.testing.assert_allclose(found.standard_deviation, spread, rtol=0.06)
    scaled = W / sigma[:, None] * found.model.base_scale
    assert found.condition == pytest.approx(np.linalg.cond(scaled), rel=1e-3)
    assert found.log_determinant == pytest.approx(np.linalg.slogdet(scaled.T @ scaled)[1], rel=1e-3)


def test_a_joint_that_does_not_move():
    motion = random_states(3)
    motion.q[2], motion.dq[2], motion.ddq[2] = 0.3, 0.0, 0.0
    kinematics = chain(3)
    found = identify_torques(torque_model(Arm("an arm", kinematics)), motion)
    W = with_friction(kinematics, motion)[:, found.model.possible.free]
    # a number is determined where its unit vector lies in the row space
    rows = np.linalg.svd(W, full_matrices=False)
    kept = rows[2][rows[1] > 1e-9 * rows[1][0]]
    expected = np.linalg.norm(kept.T @ kept - np.eye(W.shape[1]), axis=1) < 1e-6
    np.testing.assert_array_equal(found.determined, expected)
    assert 0 < found.determined.sum() < len(found.model.base)
    assert found.narrow() == [(2, 0.0)]
    assert "joint3 viscous" not in found.deviations
    assert found.deviations["joint2 viscous"] > 0
    assert np.isneginf(found.log_determinant)
    assert np.isinf(found.standard_deviation[~found.determined]).all()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"motion": Motion(*np.zeros((3, 2, 90)))}, "motion: q has the shape (2, 90); an arm takes (3, sample)"),
        ({"motion": Motion(*np.full((3, 3, 90), np.nan))}, "motion: q has a number that is not finite"),
        ({"noise": 0.0}, "torque noise 0 Nm: give one standard deviation above 0"),
        ({"gravity": (0, 0)}, "gravity [0, 0]: give three finite numbers in m/s²"),
    ],
)
def test_what_is_refused(change, says):
    given = {"noise": 0.1, "gravity": GRAVITY, "motion": random_states(3)} | change
    with pytest.raises(InputError, match=re.escape(says)):
        identify_torques(torque_model(Arm("an arm", chain(3)), given["noise"], given["gravity"]), given["motion"])


def test_a_study_of_a_slide_has_its_units(tmp_path, capsys):
    arm = str(write_arm(slid.arm(), tmp_path / "telescope.yaml"))
    assert main(["identify", arm, "--torque"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "±0.05 Nm, 0.05 Nm, 0.5 N (one standard deviation" in said
    assert "of prismatic joints, P: N·s/m, N, N, kg" in said
    assert "J3 P " in said
    model = torque_model(slid.arm())
    units = {item.name: item.unit for item in model.base}
    names = ("joint3 viscous", "joint3 rotor inertia", "joint2 Coulomb")
    assert [units[name] for name in names] == ["N·s/m", "kg", "Nm"]
    q, dq, ddq = slid.moved(seconds=4.0)[1:]
    few = identify_torques(model, Motion(*(part.T * [[1], [1], [0.04]] for part in (q, dq, ddq))))
    assert few.narrow() == [(2, pytest.approx(0.04 * np.ptp(q[:, 2])))]
    assert "No joint" not in " ".join(str(part) for part in torque_identification_report(few, "a", "b"))
