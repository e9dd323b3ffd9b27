"""Torques from a recording to findings, a document, a model and a prediction; and everything that is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
from domains.torque.moved import at_flange, hidden, motion_of, recorded, setup_of
from scipy.signal import lfilter

from benchmarks.torque_trials.effects import FAMILIES, Joint
from benchmarks.torque_trials.physics import rigid, torques
from lite6jax.diagnosis.document import model_from_document, read_model, write_document
from lite6jax.diagnosis.heldout import Judgement
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.result import AS_NOISE, block_count
from lite6jax.diagnosis.torque_diagnosis import diagnose_torques, linearised, with_likely_prior
from lite6jax.domains.predict import predict
from lite6jax.domains.torque.problem import torque_problem
from lite6jax.domains.torque.screening import contacts, screen_torques
from lite6jax.effects.dynamic import CoulombFriction, LinkInertia, RotorInertia, StribeckFriction, ViscousFriction
from lite6jax.errors import InputError
from lite6jax.estimation.options import EngineOptions
from lite6jax.recordings import Recording
from lite6jax.report.remedies import remedy_of
from lite6jax.report.sentences.diagnosis import verdict_statement
from lite6jax.report.statements import with_statements
from lite6jax.search.search import search

FEW = Options(folds=2)
"""Two held-out blocks instead of five."""
OPTIONS = Options()

FRICTION = (
    hidden("viscous_friction", "joint2", viscous_Nm_s_per_rad=0.6),
    hidden("coulomb_friction", "joint2", coulomb_Nm=0.4),
)
DECLARED = hidden("coulomb_friction", "joint5", coulomb_Nm=0.2)
"""Friction that the arm's description declares."""


@pytest.fixture(scope="module")
def diagnosed():
    recording, arm = recorded((*FRICTION, DECLARED), seed=1)
    friction = np.array([0.0, 0.0, 0.0, 0.0, 0.2, 0.0])
    return diagnose_torques(recording, replace(arm, coulomb_friction=friction), options=FEW)


def test_nothing_is_found_where_nothing_is_hidden():
    found = diagnose_torques(*recorded(seed=2), options=FEW)
    assert found.findings == ()
    assert found.verdict == "consistent"
    np.testing.assert_array_equal(found.before, found.after)


def test_friction_is_found_with_its_numbers(diagnosed):
    assert {finding.effect for finding in diagnosed.findings} == {ViscousFriction(2), CoulombFriction(2)}
    assert diagnosed.verdict == "explained"
    truth = {"viscous_friction": 0.6, "coulomb_friction": 0.4}
    for finding in diagnosed.findings:
        ((_, estimate),) = finding.parameters.items()
        assert abs(estimate.value - truth[finding.effect.name]) < 4 * estimate.std
        assert finding.p_value < 0.003
    assert np.mean(diagnosed.after**2) < 0.2 * np.mean(diagnosed.before**2)


def test_an_effect_short_of_the_level_leaves_it_open_whether_all_is_explained(diagnosed):
    def with_nearest(p_value):
        selection = replace(diagnosed.selection, nearest=(ViscousFriction(4), p_value))
        return replace(diagnosed, selection=selection)

    assert [with_nearest(p_value).verdict for p_value in (0.02, 0.06)] == ["undetermined", "explained"]
    assert verdict_statement(with_nearest(0.02).to_dict()) == (
        "Undetermined: what is left, with the effects below, is noise, but viscous friction at joint4 is nearly "
        "significant (family-wise p-value 0.02). Record a longer one."
    )


@pytest.mark.parametrize(
    ("over_noise", "said"),
    [
        ([2.03, 1.9, 18.2], " of joint 3 are 18 times the declared noise, those of the others 1.9 to 2 times."),
        ([2.03, 1.9, 3.2], " are 1.9 to 3.2 times the declared noise, and largest of joint 3."),
        ([1.0, 182.4], " of joint 2 are 182 times the declared noise, those of the others 1 times."),
        ([1.52], " are 1.5 times the declared noise, and largest of joint 1."),
    ],
)
def test_the_joint_is_said_of_which_most_is_left(diagnosed, over_noise, said):
    left = {"over_noise": {f"joint{j}": ratio for j, ratio in enumerate(over_noise, 1)}, "white": True, "acts_at": None}
    document = diagnosed.to_dict() | {"verdict": "unexplained", "left": left}
    assert verdict_statement(document).endswith(f"no effect is significant. The held-out errors{said}")
    correlated = verdict_statement(document | {"left": left | {"white": False}})
    assert correlated.endswith(f"{said} Neighbouring samples of what is left are correlated.")
    unknown = {"left": left | {"over_noise": {"joint1": None}}}
    for changed in ({"verdict": "explained"}, unknown):
        assert "times" not in verdict_statement(document | changed)


def sharp_friction(recording, slow=1.0, stribeck=0.0, speed=1.0):
    """Changes torques by dry friction of 2 Nm of joint 2, whose sign is that of the true velocity, and Stribeck's."""
    setup, _ = setup_of(recording)
    velocity = motion_of(setup, recording + 100, 100.0, slow=slow).dq[:, 1]
    friction = (2.0 + stribeck * np.exp(-((velocity / speed) ** 2))) * np.sign(velocity)
    return lambda tau: tau + friction[:, None] * (np.arange(6) == 1)


@pytest.fixture(scope="module")
def creeping():
    """Sharp friction in a motion that takes several samples through the speeds at which signs are smooth."""
    recording, arm = recorded(seed=8, change=sharp_friction(8, 0.08), rate=100.0, slow=0.08)
    return diagnose_torques(recording, arm, options=FEW)


def test_a_sharp_sign_of_friction_is_no_stribeck_friction(creeping):
    assert {finding.effect for finding in creeping.findings} == {CoulombFriction(2)}
    ((_, estimate),) = creeping.findings[0].parameters.items()
    assert abs(estimate.value - 2.0) < 4 * estimate.std


def test_errors_at_reversals_are_no_noise_of_their_joint(creeping):
    over, between = creeping.over_noise, creeping.between_reversals
    errors = (creeping.after / creeping.problem.noise[:, None])[:, creeping.problem.valid]
    np.testing.assert_allclose(list(over.values()), np.sqrt(np.mean(errors**2, 1)), rtol=1e-9)
    assert over["joint2"] > AS_NOISE > max(ratio for joint, ratio in over.items() if joint != "joint2")
    assert creeping.verdict == "partly_explained"
    assert between["joint2"] < AS_NOISE
    said = verdict_statement(creeping.to_dict())
    assert "joint 2" in said
    assert "They are larger where joint 2 reverses" in said


@pytest.mark.parametrize("slow", [0.08, 1.0])
def test_speeds_that_a_joint_passes_within_a_sample_are_neither_tried_nor_possible(slow):
    recording, arm = recorded(seed=8, rate=100.0, slow=slow)
    problem = torque_problem(screen_torques(recording, arm).data)
    moved = motion_of(setup_of(8)[0], 108, 100.0, slow=slow).dq.T
    for joint, velocity in enumerate(moved, 1):
        turned = velocity[1:] * velocity[:-1] < 0
        passed = np.median(np.abs(np.diff(velocity))[turned])
        least = problem.limits(StribeckFriction(joint))[-1][0]
        np.testing.assert_allclose(least, max(0.006, passed), rtol=0.1)
        tried = [one.chosen for one in problem.shaped if one.site == f"joint{joint}" and one.name != "viscous_friction"]
        assert min(tried, default=np.inf) >= least


def test_stribeck_friction_that_a_motion_shows_is_found_beside_a_sharp_sign():
    recording, arm = recorded(seed=8, change=sharp_friction(8, 0.4, 1.5, 0.1), rate=100.0, slow=0.4)
    found = diagnose_torques(recording, arm, options=FEW)
    named = {finding.effect.name: finding for finding in found.findings}
    assert set(named) == {"coulomb_friction", "stribeck_friction"}
    speed = named["stribeck_friction"].parameters["velocity_rad_per_s"]
    assert abs(speed.value - 0.1) < 4 * speed.std


@pytest.mark.parametrize("link", [1, 3])
def test_the_inertia_of_a_link_is_always_among_the_alternatives_of_a_rotor(link):
    recording, arm = recorded([hidden("rotor_inertia", f"joint{link}", inertia_kg_m2=0.08)], seed=4)
    found = diagnose_torques(recording, arm, options=FEW)
    (finding,) = found.to_dict()["findings"]
    assert (finding["effect"], finding["site"]) == ("rotor_inertia", f"joint{link}")
    rivals = {(one["effect"], one["site"]): one for one in finding["confusable_with"]}
    rival = rivals["link_inertia", f"link{link}"]
    # the base bears joint 1 alone: a link that turns with other joints loads them
    assert (rival["log_likelihood_gap"] < 1e-3) == (link == 1)
    assert rival["status"] == ("undecided" if link == 1 else "rejected")
    assert "its link has another inertia about the same axis" in remedy_of(finding | {"domain": "torques"}).cause


def test_the_inertia_of_a_link_that_turns_with_others_is_told_from_a_rotor():
    recording, arm = recorded([hidden("link_inertia", "link3", inertia_kg_m2=0.08)], seed=4)
    found = diagnose_torques(recording, arm, options=FEW)
    (finding,) = found.findings
    assert (finding.effect, [one.term for one in finding.alternatives][-1]) == (LinkInertia(3), RotorInertia(3))
    assert abs(finding.values[0] - 0.08) < 4 * np.sqrt(finding.covariance[0, 0])


def test_the_model_predicts_another_motion(diagnosed, tmp_path):
    path = write_document(with_statements(diagnosed.to_dict()), tmp_path / "d.json")
    model = read_model(path, domain="torques")
    setup, _ = setup_of(1)
    motion = motion_of(setup, 999)
    unseen = Recording.from_arrays(motion.q, time=motion.time, joint_velocity=motion.dq, motion="trajectory")
    predicted = predict(model, unseen)
    np.testing.assert_allclose(predicted, predict(diagnosed.model, unseen), rtol=0, atol=1e-12)
    truth = torques(setup, (*FRICTION, DECLARED), motion)
    assert np.sqrt(np.mean((predicted - truth)[10:-10] ** 2)) < 0.02
    assert np.sqrt(np.mean((torques(setup, (), motion) - truth) ** 2)) > 0.1
    document = json.loads(path.read_text())
    assert document["domain"] == "torques"
    assert document["after"]["heldout_torque_rms_Nm"] < document["before"]["heldout_torque_rms_Nm"]
    assert "Nm·s/rad" in document["findings"][0]["statement"] + document["findings"][1]["statement"]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda d: d["model"]["links"].pop(), "links of the shape"),
        (lambda d: d["model"].update(gravity=[0, 0, 1e6]), "gravity"),
        (lambda d: d["model"]["drives"].update(coulomb_friction=[0.1]), "coulomb_friction has the shape"),
        (lambda d: d["model"]["drives"].update(damping=[0.1]), "damping"),
        (lambda d: d["model"]["effects"][0].update(effect="viscous_frictio"), "the catalogue has none of this name"),
        (lambda d: d["model"].update(more=1), "unknown field `more`"),
        (lambda d: d.pop("domain"), "is no diagnosis of torques"),
    ],
)
def test_damaged_documents_are_refused(diagnosed, damage, message):
    document = json.loads(json.dumps(diagnosed.to_dict()))
    damage(document)
    with pytest.raises(InputError, match=message):
        model_from_document(document, domain="torques")


def test_a_function_outside_the_catalogue_has_no_name():
    recording, arm = recorded(seed=3)
    q, v = recording.joint_position[:, 1], recording.velocities()[:, 1]
    middle = float(np.median(q))
    sticky = 0.8 * np.exp(-(((q - middle) / 0.25) ** 2)) * np.tanh(v / 0.002)
    changed = recorded(seed=3, change=lambda tau: tau + np.stack([sticky * (j == 1) for j in range(6)], 1))[0]
    found = diagnose_torques(changed, arm, options=FEW)
    largest = max(found.findings, key=lambda finding: finding.gain)
    assert (largest.effect.name, largest.effect.site) == ("unnamed", "joint2")
    assert "position of joint 2" in [driver.phrase for driver in largest.effect.drivers]
    assert found.verdict == "unnamed"


def test_friction_that_bends_before_it_slides_is_hysteresis_of_the_position():
    setup, _ = setup_of(5)
    bent = FAMILIES["presliding"].torque(Joint({"bristle_rad": 0.02}, 1, rigid(setup, (), motion_of(setup, 105))))
    changed, arm = recorded(seed=5, change=lambda tau: tau + 0.5 * np.stack([bent * (j == 1) for j in range(6)], 1))
    found = diagnose_torques(changed, arm, options=FEW)
    assert {(one.effect.name, one.effect.site) for one in found.findings} == {("unnamed", "joint2")}
    largest = max(found.findings, key=lambda finding: finding.gain)
    assert largest.effect.hysteretic
    assert largest.effect.driver == "position of joint 2"


@pytest.mark.long
def test_a_gain_that_drifts_is_a_function_of_load_and_time_in_autocorrelated_noise():
    """Beside such noise no name is significant, and no function leaves white residuals."""

    def drifting(tau):
        noise = lfilter([0.1], [1.0, -0.9], np.random.default_rng(8).normal(0, 1, tau.shape), axis=0)
        drift = np.linspace(-0.1, 0.1, len(tau))
        return tau + noise * 0.5 * np.std(tau, axis=0) * 0.1 + drift[:, None] * tau * (np.arange(6) == 1)

    recording, arm = recorded(seed=5, change=drifting, declare=False)
    found = diagnose_torques(recording, arm, options=FEW)
    assert [(finding.effect.label, finding.effect.driver) for finding in found.findings] == [
        ("unnamed:joint2", "gravity torque of joint 2 and time")
    ]


@pytest.mark.parametrize(("again", "kept"), [(0.5, True), (1.2, False)])
def test_effects_are_withdrawn_where_searches_and_refits_without_them_reject_them(again, kept, monkeypatch):
    def judge(errors, selection, kept, folds):
        ratio = 1.2 if block_count(folds) == 2 else again
        return Judgement(ratio > 1, ratio)

    monkeypatch.setattr("lite6jax.diagnosis.torque_diagnosis.judge_by_folds", judge)
    found = diagnose_torques(*recorded(FRICTION, seed=1), options=FEW)
    effects = {ViscousFriction(2), CoulombFriction(2)}
    assert {finding.effect for finding in found.findings} == (effects if kept else set())
    assert {f.effect for f in (found.withdrawn.findings if found.withdrawn else ())} == (set() if kept else effects)
    document = found.to_dict()
    assert document["heldout_blocks"] == (10 if kept else 2)
    assert document["searched_again"] == ({"blocks": 2, "heldout_ratio": 1.2} if kept else None)
    assert (np.mean(found.after**2) < np.mean(found.before**2)) == kept


def test_friction_of_every_joint_of_an_arm_of_unknown_links():
    effects = [hidden("viscous_friction", f"joint{j}", viscous_Nm_s_per_rad=0.5) for j in range(1, 7)]
    effects += [hidden("coulomb_friction", f"joint{j}", coulomb_Nm=0.4) for j in range(1, 7)]
    recording, arm = recorded(effects, seed=4, inertial="unknown", declare=False)
    options = EngineOptions()
    problem = linearised(with_likely_prior(torque_problem(screen_torques(recording, arm).data), options), options)
    found = search(problem, options)
    labels = {term.label for term in found.state.fit.terms.terms}
    assert {f"{kind}_friction:joint{j}" for kind in ("viscous", "coulomb") for j in range(1, 7)} <= labels
    before, after = found.state.baseline.residuals.rows, found.state.fit.residuals.rows
    assert np.mean(after**2) < 0.05 * np.mean(before**2)


def test_swapped_columns_are_exchanged():
    recording, arm = recorded(seed=7, change=lambda tau: tau[:, [0, 2, 1, 3, 4, 5]])
    screened = screen_torques(recording, arm)
    assert [(f.code, f.numbers) for f in screened.found] == [("swapped_torques", {"joints": [2, 3], "columns": [3, 2]})]
    straight = recorded(seed=7)[0].torques().T
    np.testing.assert_array_equal(screened.data.torque, straight)


def test_spikes_are_said_with_their_rows():
    def spiked(tau):
        tau[[50, 400], 1] += 20.0
        return tau

    (fault,) = screen_torques(*recorded(seed=7, change=spiked)).found
    assert (fault.code, fault.rows, fault.numbers) == ("torque_spikes", (51, 401), {"joints": [2], "count": 2})


def test_a_contact_is_an_event_and_no_physics():
    def pushed(tau):
        tau[300:330, :3] += [3.0, 5.0, 2.0]
        return tau

    found = diagnose_torques(*recorded(seed=8, change=pushed), options=FEW)
    (fault,) = found.faults
    assert fault.code == "contact"
    assert {1, 2, 3} <= set(fault.numbers["joints"])
    hidden_rows = set(range(301, 331))
    assert len(hidden_rows & set(fault.rows)) >= 0.5 * len(hidden_rows | set(fault.rows))
    assert found.findings == ()


@pytest.mark.parametrize("wrong", [[1.0, 1.0], [1.0, 0.3, 1.0], [1.0, 0.6]])
def test_two_or_three_wrong_torques_where_a_joint_turns_back_are_no_contact(wrong):
    recording, _ = recorded(seed=8)
    turning = 100 + int(np.argmin(np.abs(recording.velocities()[100:-100, 1])))
    spread = recording.torques()[:, 1].std()

    def wronged(tau):
        tau[turning : turning + len(wrong), 1] += spread * np.array(wrong)
        return tau

    data = screen_torques(*recorded(seed=8, change=wronged)).data
    pushed, events = contacts(linearised(torque_problem(data, ()), FEW.engine), FEW.engine)
    assert events == []
    assert not pushed.any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda tau: 1000 * tau, "mN m"),
        (lambda tau: tau * 0 + np.nan, "not finite|NaN|no row"),
    ],
)
def test_torques_that_cannot_be(change, message):
    with pytest.raises(InputError, match=message):
        screen_torques(*recorded(seed=7, change=change))


def test_what_cannot_be_diagnosed_is_refused():
    recording, arm = recorded(seed=7)
    still = Recording.from_arrays(
        np.zeros((200, 6)) + 0.1,
        time=np.arange(200) / 50,
        joint_velocity=np.zeros((200, 6)),
        joint_torque=np.ones((200, 6)),
        motion="trajectory",
    )
    with pytest.raises(InputError, match="the arm is at rest"):
        screen_torques(still, arm)
    with pytest.raises(InputError, match="holds 11 static postures; record 12 or more"):
        screen_torques(replace(recording, motion="static").select(np.arange(11)), arm)
    bare = type(arm)(arm.name, arm.kinematics)
    with pytest.raises(InputError, match=r"has no masses; add them .* or declare inertial: unknown"):
        screen_torques(recording, bare)
    currents = Recording.from_arrays(
        recording.joint_position, time=recording.time, motor_current=recording.torques(), motion="trajectory"
    )
    with pytest.raises(InputError, match="torque_constant_Nm_per_A"):
        screen_torques(currents, arm)
    with pytest.raises(InputError, match="declares no arm"):
        diagnose_torques(recording)


def test_a_motion_without_a_driver_of_the_model_is_refused():
    effect = hidden("friction_temperature", "joint2", viscous_Nm_s_per_rad_K=-0.05)
    found = diagnose_torques(*recorded([effect], seed=9, warming=True), options=FEW)
    assert [finding.effect.label for finding in found.findings] == ["friction_temperature:joint2"]
    motion = motion_of(setup_of(9)[0], 3)
    cold = Recording.from_arrays(motion.q, time=motion.time, joint_velocity=motion.dq, motion="trajectory")
    with pytest.raises(InputError, match="has no temperature of joint 2; give the temperature of each joint"):
        predict(found.model, cold)


@pytest.mark.long
def test_a_payload_elsewhere_than_declared_is_one_finding():
    """Not a heavier last link whose centre of mass is outside it."""
    _, arm = setup_of(7)
    shift = np.array([0.03, 0.0, 0.07])
    declared = tuple(at_flange(arm) - shift)
    recording, arm = recorded([hidden("payload_error", "payload", mass_kg=0.62)], seed=7, payload_com_m=declared)
    (finding,) = diagnose_torques(recording, arm, options=FEW).findings
    assert finding.effect.label == "payload:payload"
    truth = (0.62, *(arm.T_joint_flange[:3, :3] @ shift))
    for name, value in zip(("mass_kg", "x_m", "y_m", "z_m"), truth, strict=True):
        assert finding.parameters[name].value == pytest.approx(value, abs=5e-3)
