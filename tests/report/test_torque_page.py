"""The figures and the page of a diagnosis of torques show what was found, with units, and need no other file."""

import base64
import re
from io import BytesIO

import numpy as np
import pytest
from diagnosed import Reader
from matplotlib.image import imread
from torque_diagnosed import COULOMB, EFFECTS, LITE6, VISCOUS, diagnosed, moved, recorded

import lite6jax
from lite6jax.cli import main
from lite6jax.diagnosis import evidence_map
from lite6jax.diagnosis.document import to_document
from lite6jax.diagnosis.partial_residuals import finding_curves
from lite6jax.effects.dynamic.friction import CoulombFriction, ViscousFriction
from lite6jax.effects.dynamic.unnamed import UnnamedTorque
from lite6jax.errors import InputError
from lite6jax.recordings import write_recording
from lite6jax.recordings.fault import DataFault
from lite6jax.report import canvas, torque_figures, worth
from lite6jax.report.torque_page import torque_page
from lite6jax.report.torque_statements import with_statements

FRICTION = (ViscousFriction(2), CoulombFriction(2))


def documented(found):
    return with_statements(to_document(found))


def paged(found, source="run.csv"):
    drawn = dict(torque_figures.drawings(found, "run.csv"))
    return torque_page(found, documented(found), source, drawn)


def text_of(html):
    page = Reader(html)
    assert page.open == []
    return " ".join(page.text.split())


@pytest.fixture(scope="module")
def found():
    fault = DataFault("torque_spikes", (7, 9), {"joints": [3], "count": 2})
    return diagnosed(recorded(), FRICTION, (fault,))


@pytest.fixture(scope="module")
def drawn(found):
    return dict(torque_figures.drawings(found, "run.csv"))


@pytest.fixture(scope="module")
def html(found, drawn):
    return torque_page(found, documented(found), "folder/run.csv", drawn)


def test_the_cause_comes_first_and_all_that_was_found_is_said(found, html):
    text, document = text_of(html), documented(found)
    said = worth.headline(document)
    assert said.startswith("Joint 2 rubs ")
    assert text.index(said) < text.index("Explained: ") < text.index("What each finding moves")
    for joint in range(6):
        pair = (np.sqrt(np.mean(errors[joint] ** 2)) for errors in (found.before, found.after))
        assert "joint {}, RMS {:.3g} {:.3g}".format(joint + 1, *pair) in text
    for finding in document["findings"]:
        assert finding["statement"] in text
    row = re.search(r"viscous ([\d.]+) ([\d.]+) Nm·s/rad", text)
    assert row
    assert float(row[1]) == pytest.approx(VISCOUS, abs=5 * float(row[2]))
    row = re.search(r"coulomb ([\d.]+) ([\d.]+) Nm ", text)
    assert row
    assert float(row[1]) == pytest.approx(COULOMB, abs=5 * float(row[2]))
    assert "not distinguish it from: torque offset at joint1" in text
    assert "rejected: torque offset at joint6" in text
    assert document["data_faults"][0]["statement"] in text
    assert "Rows 7, 9." in text
    assert "0.06, 0.08, 0.05, 0.02, 0.02, 0.015 Nm are declared" in text
    assert "friction temperature at joint1–6" in text  # not tested: no temperatures


def test_the_page_is_one_file(html):
    page = Reader(html)
    assert "http" not in re.sub(r"base64,[A-Za-z0-9+/=]+", "", html)
    assert not {tag for tag, _ in page.tags} & {"script", "link", "iframe", "object", "embed", "base"}
    pictures = [attributes for tag, attributes in page.tags if tag == "img"]
    assert len(pictures) == 4 + 2
    for attributes in pictures:
        assert attributes["alt"].endswith(".")
        assert imread(BytesIO(base64.b64decode(attributes["src"].partition("base64,")[2]))).ndim == 3


@pytest.mark.usefixtures("unpainted")
def test_names_are_text(found, drawn):
    hostile = "<script>alert('1')</script>{{ 7*7 }}.csv"
    page = torque_page(found, documented(found), hostile, drawn)
    assert "<script" not in page
    assert hostile in Reader(page).text


@pytest.mark.usefixtures("unpainted")
def test_nothing_missing():
    clean = diagnosed(recorded(friction=False))
    drawn = dict(torque_figures.drawings(clean, "run.csv"))
    assert list(drawn) == ["error_by_joint", "over_time", "friction", "spectra"]
    text = text_of(torque_page(clean, documented(clean), "run.csv", drawn))
    assert text.count("Consistent: the inverse dynamics") == 1
    assert "None: no effect of the catalogue" in text
    assert [panel.texts[0].get_text() for panel in drawn["friction"].axes] == ["no friction over velocity found"] * 6


def test_bars_are_the_errors_of_each_joint(found, drawn):
    (panel,) = drawn["error_by_joint"].axes
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("joint", "torque error (Nm RMS)")
    for bars, errors in zip(panel.containers, (found.before, found.after), strict=True):
        np.testing.assert_allclose([bar.get_height() for bar in bars], np.sqrt(np.mean(errors**2, 1)))
    spread = [segment[0, 1] for segment in panel.collections[0].get_segments()]
    np.testing.assert_allclose(spread, np.std(found.problem.measured, axis=1))


def test_torques_over_time(found, drawn):
    figure = drawn["over_time"]
    assert [panel.get_ylabel() for panel in figure.axes] == [f"torque of joint {j} (Nm)" for j in range(1, 7)]
    assert figure.legends[0].get_texts()[0].get_text() == "measured"
    measured, rigid, modelled = (line.get_ydata() for line in figure.axes[1].lines)
    assert np.sqrt(np.mean((measured - rigid) ** 2)) > 10 * np.sqrt(np.mean((measured - modelled) ** 2))
    shown = evidence_map.torques_over_time(found)
    time = np.asarray(found.problem.data.time)
    at = np.searchsorted(time, shown.time[0])
    np.testing.assert_allclose(shown.measured, found.problem.measured[:, at : at + len(shown.time)])


def test_friction_is_a_line_through_what_is_left(found, drawn):
    friction = evidence_map.joint_frictions(found)[1]
    away = np.abs(friction.at) > 0.05
    planted = VISCOUS * friction.at + COULOMB * np.sign(friction.at)
    np.testing.assert_allclose(friction.friction[away], planted[away], atol=0.05)
    moving = np.abs(friction.velocity) > 0.1
    there = VISCOUS * friction.velocity + COULOMB * np.sign(friction.velocity)
    assert np.sqrt(np.mean((friction.partial - there)[moving] ** 2)) < 0.1
    panel = drawn["friction"].axes[1]
    assert panel.get_xlabel() == "velocity of joint 2 (deg/s)"
    assert panel.get_ylabel() == "torque left at joint 2 (Nm)"


def test_every_kind_of_finding_draws():
    found = diagnosed(recorded(), EFFECTS)
    figure = dict(torque_figures.drawings(found, "run.csv"))["findings"]
    labels = [panel.get_xlabel() for panel in figure.axes if panel.get_visible()]
    assert labels == [
        *("velocity of joint 2 (deg/s)", "direction of motion of joint 2", "time (s)", "fitted torque at joint 1 (Nm)"),
        *("position of joint 4 (deg)", "position of joint 5 (deg)"),
        *(label for label in labels[6:]),
    ]
    assert all(re.fullmatch(r"fitted torque at joint \d \(Nm\)", label) for label in labels[6:])
    for (curve,) in (finding_curves(found, k) for k in range(len(EFFECTS))):
        assert np.isfinite(np.concatenate([curve.driver, curve.partial, curve.at, curve.curve, curve.std])).all()
        assert np.all(np.diff(curve.at) >= 0)


@pytest.mark.usefixtures("unpainted")
@pytest.mark.parametrize("signed", [False, True])
def test_a_curve_without_a_name_passes_through_its_partial_residuals(signed):
    _, q, dq, _ = moved()
    bump = 0.8 * np.exp(-(((q[1] - q[1].mean()) / 0.25) ** 2))
    extra = np.zeros_like(q)
    extra[1] = bump * np.sign(dq[1]) if signed else bump
    curve = UnnamedTorque(2, "position of joint 2", float(q[1].min()), float(q[1].max()), 10, signed)
    found = diagnosed(recorded(friction=False, extra=extra), (curve,))
    (shown,) = finding_curves(found, 0)
    planted = 0.8 * np.exp(-(((shown.at - q[1].mean()) / 0.25) ** 2))
    assert np.sqrt(np.mean((shown.curve - planted) ** 2)) < 0.05
    near = np.interp(shown.driver, shown.at, shown.curve)
    assert np.corrcoef(near, shown.partial)[0, 1] > 0.9
    text = text_of(paged(found))
    times = ", multiplied by the direction of motion" if signed else ""
    of = f"a torque at joint2 that is a function of the position of joint 2{times}"
    assert "Joint 2 has a torque that no effect of the catalogue names: " in text
    assert f"No effect of the catalogue explains {of}: it contributes " in text
    assert "peak to peak" in text
    assert not re.search(r"coefficient|level|step\d", text)


@pytest.mark.usefixtures("unpainted")
def test_a_curve_that_names_nearly_describe_says_so():
    _, q, dq, _ = moved()
    extra = np.zeros_like(q)
    extra[1] = np.sign(dq[1]) * (2.0 + 1.5 * np.abs(dq[1]) ** 1.5)
    curve = UnnamedTorque(2, "speed of joint 2", 0.0, float(np.abs(dq[1]).max()), 4, signed=True)
    found = diagnosed(recorded(friction=False, extra=extra), (curve,))
    described = found.to_dict()["findings"][0]["described_by"]
    A = np.stack([dq[1], np.sign(dq[1])], 1)  # filtering changes both sides alike, but for the ends and the jumps
    viscous, coulomb = np.linalg.lstsq(A, extra[1], rcond=None)[0]
    numbers = {entry["effect"]: next(iter(entry["parameters"].values())) for entry in described["effects"]}
    assert numbers == {
        "viscous_friction": pytest.approx(viscous, abs=0.1),
        "coulomb_friction": pytest.approx(coulomb, abs=0.1),
    }
    left = extra[1] - A @ (viscous, coulomb)
    assert described["share"] == pytest.approx(1 - np.sum(left**2) / np.sum(extra[1] ** 2), abs=0.01)
    text = text_of(paged(found))
    share = f"{100 * described['share']:.0f} %"
    assert f"Joint 2 has a torque that viscous friction and Coulomb friction describe to {share}: " in text
    sizes = r"Viscous friction of \d.\d+ Nm·s/rad and Coulomb friction of \d.\d+ Nm"
    assert re.search(f"{sizes} would give {share} of its mean square", text)


@pytest.mark.usefixtures("unpainted")
def test_a_curve_of_two_drivers_has_a_point_for_each_sample():
    _, q, dq, _ = moved()
    further = (float(dq[1].min()), float(dq[1].max()))
    drivers = "position of joint 2 and velocity of joint 2"
    curve = UnnamedTorque(2, drivers, float(q[1].min()), float(q[1].max()), degree=2, further=further)
    found = diagnosed(recorded(), (curve,))
    (shown,) = finding_curves(found, 0)
    assert shown.hysteresis
    assert shown.at.shape == shown.curve.shape == shown.partial.shape
    assert "position of joint 2 and the velocity of joint 2" in text_of(paged(found))


@pytest.mark.usefixtures("unpainted")
def test_without_declared_noise(found):
    text = text_of(paged(diagnosed(recorded(declared=False), FRICTION)))
    assert "the sidecar declares no torque_noise_Nm" in text
    assert "none is declared" in text


@pytest.mark.usefixtures("unpainted")
def test_the_command_writes_both(tmp_path, monkeypatch, capsys, found):
    run = write_recording(recorded(), tmp_path / "<b>run.csv")
    monkeypatch.setattr("lite6jax.diagnosis.torque_diagnosis.diagnose_torques", lambda *_, **__: found)
    out, report, figures = (str(tmp_path / name) for name in ("d.json", "r.html", "figures"))
    assert main(["diagnose", str(run), "--out", out, "--report", report, "--figures", figures]) == 0
    page = (tmp_path / "r.html").read_text()
    assert "&lt;b&gt;run.csv" in page
    assert "<b>" not in page
    names = {path.name for path in (tmp_path / "figures").iterdir()}
    assert names == {f"<b>run_{name}{suffix}" for name in torque_figures.NAMES for suffix in canvas.SUFFIXES}
    said = capsys.readouterr().out
    assert "r.html" in said
    assert "<b>run_friction.png" in said

    def never(*_, **__):
        raise AssertionError("checked before long work")

    monkeypatch.setattr("lite6jax.diagnosis.torque_diagnosis.diagnose_torques", never)
    others = ["diagnose", str(run), "--out", str(tmp_path / "e.json")]
    assert main([*others, "--report", report]) == 2
    assert "r.html: exists already; choose another name or add --force" in capsys.readouterr().err
    (tmp_path / "figures" / "<b>run_error_by_joint.png").unlink()
    assert main([*others, "--figures", figures]) == 2
    assert "exists already" in capsys.readouterr().err
    assert not (tmp_path / "e.json").exists()


def test_a_summary_is_sentences_and_a_table(found):
    text = found.summary()
    assert text.startswith("Joint 2 rubs ")
    assert re.search(r"viscous 2\.0\d* ± 0\.\d+ Nm·s/rad", text)
    assert text.endswith(".")
    table = found._repr_html_()
    assert table.count("<tr>") == 7
    assert "held-out torque error before, of each joint (Nm RMS)" in table
    assert not re.search(r"https?:|src=|href=|style|script", table)


def test_poses_and_torques_have_functions_of_their_own():
    with pytest.raises(InputError, match=r"has torques and no poses; call lite6jax\.diagnose_torques$"):
        lite6jax.diagnose(recorded(), LITE6)
