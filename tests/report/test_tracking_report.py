"""The report of a log of commands: how a joint follows in a sentence, percentiles, and figures of held-out rollouts."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosed import Reader, found_without_search, held_out

from lite6jax.arms.arm import Arm
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.tracking_diagnosis import TrackingDiagnosis, interleaved_folds
from lite6jax.domains.tracking.problem import tracking_problem
from lite6jax.domains.tracking.screening import screen_tracking
from lite6jax.effects.dynamic import CoulombFriction
from lite6jax.effects.servo import ServoStiffness
from lite6jax.recordings.settings import ServoSettings
from lite6jax.report import tracking
from lite6jax.report.diagnosis_figures import drawings
from lite6jax.report.pages import diagnosis_page
from lite6jax.simulation import simulate_tracking

PERIOD = 0.01
SAMPLES = 1200
TIME = PERIOD * np.arange(SAMPLES)
KP = (300.0, 80.0)
KD = (12.0, 3.0)
VISCOUS = 1.0
COULOMB = 0.4
"""Nm, that joint 2 has beyond its description."""
ARM = Arm(
    "two",
    np.array([[0.0, 0.0, 0.1, 0.0, 0.0, 0.0], [0.0, 0.0, 0.2, np.pi / 2, 0.0, 0.0]]),
    mass=np.array([2.0, 1.2]),
    center_of_mass=np.array([[0.0, 0.0, 0.1], [0.15, 0.0, 0.0]]),
    inertia=np.repeat(0.01 * np.eye(3)[None], 2, 0),
    rotor_inertia=np.array([0.15, 0.05]),
    viscous_friction=np.full(2, VISCOUS),
    coulomb_friction=np.full(2, 0.2),
)
"""The first axis is upright: its joint carries no weight."""
HALF_PERIODS = (1.0, 0.8)
"""s, between two reversals of each joint."""


def swing():
    """Commands `(sample, joint)` rad that reverse after each half period, from 0.5 s on."""
    t = np.maximum(TIME - 0.5, 0.0)[:, None]
    return 0.4 * (1 - np.cos(np.pi * t / np.array(HALF_PERIODS)))


def diagnosed(effects):
    """The result of a search that adds just these effects: nothing is searched for, nor held out."""
    servo = ServoSettings(stiffness_Nm_per_rad=KP, damping_Nm_s_per_rad=KD)
    text = f"coulomb_friction:joint=2,coulomb_Nm={COULOMB}"
    log = simulate_tracking(ARM, swing(), effects=[text], servo=servo, joint_noise=5e-5, seed=1).recording
    screened = screen_tracking(log, ARM)
    problem = tracking_problem(screened.data)
    selection, findings = found_without_search(problem, effects, lambda _: ())
    fits = selection.state.baseline, selection.state.fit
    errors = held_out(*(one.residuals.rows * problem.sigma for one in fits))
    folds = tuple(interleaved_folds(problem.run))
    behind = np.asarray(screened.data.recording.commanded_position).T - problem.measured
    rest = (screened.found, (), Options(), folds, ~problem.valid)
    return TrackingDiagnosis(problem, selection, findings, errors, *rest, peers={"commanded": behind})


@pytest.fixture(scope="module")
def rubbing():
    """Of two joints, of which the second rubs more than its description says."""
    return diagnosed((CoulombFriction(2),))


@pytest.fixture(scope="module")
def document(rubbing):
    return tracking.with_statements(rubbing.to_dict())


@pytest.fixture(scope="module")
def figures(rubbing):
    return dict(drawings(rubbing, "log.csv"))


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


# ------------------------------------------------------------------ sentences and tables


def test_a_sentence_says_how_the_joint_follows_and_what_the_model_lacks(rubbing, document):
    log = rubbing.recording
    error = 1e3 * rms(log.commanded_position[:, 1] - log.joint_position[:, 1])
    remainder = 1e3 * rms(rubbing.after[1])
    lag, sag = 1e3 * (KD[1] + VISCOUS) / KP[1], 1e3 / KP[1]
    assert document["findings"][0]["parameters"]["coulomb_Nm"]["value"] == pytest.approx(COULOMB, rel=0.01)
    found = float(f"{document['findings'][0]['parameters']['coulomb_Nm']['value']:.3g}")
    assert tracking.following_statement(document) == (
        f"Joint 2 lags {lag:.3g} ms and sags {sag:.3g} mrad per Nm; of {error:.3g} mrad RMS tracking error "
        f"{remainder:.3g} is left; Coulomb friction of {found:g} Nm, which your model lacks."
    )
    assert tracking.following_statement(document) in rubbing.summary()


def test_what_another_stiffness_a_delay_and_a_simulator_are_called(document):
    stiffness = {
        "effect": "servo_stiffness",
        "site": "joint2",
        "driver": "none",
        "parameters": {"ratio": {"value": 0.80002, "std": 1e-4}},
        "moves_rms_rad": 1e-4,
        "joints": [2],
    }
    servos = [document["servos"][0], {**document["servos"][1], "delay_s": 0.0234}]
    changed = {**document, "findings": [*document["findings"], stiffness], "servos": servos, "simulator": {}}
    said = tracking.following_statement(changed)
    assert said.startswith("Joint 2 lags 50 ms after a delay of 23.4 ms and sags 12.5 mrad per Nm; of ")
    assert "Nm, which your simulator lacks; its servo stiffness is 0.8 times that of your simulator." in said
    massless = tracking.following_statement({**document, "masses": False})
    assert massless.startswith("Joint 2 lags 50 ms; of ")


def test_without_findings_nothing_is_lacking(document):
    none = {**document, "findings": [], "after": document["before"], "verdict": "unexplained"}
    said = tracking.following_statement(none)
    assert said.endswith(" is left.")
    assert "lacks" not in said


def test_the_95th_percentile_stands_beside_the_rms(rubbing, document):
    headers, rows = tracking.percentile_rows(document)
    assert headers == ["error\n(mrad)", "measured\n= commanded", "before", "after"]
    stages = (rubbing.peers["commanded"], rubbing.before, rubbing.after)
    for joint, row in enumerate(rows[:2]):
        expected = [1e3 * np.percentile(np.abs(errors[joint]), 95) for errors in stages]
        assert [float(cell) for cell in row[1:]] == pytest.approx(expected, abs=1e-4)
    assert [row[0] for row in rows] == ["joint 1", "joint 2", "all"]
    parts = dict(tracking.parts_of(document, None, False, {}))
    blocks = parts["Held-out rollouts from the commands alone"]
    assert ("table", (headers, rows)) in blocks


def test_the_page_has_the_sentence_both_tables_and_both_figures(rubbing, document, figures):
    page = Reader(diagnosis_page(rubbing, document, "log.csv", figures))
    assert tracking.following_statement(document) in page.text
    assert "95 % of rows err by no more than" in page.text
    assert sum(tag == "img" for tag, _ in page.tags) == 2
    assert "Commands, log, and rollouts from the commands alone" in page.text
    assert "over the time since it last reversed" in page.text


# ------------------------------------------------------------------ figures


def test_a_held_out_stretch_has_command_log_and_both_rollouts(rubbing, figures):
    figure = figures["over_time"]
    upper, lower = figure.axes
    assert upper.get_title() == "joint 2"  # joint 1 does not improve
    assert (upper.get_ylabel(), lower.get_ylabel()) == ("position (deg)", "rollout less log (mrad)")
    assert lower.get_xlabel() == "time (s)"
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["command", "log", "before, held out", "after, held out"]
    command, log, before, after = (np.deg2rad(line.get_ydata()) for line in upper.lines)
    rows = np.round(upper.lines[0].get_xdata() / PERIOD).astype(int)
    assert 1.0 < PERIOD * len(rows) <= 4.0
    np.testing.assert_array_equal(np.diff(rows), 1)
    assert len({rubbing.folds[0][row] for row in rows}) == 1  # one block that was held out
    np.testing.assert_allclose(command, swing()[rows, 1], atol=1e-9)
    np.testing.assert_allclose(log, rubbing.recording.joint_position[rows, 1])
    np.testing.assert_allclose(before - log, rubbing.before[1, rows], atol=1e-12)
    np.testing.assert_allclose(after - log, rubbing.after[1, rows], atol=1e-12)
    np.testing.assert_allclose(lower.lines[0].get_ydata(), 1e3 * rubbing.before[1, rows], atol=1e-9)
    velocity = np.gradient(command)
    assert velocity.min() < 0 < velocity.max()  # it reverses


def test_errors_are_drawn_over_speed_load_and_time_since_a_reversal(figures):
    panels = figures["error_over_motion"].axes
    across = ["speed (deg/s)", "torque of the weight (Nm)", "time since the last reversal (s)"]
    assert [panel.get_xlabel() for panel in panels] == 2 * across
    assert [panels[0].get_ylabel(), panels[3].get_ylabel()] == ["joint 1 (mrad RMS)", "joint 2 (mrad RMS)"]
    assert [line.get_label() for line in panels[3].lines] == ["before, held out", "after, held out"]
    # the first joint is upright
    assert panels[1].texts[0].get_text() == "does not vary, or in too few rows"
    assert not panels[1].lines
    load = panels[4].lines[0].get_xdata()
    most = 9.81 * 1.2 * 0.15
    assert np.abs(load).max() == pytest.approx(most, rel=0.05)
    assert panels[5].lines[0].get_xdata().max() < HALF_PERIODS[1] + 0.1


def drawn_errors(rubbing, errors):
    """What is drawn over speed, load and time since a reversal of joint 2 where these errors `(sample,)` are left."""
    both = np.stack([errors, errors])
    panels = dict(drawings(replace(rubbing, errors=held_out(both, both)), "log.csv"))["error_over_motion"].axes
    return [(panel.lines[0].get_xdata(), panel.lines[0].get_ydata()) for panel in panels[3:]]


def test_an_error_that_grows_with_speed_is_drawn_so(rubbing):
    smooth = np.convolve(np.pad(rubbing.recording.joint_position[:, 1], 5, mode="edge"), np.ones(11) / 11, "valid")
    speed, error = drawn_errors(rubbing, 1e-3 * np.gradient(smooth, PERIOD))[0]
    fast = speed > 10
    assert fast.sum() > 5
    np.testing.assert_allclose(error[fast], np.deg2rad(speed[fast]), rtol=0.1)


def test_an_error_that_grows_with_the_load_is_drawn_so(rubbing):
    torque = 9.81 * 1.2 * 0.15 * np.cos(rubbing.recording.joint_position[:, 1])
    load, error = drawn_errors(rubbing, 1e-3 * torque)[1]
    np.testing.assert_allclose(error, np.abs(load), rtol=0.05, atol=0.02)


def test_an_error_that_grows_from_each_reversal_is_drawn_so(rubbing):
    lag = (KD[1] + VISCOUS) / KP[1]
    since = np.mod(TIME - 0.5 - lag, HALF_PERIODS[1])
    since_reversal, error = drawn_errors(rubbing, 1e-3 * since)[2]
    inner = (since_reversal > 0.15) & (since_reversal < 0.65)
    assert inner.sum() > 4
    np.testing.assert_allclose(error[inner], since_reversal[inner], rtol=0.15)


def test_an_arm_without_masses_has_no_panel_of_loads(rubbing):
    data = rubbing.problem.data
    massless = replace(data, bodies=replace(data.bodies, links=np.zeros_like(data.bodies.links)))
    found = replace(rubbing, problem=replace(rubbing.problem, data=massless))
    labels = [panel.get_xlabel() for panel in dict(drawings(found, "log.csv"))["error_over_motion"].axes]
    assert labels == 2 * ["speed (deg/s)", "time since the last reversal (s)"]


def test_without_findings_one_rollout_is_drawn():
    found = diagnosed(())
    figures = dict(drawings(found, "log.csv"))
    labels = [text.get_text() for text in figures["over_time"].legends[0].get_texts()]
    assert labels == ["command", "log", "before, held out"]
    assert [len(panel.lines) for panel in figures["error_over_motion"].axes][3:] == [1, 1, 1]


def test_a_feed_forward_lessens_the_lag():
    stiff = diagnosed((ServoStiffness(2),))
    model = stiff.model
    ahead = replace(model, servo=model.servo._replace(feedforward=np.array([2.0, 0.0])))
    object.__setattr__(stiff, "model", ahead)  # a cached property
    lag = stiff.to_dict()["servos"][0]["lag_s"]
    assert lag == pytest.approx((KD[0] + VISCOUS - 2.0) / KP[0])
