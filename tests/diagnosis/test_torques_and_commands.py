"""Torques and commands of one log: both are diagnosed, and the friction that both show gives the servo's gain."""

import json

import numpy as np
import pytest
from typed import flat, run

from lite6jax import cli
from lite6jax.diagnosis.diagnose import domains_of
from lite6jax.diagnosis.document import read_model
from lite6jax.domains.torque.predict import DiagnosedMotors
from lite6jax.domains.tracking.predict import DiagnosedServos
from lite6jax.recordings import read_recording
from lite6jax.report.sentences.diagnosis import shared_quantity
from tests.domains.tracking.test_servo_fit import PERIOD, TRUE
from tests.domains.tracking.test_tracking_commands import columns_of, write_log
from tests.oracles.servos import follow

SAMPLES = 600
GAIN = 150.0
"""Nm/rad, of which 200 are declared."""
FRICTION = 0.9
"""Nm, of which 0.2 are declared."""
NOISE = 2e-4
"""rad."""
TORQUE_NOISE = 0.05
"""Nm."""


def smooth_commands():
    """Sines that begin slowly, `(sample,)` rad."""
    t = PERIOD * np.arange(SAMPLES)
    begun = 1 - np.exp(-((t / 0.5) ** 2))
    return begun * sum(size * np.sin(2 * np.pi * rate * t) for size, rate in ((0.5, 0.4), (0.15, 0.9), (0.08, 1.7)))


def torques_of(joint):
    """What the motor must exert for this motion, `(sample,)` Nm: held commands move it in jerks between the samples."""
    speed = np.gradient(joint, PERIOD)
    load = TRUE["inertia"] * np.gradient(speed, PERIOD) + TRUE["weight"] * np.sin(joint)
    return load + TRUE["viscous"] * speed + FRICTION * np.sign(speed) * (np.abs(speed) > 1e-3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Of a log of a servo that is softer than declared and has more friction, and of its diagnosis."""
    place = tmp_path_factory.mktemp("both")
    command = smooth_commands()
    columns = columns_of(command, 0.5 * NOISE, kp=GAIN, coulomb=FRICTION)
    joint = follow(command, PERIOD, **(TRUE | {"kp": GAIN, "coulomb": FRICTION}))
    noise = np.random.default_rng(1).normal(0.0, TORQUE_NOISE, SAMPLES)
    log = write_log(place, columns | {"tau1_Nm": torques_of(joint) + noise}, noise=NOISE)
    assert cli.main(["diagnose", str(log), "--quick", "--out", str(place / "d.json")]) == 0
    return place


@pytest.fixture(scope="module")
def document(folder):
    return json.loads((folder / "d.json").read_text())


def test_a_log_of_both_is_diagnosed_by_both(folder, document):
    recording = read_recording(folder / "log.csv")
    assert domains_of(recording) == ("torques", "tracking")
    assert domains_of(recording, "tracking") == ("tracking",)
    assert document["domain"] == "torques"
    assert document["tracking"]["domain"] == "tracking"
    assert isinstance(read_model(folder / "d.json"), DiagnosedMotors)
    assert isinstance(read_model(folder / "d.json", domain="tracking"), DiagnosedServos)


def coulomb(part):
    (friction,) = (finding for finding in part["findings"] if finding["effect"] == "coulomb_friction")
    return friction["parameters"]["coulomb_Nm"]


def test_both_show_the_friction(document):
    """A servo that is too soft resembles one whose joint has more of everything: two names, not five."""
    measured = coulomb(document)
    assert measured["value"] == pytest.approx(FRICTION - 0.2, abs=4 * measured["std"])
    assert coulomb(document["tracking"])["value"] == pytest.approx(FRICTION - 0.2, abs=0.02)


def test_the_friction_of_both_gives_the_gain(document):
    (gain,) = (entry for entry in document["shared"] if entry["quantity"] == "position_gain")
    assert gain["site"] == "joint1"
    stiffness = gain["torques"]["parameters"]["stiffness_Nm_per_rad"]
    assert stiffness["value"] == pytest.approx(GAIN, abs=4 * stiffness["std"])
    assert stiffness["std"] < 0.02 * GAIN
    by_commands = gain["tracking"]["parameters"]["stiffness_Nm_per_rad"]
    assert by_commands["value"] == pytest.approx(GAIN, rel=0.01)
    assert gain["agree"]


def test_the_report_shows_both(capsys, folder):
    code, printed, _ = run(capsys, "report", folder / "d.json", width=100)
    assert code == 0
    said = flat(printed)
    assert said.index("Torques") < said.index("Commands") < said.index("What torques and commands both depend on")
    assert "Of the position gain at joint1, torques say stiffness 15" in said
    assert "commands say stiffness 150" in said
    assert "they agree" in said


def test_what_disagrees_is_said_with_a_remedy():
    entry = {
        "quantity": "position_gain",
        "site": "joint1",
        "agree": False,
        "p_value": 1e-5,
        "torques": {},
        "tracking": {},
    }
    said = shared_quantity(entry, {"torques": "150 Nm/rad", "tracking": "200 Nm/rad"})
    assert "torques say 150 Nm/rad, commands say 200 Nm/rad: they disagree (p = 1e-05)" in said
    assert "Put the gain that the torques show into the servo's settings" in said
