"""The filter, and torques as an estimation problem."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from domains.torque.moved import hidden, motion_of, recorded, setup_of
from scipy.signal import lfilter

from lite6jax.arms.dynamics import link_parameters
from lite6jax.diagnosis.torque_diagnosis import linearised, with_likely_prior
from lite6jax.domains.torque.filtering import low_pass, runs_of, sample_rate, spikes, without_spikes
from lite6jax.domains.torque.problem import torque_problem, uncertain
from lite6jax.domains.torque.rows import bodies_of, torque_rows
from lite6jax.effects.dynamic import (
    CoulombFriction,
    CoupledFriction,
    Delaying,
    LinkCom,
    LinkMass,
    PayloadBody,
    StribeckFriction,
    TorqueLag,
    TorqueRipple,
    TorqueScale,
    TorqueTimeOffset,
    ViscousFriction,
    direction,
)
from lite6jax.errors import InputError
from lite6jax.estimation.least_squares import fit
from lite6jax.estimation.noise import Autocorrelation, NoiseModel
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import Recording


def processes_of(problem):
    """One of every kind: kernels of one driver and of two, at several joints."""
    of = {one.driver.phrase: one for one in problem.quantities}
    tried = (
        (0, ("velocity of joint 1",), "rough"),
        (1, ("position of joint 2", "direction of motion of joint 2"), "medium*line"),
        (1, ("gravity torque of joint 2",), "smooth"),
        (2, ("travel since reversal of joint 3", "direction of motion of joint 3"), "rough*line"),
        (3, ("position of joint 3",), "wave"),
        (4, ("position of joint 5",), "play"),
        (5, ("time",), "line"),
    )
    return [problem.process(problem.components[j], [of[phrase] for phrase in own], kernel, 0.3)
            for j, own, kernel in tried]  # fmt: skip


def plain(time, run=None):
    q = np.sin(time)[:, None] * np.ones(2)
    return Recording.from_arrays(q, time=time, joint_velocity=q, run=run, motion="trajectory")


def test_a_uniform_rate_passes_and_gaps_begin_runs():
    time = np.delete(np.arange(300) / 100, np.s_[120:140])
    recording = plain(time)
    assert sample_rate(recording) == pytest.approx(100)
    runs = runs_of(recording, 100)
    assert np.flatnonzero(np.diff(runs)).tolist() == [119]


@pytest.mark.parametrize(
    ("time", "message"),
    [
        (np.cumsum(np.random.default_rng(0).exponential(0.01, 300)), "its time steps vary.*record at a constant rate"),
        (
            np.repeat(np.arange(30.0), 10),
            "its 300 rows have only 30 different times; write the times with all their digits",
        ),
        (np.arange(20) / 100, "20 rows are too few; record a motion of some seconds"),
    ],
)
def test_times_that_cannot_be_filtered(time, message):
    with pytest.raises(InputError, match=message):
        sample_rate(plain(time))


def test_torques_without_times():
    with pytest.raises(InputError, match="has torques without times; add time_s"):
        sample_rate(Recording.from_arrays(np.zeros((50, 2)), joint_velocity=np.zeros((50, 2)), motion="trajectory"))


def test_the_low_pass_keeps_what_is_slow_without_shift_and_removes_what_is_fast():
    t = np.arange(4000) / 200
    slow, fast = np.sin(2 * np.pi * 0.5 * t), np.sin(2 * np.pi * 60 * t)
    chosen = low_pass(np.stack([slow, slow]), 200.0, np.zeros(len(t), int))
    assert chosen.cutoff == 100 / chosen.every
    assert 16 <= chosen.cutoff < 32  # 32 bandwidths
    assert np.abs(chosen((slow + fast)[None])[0] - slow[chosen.kept])[5:-5].max() < 1e-3


def test_white_noise_stays_white_of_one_part_in_so_many():
    rng = np.random.default_rng(2)
    t = np.arange(40000) / 200
    noise = rng.normal(0, 1, (4, len(t)))
    chosen = low_pass(np.sin(2 * np.pi * 0.4 * t)[None], 200.0, np.zeros(len(t), int))
    kept = chosen(noise)
    assert kept.std() * np.sqrt(chosen.every) == pytest.approx(0.93, abs=0.05)
    neighbours = np.mean(kept[:, 1:] * kept[:, :-1]) / np.mean(kept**2)
    assert abs(neighbours) < 0.12


def test_torques_of_a_fast_recording_are_modelled_at_a_few_rows_for_each_one_that_is_kept():
    recording, arm = recorded(seed=5, velocity_noise=1e-4, rate=1000.0)
    data = torque_rows(recording, arm, recording.torques().T)
    every_row, recorded_filter, _ = bodies_of(recording, arm)
    assert 5 <= data.filter.every < 10
    assert len(data.rows) * recorded_filter.every < 10 * recording.samples
    np.testing.assert_array_equal(data.time, recording.time[recorded_filter.kept])
    velocity, problem = np.asarray(every_row.motion.joint_velocity), torque_problem(data)
    for effect, values, torque in (
        (ViscousFriction(2), [0.7], 0.7 * velocity[1]),
        (CoulombFriction(2), [1.0], direction(velocity[1])),
        (CoulombFriction(2, None), [1.0, 0.05], direction(velocity[1], transition=0.05)),
        (CoupledFriction(2, 1), [0.0, 1.0], direction(velocity[0] + velocity[1])),
    ):
        total = problem.torque(np.zeros(len(problem.precision)), Terms((effect,)), np.array(values))
        shown = total[1] - problem.rigid[1]
        wanted = recorded_filter(torque[None])[0]
        assert np.sqrt(np.mean((shown - wanted) ** 2)) < 5e-3


def test_accelerations_follow_those_of_the_motion_to_its_ends():
    """At the ends of a run they do not follow its first and last velocity, which are noisy."""
    motion = motion_of(setup_of(5)[0], 105)
    size = np.sqrt(np.mean(motion.ddq**2))
    ends = np.r_[:10, -10:0]
    for noise, rows, most in ((1e-3, np.s_[25:-25], 0.02 * size + 0.02), (1e-4, ends, 0.005 * size)):
        bodies, chosen, cutoff = bodies_of(*recorded(seed=5, velocity_noise=noise))
        error = (np.asarray(bodies.motion.joint_acceleration).T - motion.ddq)[rows]
        assert np.sqrt(np.mean(error**2)) < most
        assert cutoff <= 2 * chosen.cutoff


def test_single_and_double_spikes_are_found_and_a_push_is_none():
    recording, _ = recorded(seed=6)
    tau = recording.torques().T.copy()
    runs = np.zeros(tau.shape[1], int)
    assert not spikes(tau, recording.velocities().T, runs).any()
    tau[2, 50] += 15.0
    tau[4, 350] -= 4.0
    tau[2, 100:102] += (15.0, 12.0)
    tau[4, 300:302] += (-4.0, 5.0)
    tau[1, 200:205] += 15.0  # a push of a tenth of a second
    tau[3, 400:] += 15.0  # and one that stays
    found = spikes(tau, recording.velocities().T, runs)
    assert sorted(map(tuple, np.argwhere(found))) == [(2, 50), (2, 100), (2, 101), (4, 300), (4, 301), (4, 350)]
    clean = without_spikes(tau, found)
    spoiled = [50, 100, 101]
    assert np.abs(clean[2, spoiled] - recording.torques()[spoiled, 2]).max() < 1.0


@pytest.mark.parametrize("inertial", ["declared", 0.1])
def test_columns_are_the_derivatives_of_residuals(inertial):
    recording, arm = recorded([hidden("viscous_friction", "joint2", viscous_Nm_s_per_rad=0.5)], inertial=inertial)
    problem = torque_problem(torque_rows(recording, arm, recording.torques().T))
    terms = Terms((*problem.candidates, StribeckFriction(1), TorqueRipple(3), *processes_of(problem)))
    rng = np.random.default_rng(0)
    values = 0.1 * terms.typical * rng.normal(0, 1, terms.size)
    for effect, part in terms.pairs:
        if isinstance(effect, StribeckFriction | TorqueRipple):
            values[part] = (0.2, 0.1) if effect.size == 2 else (0.2, 0.1, 6.0)
        if isinstance(effect, Delaying | TorqueScale):
            values[part] = 0.0  # other effects' own columns are neither delayed nor scaled
    nuisance = np.zeros(len(problem.precision))
    columns = problem.columns(terms.terms, values)
    at = problem.residual(nuisance, terms, values)
    for effect, part in terms.pairs:
        for k, number in enumerate(effect.coordinates):
            step = np.zeros(terms.size)
            step[part.start + k] = 1e-4 * number.typical
            up, down = (problem.residual(nuisance, terms, values + sign * step) for sign in (1, -1))
            slope = (up - down) / (2e-4 * number.typical)
            column = columns[part.start + k]
            inside = slice(1, -1)  # beyond the ends of the run, torques keep their last value
            off = np.abs(slope - column)[:, inside].max()
            assert off < 1e-5 * max(np.abs(slope).max(), 1e-9), effect.label
    for k, column in enumerate(problem.nuisance_columns(terms, values)):
        step = 1e-4 * np.eye(len(nuisance))[k]
        slope = (problem.residual(nuisance + step, Terms(), np.zeros(0)) - problem.residual(nuisance, Terms(),
                 np.zeros(0))) / 1e-4  # fmt: skip
        np.testing.assert_allclose(slope, column, rtol=0, atol=1e-6 * max(np.abs(column).max(), 1.0))
    assert at.shape == (6, problem.samples)


@pytest.mark.parametrize(("inertial", "noise"), [("declared", None), (0.1, 0.7)])
def test_the_gain_alone_is_that_of_the_score(inertial, noise):
    recording, arm = recorded([hidden("viscous_friction", "joint2", viscous_Nm_s_per_rad=0.5)], inertial=inertial)
    case = torque_problem(torque_rows(recording, arm, recording.torques().T))
    model = None if noise is None else NoiseModel((Autocorrelation(noise, 0.8),) * case.rows, case.groups)
    some = fit(case, Terms((TorqueScale(3), TorqueRipple(1, 3.0))), EngineOptions(), noise=model)
    test, orders = score_test(case, some, EngineOptions()), np.array([1.0, 3.0, 20.5])
    for family in case.periodic:
        scores = test.score([family.term(float(order)) for order in orders])
        gains = test.gains(family.column, family.waves_of(orders))
        np.testing.assert_allclose(gains, [score.gain for score in scores], rtol=1e-6, atol=1e-9)


def test_what_the_description_declares_of_drives_is_part_of_the_model():
    recording, arm = recorded([hidden("viscous_friction", "joint2", viscous_Nm_s_per_rad=0.5)])
    friction = np.array([0.0, 0.5, 0.0, 0.0, 0.0, 0.0])
    term = Terms((ViscousFriction(2),))
    for declared, wanted in ((None, 0.5), (friction, 0.0), (4 * friction, -1.5)):
        case = torque_problem(torque_rows(recording, replace(arm, viscous_friction=declared), recording.torques().T))
        found = fit(case, term, EngineOptions())
        assert found.values[0] == pytest.approx(wanted, abs=4 * np.sqrt(found.covariance[0, 0]))
        lowest = 0.0 if declared is None else -declared[1]
        assert case.limits(term.terms[0])[0][0] == lowest
    assert case.limits(ViscousFriction(1))[0][0] == 0.0


def test_bodies_are_bounded_by_the_arm_that_they_belong_to():
    recording, arm = recorded(seed=7)
    case = torque_problem(torque_rows(recording, arm, recording.torques().T))
    total = float(arm.mass.sum())
    for link in range(1, 7):
        ((lightest, most),) = case.limits(LinkMass(link))
        assert lightest == -arm.mass[link - 1]
        assert min(3 * arm.mass[link - 1], total) <= most <= total
        shifts = np.array(case.limits(LinkCom(link)))
        assert (shifts[:, 0] < 0).all()
        assert (shifts[:, 1] > 0).all()
        length = np.linalg.norm(arm.kinematics[link, :3]) if link < 6 else 0.0
        assert np.ptp(shifts, axis=1).max() < length + 0.31 * arm.reach + np.abs(arm.center_of_mass[link - 1]).max()
    assert case.limits(PayloadBody())[0] == (0.0, total)


@pytest.mark.parametrize(
    "delays",
    [
        {TorqueTimeOffset(): 0.02},
        {TorqueTimeOffset(): -0.06},
        {TorqueLag(2): 0.03},
        {TorqueTimeOffset(): 0.02, TorqueLag(2): 0.03, TorqueLag(3): -0.01},
    ],
)
def test_delays_are_estimated(delays):
    recording, arm = recorded(
        [hidden(effect.name, effect.site, **{effect.coordinates[0].name: s}) for effect, s in delays.items()]
    )
    problem = torque_problem(torque_rows(recording, arm, recording.torques().T))
    found = fit(problem, Terms(tuple(delays)), EngineOptions())
    std = np.sqrt(np.diagonal(found.covariance))
    assert std.max() < 5e-4
    assert (np.abs(found.values - [*delays.values()]) < 4 * std + 1e-4).all()


def test_columns_of_delays_are_derivatives_where_torques_are_delayed_already():
    recording, arm = recorded([hidden("torque_lag", "joint2", lag_s=0.03)])
    problem = torque_problem(torque_rows(recording, arm, recording.torques().T))
    terms = Terms((TorqueTimeOffset(), TorqueLag(2), TorqueLag(5)))
    values = np.array([0.02, 0.03, -0.01])
    columns = problem.columns(terms.terms, values)
    candidate = problem.columns((TorqueLag(5),), values[2:], (Terms(terms.terms[:2]), values[:2]))
    np.testing.assert_array_equal(candidate[0], columns[2])
    for column, step in zip(columns, 1e-6 * np.eye(3), strict=True):
        up, down = (problem.residual(np.zeros(0), terms, values + sign * step) for sign in (1, -1))
        inside = slice(20, -20)  # beyond the ends of the run, torques keep their last value
        slope = (up - down)[:, inside] / 2e-6
        np.testing.assert_allclose(column[:, inside], slope, rtol=0, atol=1e-5 * np.abs(slope).max())
    assert not columns[1][[0, 2, 3, 4, 5]].any()


def test_unknown_links_are_fitted_about_the_declared_ones():
    effects = [hidden("link_mass", "link3", mass_kg=0.4)]
    recording, arm = recorded(effects, inertial="unknown")
    problem = torque_problem(torque_rows(recording, arm, recording.torques().T))
    assert problem.precision.shape == (60,)
    options = EngineOptions()
    there = linearised(with_likely_prior(problem, options), options)
    before = np.sqrt(np.mean(problem.residual(np.zeros(60), Terms(), np.zeros(0)) ** 2))
    after = np.sqrt(np.mean(there.residual(np.zeros(60), Terms(), np.zeros(0)) ** 2))
    assert after < 1.3 < before
    assert there.relative_std <= 0.1  # all but one of 60 numbers are exact


@pytest.mark.parametrize(("size", "width"), [(0.0, 0.03), (1.0, 0.03)])
def test_what_is_missing_beside_the_links_does_not_make_them_less_certain(size, width):
    """A wave of joint 2 that no friction explains is autocorrelated; inertial numbers are not to follow it."""
    q = recorded(seed=5)[0].joint_position[:, [1]]
    wave = size * np.sin(5 * q) * (np.arange(6) == 1)
    recording, arm = recorded(seed=5, inertial="unknown", change=lambda tau: tau + wave)
    there = with_likely_prior(torque_problem(torque_rows(recording, arm, recording.torques().T)), EngineOptions())
    assert there.relative_std == pytest.approx(width)


def autocorrelated(tau):
    e = np.random.default_rng(3).normal(size=tau.shape) * 2e-2
    return tau + lfilter([np.sqrt(1 - 0.9**2)], [1, -0.9], e, axis=0)


OFF = np.random.default_rng(4).normal(size=6)


@pytest.mark.parametrize(
    ("mass", "inertia", "change", "least", "most"),
    [
        # links of another arm; not 0.03, as where all but one are exact
        (np.array([0.4, 2.0, 0.5, 2.5, 0.4, 2.0]), np.full(6, 2.0), None, 0.1, 1.0),
        # between those of the grid: half the true width leaves weight of the links, which looks like ripple of order 1
        (1 + 0.1 * OFF, 1 + 0.1 * OFF, None, 0.035, 0.09),
        # noise with a coefficient of 0.9 does not make links more certain: a narrower prior would leave their weight
        (1 + 0.2 * OFF, 1 + 0.2 * OFF, autocorrelated, 0.1, 1.0),
    ],
)
def test_links_are_as_uncertain_as_they_are_off(mass, inertia, change, least, most):
    recording, arm = recorded(seed=5, inertial="unknown", change=change)
    other = replace(arm, mass=arm.mass * mass, inertia=arm.inertia * inertia[:, None, None])
    there = with_likely_prior(torque_problem(torque_rows(recording, other, recording.torques().T)), EngineOptions())
    assert least <= there.relative_std <= most


def test_a_heavier_link_has_larger_moments():
    """What is uncertain is each link's mass, centre and tensor: random draws of these have the prior's covariance."""
    _, arm = setup_of(3)
    links = np.asarray(link_parameters(arm))
    directions, deviations = uncertain(links, 0.01)
    prior = np.einsum("nja,nkb,n->jakb", directions, directions, deviations**2).reshape(links.size, -1)
    rng, draws = np.random.default_rng(0), []
    mass, center, inertia = np.asarray(arm.mass), np.asarray(arm.center_of_mass), np.asarray(arm.inertia)
    lever = np.linalg.norm(center, axis=1)
    lever = np.maximum(lever, lever.mean())
    for _ in range(4000):
        m = mass * (1 + 0.01 * rng.normal(size=len(mass)))
        c = center + 0.01 * lever[:, None] * rng.normal(size=center.shape)
        shifted = np.einsum("jk,jk,ab->jab", c, c, np.eye(3)) - np.einsum("ja,jb->jab", c, c)
        tensor = inertia + m[:, None, None] * shifted
        six = tensor[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        draws.append(np.concatenate([m[:, None], m[:, None] * c, six], 1).ravel() - links.ravel())
    drawn = np.cov(np.array(draws).T)
    first = (10 * np.arange(len(mass))[:, None] + np.arange(4)).ravel()  # tensors have a share of their own
    scale = np.sqrt(np.diagonal(prior))[first]
    np.testing.assert_allclose((drawn - prior)[np.ix_(first, first)] / np.outer(scale, scale), 0, atol=0.08)


@pytest.mark.parametrize("inertial", ["declared", "unknown"])
def test_another_process_finds_the_same_in_a_problem_that_this_one_works_on(inertial):
    rubs = hidden("viscous_friction", "joint2", viscous_Nm_s_per_rad=2.0)
    recording, arm = recorded((rubs,), inertial=inertial)
    here = torque_problem(torque_rows(recording, arm, recording.torques().T))
    cached = here.periodic, here.components, here.quantities, here.dynamics
    assert all(cached)

    def gains(problem):
        test = score_test(problem, fit(problem, Terms(), EngineOptions()), EngineOptions())
        return [one.gain for one in test.score(problem.candidates)]

    found = gains(here)
    assert here.known.units
    there = pickle.loads(pickle.dumps(here))
    assert not there.known.units
    assert gains(there) == found


def test_what_a_search_sees_of_a_process_are_its_columns():
    recording, arm = recorded(seed=3, warming=True)
    problem = torque_problem(torque_rows(recording, arm, recording.torques().T)).thinned(2)
    place = {one.driver.phrase: one for one in problem.quantities}
    for term in processes_of(problem):
        component = problem.components[term.joint - 1]
        own = np.stack([place[driver.phrase].values for driver in term.drivers])
        seen = problem.seen(np.asarray(term.functions_at(own, problem.every_run)))
        np.testing.assert_allclose(seen[:, None] * component.column, problem.columns([term]), rtol=0, atol=1e-9)
        assert component.site == term.site


def test_the_quantities_are_those_that_vary_each_with_the_joint_whose_own_it_is():
    recording, arm = recorded(seed=3)
    problem = torque_problem(torque_rows(recording, arm, recording.torques().T))
    found = {one.driver.phrase: one for one in problem.quantities}
    of_joint = ("position", "velocity", "speed", "direction of motion", "gravity torque", "travel since reversal")
    # the first joint of an upright arm carries no load
    wanted = {f"{what} of joint {j}" for what in of_joint for j in range(1, 7)} - {"gravity torque of joint 1"}
    assert set(found) - {"gravity torque of joint 1"} == {*wanted, "time"}
    assert found["position of joint 3"].own == {"joint3"}
    assert found["time"].own == {""}
    assert {one.driver.generalised for one in found.values() if one.only} == {"speed", "travel since reversal"}
    assert all(len(one.values) == problem.every_run.shape[1] for one in found.values())
    warming, _ = recorded(seed=3, warming=True)
    temperatures = torque_problem(torque_rows(warming, arm, warming.torques().T)).quantities
    assert {"temperature of joint 2", "temperature rise"} & {one.driver.phrase for one in temperatures}
