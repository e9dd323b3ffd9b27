"""A diagnosis' page says all that was found, in words and units, needs no other file, and is safe to open."""

import base64
import re
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from diagnosed import COMPLIANCE, HARMONIC, Reader, diagnosed, documented, recording_maker
from matplotlib.image import imread

from lite6jax.cli import main
from lite6jax.diagnosis.evidence_map import explained_shares
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.recordings import write_recording
from lite6jax.report import canvas, diagnosis_figures
from lite6jax.report.next_steps import Files
from lite6jax.report.page import diagnosis_page
from lite6jax.report.panels import medians


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return recording_maker(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def found(recorded):
    return diagnosed(*recorded(COMPLIANCE, HARMONIC), outliers=(3, 5))


@pytest.fixture(scope="module")
def drawn(found):
    return dict(diagnosis_figures.drawings(found, "run.csv"))


@pytest.fixture(scope="module")
def html(found, drawn):
    return diagnosis_page(found, documented(found), "folder/run.csv", drawn)


def test_all_that_was_found_is_said(found, html):
    page = Reader(html)
    assert page.open == []
    text = " ".join(page.text.split())
    assert [tag for tag, _ in page.tags].count("h1") == 1
    assert text.index("Explained: with the effects below") < text.index("held-out position error")
    kept = ~found.outliers
    for errors in (found.before, found.after):
        mm = 1e3 * errors[kept]
        for value in (np.sqrt(np.mean(mm**2)), np.percentile(mm, 95), mm.max()):
            assert f"{value:.4f}" in text
    assert f"{kept.sum()} rows" in text
    assert (
        "1. Joint compliance at joint2 Joint compliance at joint2, a function of the gravity torque of joint 2" in text
    )
    assert "2. Joint harmonic of order 2 at joint1" in text
    compliance, std = 1e6 * found.fit.values[0], 1e6 * np.sqrt(found.fit.covariance[0, 0])
    row = re.search(r"compliance ([\d.]+) ([\d.]+) µrad/Nm", text)
    assert row
    assert float(row[1]) == pytest.approx(compliance, abs=std)
    assert float(row[2]) == pytest.approx(std, rel=0.06)
    assert re.search(r"order 2 – amplitude 0\.\d+ 0\.\d+ mrad phase \d+\.\d+ \d\.\d+ deg", text)
    assert "Family-wise p-value 1.0e-09 over all effects, sites and orders searched." in text
    assert "This recording does not distinguish it from: joint compliance at joint2 (log-likelihood -1.5)" in text
    assert "rejected: joint compliance at joint2 (log-likelihood -44.0)" in text
    assert "2 rows are outliers" in text
    assert ", ".join(map(str, found.problem.recording.row[[3, 5]])) in text
    for item in found.untestable:
        assert f"{item.effect.name.replace('_', ' ')} at " in text
    lacking = "The recording has no velocity of these joints. joint lag at joint1–6"
    assert text.count(lacking) == 1  # once for all six
    assert "joint offset at joint1, 2" in text  # confounded with the nuisance
    assert "0.0200 mm is declared" in text


def test_the_page_is_one_file(html):
    page = Reader(html)
    assert "http" not in re.sub(r"base64,[A-Za-z0-9+/=]+", "", html)
    assert not {tag for tag, _ in page.tags} & {"script", "link", "iframe", "object", "embed", "base"}
    assert "url(" not in html
    assert "@import" not in html
    pictures = [attributes for tag, attributes in page.tags if tag == "img"]
    assert len(pictures) == 4 + 2
    for attributes in pictures:
        kind, _, data = attributes["src"].partition("base64,")
        assert kind == "data:image/png;"
        assert attributes["alt"].endswith(".")
        assert imread(BytesIO(base64.b64decode(data))).ndim == 3
    assert not any(name.startswith("on") for _, attributes in page.tags for name in attributes)


def test_the_same_diagnosis_gives_the_same_page(found, html):
    again = dict(diagnosis_figures.drawings(found, "run.csv"))
    assert diagnosis_page(found, documented(found), "folder/run.csv", again) == html


@pytest.mark.usefixtures("unpainted")
def test_names_are_text(found, drawn):
    hostile = "<script>alert('1')</script>\"><img src=x onerror=alert(1)>{{ 7*7 }}.csv"
    html = diagnosis_page(found, documented(found), hostile, drawn)
    page = Reader(html)
    assert "script" not in {tag for tag, _ in page.tags}
    assert "49" not in page.text.split(".csv")[0]
    assert hostile in page.text
    assert "<script" not in html


@pytest.mark.usefixtures("unpainted")
def test_nothing_missing(recorded):
    clean = diagnosed(*recorded())
    drawn = dict(diagnosis_figures.drawings(clean, "run.csv"))
    assert list(drawn) == ["error_by_joint", "where", "orders", "remaining"]
    page = Reader(diagnosis_page(clean, documented(clean), "run.csv", drawn))
    text = " ".join(page.text.split())
    assert "Consistent: the model of the arm and the sensor's noise explain the recording." in text
    assert "None: no effect of the catalogue" in text
    assert "Data faults None found." in text
    assert len([tag for tag, _ in page.tags if tag == "img"]) == 4
    shares = explained_shares(clean).shares
    assert np.nanmax(shares) < 0.2
    assert np.nanmedian(shares) < 0.02


@pytest.mark.usefixtures("unpainted")
def test_physics_without_a_name(recorded):
    recording, _ = recorded(HARMONIC)
    curve = Unnamed("joint1", "position of joint 1", -np.pi, np.pi, 8)
    found = diagnosed(recording, (curve,))
    drawn = dict(diagnosis_figures.drawings(found, "run.csv"))
    text = " ".join(Reader(diagnosis_page(found, documented(found), "run.csv", drawn)).text.split())
    assert "Unnamed: no effect of the catalogue explains the largest effect that was found." in text
    assert "1. Unnamed effect at joint1, a smooth curve over its position" in text
    assert "explains an effect at joint1, a function of the position of joint 1: a smooth curve, peak to peak" in text
    assert "coefficient" not in text
    row = re.search(r"unit peak to peak ([\d.]+) ([\d.]+) mrad", text)
    assert row
    assert float(row[1]) == pytest.approx(0.8, abs=4 * float(row[2]))  # twice the amplitude
    assert float(row[2]) < 0.1


def test_a_panel_for_each_joint(found, drawn):
    figure = drawn["error_by_joint"]
    assert [panel.get_xlabel() for panel in figure.axes] == [f"joint {i} (deg)" for i in range(1, 7)]
    assert figure.axes[0].get_ylabel() == figure.axes[3].get_ylabel() == "position error (mm)"
    assert "run.csv" in figure.get_suptitle()
    kept = ~found.outliers
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    rms = [1e3 * np.sqrt(np.mean(errors[kept] ** 2)) for errors in (found.before, found.after)]
    assert labels == [
        f"{name}: {value:.3g} mm RMS, held out" for name, value in zip(("before", "after"), rms, strict=True)
    ]
    q = np.rad2deg(np.asarray(found.problem.motion.joint_position)[:, kept])
    for joint, panel in enumerate(figure.axes):
        dots = panel.lines[0]
        np.testing.assert_allclose(dots.get_xdata(), q[joint])
        np.testing.assert_allclose(dots.get_ydata(), 1e3 * found.before[kept])


def test_where_it_is(recorded):
    only = diagnosed(*recorded(COMPLIANCE))
    sites, drivers, shares = explained_shares(only)
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
    figure = diagnosis_figures.explained_map(only, "run.csv")
    panel, bar = figure.axes
    assert bar.get_ylabel() == f"explained variance (%), scaled to {100 * most:.2g} %"
    assert panel.images[0].get_clim() == (0, pytest.approx(100 * most))
    assert panel.images[0].get_cmap().name == "cividis"
    assert [tick.get_text().replace(" ", "") for tick in panel.get_yticklabels()] == list(sites)
    assert f"{100 * shares[at, driver]:.0f}" in [text.get_text() for text in panel.texts]


def test_where_little_is_explained_the_map_is_scaled_to_that(recorded):
    clean = diagnosed(*recorded())
    low, high = diagnosis_figures.explained_map(clean, "run.csv").axes[0].images[0].get_clim()
    shares = explained_shares(clean).shares
    assert (low, high) == (0, pytest.approx(max(100 * np.nanmax(shares), 2.0)))


def test_a_median_of_a_thin_bin_is_left_out():
    x = np.concatenate([np.linspace(0, 1, 400), np.full(6, 2.0)])
    at, thick, _ = medians(x, np.ones(406), share=0.5)
    assert np.isfinite(thick[at < 1]).all()
    assert np.isnan(thick[at > 1.1]).all()
    assert np.isfinite(medians(x, np.ones(406))[1][-1])


def test_what_was_ruled_out_is_folded_and_commands_stand_on_the_page(found, drawn):
    html = diagnosis_page(found, documented(found), "run.csv", drawn, Files(Path("my run.csv"), Path("d.json")))
    page = Reader(html)
    assert page.open == []
    folded = html[html.index("<details>") : html.index("</details>")]
    assert "Effects not tested" in folded
    assert "Effects not tested" not in html.replace(folded, "")
    text = " ".join(page.text.split())
    assert "lite6jax compensate d.json 'my run.csv' --out 'my run_compensated.csv'" in text
    assert text.index("Joint 2 gives way to gravity: ") < text.index("Explained: ")
    widths = [float(width) for width in re.findall(r'class="bar"><span style="width: ([\d.]+)%"', html)]
    assert widths[0] == 100 > widths[1]


def test_the_share_is_what_a_plain_fit_explains(recorded):
    """Of joint 2 and gravity's torque, by least squares on the residuals, the adjusted share of the variance."""
    only = diagnosed(*recorded(COMPLIANCE))
    problem, baseline = only.problem, only.selection.state.baseline
    sites, drivers, shares = explained_shares(only)
    torque = np.asarray(problem.loads.torque[1])
    u = 8 * (torque - torque.min()) / np.ptp(torque)
    t = np.abs(u - np.arange(-1, 10)[:, None])
    splines = (np.maximum(2 - t, 0) ** 3 - 4 * np.maximum(1 - t, 0) ** 3) / 6
    A = (problem.sites["joint", 1, 0] * splines[:, None]).reshape(11, -1).T
    e = baseline.residuals.rows.ravel()
    left = e - A @ np.linalg.lstsq(A, e, rcond=None)[0]
    share = 1 - np.sum(left**2) / np.sum(e**2) * e.size / (e.size - 11)
    assert shares[sites.index("joint2"), drivers.index("load")] == pytest.approx(share, abs=0.01)


def test_what_a_constant_explains_is_shown_beside_functions_that_contain_it(recorded):
    """A joint whose zero is off: functions of any driver there explain as much, and nothing says by which."""
    sites, drivers, shares = explained_shares(diagnosed(*recorded("joint_offset:joint=2,offset_rad=1e-3")))
    joint2 = shares[sites.index("joint2")]
    assert joint2[drivers.index("constant")] > 0.9
    np.testing.assert_allclose(joint2[[drivers.index("position"), drivers.index("time")]], joint2[0], atol=0.02)


def test_an_error_of_the_image_is_at_the_sensor(recorded):
    recording, _ = recorded()
    p = recording.position
    seen = replace(recording, position=p * (1 + 4e-3 * np.sum(p**2, 1, keepdims=True)))
    sites, drivers, shares = explained_shares(diagnosed(seen, ()))
    at, driver = np.unravel_index(np.nanargmax(shares), shares.shape)
    assert (sites[at], drivers[driver]) == ("sensor", "measured position")


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


def test_the_residual_left_is_the_noise(found, drawn):
    sizes, alike = drawn["remaining"].axes
    assert sizes.get_xlabel() == "residual over the declared noise"
    assert alike.get_xlabel() == "lag (rows)"
    labels = [text.get_text() for text in sizes.get_legend().get_texts()]
    kept = ~found.outliers
    rms = np.sqrt(np.mean(found.fit.residuals.rows[:, kept] ** 2))
    assert labels[1] == f"after: {rms:.3g} RMS"
    rows = found.fit.residuals.rows[:, kept]
    rows = rows - rows.mean(1, keepdims=True)
    after = alike.lines[1].get_ydata()
    for lag in (1, 7):
        plain = np.sum(rows[:, lag:] * rows[:, :-lag]) / np.sum(rows**2)
        assert after[lag - 1] == pytest.approx(plain)


def test_written_as_png_and_svg(tmp_path, drawn):
    paths = canvas.save(drawn, tmp_path)
    assert {path.name for path in paths} == {f"{n}{s}" for n in diagnosis_figures.NAMES for s in (".png", ".svg")}


@pytest.mark.usefixtures("unpainted")
def test_the_command_writes_both(tmp_path, recorded, monkeypatch, capsys):
    recording, effects = recorded(COMPLIANCE)
    run = write_recording(recording, tmp_path / "<b>run.csv")
    monkeypatch.setattr("lite6jax.diagnosis.diagnose.diagnose", lambda *_, **__: diagnosed(recording, effects))
    out, report, figures = (str(tmp_path / name) for name in ("d.json", "r.html", "figures"))
    command = ["diagnose", str(run), "--out", out, "--report", report, "--figures", figures]
    assert main(command) == 0
    page = (tmp_path / "r.html").read_text()
    assert "&lt;b&gt;run.csv" in page
    assert "<b>" not in page
    names = {path.name for path in (tmp_path / "figures").iterdir()}
    assert names == {f"<b>run_{name}{suffix}" for name in diagnosis_figures.NAMES for suffix in canvas.SUFFIXES}
    capsys.readouterr()

    def never(*_, **__):
        raise AssertionError("checked before long work")

    monkeypatch.setattr("lite6jax.diagnosis.diagnose.diagnose", never)
    others = ["diagnose", str(run), "--out", str(tmp_path / "e.json")]
    assert main([*others, "--report", report]) == 2
    assert "r.html: exists already; choose another name or add --force" in capsys.readouterr().err
    assert main([*others, "--report", str(tmp_path / "r.pdf")]) == 2
    assert "r.pdf: what is written here is html; let the name end in .html" in capsys.readouterr().err
    assert main([*others, "--figures", figures]) == 2
    assert "run_error_by_joint.png: exists already" in capsys.readouterr().err
    assert not (tmp_path / "e.json").exists()
