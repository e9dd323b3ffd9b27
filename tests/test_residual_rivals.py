"""The rivals' own honesty: their columns are what the physics does, and what is held out they have not seen."""

import json

import numpy as np
import pytest
from diagnosis.recorded import LITE6, Made, static_motion, with_effects
from threadpoolctl import threadpool_limits
from typed import flat

from benchmarks import __main__ as harness
from benchmarks import residual, rivals
from benchmarks.concealed.chain import Chain
from benchmarks.residual import Geometry
from lite6jax.recordings import write_recording

SAMPLES = 120
COMPLIANCE = "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5"


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return Made(tmp_path_factory.mktemp("arm"), seed=1, frame=True, tool=True)


@pytest.fixture(scope="module")
def motion():
    return static_motion(1, SAMPLES)


@pytest.fixture(scope="module")
def soft(arm, motion):
    return with_effects(arm, COMPLIANCE).recording(motion)


@pytest.fixture(scope="module")
def view(arm, motion):
    """Rows as the true geometry sees them, without noise."""
    return true_geometry(arm).view(arm.recording(motion, noise=None))


def true_geometry(arm):
    """What a fit would find of an arm's frame and tool if there were neither noise nor physics."""
    chain = Chain("lite6", arm.kinematics, LITE6.joint_limits, LITE6.mass, LITE6.center_of_mass)
    return Geometry(chain, True, arm.T_sensor_base, arm.T_flange_tool, free=False, parameters=12)


def moved(arm, motion, text, size):
    """What an effect does to positions and orientations, per unit, in the base's axes."""
    name, _, rest = text.partition(":")
    plus, minus = (with_effects(arm, f"{name}:{rest.format(sign * size)}").poses(motion) for sign in (1, -1))
    R = arm.T_sensor_base[:3, :3]
    shift = (plus - minus)[:, :3, 3] @ R / (2 * size)
    spin = R.T @ (plus @ np.linalg.inv(minus))[:, :3, :3] @ R
    turn = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], 1) / (2 * size)
    return shift, turn


@pytest.mark.long
@pytest.mark.parametrize(
    ("text", "group", "place"),
    [
        ("joint_compliance:joint=2,compliance_rad_per_Nm={:g}", "joint_compliance:joint2", 0),
        ("link_compliance:link=3,compliance_x_rad_per_Nm=0,compliance_y_rad_per_Nm={:g}", "link_compliance:link3", 1),
        ("base_compliance:compliance_x_rad_per_Nm={:g},compliance_y_rad_per_Nm=0", "base_compliance:base", 0),
        ("joint_scale:joint=4,scale={:g}", "joint_scale:joint4", 0),
        ("base_drift:vx_m_per_s=0,vy_m_per_s={:g},vz_m_per_s=0", "base_drift:base", 1),
    ],
)
def test_a_column_is_what_the_effect_does(arm, motion, view, text, group, place):
    (found,) = (g for g in (*residual.gravity(view), *residual.other_physics(view)) if g.name == group)
    J = residual.design(view, found.columns)[:, :, place]
    shift, turn = moved(arm, motion, text, 1e-6)
    scale = np.abs(shift).max()
    np.testing.assert_allclose(J[:, :3] * view.noise[0], shift, atol=2e-5 * scale)
    np.testing.assert_allclose(J[:, 3:] * view.noise[1], turn, atol=2e-5 * max(scale, np.abs(turn).max()))


def test_a_wave_is_a_joints_sine(motion, view):
    groups = [g for g in residual.waves(view, (3,)) if g.name == "joint_harmonic:joint5"]
    J = residual.design(view, groups[0].columns)
    lever = residual.design(view, [residual.Column(5, 5, lambda v: np.ones(v.recording.samples))])[:, :, 0]
    angle = 3 * motion["joint_position"][:, 4]
    np.testing.assert_allclose(J[:, :, 0], lever * np.sin(angle)[:, None], atol=1e-9)
    np.testing.assert_allclose(J[:, :, 1], lever * np.cos(angle)[:, None], atol=1e-9)


@pytest.mark.long
def test_folds_stay_unseen_and_the_stepwise_search_names_what_is_hidden(soft, monkeypatch):
    seen = []

    def spy(view):
        seen.append(set(view.recording.row))
        return residual.geometry_alone(view)

    chosen = {"spy": spy, "stepwise": lambda view: residual.stepwise(False, view)}
    monkeypatch.setattr(rivals, "rivals", lambda free: chosen)
    monkeypatch.setattr(residual, "ORDERS", (1, 2, 3))
    spied, stepwise = rivals.compare(soft, folds=2)
    half = set(range(1, SAMPLES // 2 + 1))
    assert seen[0].isdisjoint(half)
    assert seen[1] <= half
    assert len(seen[2]) > SAMPLES // 2 + 1
    assert "joint_compliance:joint2" in stepwise.names
    assert stepwise.parameters < 8
    rms = [float(np.sqrt(np.mean(outcome.errors**2))) for outcome in (spied, stepwise)]
    assert rms[1] < 0.3 * rms[0]
    assert spied.parameters == 0
    assert spied.errors.shape == (SAMPLES,)


@pytest.mark.long
def test_residual_and_a_ridge_learn_what_they_can(arm, monkeypatch):
    monkeypatch.setattr(residual, "_GP_TUNED", 100)
    many = with_effects(arm, COMPLIANCE).recording(static_motion(2, 300))
    geometry = true_geometry(arm)
    train, other = many.select(np.arange(250)), many.select(np.arange(250, 300))
    view = geometry.view(train)
    with threadpool_limits(1):
        fitted = {name: rival(view) for name, rival in rivals.rivals(geometry.free).items() if "BIC" not in name}
    there = geometry.view(other)
    error = {name: rms_of(there, f.correct(there)) for name, f in fitted.items()}
    assert error["geometry and Gaussian process"] < 0.9 * error["geometry alone"]
    assert error["ridge, orders 1–60"] < 0.5 * error["geometry alone"]
    assert np.isfinite(error["geometry and neural network"])
    assert fitted["ridge, orders 1–60"].parameters == 6 * 60 * 2 + 6 + 12 + 2
    # a network of two layers of 64 over six joints, their sines and cosines, payload, directions and temperatures
    inputs = 18 + 1 + 6 + 6
    assert fitted["geometry and neural network"].parameters == 64 * (inputs + 1) + 64 * 65 + 3 * 65


def rms_of(view, correction):
    return float(np.sqrt(np.mean(np.sum((view.missed - correction.shift) ** 2, 1))))


# ------------------------------------------------------------------ as it is typed


@pytest.fixture
def few(monkeypatch):
    """Two rivals, so that a command ends soon."""
    chosen = {"geometry alone": residual.geometry_alone, "stepwise, BIC": lambda view: residual.stepwise(False, view)}
    monkeypatch.setattr(rivals, "rivals", lambda free: chosen)
    monkeypatch.setattr(residual, "ORDERS", (1, 2))
    monkeypatch.setenv("COLUMNS", "140")


@pytest.mark.long
def test_real_series_are_compared_and_carried_over(few, capsys, soft, tmp_path):
    for name in "ab":
        write_recording(soft, tmp_path / f"series_{name}.csv")
    out = tmp_path / "out.json"
    code = harness.main(["rivals", "--real", str(tmp_path), "--every", "2", "--rivals-only", "--json", str(out)])
    said = flat(capsys.readouterr().out)
    assert code == 0
    assert "series_a.csv, 60 rows, held-out fifths" in said
    assert "from series_a.csv to series_b.csv, frame and tool registered anew" in said
    records = json.loads(out.read_text())
    assert {record["subject"] for record in records} == {"geometry alone", "stepwise, BIC"}
    assert {"error, RMS", "error, p95", "error, largest", "numbers", "time"} <= {record["metric"] for record in records}


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ([], "name what to compare on: --real DIR (or the variable LITE6JAX_REAL)"),
        (["--real", ".", "--every", "0"], "--every: give 1 or more"),
    ],
)
def test_options_that_cannot_be(capsys, monkeypatch, options, says):
    monkeypatch.delenv("LITE6JAX_REAL", raising=False)
    with pytest.raises(SystemExit):
        harness.main(["rivals", *options])
    assert says in capsys.readouterr().err


def test_a_folder_without_recordings(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("LITE6JAX_REAL", str(tmp_path))
    assert harness.main(["rivals"]) == 2
    assert "holds no recording (.csv with .yaml beside it); put the real series there" in capsys.readouterr().err
