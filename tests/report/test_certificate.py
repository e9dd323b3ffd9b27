"""A certificate is one page, the same bytes for the same document, and holds the document's figures."""

import re
from dataclasses import replace

import pytest
from diagnosed import documented

from lite6jax.report.pages import certificate, write_certificate

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


def row_of(figure, name):
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
        *cells, ratio = row_of(page, f"position error (mm), {name}")
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
