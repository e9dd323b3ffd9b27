"""Poses and torques of one recording: one command, one document, one page; what both depend on is compared."""

import json
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pyarrow.csv
import pytest
from diagnosis.recorded import LITE6, Made, moving_motion, static_motion
from matplotlib.figure import Figure
from report import diagnosed, torque_diagnosed
from typed import flat, refused, run

from lite6jax.arms.dynamics import is_consistent, link_parameters
from lite6jax.arms.files import read_arm
from lite6jax.diagnosis.diagnose import diagnose
from lite6jax.diagnosis.document import read_model, write_document
from lite6jax.diagnosis.estimates import compare_domains
from lite6jax.effects.dynamic import BaseTilt, PayloadTorque, ViscousFriction
from lite6jax.effects.kinematic import GravityDirection, JointCompliance, PayloadError
from lite6jax.errors import InputError
from lite6jax.recordings import Recording, write_recording
from lite6jax.report import ranking
from lite6jax.report.pages import diagnosis_page
from lite6jax.report.sections import diagnosis_report
from lite6jax.report.statements import with_statements
from tests.oracles.pinocchio_dynamics import pinocchio_model, pinocchio_torques

COMPLIANCE = "joint_compliance:joint=2,compliance_rad_per_Nm=2e-4"
SIGMA = np.array([0.06, 0.08, 0.05, 0.02, 0.02, 0.015])
DECLARED, HELD = 0.4, 0.9
"""kg: what the column says, and what the arm really carries."""
VISCOUS = 0.8


def accelerations(motion):
    """Of `moving_motion`, analytically: the sum of two sines a joint."""
    rng = np.random.default_rng(3)
    rate, phase = rng.uniform(0.6, 2.4, (2, 6)), rng.uniform(-np.pi, np.pi, (2, 6))
    angle = np.multiply.outer(motion["time"], rate) + phase
    return -np.sum(np.array([[0.9], [0.4]]) * rate**2 * np.sin(angle), 1)


def both(made, held=HELD, seed=0):
    """A recording of poses and torques of an arm that carries more than is declared, with friction at joint 2."""
    motion = {**moving_motion(3, 800)}
    motion["payload"] = np.full(800, held)
    recording = made.recording(motion, seed=seed)
    center = np.array(recording.settings.payload_com_m)
    model = pinocchio_model(LITE6.kinematics, LITE6.mass, LITE6.center_of_mass, LITE6.inertia, (0, 0, -9.81))
    model.appendBodyToJoint(6, pin.Inertia(held, center, np.zeros((3, 3))), pin.SE3.Identity())
    q, dq = motion["joint_position"], motion["joint_velocity"]
    tau = pinocchio_torques(model, q.T, dq.T, accelerations(motion).T).T
    tau[:, 1] += VISCOUS * dq[:, 1]
    tau += np.random.default_rng(seed + 9).normal(0, 1, tau.shape) * SIGMA
    settings = replace(recording.settings, torque_noise_Nm=tuple(SIGMA.tolist()))
    return replace(recording, joint_torque=tau, payload=np.full(800, DECLARED), settings=settings)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return Made(tmp_path_factory.mktemp("arm"), (COMPLIANCE,), seed=1)


@pytest.fixture(scope="module")
def recording(made):
    return both(made)


@pytest.fixture(scope="module")
def found(recording):
    """Both, the payload found by the torques alone: the poses have it beside their finding."""
    poses = diagnosed.diagnosed(recording, (JointCompliance(2),))
    torques = torque_diagnosed.diagnosed(recording, (ViscousFriction(2), PayloadTorque()))
    return replace(poses, beside=(torques,), shared=compare_domains(poses, torques))


def test_the_payload_is_compared(recording, found):
    shared = {each.of["quantity"]: each.estimates for each in found.shared}
    payload = shared["payload_mass"]
    assert payload["torques"].found
    assert not payload["poses"].found
    assert found.shared[0].agree
    assert set(shared) == {"payload_mass"}
    for known in payload.values():
        estimate = known.parameters["mass_kg"]
        assert abs(estimate.value - (HELD - DECLARED)) < 4 * estimate.std < 1.0
    poses = diagnosed.diagnosed(recording, (JointCompliance(2), PayloadError()))
    (both_found,) = compare_domains(poses, found.torques)  # the compliance rests on the payload that was found
    assert both_found.estimates["poses"].found
    assert both_found.agree


def test_a_tilt_has_one_sign_in_both(recording, found):
    """Poses state by what gravity is turned, torques by what the base is."""
    declared = recording.settings
    tilted = 9.81 * np.array([np.sin(0.05), 0.0, -np.cos(0.05)])
    turned = replace(recording, settings=replace(declared, gravity_m_per_s2=tuple(tilted)))
    poses = diagnosed.diagnosed(turned, (JointCompliance(2), PayloadError(), GravityDirection()))
    torques = torque_diagnosed.diagnosed(turned, (ViscousFriction(2), PayloadTorque(), BaseTilt()))
    tilt = next(each for each in compare_domains(poses, torques) if each.of["quantity"] == "gravity_direction")
    assert abs(tilt.estimates["torques"].values[1]) == pytest.approx(0.05, abs=0.02)
    assert tilt.agree
    assert np.sign(tilt.estimates["poses"].values[1]) == -np.sign(tilt.estimates["torques"].values[1])


def test_the_commands_take_it(made, found, recording, tmp_path, capsys, monkeypatch):
    run_file = write_recording(recording, tmp_path / "run.csv")
    out = tmp_path / "d.json"
    monkeypatch.setattr("lite6jax.diagnosis.diagnose.diagnose", lambda *_, **__: found)
    named = ["error_by_joint", "where", "orders"]
    named += [f"torque_{name}" for name in ("error_by_joint", "over_time", "friction")]
    blank = {name: Figure((1, 1)) for name in named}
    monkeypatch.setattr("lite6jax.report.diagnosis_figures.drawings", lambda *_: blank.items())
    code, said, _ = run(capsys, "diagnose", run_file, "--out", out, "--report", tmp_path / "r.html", width=60)
    assert code == 0
    text = flat(said)
    assert text.index("Joint compliance at joint2") < text.index("joint 2 (Nm), RMS")
    assert "What poses and torques both depend on:" in text
    assert "they agree" in text
    html = (tmp_path / "r.html").read_text()
    document, page = json.loads(out.read_text()), diagnosed.Reader(html)
    assert page.open == []
    shown = flat(page.text)
    for finding in (*document["findings"], *document["torques"]["findings"]):
        assert finding["statement"] in shown
    assert "they agree, and it is one finding that both sensors see" in shown
    cause = ranking.headline(document["torques"])
    assert shown.index("Poses") < shown.index(cause) < shown.index("What poses and torques both depend on")
    anchors = [attributes.get("id") for tag, attributes in page.tags if tag == "article"]
    assert len(set(anchors)) == len(anchors) == len(document["findings"]) + len(document["torques"]["findings"])
    code, said, _ = run(capsys, "predict", out, run_file, "--out", tmp_path / "p.csv")
    assert code == 0
    names = pyarrow.csv.read_csv(tmp_path / "p.csv").column_names
    assert {"x_m", "x_std_m", "tau1_Nm", "tau1_std_Nm", "outside"} <= set(names)
    still = write_recording(
        Recording.from_arrays(static_motion(1, 20)["joint_position"], motion="static"), tmp_path / "still.csv"
    )
    code, said, _ = run(capsys, "predict", out, still, "--out", tmp_path / "q.csv")
    assert code == 0
    assert "tau1_Nm" in pyarrow.csv.read_csv(tmp_path / "q.csv").column_names  # of gravity, at rest
    code, said, _ = run(capsys, "convert", out, tmp_path / "arm.yaml")
    assert code == 0
    arm = read_arm(tmp_path / "arm.yaml")
    np.testing.assert_allclose(arm.kinematics, made.kinematics, atol=1e-9)
    assert arm.viscous_friction[1] == pytest.approx(VISCOUS, abs=0.1)
    assert is_consistent(link_parameters(arm))
    assert "joint compliance at joint2" in flat(said)


def test_the_report_of_its_file_is_that_of_the_command(found, recording, tmp_path, capsys, monkeypatch):
    run_file, out = write_recording(recording, tmp_path / "run.csv"), tmp_path / "d.json"
    monkeypatch.setattr("lite6jax.diagnosis.diagnose.diagnose", lambda *_, **__: found)
    _, printed, _ = run(capsys, "diagnose", run_file, "--out", out)
    code, said, err = run(capsys, "report", out)
    assert (code, err) == (0, "")
    shown = [line for line in printed.splitlines() if line not in (str(run_file), f"Wrote {out}")]
    assert [line for line in said.splitlines() if line != str(out)] == shown
    assert "joint 2 (Nm), RMS" in said
    assert "they agree" in flat(said)
    refused = replace(found, beside=(), shared=(), refused={"torques": "it holds static poses"})
    write_document(with_statements(refused.to_dict()), out, overwrite=True)
    assert "not diagnosed: it holds static poses." in flat(run(capsys, "report", out)[1])
    document = found.to_dict()
    document["torques"]["model"]["links"] = "none"
    write_document(document, out, overwrite=True)
    code, said, err = run(capsys, "report", out)
    assert (code, said) == (2, "")
    assert "its model is damaged (Expected `array`, got `str` - at `$.model.links`)" in err


def test_torques_that_cannot_be_diagnosed_do_not_stop_the_poses(recording, found, tmp_path, monkeypatch):
    poses = replace(found, beside=(), shared=())
    monkeypatch.setattr("lite6jax.diagnosis.diagnose.diagnose_poses", lambda *_, **__: poses)
    alone = diagnose(recording, replace(LITE6, mass=None, center_of_mass=None, inertia=None))
    assert alone.torques is None
    assert "has no masses" in alone.refused["torques"]
    document = with_statements(alone.to_dict())
    path = write_document(document, tmp_path / "d.json")
    assert read_model(path).dof == 6
    with pytest.raises(InputError, match="is a diagnosis of poses; give one of torques"):
        read_model(path, domain="torques")
    assert "are not diagnosed: " in alone.summary()
    assert any("has no masses" in str(part) for part in diagnosis_report(document, "run.csv"))
    assert "has no masses" in diagnosis_page(alone, document)


def test_the_columns_or_the_domain_decide_what_is_diagnosed(recording, found, tmp_path, capsys, monkeypatch):
    """Each domain is given the effects of a user's own that are of it; what it does not have is refused."""
    given, own = {}, {"poses": JointCompliance(2), "torques": ViscousFriction(2)}
    for name, one in (("poses", replace(found, beside=(), shared=())), ("torques", found.torques)):
        take = lambda *_, name=name, one=one, **more: given.update({name: more["effects"]}) or one  # noqa: E731
        monkeypatch.setattr(f"lite6jax.diagnosis.diagnose.diagnose_{name}", take)
    of_poses, of_torques = replace(recording, joint_torque=None), replace(recording, position=None, quaternion=None)
    asked = ((recording, "poses"), (of_poses, None), (recording, "torques"), (of_torques, None))
    for (one, domain), searched in zip(asked, ("poses", "poses", "torques", "torques"), strict=True):
        given.clear()
        assert getattr(diagnose(one, domain=domain, effects=[*own.values()]), "torques", None) is None
        assert given == {searched: (own[searched],)}
    assert diagnose(recording, effects=[*own.values()]).torques is found.torques
    assert given == {name: (effect,) for name, effect in own.items()}
    with pytest.raises(InputError, match=r"has torques and no poses; leave --poses or domain='poses' out$"):
        diagnose(of_torques, domain="poses")
    alone = write_recording(of_torques, tmp_path / "motors.csv")
    said = refused(capsys, "diagnose", alone, "--poses")
    assert said == f"{alone}: has torques and no poses; leave --poses or domain='poses' out"
    with pytest.raises(InputError, match=r"^geometry: is not of torques, by which .* is diagnosed; leave it out$"):
        diagnose(of_torques, geometry="exact")
