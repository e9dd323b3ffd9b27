"""The page of a diagnosis says all that was found, in words and units, needs no other file, and is safe to open."""

import base64
import re
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from diagnosed import COMPLIANCE, Reader, diagnosed, documented
from matplotlib.image import imread
from torque_diagnosed import COULOMB, VISCOUS
from torque_diagnosed import diagnosed as torques_diagnosed
from torque_diagnosed import recorded as torques_recorded

from lite6jax.cli import main
from lite6jax.diagnosis.evidence_map import explained_shares
from lite6jax.recordings import write_recording
from lite6jax.report import ranking
from lite6jax.report.diagnosis_figures import drawings, figure_names
from lite6jax.report.figures import SUFFIXES
from lite6jax.report.pages import certificate, diagnosis_page, write_certificate

DOMAINS = ("poses", "torques")
both_domains = pytest.mark.parametrize("domain", DOMAINS)


@pytest.fixture(scope="module")
def shown(found, motors):
    """By domain a diagnosis, its figures and its page."""
    made = {}
    for domain, one in zip(DOMAINS, (found, motors), strict=True):
        figures = dict(drawings(one, "run.csv"))
        made[domain] = one, figures, diagnosis_page(one, documented(one), "folder/run.csv", figures)
    return made


def text_of(html):
    page = Reader(html)
    assert page.open == []
    return " ".join(page.text.split())


def row_of(pattern, text):
    """The numbers of a row of a table."""
    seen = re.search(pattern, text)
    assert seen, pattern
    return [float(number) for number in seen.groups()]


# ------------------------------------------------------------------ both domains


@both_domains
def test_the_page_is_one_file(shown, domain):
    html = shown[domain][2]
    page = Reader(html)
    assert "http" not in re.sub(r"base64,[A-Za-z0-9+/=]+", "", html)
    assert not {tag for tag, _ in page.tags} & {"script", "link", "iframe", "object", "embed", "base"}
    assert "url(" not in html
    assert "@import" not in html
    pictures = [attributes for tag, attributes in page.tags if tag == "img"]
    assert len(pictures) == 2 + (3 if domain == "poses" else 4)
    for attributes in pictures:
        kind, _, data = attributes["src"].partition("base64,")
        assert kind == "data:image/png;"
        assert attributes["alt"].endswith(".")
        assert imread(BytesIO(base64.b64decode(data))).ndim == 3
    assert not any(name.startswith("on") for _, attributes in page.tags for name in attributes)


@both_domains
@pytest.mark.usefixtures("unpainted")
def test_names_are_text(shown, domain):
    found, drawn, _ = shown[domain]
    hostile = "<script>alert('1')</script>\"><img src=x onerror=alert(1)>{{ 7*7 }}.csv"
    html = diagnosis_page(found, documented(found), hostile, drawn)
    page = Reader(html)
    assert "script" not in {tag for tag, _ in page.tags}
    assert "49" not in page.text.split(".csv")[0]
    assert hostile in page.text
    assert "<script" not in html


@both_domains
@pytest.mark.usefixtures("unpainted")
def test_nothing_missing(clean, domain):
    found = clean if domain == "poses" else torques_diagnosed(torques_recorded(friction=False))
    drawn = dict(drawings(found, "run.csv"))
    names, said = {
        "poses": (
            figure_names(["poses"]),
            "Consistent: the model of the arm and the sensor's noise explain the recording.",
        ),
        "torques": (
            figure_names(["torques"]),
            "Consistent: the inverse dynamics of the declared arm and the sensors' noise",
        ),
    }[domain]
    assert list(drawn) == [name for name in names if name != "findings"]
    html = diagnosis_page(found, documented(found), "run.csv", drawn)
    text = text_of(html)
    assert text.count(said) == 1
    assert "None: no effect of the catalogue" in text
    assert "Data faults None found." in text
    assert html.count("<img") == (3 if domain == "poses" else 4)
    if domain == "torques":
        panels = drawn["friction"].axes
        assert [panel.texts[0].get_text() for panel in panels] == ["no friction over velocity found"] * 6
    else:
        shares = explained_shares(found).shares
        assert np.nanmax(shares) < 0.2
        assert np.nanmedian(shares) < 0.02


@both_domains
@pytest.mark.usefixtures("unpainted")
def test_the_command_writes_both(tmp_path, recorded, motors, monkeypatch, capsys, domain):
    recording, effects = recorded(COMPLIANCE)
    found, search, names = diagnosed(recording, effects), "lite6jax.diagnosis.diagnose.diagnose", figure_names([domain])
    if domain == "torques":
        recording, found = torques_recorded(), motors
    run = write_recording(recording, tmp_path / "<b>run.csv")
    monkeypatch.setattr(search, lambda *_, **__: found)
    out, report, figures = (str(tmp_path / name) for name in ("d.json", "r.html", "figures"))
    assert main(["diagnose", str(run), "--out", out, "--report", report, "--figures", figures]) == 0
    page = (tmp_path / "r.html").read_text()
    assert "&lt;b&gt;run.csv" in page
    assert "<b>" not in page
    written = {path.name for path in (tmp_path / "figures").iterdir()}
    assert written == {f"<b>run_{name}{suffix}" for name in names for suffix in SUFFIXES}
    said = capsys.readouterr().out
    assert "r.html" in said
    assert "<b>run_error_by_joint.png" in said

    def never(*_, **__):
        raise AssertionError("checked before long work")

    monkeypatch.setattr(search, never)
    others = ["diagnose", str(run), "--out", str(tmp_path / "e.json")]
    for more, message in (
        (["--report", report], "r.html: exists already; choose another name or add --force"),
        (["--report", str(tmp_path / "r.pdf")], "r.pdf: what is written here is html; let the name end in .html"),
        (["--figures", figures], "run_error_by_joint.png: exists already"),
    ):
        assert main([*others, *more]) == 2
        assert message in capsys.readouterr().err
    assert not (tmp_path / "e.json").exists()


# ------------------------------------------------------------------ poses


def test_all_that_was_found_is_said(shown):
    found, _, html = shown["poses"]
    text = text_of(html)
    assert [tag for tag, _ in Reader(html).tags].count("h1") == 1
    assert text.index("Explained: with the effects below") < text.index("Held-out errors")
    kept = ~found.outliers
    for errors in (found.before, found.after):
        mm = 1e3 * errors[kept]
        for value in (np.sqrt(np.mean(mm**2)), np.percentile(mm, 95), mm.max()):
            assert f"{value:.4f}" in text
    assert f"{kept.sum()} rows" in text
    first = "1. Joint compliance at joint2 Joint compliance at joint2, a function of the gravity torque of joint 2"
    assert first in text
    assert "2. Joint harmonic of order 2 at joint1" in text
    compliance, std = 1e6 * found.fit.values[0], 1e6 * np.sqrt(found.fit.covariance[0, 0])
    value, deviation = row_of(r"compliance ([\d.]+) ± ([\d.]+) µrad/Nm", text)
    assert value == pytest.approx(compliance, abs=std)
    assert deviation == pytest.approx(std, rel=0.06)
    assert re.search(r"amplitude 0\.\d+ ± 0\.\d+ mrad, phase \d+\.\d+ ± \d\.\d+ deg", text)
    assert "Family-wise p-value 1.0e-09 over all effects, sites and orders searched." in text
    assert "Not distinguished from joint compliance at joint2 (log evidence -1.5)" in text
    assert "rejected: joint compliance at joint2 (log evidence -44.0)" in text
    assert "2 rows are outliers" in text
    assert ", ".join(map(str, found.problem.recording.row[[3, 5]])) in text
    assert "0.0200 mm is declared" in text


# ------------------------------------------------------------------ torques


def test_the_cause_comes_first_and_all_that_was_found_is_said(shown):
    found, _, html = shown["torques"]
    text, document = text_of(html), documented(found)
    said = ranking.headline(document)
    assert said.startswith("Joint 2 has friction ")
    assert text.index(said) < text.index("Explained: ") < text.index("What each finding moves")
    for joint in range(6):
        pair = (np.sqrt(np.mean(errors[joint] ** 2)) for errors in (found.before, found.after))
        assert "joint {} (Nm), RMS {:.3g} {:.3g}".format(joint + 1, *pair) in text
    for finding in document["findings"]:
        assert finding["statement"] in text
    for name, unit, truth in (("viscous", "Nm·s/rad", VISCOUS), ("coulomb", "Nm;", COULOMB)):
        value, std = row_of(rf"{name} ([\d.]+) ± ([\d.]+) {unit}", text)
        assert value == pytest.approx(truth, abs=5 * std)
    assert "Not distinguished from torque offset at joint1" in text
    assert "rejected: torque offset at joint6" in text
    assert document["data_faults"][0]["statement"] in text
    assert "Rows 7, 9." in text
    assert "0.06, 0.08, 0.05, 0.02, 0.02, 0.015 Nm are declared" in text
    assert "Friction temperature at joint1–6" in text  # not tested: no temperatures


# ------------------------------------------------------------------ the certificate


INPUTS = [{"role": "recording", "file": "run7.csv", "sha256": "ab" * 32}]


@pytest.fixture(scope="module")
def document(found):
    return {**documented(found), "inputs": INPUTS, "date": "2026-11-21", "instrument": "tracker 7"}


@pytest.fixture(scope="module")
def of_motors(motors):
    return {**documented(motors), "inputs": INPUTS}


def texts(figure):
    return [text.get_text() for text in figure.texts]


def flat_text(figure):
    return " ".join(" ".join(texts(figure)).split())


def certified(figure, name):
    """The cells of a row of the table."""
    (line,) = [line for line in texts(figure) if line.startswith(f"{name} ")]
    return line.removeprefix(name).split(maxsplit=2)


def test_the_figures_are_those_of_the_document(document):
    page = certificate(document)
    said = flat_text(page)
    assert said.startswith("Certificate of accuracy")
    for part in ("Arm lite6", "Date 2026-11-21", "run7.csv, 200 rows, static", "ab" * 32):
        assert part in said
    assert "tracker 7; declared noise 0.0200 mm" in said
    for key, name in (("mean", "mean"), ("rms", "RMS"), ("p95", "95th percentile"), ("max", "maximum")):
        before, after = (1e3 * document[stage][f"heldout_position_{key}_m"] for stage in ("before", "after"))
        *cells, ratio = certified(page, f"position error (mm), {name}")
        assert [float(cell) for cell in cells] == pytest.approx([before, after], abs=6e-5)
        assert ratio == f"{100 * after / before:.0f} %"


def test_the_sidecar_says_when_and_with_what(found, tmp_path):
    recording = found.problem.recording
    settings = replace(recording.settings, date="2026-11-20", instrument="tracker 9")
    declared = replace(found, problem=replace(found.problem, recording=replace(recording, settings=settings)))
    document = documented(declared)
    said = flat_text(certificate(document))
    assert "Date 2026-11-20" in said
    assert "Instrument tracker 9; declared noise" in said
    assert b"CreationDate (D:20261120000000" in write_certificate(document, tmp_path / "c.pdf").read_bytes()
    assert flat_text(certificate(documented(found))).count("not stated") == 1


def test_one_page_and_the_same_bytes(document, tmp_path):
    paths = [write_certificate(document, tmp_path / f"{name}.pdf") for name in "ab"]
    first, second = (path.read_bytes() for path in paths)
    assert first == second
    assert len(re.findall(rb"/Type /Page\b", first)) == 1
    undated = write_certificate({**document, "date": None}, tmp_path / "c.pdf").read_bytes()
    assert b"CreationDate" not in undated
    width, height = map(float, re.search(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+)", first).groups())
    assert (width / 72, height / 72) == pytest.approx((8.27, 11.69), abs=0.01)  # A4


def test_everything_stays_inside_the_page(document, of_motors):
    effects = of_motors["model"]["effects"] * 20
    many = {**of_motors, "findings": of_motors["findings"] * 20, "model": {**of_motors["model"], "effects": effects}}
    for each in (document, of_motors, many):
        figure = certificate(each)
        figure.canvas.draw()
        for text in figure.texts:
            box = text.get_window_extent()
            assert 0 < box.x0 < box.x1 < figure.bbox.x1, text.get_text()
            assert box.y0 > 0, text.get_text()
