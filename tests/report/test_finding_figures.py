"""Each finding's curve lies on its partial residuals, over its driver, with labels and units."""

import io
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from diagnosed import (
    AMPLITUDES,
    COMPLIANCE,
    HARMONIC,
    LITE6,
    WAVES,
    diagnosed,
    recording_maker,
    wavy_arm,
)

from lite6jax.diagnosis import evidence_map
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.report import diagnosis_figures
from lite6jax.report.finding_figures import finding_figure
from lite6jax.simulation import simulate

TURN = "joint deflection (mrad)"
ALONG = "displacement along it (mm)"
FITTED = "fitted displacement of the measured pose (mm)"
GEAR = "joint_harmonic:joint=1,order=80.4,amplitude_rad=4e-4,phase_rad=1"
EXPANSION = "link_thermal_expansion:expansion_per_K=4e-5"
CURVES = [
    (COMPLIANCE, {}, "gravity torque of joint 2 (Nm)", TURN),
    (HARMONIC, {}, "position of joint 1 (deg)", TURN),
    ("joint_offset:joint=3,offset_rad=5e-4", {}, "position of joint 3 (deg)", TURN),
    ("joint_backlash:joint=2,gap_rad=8e-4", {}, "direction of motion of joint 2", TURN),
    ("joint_lag:joint=1,lag_s=2e-3", {"motion": "trajectory"}, "velocity of joint 1 (deg/s)", TURN),
    (GEAR, {}, "phase of the harmonic, position of joint 1 (deg)", TURN),
    (EXPANSION, {"warm_up": 15.0}, "temperature rise (K)", "growth of the links (ppm)"),
    ("tool_offset:x_m=2e-3,y_m=1e-3", {}, "row of the recording", ALONG),
    ("measurement_scale:scale=5e-4", {}, FITTED, ALONG),
    ("time_offset:offset_s=0.02", {"motion": "trajectory"}, FITTED, ALONG),
]  # fmt: skip


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return recording_maker(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def compliant(recorded):
    return diagnosed(*recorded(COMPLIANCE))


@pytest.fixture(scope="module")
def found(recorded):
    return diagnosed(*recorded(COMPLIANCE, HARMONIC))


@pytest.fixture(scope="module")
def wavy(recorded):
    return wavy_arm(recorded)


@pytest.mark.parametrize(("text", "given", "across", "up"), CURVES, ids=[case[0].split(":")[0] for case in CURVES])
def test_a_finding_lies_on_its_data(recorded, text, given, across, up):
    found = diagnosed(*recorded(text, **given))
    (panel,) = finding_figure(found, "run.csv").axes
    assert (panel.get_xlabel(), panel.get_ylabel()) == (across, up)
    dots, curve = panel.lines[0], panel.lines[1]
    fitted = np.interp(dots.get_xdata(), curve.get_xdata(), curve.get_ydata())
    left = np.median(np.abs(dots.get_ydata() - fitted))
    assert left < 0.4 * np.median(np.abs(dots.get_ydata()))
    assert np.isfinite(panel.get_ylim()).all()


def test_links_turn_about_two_axes(recorded):
    found = diagnosed(*recorded("link_compliance:link=2,compliance_x_rad_per_Nm=1e-4,compliance_y_rad_per_Nm=6e-5"))
    figure = finding_figure(found, "run.csv")
    assert [(panel.get_xlabel(), panel.get_ylabel()) for panel in figure.axes] == [
        (f"gravity moment {axis} of link 2 (Nm)", f"rotation about {axis} (mrad)") for axis in "xy"
    ]


def test_one_finding_alone(found):
    (panel,) = finding_figure(found, "", [1]).axes
    assert panel.get_title() == "2. joint harmonic, joint1"


def test_a_curve_of_waves_lies_on_its_data(wavy):
    (panel,) = finding_figure(wavy, "", [0]).axes
    dots, curve = panel.lines[0], panel.lines[1]
    at, drawn = np.deg2rad(curve.get_xdata()), 1e-3 * np.asarray(curve.get_ydata())
    assert np.diff(at).max() < 2 * np.pi / max(WAVES) / 8  # each wave can be seen
    turned = np.multiply.outer(np.array(WAVES), at)
    assert np.sqrt(np.mean((drawn - AMPLITUDES[::2] @ np.sin(turned) - AMPLITUDES[1::2] @ np.cos(turned)) ** 2)) < 3e-5
    fitted = np.interp(dots.get_xdata(), curve.get_xdata(), curve.get_ydata())
    assert np.median(np.abs(dots.get_ydata() - fitted)) < 0.4 * np.median(np.abs(dots.get_ydata()))
    band = panel.collections[0].get_paths()[0].vertices
    assert band[:, 0].min() == pytest.approx(curve.get_xdata().min())
    figure = diagnosis_figures.order_spectrum(wavy, "run.csv")
    marks = [line for line in figure.axes[1].lines if line.get_marker() == "v"]
    assert tuple(marks[0].get_xdata()) == WAVES


def test_a_loop_has_a_point_at_each_sample(recorded):
    """Over its driver it has more than one value."""
    settings = recorded(COMPLIANCE)[0].settings
    slack = Unnamed("joint2", "position of joint 2", -2.0, 2.0, memory=(0.0, 0.5))
    values = np.array([4e-4, 1.5e-3])
    recording = simulate(LITE6, effects=[(slack, values)], motion="static", samples=300, settings=settings)
    loop = diagnosed(recording, (slack,))
    (panel,) = finding_figure(loop, "", [0]).axes
    dots, curve = panel.lines[0], panel.lines[1]
    assert curve.get_linestyle() == "None"
    motion = loop.problem.motion
    fitted = np.asarray(slack.curve(jnp.asarray(values), motion.joint_position[1], motion.run))
    order = np.argsort(np.asarray(motion.joint_position[1]), kind="stable")
    np.testing.assert_allclose(np.deg2rad(curve.get_xdata()), np.asarray(motion.joint_position[1])[order], atol=1e-12)
    np.testing.assert_allclose(1e-3 * np.asarray(curve.get_ydata()), fitted[order], atol=5e-5)
    assert len(dots.get_xdata()) > 100
    assert not panel.collections


def test_many_findings_fit_a_page(compliant):
    """Fourteen findings and more: no figure is higher than a page of its width, and panels stay readable."""
    for count in (1, 4, 6, 7, 14, 15, 20):
        figure = finding_figure(compliant, "", [0] * count)
        width, height = figure.get_size_inches()
        assert sum(panel.get_visible() for panel in figure.axes) == count
        assert height <= 1.42 * width
        assert width <= 18.5


def test_two_components_do_not_mix(recorded):
    """What one component does is not in the data that the other one is drawn over."""
    tilt = "base_compliance:compliance_x_rad_per_Nm=3e-5,compliance_y_rad_per_Nm=3e-5"
    found = diagnosed(*recorded(tilt))
    for panel in finding_figure(found, "").axes:
        dots, curve = panel.lines[0], panel.lines[1]
        fitted = np.interp(dots.get_xdata(), curve.get_xdata(), curve.get_ydata())
        assert np.median(np.abs(dots.get_ydata() - fitted)) < 0.3 * np.median(np.abs(dots.get_ydata()))


def test_orders_are_drawn_where_nothing_is_left(compliant, monkeypatch):
    """Of two identical recordings, whose difference is zero."""
    tested = evidence_map.score_test

    def nothing(problem, fit, options):
        test = tested(problem, fit, options)
        return replace(test, residual=np.zeros_like(test.residual))

    monkeypatch.setattr(evidence_map, "score_test", nothing)
    figure = diagnosis_figures.order_spectrum(compliant, "run.csv")
    assert np.isfinite(figure.axes[0].get_ylim()).all()
    assert all((joint.noise == 1.0).all() for joint in evidence_map.joint_spectra(compliant))
    figure.savefig(io.BytesIO())
