"""The sentences of a diagnosis on the page, on the terminal and in its JSON file: the same, from codes and numbers."""

import json
import re
import time
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from diagnosed import LITE6, Reader, diagnosed, documented, gear, with_rivals
from rich.console import Console
from rich.text import Text

from lite6jax import formatting
from lite6jax.arms.factory import write_factory
from lite6jax.diagnosis.fault_alternative import FaultAlternative
from lite6jax.diagnosis.result import SeparatingPoses
from lite6jax.domains.pose.reference import ReferenceComparison
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.serialization import effect_as_dict, parse_effect
from lite6jax.progress import Stage
from lite6jax.recordings import RecordingSettings
from lite6jax.recordings.fault import DataFault
from lite6jax.report import diagnosis_figures, ranking, remedies, statements
from lite6jax.report import screen as terminal
from lite6jax.report.faults import fault_name, fault_statement, ruled_out_statements
from lite6jax.report.pages import diagnosis_page
from lite6jax.report.sections import diagnosis_report
from lite6jax.report.sentences.diagnosis import verdict_statement
from lite6jax.simulation import simulate

pytestmark = pytest.mark.usefixtures("unpainted")

DOCS = Path(__file__).resolve().parents[2] / "docs/reference"

JUMP = {
    "row": 90, "part": "base", "translation_m": 3e-3, "rotation_rad": 1e-3, "twist": [3e-3, 0, 0, 1e-3, 0, 0],
    "displacement_rms_m": 3e-3, "p_value": 1e-9,
}  # fmt: skip
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


def test_the_keys_of_a_diagnosis_are_documented(found, motors):
    of_poses = {*found.to_dict(), "inputs", "against", "shared"}
    of_poses |= {"torques", "torques_refused", "tracking", "tracking_refused"}
    keys = []
    for page, title in (("results", "The file of a diagnosis"), ("torques", "The JSON file")):
        text = (DOCS / f"{page}.md").read_text().partition(f"\n## {title}\n")[2].partition("\n## ")[0]
        first = [row.split("|")[1] for row in text.partition("\n###")[0].splitlines() if row.startswith("| `")]
        keys.append({key for cell in first for key in re.findall(r"`(\w+)`", cell)})
    assert keys[0] == of_poses
    assert set(motors.to_dict()) - of_poses <= keys[1] <= set(motors.to_dict()) | {"against"}


@pytest.fixture(scope="module")
def against(compliant):
    tables = {
        "difference": "other_table",
        "model": {"kind": "factory_calibration", "name": "arm7.yaml"},
        "reference": {"kind": "ros_default_table", "name": "lite6_ros"},
    }
    return ReferenceComparison(
        file="gazebo.csv", rows=200, matched=198, reproduced=False, rigid=True, distance=np.array([3e-3, 4e-3]),
        remaining=np.array([1e-5, 1e-5]), recording=compliant.problem.recording, factory=None, geometry="declared",
        differences=({**tables, "position_rms_before_m": 3.5e-3, "position_rms_after_m": 1e-5},),
        notes=({"note": "unmatched_rows", "count": 2, "rows": 200},),
    )  # fmt: skip


@pytest.fixture(scope="module")
def drawn(compliant):
    return dict(diagnosis_figures.drawings(compliant, "run.csv"))


def page(found, drawn, against=None):
    return " ".join(Reader(diagnosis_page(found, documented(found, against), "run.csv", drawn)).text.split())


def screen(found, against=None, width=96):
    """What a terminal shows, and its text without the breaks of lines."""
    return reported(documented(found, against), width)


def reported(document, width=96):
    held = StringIO()
    console = Console(width=width, file=held, highlight=False, markup=False, emoji=False)
    for part in diagnosis_report(document, "run.csv", details=True):
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
    assert start < text.index("Findings") < text.index("Tested and ruled out")
    short = ruled_out_statements(RULED_OUT)
    assert len(short) == 2
    start = text.index("Tested and ruled out")
    assert start < text.index(short[0]) < text.index(short[1]) < text.index("Effects not tested")

    _, said = screen(found)
    start = said.index("Data faults: ")
    for fault in (*FAULTS, outliers):
        start = said.index(fault_statement(fault), start)
    assert "Rows 90–200." in said
    assert start < said.index("1. Joint compliance at joint2, a function") < said.index(short[0]) < said.index(short[1])


def test_what_was_not_tested_is_grouped_alike_everywhere(compliant, drawn):
    document = documented(compliant)
    groups = statements.untested(document)
    assert len({group.reason for group in groups}) == len(groups)
    velocity = groups[0]
    assert velocity.reason == "The recording has no velocity of these joints."
    assert velocity.remedy.startswith("the velocities of a moving arm; record a trajectory")
    named = [(entry["effect"], entry["site"]) for group in groups for entry in group.entries]
    effects = [item.effect for item in compliant.untestable] + list(compliant.confounded)
    assert sorted(named) == sorted((effect.name, effect.site) for effect in effects)
    assert groups[-1].entries == tuple(document["confounded"])
    assert groups[-1].reason == "The sensor does not observe them in these poses."  # nothing of the arm is fitted
    for shown in (page(compliant, drawn), screen(compliant)[1]):
        assert "Joint lag at joint1–6, time offset at clock. The recording has no velocity of these joints." in shown
    reasons = {(entry["effect"], entry["site"]): entry["reason"] for entry in document["untestable"]}
    assert reasons["joint_lag", "joint2"].startswith("needs the velocity of joint 2: give the velocities of a moving")


# ------------------------------------------------------------------ physics without a name


@pytest.mark.parametrize(
    ("effect", "title", "shape"),
    [
        (Unnamed("joint2", "gravity torque of joint 2", -1.0, 1.0),
         "joint2 as a function of its gravity torque", "a smooth curve"),


        (Unnamed("joint2", "gravity torque of joint 2", -1.0, 1.0, "play"),
         "joint2 as a function of its gravity torque", "a hysteresis loop"),

        (gear(1), "joint1 as a function of its position", "waves of many orders, as of a gear"),
        (Unnamed("joint1", "position of joint 1", -3.0, 3.0, "repeat", rolloff=(2 * np.pi / 0.8, 2.0)),
         "joint1 as a function of its position", "a curve that repeats every 0.8 rad and is no sine"),

        (Unnamed("joint1", "position of joint 1 and position of joint 2", -3.0, 3.0, "sine*line", further=(-1.0, 1.0),
                 rolloff=(4.2,)),
         "joint1 as a function of the position of joints 1 and 2",
         "a wave of order 4.2 of the angle, whose size follows the other"),

        (Unnamed("joint3", "position of joint 3 and direction of motion of joint 3", 0.0, 1.0, "rough*line",
                 further=(-1.0, 1.0)),
         "joint3 as a function of the position of joint 3 and the direction of motion of joint 3",
         "a curve in each direction"),
        (Unnamed("joint3", "position of joint 3 and gravity torque of joint 3", 0.0, 1.0, "fine*line",
                 further=(0.0, 1.0)),
         "joint3 as a function of the position of joint 3 and the gravity torque of joint 3", "a surface"),
    ],
)  # fmt: skip
def test_what_is_known_of_an_unnamed_effect_is_its_title_and_its_shape(effect, title, shape):
    where = effect_as_dict(effect, np.zeros(effect.size))["where"]
    entry = {"effect": "unnamed", "site": effect.site, "driver": effect.driver, "where": where}
    assert remedies.effect_title(entry) == f"unnamed effect at {title}"
    assert remedies.shape(where) == shape


# ------------------------------------------------------------------ the reference


def test_the_reference_comes_first(compliant, drawn, against):
    said = "Reference gazebo.csv, 198 of 200 rows: the model does not reproduce it, with position errors of 3.5355 mm"
    said += " RMS and 4.0000 mm at most."
    for text in (page(compliant, drawn, against), screen(compliant, against)[1]):
        assert f"{said} With the differences below, 0.0100 mm RMS remain." in text
        start = text.index(said)
        stated = statements.with_comparison(against.to_dict())
        parts = [entry["statement"] for key in ("differences", "notes") for entry in stated[key]]
        parts += [stated["statement"], "Explained: with the effects below"]
        assert sorted(parts, key=lambda part: text.index(part, start)) == parts
    assert "Difference from the reference" in page(compliant, drawn, against)
    assert "Difference from the reference" not in page(compliant, drawn)
    same = replace(against, reproduced=True, matched=200, differences=(), notes=())
    said = "Reference gazebo.csv, 200 rows: the model reproduces it, with position errors of 3.5355 mm RMS and 4.0000"
    assert f"{said} mm at most. gazebo" in page(compliant, drawn, same)


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
    for shown_text in (text, said):
        start = shown_text.index("What to record next")
        for said_once in (
            f"To separate {pair}, record the poses below (separating_poses in the JSON",
            "To separate joint compliance at joint2 from joint lag at joint2, record more poses in which the gravity "
            "torque of joint 2 and the velocity of joint 2 vary independently.",
            "To test for joint lag and time offset, give the velocities of a moving arm; record a trajectory",
            f"Poses that separate {pair} (deg)",
            "1 10.0 -20.0 30.0 40.0 50.0 60.0",
            "2 -175.0 80.0 200.0 -100.0 0.0 5.0",
            "not checked for collisions",
        ):
            assert shown_text.index(said_once) > start
        assert "from joint harmonic" not in shown_text  # rejected
        assert "from joint compliance" not in shown_text  # in the model
    assert max(map(len, shown.splitlines())) <= 60
    gaps = {"link compliance at link1": "+0.1", "joint compliance at joint2": "+0.0", "joint lag at joint2": "-5.9"}
    near = ", ".join(f"{name} (log evidence {gap})" for name, gap in gaps.items())
    assert f"Not distinguished from {near}." in said
    assert "rejected: joint harmonic of order 1 at joint2 (log evidence -6.1)" in text


FAULTS_INSTEAD = {
    "calibration_off": ({"sigma_m": 1e-5, "sigma_rad": 1e-5}, "a calibration file that is off everywhere by 10 µm and"),
    "nominal_table": ({"table": "lite6_ros"}, "the nominal table lite6_ros in place of the declared one"),
    "frame_jump": ({"candidate_rows": [30, 90]}, "a frame jump at row 30 and 90"),
    "unsettled_readouts": ({"joints": [2]}, "joint positions that were read before the arm had settled"),
    "distance_offset": ({"constant_m": 1e-4}, "a constant of 0.1 mm in all distances"),
}


@pytest.mark.parametrize("code", FAULTS_INSTEAD)
def test_a_fault_that_may_be_there_instead_is_said_beside_the_effects(undecided, drawn, code):
    numbers, phrase = FAULTS_INSTEAD[code]
    effect = parse_effect("joint_harmonic:joint=2,order=1,amplitude_rad=1e-4,phase_rad=0")[0]
    (finding,) = undecided.findings
    alternative = FaultAlternative(DataFault(code, (), numbers), 1.54, (finding.effect, effect))
    found = replace(undecided, findings=(replace(finding, faults=(alternative,)),))
    text, (_, said) = page(found, drawn), screen(found, width=60)
    for shown in (text, said):
        assert f", {phrase}" in shown
        assert ", in place of joint harmonic of order 1 at joint2 as well (log evidence -1.5)" in shown
        assert shown.count(f"To separate joint compliance at joint2 from {phrase}") == 1
    (entry,) = [entry for entry in found.to_dict()["findings"][0]["confusable_with"] if "fault" in entry]
    assert entry["instead_of"] == [
        {"effect": "joint_harmonic", "site": "joint2", "driver": "position of joint 2", "order": 1.0}
    ]


@pytest.mark.parametrize(("time", "memory"), [(np.linspace(0.0, 500.0, 200), "160 s"), (None, "64 rows")])
def test_a_read_out_that_wanders_is_an_alternative_with_its_memory(compliant, drawn, time, memory):
    corner = 1 / (0.32 * np.pi)
    wander = Unnamed("joint3", "order of recording", 0.0, 1.0, "wander", spread=1e-4, rolloff=(corner, 2.0))
    problem = compliant.problem
    timed = replace(problem, motion=problem.motion._replace(time=time))
    found = replace(with_rivals(compliant, (wander, 1.5)), problem=timed)
    other = f"a read-out of joint3 that wanders by itself with a memory of {memory}"
    text, (_, said) = page(found, drawn), screen(found, width=60)
    for shown in (text, said):
        assert f"Not distinguished from {other} (log evidence -1.5)." in shown
        assert (
            f"To separate joint compliance at joint2 from {other}, record the same poses again in another order, and "
            "the temperatures of the joints."
        ) in shown
        assert "order of recording" not in shown


def test_what_no_recording_would_change_comes_last(undecided):
    document = documented(undecided)
    for rival in document["findings"][0]["confusable_with"]:
        rival["status"] = "equivalent"
    *first, last = statements.what_to_record(document)
    assert first
    assert all(line.startswith("To test for ") for line in first)
    assert last.startswith("No recording of this kind separates joint compliance at joint2 from ")
    assert "link compliance at link1" in last
    assert last.endswith(": their effects are the same here.")


def test_two_waves_together_are_one_alternative_of_one_between_them(undecided):
    document = documented(undecided)
    finding = document["findings"][0]
    wave = {"effect": "joint_harmonic", "site": "joint4", "driver": "position of joint 4"}
    order = {"order": {"value": 1.31, "std": 0.02}}
    pair = {**wave, "order": 1.0, "log_likelihood_gap": 2.4, "status": "undecided"}
    pair["together_with"] = [{**wave, "order": 2.0}]
    finding |= {**wave, "parameters": order, "confusable_with": [pair]}
    assert statements.rivals(finding) == [
        "joint harmonic of order 1 with another of order 2 at joint4 (log evidence -2.4)"
    ]
    assert (
        "To separate joint harmonic of order 1.31 at joint4 from waves of orders 1 and 2 together, record more rows, "
        "over a wider range of joint4."
    ) in statements.what_to_record(document)
    slide = {"effect": "joint_harmonic", "site": "joint4", "driver": "position of joint 4"}
    strokes = {**slide, "period_m": 0.02, "log_likelihood_gap": 2.4, "status": "undecided"}
    finding["confusable_with"] = [{**strokes, "together_with": [{**slide, "period_m": 0.01}]}]
    assert statements.rivals(finding)[0].startswith("joint harmonic of period 20 mm with another of period 10 mm at ")
    assert statements.what_to_record(document)


def test_what_is_confounded_is_to_be_declared(compliant):
    start = "To test for effects that are confounded or not observed, "
    last = statements.what_to_record(documented(compliant))[-1]
    assert last == f"{start}measure orientations too."
    document = documented(compliant)
    document["nuisance"] = {"numbers": 2, "parts": ["base", "link"]}
    last = statements.what_to_record(document)[-1]
    assert last == f"{start}declare the sensor's frame and the arm's own calibration and measure orientations too."
    reason = statements.untested(document)[-1].reason
    assert reason.startswith("They are confounded with the fitted frames and geometry")
    assert statements.what_to_record({**document, "confounded": [], "untestable": []}) == []


# ------------------------------------------------------------------ verdicts and the JSON file


def of_six_numbers(folder, noise, **declared):
    """The diagnosis without findings of poses with noise, of a declaration that may be another."""
    calibration = write_factory(LITE6.kinematics, folder / "arm.yaml", overwrite=True)
    settings = RecordingSettings(arm="lite6", motion="static", factory_calibration=str(calibration))
    given = {"position_noise": noise, "orientation_noise": noise, "joint_noise": 0.0}
    recording = simulate(LITE6, samples=250, settings=settings, sensor="tracker_6d", **given)
    measured = recording.settings
    changed = {"position_noise_m": None, "orientation_noise_rad": None, **declared}
    return diagnosed(recording.made_anew(settings=replace(measured, **changed)), ())


@pytest.mark.parametrize("key", ["position_noise_m", "orientation_noise_rad"])
def test_a_residual_of_many_times_a_noise_that_is_declared_in_part_is_not_the_sensors_noise(tmp_path, key):
    found = of_six_numbers(tmp_path, 2e-3, **{key: 2e-5})
    document = documented(found)
    assert found.verdict == "unexplained"
    assert re.search(r"are (9\d|1\d\d) times the declared noise", verdict_statement(document))
    assert ranking.headline(document).endswith(" is not the noise of the poses alone, and nothing explains it.")
    over = document["left"]["over_noise"][key.partition("_")[0]]
    assert over == pytest.approx(100, rel=0.2)
    as_declared = of_six_numbers(tmp_path, 2e-5, **{key: 2e-5})
    assert as_declared.verdict == "consistent"


def test_poses_of_the_controller_test_the_table_alone(compliant):
    document = documented(compliant)
    none = {**document, "findings": [], "source": "controller_fk"}
    none["model"] = {**document["model"], "effects": []}
    assert verdict_statement({**none, "verdict": "consistent"}) == (
        "Consistent: the table of the arm reproduces what the controller computed from the joints."
    )
    assert statements.cautions(none)[0].startswith("The poses are the controller's own computation from the joints")
    assert "To diagnose the arm itself, record the poses with a sensor." in reported(none)[1]
    assert "The poses are the controller's own computation" not in reported(document)[1]


def test_the_verdict_says_what_the_numbers_say(compliant):
    document = documented(compliant)

    def verdict(code, declared=2e-5, position=1.0, orientation=None, white=True, rows=None, turned=False):
        known = {"position_m": declared} | ({"orientation_rad": None} if turned else {})
        noise = {"declared": known, "estimated": {"position_m": 2e-5}}
        left = {"over_noise": {"position": position, "orientation": orientation}, "white": white, "acts_at": None}
        changed = {"verdict": code, "noise": noise, "left": left, "rows_needed": rows}
        return verdict_statement({**document, **changed})

    assert verdict("consistent") == "Consistent: the model of the arm and the sensor's noise explain the recording."
    assert "which are 5.5 times the declared noise: check the arm" in verdict("unexplained", position=5.5)
    assert verdict("unexplained", position=2.34, white=False) == (
        "Unexplained: what is left is not the sensor's noise alone, and no effect is significant. Held-out "
        "position errors are 2.3 times the declared noise and neighbouring rows are correlated."
    )
    assert verdict("partly_explained", position=1.1, orientation=8.0) == (
        "Partly explained: the effects below are significant. Held-out position errors are 1.1 times the declared "
        "noise and orientation errors are 8 times the declared noise."
    )
    for turned, said in ((False, "position_noise_m."), (True, "position_noise_m and no orientation_noise_rad.")):
        assert verdict("consistent", declared=None, turned=turned).endswith(
            f"not tested, as the sidecar declares no {said}"
        )
        assert verdict("partly_explained", declared=None, turned=turned).endswith(
            f"because the sidecar declares no {said}"
        )
    document = {**document, "findings": [], "nearest": None}
    assert verdict("undetermined", rows=document["samples"] + 30) == (
        "Undetermined: there are too few rows to tell whether something is missing. Record about 30 more poses."
    )
    document["nearest"] = {"effect": "joint_scale", "site": "joint1", "p_value": 0.02}
    assert verdict("undetermined", rows=document["samples"] + 1) == (
        "Undetermined: what is left is noise, but joint scale at joint1 is nearly significant (family-wise p-value "
        "0.02). Record about 1 more pose."
    )


def test_statements_are_added_to_codes_and_nothing_is_taken_away(compliant):
    plain, stated = compliant.to_dict(), documented(compliant)

    def without(entry, key):
        assert entry[key]
        return {name: value for name, value in entry.items() if name != key}

    for name, key in (("findings", "statement"), ("untestable", "reason")):
        assert [without(entry, key) for entry in stated[name]] == plain[name]
    assert {name: value for name, value in stated.items() if name not in ("findings", "untestable")} == {
        name: value for name, value in plain.items() if name not in ("findings", "untestable")
    }
    again = json.loads(json.dumps(plain, allow_nan=False))
    assert statements.with_statements(again) == json.loads(json.dumps(stated))


@pytest.mark.parametrize(("times", "is_said"), [(None, False), (1.2, False), (2.4, True)])
def test_blocks_that_scatter_much_more_than_the_fit_says_are_said(compliant, drawn, times, is_said):
    finding = compliant.findings[0]
    if times is not None:
        finding = replace(finding, block_std=times * np.sqrt(np.diagonal(finding.covariance)))
    entry = replace(compliant, findings=(finding,)).to_dict()["findings"][0]
    assert ("fit_std" in entry) == (times is not None)
    plain = compliant.to_dict()["findings"][0]
    for name, estimate in entry["parameters"].items():
        std = plain["parameters"][name]["std"]
        assert estimate == {"value": plain["parameters"][name]["value"], "std": pytest.approx((times or 1.0) * std)}
        assert entry.get("fit_std", {}).get(name, std) == std
    said = "Between blocks of the recording its numbers scatter 2.4 times as much as the noise lets expect"
    for text in (page(replace(compliant, findings=(finding,)), drawn), statements.finding_statement(entry)):
        assert (said in text) == is_said


def test_a_number_that_is_not_finite_is_unknown():
    for shown in (
        formatting.number,
        formatting.significant,
        formatting.milli,
        formatting.multiple,
        formatting.fixed,
        formatting.plus_minus,
    ):
        assert [shown(value) for value in (np.inf, -np.inf, np.nan)] == ["unknown"] * 3
    assert formatting.each_with_unit([1.0, np.nan], ("Nm", "Nm")) == "1, unknown Nm"


def test_where_stderr_is_no_terminal_a_line_comes_from_time_to_time(monkeypatch, capsys):
    monkeypatch.setattr(terminal, "EVERY", 0.01)
    with terminal.stages() as follow:
        follow(Stage("naming", 1, 5))
        until = time.monotonic() + 10.0
        heard = ""
        while "testing names" not in heard and time.monotonic() < until:
            time.sleep(0.01)
            heard += capsys.readouterr().err
    assert "testing names, without block 1 of 4: 0:00 so far" in heard
