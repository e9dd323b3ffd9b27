"""Null spaces known by hand, ranks known by theory, and words that say them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from lite6jax import fit_fleet
from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import HayatiForm, hayati_fk
from lite6jax.arms.description import load_bundled
from lite6jax.design.determination import observability
from lite6jax.design.identify import determine
from lite6jax.design.information import Experiment, plan_experiment
from lite6jax.sensors.usual import SENSORS, plan_sensor
from tests.oracles.arms import perturbed, random_kinematics, random_positions
from tests.oracles.transforms import perturb_poses

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


def test_planar_arms_by_hand():
    """p = (l1 cos q1 + l2 cos q12, l1 sin q1 + l2 sin q12, 0), and z felt by tilts only.

    Both joints' heights do the same. With e(a) = (−sin a, cos a): yaw 1 moves p by l1 e(q1) + l2 e(q12), yaw 2 by
    l2 e(q12), and y of joint 2 by e(q1): so yaw 2 is yaw 1 less l1 times that y.
    """
    setup = plan_experiment(planar(0.3, 0.2), "tracker", chain="six_parameter", frame=False)
    found = determine(setup, random_positions(np.random.default_rng(0), 30, 2))
    assert found.rank == 10
    assert dependencies(found) == {"joint2_z": {"joint1_z": -1}, "joint2_yaw": {"joint1_yaw": -1, "joint2_y": 0.3}}
    assert [d.statement for d in found.dependencies] == [
        "joint2_z and joint1_z move together: joint2_z +1 mm is undone by joint1_z −1 mm.",
        "joint2_yaw, joint2_y and joint1_yaw move together: joint2_yaw +1 deg is undone by joint2_y +5.24 mm, "
        "joint1_yaw −1 deg.",
    ]
    assert [b.statement for b in found.base if len(b.terms) > 1] == [
        "joint1_z + joint2_z",
        "joint1_yaw + joint2_yaw",
        "joint2_y − 5.24 mm/deg joint2_yaw",
    ]
    setup = plan_experiment(planar(0.3, 0.25, 0.2), "tracker", chain="six_parameter", frame=False)
    found = determine(setup, random_positions(np.random.default_rng(0), 40, 3))
    assert found.rank == 14
    assert dependencies(found) == {
        "joint2_z": {"joint1_z": -1},
        "joint3_z": {"joint1_z": -1},
        "joint2_yaw": {"joint1_yaw": -1, "joint2_y": 0.3},
        "joint3_yaw": {"joint1_yaw": -1, "joint2_y": 0.3, "joint3_y": 0.25},
    }


def count(form, quantity, on_last_axis=False):
    """How many parameters the best poses determine of a generic arm of revolute joints, by counting.

    By the product of exponentials a chain is its joints' axes, 4 numbers each, and the flange's pose, 6 (R. Brockett,
    1984; B. Mooring, Z. Roth, M. Driels, Fundamentals of Manipulator Calibration, 1991). A chain without a free tool
    has a flange that its last axis carries in a set way: 4 n + 4 of Hayati's, 4 n + 2 of six parameters. Positions
    depend on the flange's pose through the point (3) only, of six parameters on that axis through none of its three
    numbers; one axis or one distance leaves three motions of the whole arm unobservable.
    """
    axes, hayati = 4 * form.chain.dof, isinstance(form.chain, HayatiForm)
    if quantity == "pose":
        return axes + (6 if form.tool else 4 if hayati else 2)
    observable = axes + 3 if form.tool or hayati else axes - 1 if on_last_axis else axes + 2
    return observable if quantity == "position" else observable - 3


@pytest.mark.long
@pytest.mark.parametrize(
    ("dof", "quantity"), [(4, "pose"), (7, "position"), (4, "axis"), (7, "distance"), (6, "position")]
)
def test_theory_counts_what_random_arms_show(dof, quantity):
    """The published counts, by rank, on arms in general position seen by sensors in general position."""
    sensor = plan_sensor(
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
            assert determine(setup, q).rank == count(setup.form, quantity, not tool), (chain, frame, tool)


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


@pytest.mark.parametrize(
    "setup",
    [
        plan_experiment("lite6", "tracker_6d", tool=True),
        plan_experiment("lite6", "tracker", tool=True, tool_at=(0.05, 0.0, 0.05)),
        plan_experiment("lite6", "tracker_6d", chain="six_parameter", frame=False),
        plan_experiment("lite6", "ball_bar", tool=True),
        plan_experiment("lite6", "tracker_6d", frame=False),
    ],
    ids=["pose", "position", "six_parameter", "distance", "all determined"],
)
def test_what_is_said_of_parameters_is_what_readings_show(setup):
    found = determine(setup, joints(60))
    rows = setup.rows(joints(60)).reshape(-1, setup.size) / setup.unit
    size = np.linalg.norm(rows)
    place = {name: i for i, name in enumerate(setup.names)}
    # each dependency, held parameter and partners together, changes no reading
    assert len(found.dependencies) == setup.size - found.rank
    for dependency in found.dependencies:
        step = np.zeros(setup.size)
        step[place[dependency.name]] = 1.0
        for name, _, share in dependency.partners:
            step[place[name]] = share
        assert np.linalg.norm(rows @ step) < 1e-9 * size
    # a step of the held parameters is the same to every reading as that of the base parameters it adds to
    step, same = np.where(found.free, 0, np.random.default_rng(0).normal(size=setup.size)), np.zeros(setup.size)
    for base in found.base:
        same[place[base.name]] = sum(factor * step[place[name]] for name, factor in base.terms)
    np.testing.assert_allclose(rows @ step, rows @ same, rtol=0, atol=1e-9 * size)
    # the open directions are all directions that no reading shows
    count = setup.size - found.rank
    assert found.open_directions.shape == (setup.size, count)
    np.testing.assert_allclose(found.open_directions.T @ found.open_directions, np.eye(count), atol=1e-12)
    assert np.linalg.norm(rows * setup.unit @ found.open_directions) < 1e-9 * np.linalg.norm(rows * setup.unit)
    # the covariance is the inverse of the information
    free = np.flatnonzero(found.free)
    information = rows[:, free].T @ rows[:, free]
    np.testing.assert_allclose(found.covariance[np.ix_(free, free)] @ information, np.eye(len(free)), atol=1e-7)
    np.testing.assert_allclose(np.diagonal(found.correlation)[free], 1.0, rtol=1e-12)
    if not count:
        singular = found.singular_values
        assert singular[0] / singular[-1] == pytest.approx(np.linalg.cond(rows * setup.unit), rel=1e-9)


def test_what_is_known_beforehand_decides_what_readings_cannot():
    form = plan_experiment("lite6", "tracker_6d", chain="six_parameter", frame=False).form
    model = plan_experiment("lite6", "tracker_6d", chain="six_parameter", frame=False).model
    sigma = np.array([1e-4 if unit == "m" else 1e-3 for unit in form.units])
    setup = Experiment(LITE6, form, model, SENSORS["tracker_6d"], precision=1 / sigma**2)
    found = determine(setup, joints(60))
    assert found.rank == 25
    assert found.free.all()
    assert (found.standard_deviation <= sigma * (1 + 1e-9)).all()
    rows = setup.rows(joints(60)).reshape(-1, 36) / setup.unit
    want = np.linalg.inv(rows.T @ rows + np.diag(1 / sigma**2))
    np.testing.assert_allclose(found.covariance, want, rtol=0, atol=1e-6 * np.abs(want).max())


# ------------------------------------------------------------------ observability indices


def test_indices_by_hand():
    found = observability([4.0, 2.0, 1.0], samples=4)
    assert (found.O2, found.O3, found.O4, found.condition, found.noise_amplification) == (0.25, 1, 0.25, 4, 1)
    assert pytest.approx((4 * 2 * 1) ** (1 / 3) / 2) == found.O1
    assert pytest.approx(1 / (1 / 4 + 1 / 2 + 1)) == found.O5


def test_the_fleet_fit_spreads_as_predicted():
    """The Cramér–Rao bound is met by the fit, on noise made in plain NumPy."""
    setup = plan_experiment("lite6", "tracker_6d", frame=False)
    q = random_positions(np.random.default_rng(0), 30, 6)
    predicted = determine(setup, q).standard_deviation
    rng = np.random.default_rng(3)
    true = LITE6.hayati + rng.normal(0, 5e-4, 28)
    poses = np.asarray(hayati_fk(LITE6.form, true, q))
    readings = np.stack([perturb_poses(rng, poses, 2e-5, 1e-4) for _ in range(200)])
    fits = fit_fleet(q, readings, nominal=LITE6, noise=(2e-5, 1e-4))
    ratio2 = np.mean((fits.parameters - true) ** 2, 0) / predicted**2
    each = 1e-4 / 28
    assert (200 * ratio2 > chi2.ppf(each, 200)).all()
    assert (200 * ratio2 < chi2.ppf(1 - each, 200)).all()
