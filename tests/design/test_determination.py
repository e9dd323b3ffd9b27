"""Null spaces known by hand, ranks known by theory, and words that say them."""

from dataclasses import replace

import numpy as np
import pytest

from lite6jax.arms.arm import Arm
from lite6jax.arms.bundled import load_bundled
from lite6jax.design.determination import count, determination_of, determine
from lite6jax.design.identify import identify
from lite6jax.design.information import Experiment, experiment, plan_experiment
from lite6jax.design.sensor import SENSORS, Sensor
from tests.oracles.arms import perturbed, random_kinematics, random_positions

LITE6 = load_bundled("lite6")


def planar(*lengths):
    """An arm of parallel joints with links of these lengths along x."""
    kinematics = np.zeros((len(lengths), 6))
    kinematics[1:, 0] = lengths[:-1]
    flange = np.eye(4)
    flange[0, 3] = lengths[-1]
    return Arm(f"planar {len(lengths)}R", kinematics, T_joint_flange=flange)


def dependencies(found):
    return {d.name: {name: pytest.approx(share, rel=1e-9) for name, _, share in d.partners} for d in found.dependencies}


def test_planar_2r_by_hand():
    """p = (l1 cos q1 + l2 cos q12, l1 sin q1 + l2 sin q12, 0), and z felt by tilts only.

    Both joints' heights do the same. With e(a) = (−sin a, cos a): yaw 1 moves p by l1 e(q1) + l2 e(q12), yaw 2 by
    l2 e(q12), and y of joint 2 by e(q1): so yaw 2 is yaw 1 less l1 times that y.
    """
    setup = plan_experiment(planar(0.3, 0.2), "tracker", chain="six_parameter", frame=False)
    found = determine(setup, random_positions(np.random.default_rng(0), 30, 2))
    assert found.rank == 10
    assert dependencies(found) == {
        "joint2_z": {"joint1_z": -1},
        "joint2_yaw": {"joint1_yaw": -1, "joint2_y": 0.3},
    }
    assert [d.statement for d in found.dependencies] == [
        "joint2_z and joint1_z move together: joint2_z +1 mm is undone by joint1_z −1 mm.",
        "joint2_yaw, joint2_y and joint1_yaw move together: joint2_yaw +1 deg is undone by joint2_y +5.24 mm, "
        "joint1_yaw −1 deg.",
    ]
    assert [b.statement for b in found.base] == [
        "joint1_z + joint2_z",
        "joint1_yaw + joint2_yaw",
        "joint2_y − 5.24 mm/deg joint2_yaw",
    ]


def test_planar_3r_by_hand():
    setup = plan_experiment(planar(0.3, 0.25, 0.2), "tracker", chain="six_parameter", frame=False)
    found = determine(setup, random_positions(np.random.default_rng(0), 40, 3))
    assert found.rank == 14
    assert dependencies(found) == {
        "joint2_z": {"joint1_z": -1},
        "joint3_z": {"joint1_z": -1},
        "joint2_yaw": {"joint1_yaw": -1, "joint2_y": 0.3},
        "joint3_yaw": {"joint1_yaw": -1, "joint2_y": 0.3, "joint3_y": 0.25},
    }


def test_a_joint_that_stands_still_tells_less():
    """With q2 = 0 the arm is one link: of joint 2 nothing is told apart from joint 1 but along the circle it draws."""
    setup = plan_experiment(planar(0.3, 0.2), "tracker", chain="six_parameter", frame=False)
    q = random_positions(np.random.default_rng(0), 30, 2)
    q[:, 1] = 0.0
    found = determine(setup, q)
    # z = const, sin q1, cos q1; in the plane: const x, const y, radius and angle
    assert found.rank == 7
    study = identify(setup, q)
    assert study.missed == 3
    assert study.narrow() == [(1, 0.0)]


@pytest.mark.long
@pytest.mark.parametrize(
    ("dof", "quantity"), [(4, "pose"), (7, "position"), (4, "axis"), (7, "distance"), (6, "position")]
)
def test_theory_counts_what_random_arms_show(dof, quantity):
    """The published counts, by rank, on arms in general position seen by sensors in general position."""
    sensor = Sensor(
        quantity, 1e-5, 1e-4 if quantity == "pose" else None, direction=(1.0, -2.0, 3.0), center=(0.7, 0.1, -0.4)
    )
    rng = np.random.default_rng(dof)
    kinematics = random_kinematics(rng, dof)
    kinematics[0, 3:5] *= 0.1  # Hayati's base needs joint 1 upright
    arm = Arm("random", kinematics)
    q = random_positions(rng, 300, dof)
    for chain in ("hayati", "six_parameter"):
        for frame, tool in ((False, False), (True, False), (True, True)):
            setup = plan_experiment(
                arm, sensor, chain=chain, frame=frame, tool=tool, tool_at=(0.1, 0.05, 0.2) if tool else (0.0, 0.0, 0.0)
            )
            values = np.array(setup.model.geometry)
            if chain == "hayati":  # a flange off the last axis
                values = values + rng.normal(0, 0.05, values.shape)
            setup = replace(setup, model=setup.model._replace(geometry=values))
            found = determine(setup, q)
            assert found.rank == found.theory, (chain, frame, tool, off)
            if chain == "hayati" or tool:
                assert found.theory == count(setup.form, quantity)


def test_the_published_counts():
    assert determine(plan_experiment("lite6", "tracker_6d", tool=True), joints(60)).rank == 30
    assert determine(plan_experiment("lite6", "tracker_6d", frame=False), joints(60)).rank == 28
    calibrated = replace(LITE6, kinematics=perturbed(np.random.default_rng(0), LITE6.kinematics), dh=None)
    assert (
        determine(plan_experiment(calibrated, "tracker_6d", chain="six_parameter", frame=False), joints(60)).rank == 26
    )


def joints(samples, seed=4):
    lower, upper = LITE6.joint_limits.T
    return np.random.default_rng(seed).uniform(lower, upper, (samples, 6))


def test_every_dependency_changes_no_reading():
    """By a finite step along each direction, held parameter and partners together, on the plain experiment."""
    for setup in (
        plan_experiment("lite6", "tracker_6d", tool=True),
        plan_experiment("lite6", "tracker"),
        plan_experiment("lite6", "tracker_6d", chain="six_parameter", frame=False),
        plan_experiment("lite6", "ball_bar", tool=True),
    ):
        q = joints(60)
        found = determine(setup, q)
        rows = setup.rows(q).reshape(-1, setup.size) / setup.unit
        assert len(found.dependencies) == setup.size - found.rank
        for dependency in found.dependencies:
            step = np.zeros(setup.size)
            step[setup.names.index(dependency.name)] = 1.0
            for name, _, share in dependency.partners:
                step[setup.names.index(name)] = share
            assert np.linalg.norm(rows @ step) < 1e-9 * np.linalg.norm(rows)


def test_base_parameters_are_felt_alike_however_they_are_made_up():
    """A step of the held parameters is the same to every reading as that of the base parameters it adds to."""
    setup = plan_experiment("lite6", "tracker_6d", chain="six_parameter", frame=False)
    q = joints(60)
    found = determine(setup, q)
    rows = setup.rows(q).reshape(-1, setup.size) / setup.unit
    step = np.zeros(setup.size)
    held = np.flatnonzero(~found.free)
    step[held] = np.random.default_rng(0).normal(size=len(held))
    same = np.zeros(setup.size)
    for base in found.base:
        same[setup.names.index(base.name)] = sum(f * step[setup.names.index(name)] for name, f, _ in base.adds)
    np.testing.assert_allclose(rows @ step, rows @ same, rtol=0, atol=1e-9 * np.abs(rows @ step).max())


def test_covariance_is_the_inverse_information():
    setup = plan_experiment("lite6", "tracker_6d", frame=False)
    q = joints(60)
    found = determine(setup, q)
    rows = setup.rows(q).reshape(-1, 28) / setup.unit
    np.testing.assert_allclose(found.covariance @ (rows.T @ rows), np.eye(28), atol=1e-8)
    np.testing.assert_allclose(np.diagonal(found.correlation), 1.0, rtol=1e-12)
    singular = found.singular_values
    assert singular[0] / singular[-1] == pytest.approx(np.linalg.cond(rows * setup.unit), rel=1e-9)


def test_nothing_depends_on_the_units():
    """Scaling a parameter's unit (mm for m) scales its deviation and leaves rank, words and free set as they were."""
    setup = plan_experiment("lite6", "tracker", tool=True, tool_at=(0.05, 0.0, 0.05))
    q = joints(60)
    root = setup.root(q)
    want = determination_of(setup, root, 60)
    factor = np.where(np.array(setup.units) == "m", 1e3, 57.3) * np.random.default_rng(0).uniform(0.5, 2, setup.size)
    rescaled = replace(setup, scale=setup.scale * factor)
    got = determination_of(rescaled, np.linalg.qr(root * factor, mode="r"), 60)
    assert got.rank == want.rank
    np.testing.assert_array_equal(got.free, want.free)
    np.testing.assert_allclose(got.standard_deviation, want.standard_deviation, rtol=1e-6)
    assert [d.statement for d in got.dependencies] == [d.statement for d in want.dependencies]


def test_what_is_known_beforehand_decides_what_readings_cannot():
    form = plan_experiment("lite6", "tracker_6d", chain="six_parameter", frame=False).form
    model = plan_experiment("lite6", "tracker_6d", chain="six_parameter", frame=False).model
    sigma = np.array([1e-4 if unit == "m" else 1e-3 for unit in form.units])
    setup = experiment(LITE6, form, model, SENSORS["tracker_6d"], precision=1 / sigma**2)
    found = determine(setup, joints(60))
    assert found.rank == 25
    assert found.free.all()
    assert (found.standard_deviation <= sigma * (1 + 1e-9)).all()
    rows = setup.rows(joints(60)).reshape(-1, 36) / setup.unit
    want = np.linalg.inv(rows.T @ rows + np.diag(1 / sigma**2))
    np.testing.assert_allclose(found.covariance, want, rtol=0, atol=1e-6 * np.abs(want).max())


def test_what_cannot_move_is_left_out():
    full = plan_experiment("lite6", "tracker_6d")
    movable = np.arange(full.form.size) >= 28
    setup = experiment(LITE6, full.form, full.model, full.sensor, movable=movable)
    found = determine(setup, joints(60))
    assert found.names == tuple(f"frame_{t}" for t in ("x", "y", "z", "rx", "ry", "rz"))
    assert (found.rank, found.size, found.theory) == (6, 6, None)


def test_weak_parameters_are_named():
    """A sensor of 100 mm tells nothing better than assembly does."""
    setup = plan_experiment("lite6", SENSORS["tracker_6d"].with_noise(0.1, 1.0), frame=False)
    assert set(determine(setup, joints(60)).weak()) == set(setup.names)
    assert determine(plan_experiment("lite6", "tracker_6d", frame=False), joints(60)).weak() == ()


def test_correlated_pairs():
    setup = plan_experiment("lite6", "tracker", frame=False)
    pairs = determine(setup, joints(100)).correlated()
    assert ("d3", "alpha3") in [(a, b) for a, b, _ in pairs]
    assert all(abs(rho) > 0.95 for _, _, rho in pairs)


def test_an_unfelt_parameter_is_said_to_be():
    found = determine(plan_experiment("lite6", "tracker", frame=False), joints(100))
    said = {d.name: d.statement for d in found.dependencies}
    assert said["theta_off6"] == "theta_off6 is unobservable: no reading changes with it."
    assert said["a5"] == "a5 and theta_off5 move together: a5 +1 mm is undone by theta_off5 +0.932 deg."


def test_nothing_read_at_all():
    """One pose of a dial gauge across an unfelt direction: nothing but one combination is told."""
    setup = plan_experiment("lite6", "dial_gauge")
    found = determine(setup, joints(1))
    assert found.rank == 1
    assert isinstance(setup, Experiment)


def test_one_joint_moves_too_little_to_count():
    arm = Arm("one", np.zeros((1, 6)))
    assert determine(plan_experiment(arm, "tracker", chain="six_parameter"), [[0.1], [0.5], [1.0]]).theory == 3
    assert determine(plan_experiment(arm, "dial_gauge", chain="six_parameter"), [[0.1], [0.5], [1.0]]).theory is None


def test_open_directions_change_nothing_and_are_all_of_them():
    setup = plan_experiment("lite6", "tracker", tool=True, tool_at=(0.05, 0.0, 0.05))
    q = joints(60)
    found = determine(setup, q)
    assert found.open_directions.shape == (setup.size, setup.size - found.rank)
    np.testing.assert_allclose(
        found.open_directions.T @ found.open_directions, np.eye(setup.size - found.rank), atol=1e-12
    )
    rows = setup.rows(q).reshape(-1, setup.size)
    assert np.abs(rows @ found.open_directions).max() < 1e-9 * np.abs(rows).max()


def test_no_accuracy_is_promised_where_something_stays_open():
    """One pose tells 3 numbers; a dial gauge never tells x; a tracker tells all that positions depend on."""
    offset = (0.06, 0.0, 0.04)
    one = identify(plan_experiment("lite6", "tracker", tool_at=offset), joints(1))
    assert not one.accuracy.position_determined
    assert one.to_dict()["predicted_accuracy"] == {"position_rms_m": None, "orientation_rms_rad": None}
    gauge = identify(plan_experiment("lite6", "dial_gauge", tool_at=offset), joints(60))
    assert not gauge.accuracy.position_determined
    tracker = identify(plan_experiment("lite6", "tracker", tool_at=offset), joints(60))
    assert (tracker.accuracy.position_determined, tracker.accuracy.orientation_determined) == (True, False)
    full = identify(plan_experiment("lite6", "tracker_6d", tool_at=offset), joints(60))
    assert (full.accuracy.position_determined, full.accuracy.orientation_determined) == (True, True)
