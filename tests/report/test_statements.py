"""What a page and a terminal both say of a diagnosis: faults, what was ruled out, curves without a name, what next."""

from dataclasses import replace
from io import StringIO

import jax.numpy as jnp
import numpy as np
import pytest
from diagnosed import COMPLIANCE, LITE6, Reader, diagnosed, recording_maker, with_rivals
from rich.console import Console
from rich.text import Text

from lite6jax.diagnosis.diagnose import statement
from lite6jax.diagnosis.discrimination import SeparatingPoses
from lite6jax.domains.pose.reference import ReferenceComparison
from lite6jax.effects.catalogue import catalogue
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.serialization import parse_effect
from lite6jax.recordings.fault import DataFault
from lite6jax.report import diagnosis_figures, diagnosis_words, reference
from lite6jax.report.data_faults import fault_name, fault_statement, ruled_out_statement, ruled_out_statements
from lite6jax.report.diagnosis_tables import diagnosis_report
from lite6jax.report.page import diagnosis_page
from lite6jax.simulation import simulate

WAVES = (3.0, 5.5, 9.0, 20.0, 33.0)
AMPLITUDES = np.array([3e-4, 0, 2e-4, 1e-4, 0, 1e-4, -2e-4, 0, 5e-5, 5e-5])
JUMP = {
    "row": 90,
    "part": "base",
    "translation_m": 3e-3,
    "rotation_rad": 1e-3,
    "twist": [3e-3, 0, 0, 1e-3, 0, 0],
    "displacement_rms_m": 3e-3,
    "p_value": 1e-9,
}
FAULTS = (
    DataFault("repeated_rows", (7, 9), {"first_rows": [3, 4]}),
    DataFault("frame_jump", tuple(range(90, 201)), JUMP),
    DataFault("of_tomorrow"),
)
COLUMNS = {"median_error_m": 3e-4, "suspected_above_m": 7e-3}
RULED_OUT = (
    DataFault("swapped_joints", (), COLUMNS),
    DataFault("mirrored_joint", (), COLUMNS),
    DataFault("time_order", (), {"samples": 200, "timed": False}),
)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return recording_maker(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def compliant(recorded):
    """Of a compliant arm; one rival is as good, one is not."""
    return diagnosed(*recorded(COMPLIANCE))


@pytest.fixture(scope="module")
def against(compliant):
    return ReferenceComparison(
        file="gazebo.csv",
        rows=200,
        matched=198,
        reproduced=False,
        rigid=True,
        distance=np.array([3e-3, 4e-3]),
        remaining=np.array([1e-5, 1e-5]),
        differences=(
            {
                "difference": "other_table",
                "model": {"kind": "factory_calibration", "name": "arm7.yaml"},
                "reference": {"kind": "ros_default_table", "name": "lite6_ros"},
                "position_rms_before_m": 3.5e-3,
                "position_rms_after_m": 1e-5,
            },
        ),
        notes=({"note": "unmatched_rows", "count": 2, "rows": 200},),
        recording=compliant.problem.recording,
        factory=None,
        geometry="declared",
    )


def waves(joint):
    return Unnamed(f"joint{joint}", f"position of joint {joint}", -7.0, 7.0, orders=WAVES, trust=(1.0, 1.0))


@pytest.fixture(scope="module")
def wavy(recorded):
    """Of an arm whose first four joints err at five orders each, as a search of real arms finds it."""
    settings = recorded(COMPLIANCE)[0].settings
    effects = tuple(waves(joint) for joint in (1, 2, 3, 4))
    given = [(effect, AMPLITUDES) for effect in effects]
    recording = simulate(LITE6, effects=given, motion="static", samples=400, settings=settings)
    return diagnosed(recording, effects)


@pytest.fixture(scope="module")
def drawn(compliant):
    return dict(diagnosis_figures.drawings(compliant, "run.csv"))


def page(found, drawn, against=None):
    return " ".join(Reader(diagnosis_page(found, "run.csv", drawn, against)).text.split())


def screen(found, against=None, width=96):
    """What a terminal shows, and its text without the breaks of lines."""
    held = StringIO()
    console = Console(width=width, file=held, highlight=False, markup=False, emoji=False)
    for part in diagnosis_report(found, "run.csv", against):
        console.print(part, soft_wrap=isinstance(part, Text) and bool(part.no_wrap))
    return held.getvalue(), " ".join(held.getvalue().split())


# ------------------------------------------------------------------ faults and what was ruled out


def test_faults_come_before_the_findings(compliant, drawn):
    wild = np.zeros(compliant.problem.samples, bool)
    wild[[3, 4, 5, 50]] = True
    found = replace(compliant, faults=FAULTS, ruled_out=RULED_OUT, outliers=wild)
    outliers = DataFault("outliers", (4, 5, 6, 51))
    text = page(found, drawn)
    start = text.index("Data faults")
    for fault in (*FAULTS, outliers):
        start = text.index(f"{fault_name(fault.code)}. {fault_statement(fault)}", start)
    assert "Rows 90–200." in text
    assert start < text.index("Findings") < text.index("Ruled out")
    start = text.index("Ruled out")
    for fault in RULED_OUT:
        start = text.index(f"{fault_name(fault.code)}. {ruled_out_statement(fault)}", start)
    assert start < text.index("Not tested")

    _, said = screen(found)
    start = said.index("Data faults: ")
    for fault in (*FAULTS, outliers):
        start = said.index(fault_statement(fault), start)
    assert "Rows 90–200." in said
    short = ruled_out_statements(RULED_OUT)
    assert len(short) == 2
    assert start < said.index("1. Joint compliance") < said.index(short[0]) < said.index(short[1])


def test_one_row_stands_out(compliant):
    wild = np.zeros(compliant.problem.samples, bool)
    wild[11] = True
    (told,) = diagnosis_words.faults_of(replace(compliant, outliers=wild))
    assert told.statement == fault_statement(DataFault("outliers", (12,)))
    assert diagnosis_words.faults_of(compliant) == []


def test_rows_are_listed_in_short():
    assert diagnosis_words.listed([3, 5, 6, 9, 10, 11, 12]) == "3, 5, 6, 9–12"
    assert diagnosis_words.listed(range(1, 100, 2)) == "1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23 and 38 more"
    assert diagnosis_words.listed([]) == ""


def test_sites_are_listed_in_short():
    told = dict(diagnosis_words.by_site(catalogue(7)))
    assert told["joint_lag"] == "joint1–7"
    assert told["joint_coupling"] == "joint1–7"  # each once, of 42
    assert told["link_thermal_expansion"] == "links, link1–6"
    assert told["time_offset"] == "clock"
    some = [parse_effect(f"joint_lag:joint={joint},lag_s=1")[0] for joint in (1, 3, 4, 6)]
    assert diagnosis_words.by_site(some) == [("joint_lag", "joint1, 3, 4, 6")]


def test_what_was_not_tested_is_grouped_alike_everywhere(compliant, drawn):
    groups = diagnosis_words.untested(compliant)
    assert len({group.reason for group in groups}) == len(groups)
    velocity = groups[0]
    assert velocity.reason == "Needs the velocity of its joint"
    assert velocity.remedy.startswith("give the velocities of a moving arm; record a trajectory")
    tested = {effect for group in groups for effect in group.effects}
    assert tested == {item.effect for item in compliant.untestable} | set(compliant.confounded)
    assert groups[-1].effects == compliant.confounded
    assert groups[-1].reason == "The sensor does not see it here"  # no frame, no number of the chain is fitted
    assert "Needs the velocity of its joint. joint lag at joint1–6" in page(compliant, drawn)
    assert "Needs the velocity of its joint: joint_lag:joint1–6" in screen(compliant)[1]


# ------------------------------------------------------------------ physics without a name


def test_curves_of_many_waves_are_named_in_short(wavy, drawn):
    text, (shown, said) = page(wavy, drawn), screen(wavy, width=60)
    assert max(map(len, shown.splitlines())) <= 60
    for joint in (1, 2, 3, 4):
        title = f"Unnamed: joint {joint}, function of its position, waves of 5 orders 3–33"
        assert text.count(f"{joint}. {title}") == 2  # in the overview and above its figure
        assert f"{joint}. {title}: " in said
    for told in (text, said):
        assert "sine" not in told
        assert "coefficient" not in told
    q = np.asarray(wavy.problem.motion.joint_position[0])
    inside = q[(q >= np.percentile(q, 2)) & (q <= np.percentile(q, 98))]
    turned = np.multiply.outer(np.array(WAVES), inside)
    truth = AMPLITUDES[::2] @ np.sin(turned) + AMPLITUDES[1::2] @ np.cos(turned)
    swing, std = diagnosis_words.peak_to_peak(
        wavy.problem, waves(1), wavy.fit.values[:10], wavy.fit.covariance[:10, :10]
    )
    assert 0 < std < 3e-5
    assert swing == pytest.approx(np.ptp(truth), abs=5 * std)
    value, spread = diagnosis_words.rounded(1e3 * swing, 1e3 * std)
    assert f"{value} ± {spread} mrad peak to peak." in said
    assert f"peak to peak {value} {spread} mrad" in text


def test_a_curve_of_waves_lies_on_its_data(wavy):
    (panel,) = diagnosis_figures.finding_curves(wavy, "", [0]).axes
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
    (panel,) = diagnosis_figures.finding_curves(loop, "", [0]).axes
    dots, curve = panel.lines[0], panel.lines[1]
    assert curve.get_linestyle() == "None"
    motion = loop.problem.motion
    fitted = np.asarray(slack.curve(jnp.asarray(values), motion.joint_position[1], motion.run))
    order = np.argsort(np.asarray(motion.joint_position[1]), kind="stable")
    np.testing.assert_allclose(np.deg2rad(curve.get_xdata()), np.asarray(motion.joint_position[1])[order], atol=1e-12)
    np.testing.assert_allclose(1e-3 * np.asarray(curve.get_ydata()), fitted[order], atol=5e-5)
    assert len(dots.get_xdata()) > 100
    assert not panel.collections


@pytest.mark.parametrize(
    ("effect", "title"),
    [
        (Unnamed("joint2", "gravity torque of joint 2", -1.0, 1.0), "joint 2, function of its gravity torque, "),
        (Unnamed("base", "time", 0.0, 1.0, component="rx"), "base rx, function of time, "),
        (
            Unnamed("link3", "position of joint 1", 0.0, 1.0, component="z"),
            "link 3 z, function of position of joint 1, ",
        ),
    ],
)
def test_a_smooth_curve_is_named(effect, title):
    assert diagnosis_words.named(effect) == f"unnamed: {title}a smooth curve"


def test_a_curve_with_memory_is_named():
    effect = Unnamed("joint2", "gravity torque of joint 2", -1.0, 1.0, memory=(0.0, 0.3))
    assert diagnosis_words.named(effect) == "unnamed: joint 2, function of its gravity torque and of its past, a loop"
    assert statement(effect, {}).startswith(
        "Something real at joint2, a function of gravity torque of joint 2 and of its past, that no entry"
    )


def test_many_findings_fit_a_page(compliant):
    """Fourteen findings and more: no figure is higher than a page of its width, and panels stay readable."""
    for count in (1, 4, 6, 7, 14, 15, 20):
        figure = diagnosis_figures.finding_curves(compliant, "", [0] * count)
        width, height = figure.get_size_inches()
        assert sum(panel.get_visible() for panel in figure.axes) == count
        assert height <= 1.42 * width
        assert width <= 18.5


def test_two_components_do_not_mix(recorded):
    """What one component does is not in the data that the other one is drawn over."""
    tilt = "base_compliance:compliance_x_rad_per_Nm=3e-5,compliance_y_rad_per_Nm=3e-5"
    found = diagnosed(*recorded(tilt))
    for panel in diagnosis_figures.finding_curves(found, "").axes:
        dots, curve = panel.lines[0], panel.lines[1]
        fitted = np.interp(dots.get_xdata(), curve.get_xdata(), curve.get_ydata())
        assert np.median(np.abs(dots.get_ydata() - fitted)) < 0.3 * np.median(np.abs(dots.get_ydata()))


def test_numbers_have_the_digits_that_they_are_known_to():
    assert diagnosis_words.rounded(1.52689, 0.0123) == ("1.527", "0.012")
    assert diagnosis_words.rounded(21654.3, 4320.0) == ("21654", "4320")
    assert diagnosis_words.rounded(1.0, np.inf) == ("1", "inf")


# ------------------------------------------------------------------ the other side


def test_the_other_side_comes_first(compliant, drawn, against):
    said = (
        "Reference gazebo.csv, 198 of 200 rows: the model does not reproduce it, with position errors of 3.5355 mm RMS "
        "and 4.0000 mm at most."
    )
    for text in (page(compliant, drawn, against), screen(compliant, against)[1]):
        assert f"{said} With the differences below, 0.0100 mm RMS remain." in text
        start = text.index(said)
        codes = against.to_dict()
        parts = [*reference.difference_sentences(codes), *reference.note_sentences(codes)]
        parts += [reference.model_statement("gazebo.csv", rigid=True), "Explained: with the physics below"]
        assert sorted(parts, key=lambda part: text.index(part, start)) == parts
    assert "The other side" in page(compliant, drawn, against)
    assert "The other side" not in page(compliant, drawn)
    same = replace(against, reproduced=True, matched=200, differences=(), notes=())
    said = (
        "Reference gazebo.csv, 200 rows: the model reproduces it, with position errors of 3.5355 mm RMS and 4.0000 mm"
    )
    assert f"{said} at most. gazebo" in page(compliant, drawn, same)


def test_both_sides_agree(recorded, drawn, against):
    found = diagnosed(*recorded())
    for told in (page(found, drawn, against), screen(found, against)[1]):
        assert diagnosis_words.AGREE in told
        assert "Nothing is missing" not in told


# ------------------------------------------------------------------ what to record next


@pytest.fixture(scope="module")
def undecided(compliant):
    """With two rivals as good, one of which poses at rest separate."""
    link, _ = parse_effect("link_compliance:link=1,compliance_x_rad_per_Nm=1e-5,compliance_y_rad_per_Nm=1e-5")
    lag, _ = parse_effect("joint_lag:joint=2,lag_s=1e-3")
    harmonic, _ = parse_effect("joint_harmonic:joint=2,order=1,amplitude_rad=1e-4,phase_rad=0")
    (finding,) = compliant.findings
    found = with_rivals(compliant, (lag, 5.9), (link, -0.1), (harmonic, 6.1), (finding.effect, 0.0))
    q = np.deg2rad([[10.04, -20, 30, 40, 50, 60], [-175, 80, 200, -100, -0.01, 5]])
    poses = SeparatingPoses(("joint_compliance:joint2", "link_compliance:link1"), q)
    return replace(found, separating=(poses,))


def test_what_to_record_next(undecided, drawn):
    text, (shown, said) = page(undecided, drawn), screen(undecided, width=60)
    pair = "joint compliance at joint2 from link compliance at link1"
    for told in (text, said):
        start = told.index("What to record next")
        assert told.index(f"To separate {pair}, record the poses below; they are in the JSON as", start) > start
        assert (
            "To separate joint compliance at joint2 from joint lag at joint2, record more poses with gravity torque of "
            "joint 2 and velocity of joint 2 varied each on its own." in told
        )
        assert "To test for joint lag and time offset, give the velocities of a moving arm; record a trajectory" in told
        assert "from joint harmonic" not in told  # rejected
        assert "from joint compliance" not in told  # in the model
        assert f"Poses that separate {pair} (deg)" in told
        assert "1 10.0 -20.0 30.0 40.0 50.0 60.0" in told
        assert "2 -175.0 80.0 200.0 -100.0 0.0 5.0" in told
        assert "not checked for collisions" in told
    assert max(map(len, shown.splitlines())) <= 60
    assert "link compliance at link1 (-0.1), joint compliance at joint2 (+0.0), joint lag at joint2 (+5.9)" in said
    assert "rejected: joint harmonic of order 1 at joint2 (+6.1)" in text


def test_no_poses_are_shown_where_there_are_none(compliant, drawn):
    assert compliant.separating == ()
    assert "Poses that separate" not in page(compliant, drawn)
    assert "Poses that separate" not in screen(compliant)[1]


def test_what_hides_effects_is_to_be_declared(compliant):
    hidden = "To see more of what is hidden, "
    assert diagnosis_words.to_record(compliant)[-1] == f"{hidden}measure orientations too."
    sites = (("base", 0, 0), ("link", 1, 3))
    problem = replace(compliant.problem, unknown=sites, precision=np.ones(2), offset=np.zeros(2))
    said = f"{hidden}declare the sensor's frame and the arm's own calibration and measure orientations too."
    assert diagnosis_words.to_record(replace(compliant, problem=problem))[-1] == said
    selection, problem = replace(compliant.selection, confounded=()), replace(compliant.problem, untestable=())
    nothing = replace(compliant, selection=selection, problem=problem)
    assert diagnosis_words.to_record(nothing) == []
