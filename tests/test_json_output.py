"""`--json`: every command that reports prints one JSON document instead, and writes the same files."""

import json
from dataclasses import fields

import numpy as np
import pytest
from typed import run

from lite6jax.arms.description import load_bundled
from lite6jax.arms.factory import write_factory
from lite6jax.cli.program import COMMANDS, load_command
from lite6jax.report import screen

LITE6 = load_bundled("lite6")
SILENT = {"simulate", "detect", "emulate", "record", "demo", "view"}
"""Commands that report nothing but what they wrote or serve."""


@pytest.fixture(scope="module")
def calibration(tmp_path_factory):
    rows = LITE6.kinematics + 1e-4 * np.random.default_rng(3).standard_normal(LITE6.kinematics.shape)
    return write_factory(rows, tmp_path_factory.mktemp("arm") / "arm.yaml")


@pytest.mark.parametrize("name", sorted(set(COMMANDS) - SILENT))
def test_every_command_that_reports_has_the_option(name):
    assert "json" in {field.name for field in fields(load_command(name))}


def test_fit_check_and_convert_print_documents(capsys, calibration, tmp_path):
    out = tmp_path / "table.json"
    code, said, err = run(capsys, "fit", calibration, "--out", out, "--json")
    found = json.loads(said)
    assert (code, err) == (0, "")
    assert (found["schema"], found["result"], found["written"]) == ("lite6jax/fit/1", "converged", [str(out)])
    assert out.exists()
    table = json.loads(out.read_text())
    assert found["arm"] == "lite6"
    assert found["after"]["position_rms_m"] < 1e-9 < found["before"]["position_rms_m"]
    named = {entry["name"]: entry for entry in found["parameters"]}
    assert named["a2"]["unit"] == "m"
    assert f"{1e3 * named['a2']['value']:.6f}"[:7] in json.dumps(table)

    code, said, _ = run(capsys, "check", calibration, calibration, "--json")
    assert code == 0
    lines = [json.loads(line) for line in said.splitlines()]
    assert [line["file"] for line in lines] == [str(calibration)] * 2
    assert {cause["code"] for cause in lines[0]["causes"]} >= {"nominal_table", "tool_offset"}

    target = tmp_path / "arm.urdf"
    code, said, _ = run(capsys, "convert", "lite6", target, "--json")
    assert code == 0
    assert json.loads(said)["written"] == [str(target)]
    assert json.loads(said)["difference_m"] < 1e-9


def test_progress_is_a_line_from_time_to_time_where_stderr_is_no_terminal(monkeypatch, capsys):
    import time

    monkeypatch.setattr(screen, "EVERY", 0.01)
    with screen.progress(4, "drawing") as advance:
        advance(2)
        heard, until = "", time.monotonic() + 10.0
        while "2 of 4" not in heard and time.monotonic() < until:
            time.sleep(0.01)
            heard += capsys.readouterr().err
    assert "drawing: 2 of 4, 0:00 so far, about 0:00 to go" in heard


@pytest.mark.parametrize("width", [40, 60, 200])
def test_help_breaks_at_words_and_shows_defaults_that_say_something(capsys, width):
    code, said, _ = run(capsys, "design", "--help", width=width)
    assert code == 0
    commands = [line for line in said.splitlines() if line.startswith("    lite6jax ")]
    assert max(map(len, commands)) > 60  # whole, to be copied
    prose = [line for line in said.splitlines() if not line.startswith(("╭", "│", "╰")) and line not in commands]
    assert all(len(line) <= width or " " not in line.strip() for line in prose)
    assert "(default: None)" not in said
    assert "(default: False)" not in said
    text = " ".join(line.strip("│ ") for line in said.splitlines())
    assert "Number of poses to choose. (default: 40)" in " ".join(text.split())
