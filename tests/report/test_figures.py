"""Figures show errors, shares, orders and curves on the data they are of, with labels and units; files are whole."""

import re

import numpy as np
import pytest
from diagnosed import COMPLIANCE, LITE6, WAVES, diagnosed, of_waves
from matplotlib.image import imread
from torque_diagnosed import COULOMB, EFFECTS, VISCOUS
from torque_diagnosed import diagnosed as torques_diagnosed
from torque_diagnosed import recorded as torques_recorded

from lite6jax import fit
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.calibration.fleet import compare
from lite6jax.diagnosis import evidence_map
from lite6jax.diagnosis.evidence_map import explained_shares
from lite6jax.diagnosis.partial_residuals import finding_curves
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.errors import InputError
from lite6jax.report import figures
from lite6jax.report.diagnosis_figures import drawings, explained_map, finding_figure, order_spectrum
from lite6jax.simulation import simulate
from tests.oracles.arms import perturbed

TURN = "joint deflection (mrad)"
ALONG = "displacement along it (mm)"
FITTED = "fitted displacement of the measured pose (mm)"
GEAR = "joint_harmonic:joint=1,order=80.4,amplitude_rad=4e-4,phase_rad=1"
CURVES = [
    (COMPLIANCE, {}, "gravity torque of joint 2 (Nm)", TURN),
    ("joint_backlash:joint=2,gap_rad=8e-4", {}, "direction of motion of joint 2", TURN),
    ("joint_lag:joint=1,lag_s=2e-3", {"motion": "trajectory"}, "velocity of joint 1 (deg/s)", TURN),
    (GEAR, {}, "phase of the harmonic, position of joint 1 (deg)", TURN),
    ("tool_offset:x_m=2e-3,y_m=1e-3", {}, "row of the recording", ALONG),
    ("time_offset:offset_s=0.02", {"motion": "trajectory"}, FITTED, ALONG),
]  # fmt: skip


@pytest.fixture(scope="module")
def drawn(found):
    return dict(drawings(found, "run.csv"))


@pytest.fixture(scope="module")
def motors_drawn(motors):
    return dict(drawings(motors, "run.csv"))


def assert_on_its_data(panel, share):
    """A curve leaves less than this share of the partial residuals."""
    dots, curve = panel.lines[:2]
    fitted = np.interp(dots.get_xdata(), curve.get_xdata(), curve.get_ydata())
    assert np.median(np.abs(dots.get_ydata() - fitted)) < share * np.median(np.abs(dots.get_ydata()))


# ------------------------------------------------------------------ findings


@pytest.mark.parametrize(("text", "given", "across", "up"), CURVES, ids=[case[0].split(":")[0] for case in CURVES])
def test_a_finding_lies_on_its_data(recorded, text, given, across, up):
    (panel,) = finding_figure(diagnosed(*recorded(text, **given)), "run.csv").axes
    assert (panel.get_xlabel(), panel.get_ylabel()) == (across, up)
    assert_on_its_data(panel, 0.4)
    assert np.isfinite(panel.get_ylim()).all()


def test_the_spectrum_of_a_gear_lies_on_its_data(wavy):
    (panel,) = finding_figure(wavy, "", [0]).axes
    assert (panel.get_title(), panel.get_ylabel()) == (
        "1. unnamed effect, joint1",
        "joint deflection from its mean (µrad)",
    )
    curve = panel.lines[1]
    at, drawn = np.deg2rad(curve.get_xdata()), 1e-6 * np.asarray(curve.get_ydata())
    assert np.diff(at).max() < 2 * np.pi / max(WAVES) / 8  # each wave can be seen
    missed = drawn - of_waves(at)
    assert np.std(missed) < 4e-5
    assert_on_its_data(panel, 0.4)
    band = panel.collections[0].get_paths()[0].vertices
    assert band[:, 0].min() == pytest.approx(curve.get_xdata().min())
    marks = [line for line in order_spectrum(wavy, "run.csv").axes[1].lines if line.get_linewidth() == 6]
    assert [tuple(mark.get_xdata()) for mark in marks] == [(0.5, 60.0)]


def test_a_loop_has_a_point_at_each_sample(recorded):
    """Over its driver it has more than one value."""
    settings = recorded(COMPLIANCE)[0].settings
    slack = Unnamed("joint2", "position of joint 2", -2.0, 2.0, "play", spread=1e-3)
    values = np.array([0.0, 8e-4, 0, 0, 3e-3, 0, 0, 0, 0])
    recording = simulate(LITE6, effects=[(slack, values)], motion="static", samples=300, settings=settings)
    loop = diagnosed(recording, (slack,))
    (panel,) = finding_figure(loop, "", [0]).axes
    dots, curve = panel.lines[:2]
    assert curve.get_linestyle() == "None"
    motion = loop.problem.motion
    fitted = values @ np.asarray(slack.functions_at(motion.joint_position[1:2], motion.run))
    order = np.argsort(np.asarray(motion.joint_position[1]), kind="stable")
    np.testing.assert_allclose(np.deg2rad(curve.get_xdata()), np.asarray(motion.joint_position[1])[order], atol=1e-12)
    drawn = 1e-6 * np.asarray(curve.get_ydata())
    np.testing.assert_allclose(drawn - drawn.mean(), (fitted - fitted.mean())[order], atol=6e-5)
    assert len(dots.get_xdata()) > 100
    assert not panel.collections


# ------------------------------------------------------------------ errors, shares, orders and what is left of poses


def test_a_panel_for_each_joint(found, drawn):
    figure = drawn["error_by_joint"]
    assert [panel.get_xlabel() for panel in figure.axes] == [f"joint {i} (deg)" for i in range(1, 7)]
    assert figure.axes[0].get_ylabel() == figure.axes[3].get_ylabel() == "position error (mm)"
    assert "run.csv" in figure.get_suptitle()
    kept = ~found.outliers
    pairs = (("before", found.before), ("after", found.after))
    rms = [(name, 1e3 * np.sqrt(np.mean(errors[kept] ** 2))) for name, errors in pairs]
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == [f"{name}: {value:.3g} mm RMS, held out" for name, value in rms]
    q = np.rad2deg(np.asarray(found.problem.motion.joint_position)[:, kept])
    for joint, panel in enumerate(figure.axes):
        dots = panel.lines[0]
        np.testing.assert_allclose(dots.get_xdata(), q[joint])
        np.testing.assert_allclose(dots.get_ydata(), 1e3 * found.before[kept])


def test_where_it_is(compliant):
    sites, drivers, shares = explained_shares(compliant)
    assert sites == (*(f"{kind}{i}" for kind in ("joint", "link") for i in range(1, 7)), "base", "tool", "sensor")
    assert drivers == (
        *("constant", "position", "other positions", "direction of motion", "load", "time", "measured position"),
        "two drivers",
    )
    most, at, driver = np.nanmax(shares), sites.index("joint2"), drivers.index("load")
    # link 1 moves the arm alike, and the products of two drivers contain the load
    assert 0.9 < most - 0.001 < shares[at, driver] <= most <= 1
    others = [sites.index(f"joint{i}") for i in (1, 3, 4, 5, 6)]
    assert np.nanmax(shares[others]) < 0.9 * most
    panel, bar = explained_map(compliant, "run.csv").axes
    assert bar.get_ylabel() == f"explained variance (%), scaled to {100 * most:.2g} %"
    assert panel.images[0].get_clim() == (0, pytest.approx(100 * most))
    assert panel.images[0].get_cmap().name == "cividis"
    assert [tick.get_text().replace(" ", "") for tick in panel.get_yticklabels()] == list(sites)
    assert f"{100 * shares[at, driver]:.0f}" in [text.get_text() for text in panel.texts]


def test_the_share_is_what_a_plain_fit_explains(compliant):
    """Of joint 2 and gravity's torque, by least squares on the residuals, the adjusted share of the variance."""
    problem, baseline = compliant.problem, compliant.selection.state.baseline
    sites, drivers, shares = explained_shares(compliant)
    torque = np.asarray(problem.loads.torque[1])
    u = 8 * (torque - torque.min()) / np.ptp(torque)
    t = np.abs(u - np.arange(-1, 10)[:, None])
    splines = (np.maximum(2 - t, 0) ** 3 - 4 * np.maximum(1 - t, 0) ** 3) / 6
    A = (problem.sites["joint", 1, 0] * splines[:, None]).reshape(11, -1).T
    e = baseline.residuals.rows.ravel()
    left = e - A @ np.linalg.lstsq(A, e, rcond=None)[0]
    share = 1 - np.sum(left**2) / np.sum(e**2) * e.size / (e.size - 11)
    assert shares[sites.index("joint2"), drivers.index("load")] == pytest.approx(share, abs=0.01)


def test_the_order_found_is_marked(drawn):
    figure = drawn["orders"]
    assert [panel.get_xlabel() for panel in figure.axes] == [f"order per turn of joint {i}" for i in range(1, 7)]
    assert figure.axes[0].get_ylabel() == "explained variance (%)"
    assert [[text.get_text().strip() for text in panel.texts] for panel in figure.axes[:2]] == [["2"], []]
    marks = [line for line in figure.axes[0].lines if line.get_linestyle() == "--" and len(line.get_xdata())]
    assert set(marks[0].get_xdata()) == {2.0}
    spectrum = figure.axes[0].lines[0]
    orders, shares = spectrum.get_xdata(), spectrum.get_ydata()
    assert orders[np.argmax(shares)] == pytest.approx(2.0, abs=0.3)
    assert orders[0] == 1
    assert orders[-1] > 195


# ------------------------------------------------------------------ torques


def test_torques_over_time(motors, motors_drawn):
    figure = motors_drawn["over_time"]
    assert [panel.get_ylabel() for panel in figure.axes] == [f"torque of joint {j} (Nm)" for j in range(1, 7)]
    assert figure.legends[0].get_texts()[0].get_text() == "measured"
    measured, rigid, modelled = (line.get_ydata() for line in figure.axes[1].lines)
    assert np.sqrt(np.mean((measured - rigid) ** 2)) > 10 * np.sqrt(np.mean((measured - modelled) ** 2))
    time, torques = evidence_map.torques_over_time(motors)
    at = np.searchsorted(np.asarray(motors.problem.data.time), time[0])
    np.testing.assert_allclose(torques["measured"], motors.problem.measured[:, at : at + len(time)])


def test_friction_is_a_line_through_what_is_left(motors, motors_drawn):
    def planted(velocity):
        return VISCOUS * velocity + COULOMB * np.sign(velocity)

    friction = evidence_map.joint_frictions(motors)[1]
    away = np.abs(friction.at) > 0.05
    np.testing.assert_allclose(friction.friction[away], planted(friction.at[away]), atol=0.05)
    moving = np.abs(friction.velocity) > 0.1
    assert np.sqrt(np.mean((friction.partial - planted(friction.velocity))[moving] ** 2)) < 0.1
    panel = motors_drawn["friction"].axes[1]
    assert panel.get_xlabel() == "velocity of joint 2 (deg/s)"
    assert panel.get_ylabel() == "torque left at joint 2 (Nm)"


def test_every_kind_of_finding_draws():
    found = torques_diagnosed(torques_recorded(), EFFECTS)
    figure = dict(drawings(found, "run.csv"))["findings"]
    labels = [panel.get_xlabel() for panel in figure.axes if panel.get_visible()]
    assert labels[:6] == [
        *("velocity of joint 2 (deg/s)", "direction of motion of joint 2", "time (s)", "fitted torque at joint 1 (Nm)"),
        *("position of joint 4 (deg)", "position of joint 5 (deg)"),
    ]
    assert all(re.fullmatch(r"fitted torque at joint \d \(Nm\)", label) for label in labels[6:])
    for (curve,) in (finding_curves(found, k) for k in range(len(EFFECTS))):
        assert np.isfinite(np.concatenate([curve.driver, curve.partial, curve.at, curve.curve, curve.std])).all()
        assert np.all(np.diff(curve.at) >= 0)


# ------------------------------------------------------------------ fits, comparisons, and files


@pytest.fixture(scope="module")
def solution():
    return fit(perturbed(np.random.default_rng(0), LITE6.kinematics), "lite6")


@pytest.fixture(scope="module")
def comparison():
    rng = np.random.default_rng(1)
    arms = [perturbed(rng, LITE6.kinematics) for _ in range(3)]
    return compare([FactoryCalibration(k, LITE6, np.eye(4), f"folder/arm{i}.yaml") for i, k in enumerate(arms)])


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_a_fit_has_a_panel_for_each_joint(solution):
    figure = figures.error_by_joint(solution, "arm.yaml")
    assert [panel.get_xlabel() for panel in figure.axes] == [f"joint {i} (deg)" for i in range(1, 7)]
    assert figure.axes[0].get_ylabel() == figure.axes[3].get_ylabel() == "position error (mm)"
    assert figure.get_suptitle() == "arm.yaml"
    before, after = legend(figure)
    rms, most = 1e3 * solution.nominal_errors.position_rms, 1e3 * solution.nominal_errors.position.max()
    assert before == f"nominal: {rms:.3g} mm RMS, {most:.3g} mm at most"
    assert after.startswith("fitted, on fresh samples: ")
    for joint, panel in enumerate(figure.axes):
        dots, medians = panel.lines[:2]
        np.testing.assert_allclose(dots.get_xdata(), np.rad2deg(solution.nominal_errors.joint_position[:, joint]))
        np.testing.assert_allclose(dots.get_ydata(), 1e3 * solution.nominal_errors.position)
        x, y = medians.get_xdata(), medians.get_ydata()
        near = np.abs(dots.get_xdata() - x[7]) < (x[1] - x[0]) / 2
        assert y[7] == pytest.approx(np.median(dots.get_ydata()[near]))


def test_the_distances_between_arms(comparison):
    panel, bar = figures.distance_between(comparison, "arms").axes
    assert bar.get_ylabel() == "largest distance of the flanges (mm)"
    table = np.asarray(panel.images[0].get_array())
    np.testing.assert_allclose(table[1:, 1:], 1e3 * comparison.between)
    np.testing.assert_allclose(table[0, 1:], 1e3 * comparison.from_nominal.max(1))
    assert f"{table[1, 2]:.2f}" in [text.get_text() for text in panel.texts]


def test_written_whole_and_the_same_again(tmp_path, solution):
    drawn = {"one": figures.error_by_joint(solution, "arm.yaml")}
    paths = figures.save(drawn, tmp_path)
    assert [path.name for path in paths] == ["one.png", "one.svg"]
    image = imread(paths[0])
    assert image.shape[1] == 12 * 120
    assert image[..., :3].min() < 0.2 < 0.99 < image[..., :3].max()
    first = [path.read_bytes() for path in paths]
    again = {"one": figures.error_by_joint(solution, "arm.yaml")}
    assert [path.read_bytes() for path in figures.save(again, tmp_path, overwrite=True)] == first
    with pytest.raises(InputError, match=r"one\.png: exists already; choose another name or add `overwrite=True`"):
        figures.check_names(tmp_path, ["one"])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.png", "one.svg"]
