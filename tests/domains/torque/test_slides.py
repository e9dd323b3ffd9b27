"""An arm with a prismatic joint from the forces of its motors to findings, files and simulators: in N, m and kg."""

import json
import re
from dataclasses import dataclass, replace
from typing import ClassVar, final

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pyarrow.csv as pacsv
import pytest
from domains.torque import slid

from lite6jax.arms.description import write_arm
from lite6jax.arms.dynamics import inverse_dynamics, link_parameters
from lite6jax.arms.files import read_arm
from lite6jax.cli import main
from lite6jax.diagnosis.document import model_from_document
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.torque_diagnosis import diagnose_torques
from lite6jax.domains.predict import predict
from lite6jax.domains.torque.predict import composed
from lite6jax.domains.torque.problem import torque_problem
from lite6jax.domains.torque.reference import compare_rows
from lite6jax.domains.torque.rows import RigidBodies
from lite6jax.domains.torque.screening import contacts, screen_torques
from lite6jax.effects.catalogue import TORQUE_EFFECTS, torque_catalogue
from lite6jax.effects.drivers import Driver
from lite6jax.effects.dynamic import CoulombFriction, CoupledFriction, JointTorque, StribeckFriction, ViscousFriction
from lite6jax.effects.effect import Coordinate
from lite6jax.effects.motion import motion_of
from lite6jax.effects.serialization import effect_as_dict, effect_from_dict, parse_effect
from lite6jax.errors import InputError
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.terms import Terms
from lite6jax.fleet.reduction import reduced
from lite6jax.recordings import write_recording
from lite6jax.report.faults import fault_statement
from lite6jax.report.remedies import cause_of, remedy_of
from lite6jax.report.sentences.diagnosis import comparison_headline
from lite6jax.report.statements import finding_statement
from tests.conftest import without_pictures

FEW = Options(folds=2)
TRUTH = {
    ("viscous_friction", "joint2"): ("viscous_Nm_s_per_rad", slid.SHOULDER),
    ("viscous_friction", "joint3"): ("viscous_N_s_per_m", slid.VISCOUS),
    ("coulomb_friction", "joint3"): ("coulomb_N", slid.COULOMB),
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A folder with the arm and its recording."""
    folder = tmp_path_factory.mktemp("telescope")
    write_arm(slid.arm(), folder / "telescope.yaml")
    recording = slid.recorded(slid.friction)
    settings = replace(recording.settings, arm="telescope.yaml")
    write_recording(replace(recording, settings=settings), folder / "run.csv")
    return folder


@pytest.fixture(scope="module")
def diagnosed(run):
    """Its document."""
    files = ["--out", str(run / "d.json"), "--report", str(run / "d.html")]
    with pytest.MonkeyPatch.context() as patch:
        without_pictures(patch)
        assert main(["diagnose", str(run / "run.csv"), "--quick", *files]) == 0
    return json.loads((run / "d.json").read_text())


def test_forces_and_torques_are_those_of_an_oracle():
    _, q, dq, ddq = slid.moved(3)
    arm = slid.arm()
    found = inverse_dynamics(arm.kinematics, link_parameters(arm), q.T, dq.T, ddq.T, slid.GRAVITY, arm.sliding)
    wanted = slid.exerted(q, dq, ddq)
    np.testing.assert_allclose(np.asarray(found).T, wanted, rtol=0, atol=1e-11)


def test_friction_of_a_slide_is_found_beside_that_of_a_revolute_joint(diagnosed):
    document = diagnosed
    found = {(finding["effect"], finding["site"]): finding for finding in document["findings"]}
    assert found.keys() == TRUTH.keys()
    for place, (key, value) in TRUTH.items():
        ((name, estimate),) = found[place]["parameters"].items()
        assert name == key
        assert abs(estimate["value"] - value) < 1.96 * estimate["std"]
        assert estimate["std"] < 0.01 * value
    assert document["verdict"] == "explained"
    assert document["model"]["prismatic_joints"] == [3]
    assert [effect["where"].get("of_slide") for effect in document["model"]["effects"]].count(True) == 2
    assert {key for key in found["coulomb_friction", "joint3"] if key.startswith("moves")} == {"moves_rms_N"}
    assert {key for key in found["viscous_friction", "joint2"] if key.startswith("moves")} == {"moves_rms_Nm"}
    before, by_joint = document["before"], document["before"]["heldout_torque_rms_by_joint_Nm"]
    assert before["heldout_torque_rms_N"] == pytest.approx(by_joint[2])
    assert before["heldout_torque_rms_Nm"] == pytest.approx(np.sqrt(np.mean(np.square(by_joint[:2]))))
    assert found["viscous_friction", "joint3"]["driver"] == "slide velocity of joint 3"


def test_each_joint_is_said_in_its_own_unit(run, diagnosed):
    said = {(finding["effect"], finding["site"]): finding["statement"] for finding in diagnosed["findings"]}
    assert "N·s/m; it contributes" in said["viscous_friction", "joint3"]
    assert " N RMS to the force." in said["coulomb_friction", "joint3"]
    assert "Nm·s/rad; it contributes" in said["viscous_friction", "joint2"]
    page = (run / "d.html").read_text()
    assert "<td>prismatic joints (N), RMS</td>" in page
    assert "<td>joint 3 (N), RMS</td>" in page
    assert "<td>revolute joints (Nm), maximum</td>" in page
    assert "0.05 Nm, 0.3 N are declared" in page
    assert "6.0 N</td>" in page


def test_the_screen_ranks_what_has_no_common_unit(run, diagnosed, capsys):
    assert main(["report", str(run / "d.json")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "What each finding moves (RMS):" in said
    assert "Nm 2. Coulomb friction at joint3" in said  # a share of the error of its own kind each
    assert "prismatic joints (N), RMS 9" in said
    assert "joint 2 (Nm), RMS 0." in said


def test_the_model_predicts_another_motion_in_the_columns_of_its_joints(run, diagnosed):
    model = model_from_document(diagnosed)
    assert model.arm.sliding == (2,)
    unseen = slid.recorded(seed=5)
    _, q, dq, ddq = slid.moved(5)
    truth = slid.exerted(q, dq, ddq) + slid.friction(dq)
    away = (predict(model, unseen) - truth)[20:-20]
    # where the telescope turns back, smoothed velocities know the sign of friction some milliseconds late
    assert (np.sqrt(np.mean(away**2, 0)) < [0.02, 0.03, 0.5]).all()
    assert np.median(np.abs(away[:, 2])) < 0.1
    write_recording(replace(unseen, joint_torque=None), run / "unseen.csv")
    assert main(["predict", str(run / "d.json"), str(run / "unseen.csv"), "--out", str(run / "p.csv")]) == 0
    names = pacsv.read_csv(run / "p.csv").column_names
    assert names == ["tau1_Nm", "tau2_Nm", "tau3_N", "tau1_std_Nm", "tau2_std_Nm", "tau3_std_N", "outside"]


def test_simulators_get_damping_and_friction_of_the_slide(run, diagnosed):
    values = {(f["effect"], f["site"]): next(iter(f["parameters"].values()))["value"] for f in diagnosed["findings"]}
    for name in ("arm.xml", "arm.urdf"):
        assert main(["convert", str(run / "d.json"), str(run / name), "--force"]) == 0
        back = read_arm(str(run / name))
        assert back.sliding == (2,)
        np.testing.assert_allclose(back.viscous_friction[1:], [values[place] for place in list(TRUTH)[:2]])
        np.testing.assert_allclose(back.coulomb_friction, [0, 0, values["coulomb_friction", "joint3"]])
    model = mujoco.MjModel.from_xml_path(str(run / "arm.xml"))
    assert model.jnt_type[2] == mujoco.mjtJoint.mjJNT_SLIDE
    assert model.dof_damping[2] == pytest.approx(slid.VISCOUS, rel=0.01)
    assert model.dof_frictionloss[2] == pytest.approx(slid.COULOMB, rel=0.01)
    assert model.dof_damping[1] == pytest.approx(slid.SHOULDER, rel=0.01)


def test_nothing_is_found_where_nothing_is_hidden():
    found = diagnose_torques(slid.recorded(seed=2), slid.arm(), options=FEW)
    assert found.findings == ()
    assert found.verdict == "consistent"
    declared = slid.arm(
        viscous_friction=[0, slid.SHOULDER, slid.VISCOUS], coulomb_friction=[0, 0, slid.COULOMB]
    )  # what the description declares is no finding
    found = diagnose_torques(slid.recorded(slid.friction, seed=2), declared, options=FEW)
    assert found.findings == ()
    assert found.verdict == "consistent"


def dynamics_of(seed=7):
    """The library's view of a motion, exact, with temperatures."""
    arm, (t, q, dq, ddq) = slid.arm(), slid.moved(seed, 4.0, 40.0)
    warm = 25 + np.outer(t, [1.0, 2.0, 3.0])
    motion = motion_of(q, joint_velocity=dq, time=t, joint_temperature=warm, sliding=arm.sliding)
    host = jax.tree.map(np.asarray, motion._replace(joint_acceleration=jnp.asarray(ddq.T)))
    links = np.asarray(link_parameters(arm))
    bodies = RigidBodies(host, links, np.zeros(3), slid.GRAVITY, np.asarray(arm.kinematics))
    return bodies.dynamics(links), (t, q[:, 2], dq[:, 2], ddq[:, 2])


FORMULAS = {
    "viscous_friction:joint=3,viscous_N_s_per_m=20": lambda F, t, q, v, a: 20 * v,
    "coulomb_friction:joint=3,coulomb_N=5": lambda F, t, q, v, a: 5 * np.tanh(v / 2e-4),
    "stribeck_friction:joint=3,velocity_m_per_s=0.05,stribeck_N=4": lambda F, t, q, v, a: (
        4 * np.exp(-((v / 0.05) ** 2)) * np.tanh(v / 2e-4)
    ),
    "friction_temperature:joint=3,viscous_N_s_per_m_K=-0.5": lambda F, t, q, v, a: -0.5 * 3 * t * v,
    "rotor_inertia:joint=3,mass_kg=7": lambda F, t, q, v, a: 7 * a,
    "joint_spring:joint=3,stiffness_N_per_m=90,rest_m=0.1": lambda F, t, q, v, a: 90 * (q - 0.1),
    "torque_ripple:joint=3,period_m=0.02,amplitude_N=3,phase_rad=0.7": lambda F, t, q, v, a: (
        3 * np.sin(2 * np.pi * q / 0.02 + 0.7)
    ),
}


@pytest.mark.parametrize("text", FORMULAS)
def test_what_an_effect_adds_to_a_force(text):
    dynamics, moved = dynamics_of()
    effect, values = parse_effect(text, TORQUE_EFFECTS, sliding=slid.SLIDING)
    added = composed(Terms((effect,)), values, dynamics) - dynamics.torque
    np.testing.assert_allclose(added[:2], 0.0, rtol=0, atol=0)
    np.testing.assert_allclose(added[2], FORMULAS[text](dynamics.torque[2], *moved), rtol=1e-12, atol=1e-12)
    numbers = text.partition(":")[2].split(",")[1:]
    assert {name: one["value"] for name, one in effect_as_dict(effect, values)["parameters"].items()} == pytest.approx(
        {key: float(value) for key, value in (item.split("=") for item in numbers)}
    )
    again, same = effect_from_dict(json.loads(json.dumps(effect_as_dict(effect, values))), TORQUE_EFFECTS)
    assert again == effect
    np.testing.assert_array_equal(same, values)


def test_every_number_of_the_catalogue_is_in_the_unit_of_its_joint():
    for effect in torque_catalogue(3, slid.SLIDING):
        units = {unit for number in effect.coordinates for unit in number.unit.replace("·", "/").split("/")}
        if getattr(effect, "of_slide", None):
            assert effect.site == "joint3"
            assert not units & {"Nm", "rad", "kg·m²", "m²"}
            assert all("rad" not in name and "Nm" not in name for name in effect.parameters)
            assert not {driver.unit for driver in effect.drivers} & {"rad", "rad/s", "rad/s²", "Nm"}
        elif hasattr(effect, "joint"):
            assert not units & {"N", "m"}
    pairs = [effect for effect in torque_catalogue(4, (1, 3)) if isinstance(effect, CoupledFriction)]
    assert pairs == [CoupledFriction(3, 1), CoupledFriction(4, 2, of_slide=True)]


def test_a_function_of_a_slide_without_a_name():
    """Half again as wide as an interval of its spline, 34 mm, so that the spline describes it and leaves no ripple."""
    q = slid.moved(1)[1][:, 2]

    def bump(dq):
        return np.outer(8 * np.exp(-(((q - 0.2) / 0.05) ** 2)), [0, 0, 1])

    found = diagnose_torques(slid.recorded(bump, seed=1), slid.arm(), options=FEW)
    (only,) = found.findings
    assert (only.effect.name, only.effect.site) == ("unnamed", "joint3")
    assert only.effect.drivers == (Driver("slide position", 3),)
    (entry,) = found.to_dict()["findings"]
    assert entry["peak_to_peak"]["peak_to_peak_N"]["value"] == pytest.approx(8, rel=0.2)
    assert {number.unit for number in only.effect.coordinates} == {"N"}


LEAD = 0.01
"""m, of a screw."""


@pytest.fixture(scope="module")
def on_a_screw():
    """The diagnosis of friction and of a force that repeats with the lead of a screw; the force of positions."""

    def ripple(q):
        return 3.0 * np.sin(2 * np.pi * q / LEAD + 0.7)

    q = slid.moved(5)[1][:, 2]
    recording = slid.recorded(lambda dq: slid.friction(dq) + np.outer(ripple(q), [0, 0, 1]), seed=5)
    return diagnose_torques(recording, slid.arm(), options=FEW), ripple


def test_the_ripple_of_a_screw_is_found_with_its_lead(on_a_screw):
    found, _ = on_a_screw
    assert found.verdict == "explained"
    entries = {(entry["effect"], entry["site"]): entry for entry in found.to_dict()["findings"]}
    assert entries.keys() == {*TRUTH, ("torque_ripple", "joint3")}
    ripple = entries["torque_ripple", "joint3"]
    for name, value in {"period_m": LEAD, "amplitude_N": 3.0, "phase_rad": 0.7}.items():
        estimate = ripple["parameters"][name]
        assert abs(estimate["value"] - value) < 3 * estimate["std"], name
        assert estimate["std"] < 0.1 * value
    assert ripple["driver"] == "slide position of joint 3"
    ripple |= {"where": {"of_slide": True}, "domain": "torques"}
    said = finding_statement(ripple)
    assert re.match(r"Torque ripple of period (9\.99|10)\d* mm at joint3 is significant: period [\d.]+ ± ", said)
    assert re.search(r"it contributes 1\.\d+ N RMS to the force\.$", said)  # 3 / √2, less what the low pass keeps back
    assert cause_of(ripple) == "joint 3 cogs as it moves"
    assert "Service the screw, the belt or the guide" in remedy_of(ripple).action


def test_the_ripple_of_a_screw_stays_in_the_model_where_recordings_are_pooled(on_a_screw):
    """Its order counts along the stroke of this recording: no wave of a fleet can take it up."""
    found = on_a_screw[0]
    pooled = reduced(found)
    assert {family.site for family in pooled.heading.families} == {"joint1", "joint2"}
    ripple = next(one.effect for one in found.findings if one.effect.name == "torque_ripple")
    problem = found.problem
    columns = found.fit.noise.whitened(problem.columns([ripple])) * found.fit.training
    flat = np.zeros((len(columns), pooled.residual.size))
    flat[:, : columns[0].size] = columns.reshape(len(columns), -1)
    left = flat - (flat @ pooled.basis.T) @ pooled.basis
    assert np.linalg.norm(left) < 1e-6 * np.linalg.norm(flat)


def test_the_model_of_a_screw_is_written_read_and_predicts(on_a_screw):
    found, ripple = on_a_screw
    document = json.loads(json.dumps(found.to_dict()))
    model = model_from_document(document)
    unseen = slid.recorded(seed=6)
    _, q, dq, ddq = slid.moved(6)
    truth = slid.exerted(q, dq, ddq) + slid.friction(dq)
    truth[:, 2] += ripple(q[:, 2])
    away = predict(model, unseen) - truth
    assert np.median(np.abs(away[20:-20, 2])) < 0.15  # of a ripple of 3 N


def test_a_ripple_of_a_fixed_order_is_one_of_its_period():
    effect, values = parse_effect(
        "torque_ripple:joint=3,order=300,amplitude_N=2,phase_rad=1", TORQUE_EFFECTS, sliding=(2,)
    )
    stored = json.loads(json.dumps(effect_as_dict(effect, values)))
    assert stored["where"] == {"joint": 3, "of_slide": True, "order": 300.0}
    assert stored["parameters"]["period_m"]["value"] == pytest.approx(1 / 300)
    again, same = effect_from_dict(stored, TORQUE_EFFECTS)
    assert again == effect
    np.testing.assert_allclose(same, values, rtol=1e-15)
    free = effect.released()
    shown = free.reported([*values, 300.0], np.diag([0, 0, 0.3**2]))
    assert shown["period_m"].std == pytest.approx(0.3 / 300**2)


def test_periods_are_searched_as_far_as_stroke_and_low_pass_resolve_them():
    recording = slid.recorded(seed=4)
    problem = torque_problem(screen_torques(recording, slid.arm()).data)
    revolute, _, slide = problem.periodic
    assert (revolute.whole, revolute.highest, slide.whole) == (True, None, False)
    q, dq = (np.asarray(part)[2] for part in (problem.data.motion.joint_position, problem.data.motion.joint_velocity))
    shortest = np.ptp(q) / slide.highest
    assert shortest == pytest.approx(np.quantile(np.abs(dq), 0.2) / problem.data.filter.cutoff, rel=0.05)
    assert slide.term(40.0).period_m == pytest.approx(np.ptp(q) / 40)
    assert slide.order(slide.term(40.0)) == pytest.approx(40)
    at = np.outer([1, 7.3], 2 * np.pi * q[problem.data.filter.kept][problem.chosen] / np.ptp(q))
    own = replace(slide, waves=None).waves_of(np.array([1, 7.3]))
    np.testing.assert_allclose(own, np.stack([np.sin(at), np.cos(at)], 1), atol=1e-12)


def test_a_push_along_the_slide_is_a_contact_in_newtons():
    recording = slid.recorded(seed=4)
    tau = recording.torques().copy()
    tau[500:560, 2] += 30.0
    screened = screen_torques(replace(recording, joint_torque=tau), slid.arm())
    _, (fault,) = contacts(torque_problem(screened.data), EngineOptions())
    assert fault.numbers["joints"] == [3]
    assert fault.numbers["largest_N"] == pytest.approx(30, rel=0.1)
    said = fault_statement(fault)
    assert " N from the model" in said
    assert "Nm and " in said  # the revolute joints differ by less than their noise explains


def test_two_recordings_of_one_motion_are_compared_in_each_unit():
    one, other = slid.recorded(slid.friction), slid.recorded(lambda dq: slid.friction(dq, coulomb=16.0))
    found = compare_rows(one, other, slid.arm())
    np.testing.assert_allclose(found.apart, [0, 0, 10], atol=1e-9)
    document = {
        "file": "b.csv",
        "basis": "rows",
        "rows": found.rows,
        "matched_rows": found.matched,
        "apart_rms_by_joint_Nm": found.apart.tolist(),
        "reference_rms_by_joint_Nm": found.from_model.tolist(),
    }
    said = comparison_headline(document, ("Nm", "Nm", "N"))
    assert "by 0 Nm, 0 Nm, 10 N RMS" in said
    late = replace(other, joint_position=other.joint_position + np.array([0, 0, 1e-3]))  # 1 mm is another state
    assert compare_rows(one, late, slid.arm()) is None
    late = replace(other, joint_position=other.joint_position + np.array([1e-3, 0, 0]))  # 1 mrad is none
    assert compare_rows(one, late, slid.arm()) is not None


@final
@dataclass(frozen=True)
class Drag(JointTorque):
    """A user's own effect."""

    name: ClassVar[str] = "drag"
    quantities: ClassVar[tuple] = ("velocity",)
    numbers: ClassVar[tuple] = (Coordinate("drag_Nm", "Nm", 1.0),)

    def at_joint(self, values, dynamics):
        speed = dynamics.velocity(self.joint)
        return values[0] * speed * abs(speed)


def test_what_does_not_fit_the_joint_is_refused():
    arm, recording = slid.arm(), slid.recorded(seed=4)
    revolute = replace(recording, sliding=())
    with pytest.raises(InputError, match="q3 is an angle, but joint 3 of telescope is prismatic; name the column q3_m"):
        screen_torques(revolute, arm)
    with pytest.raises(InputError, match="q3 is an angle, but joint 3 of telescope is prismatic"):
        compare_rows(recording, revolute, arm)
    still = replace(recording, joint_position=recording.joint_position[:1] + 1e-4 * (recording.joint_position * 0 + 1))
    with pytest.raises(InputError, match=r"at rest \(no joint moves by 0.02 rad or 0.002 m\); record"):
        screen_torques(still, arm)
    large = replace(recording, joint_torque=recording.torques() * [1, 1, 1000])
    with pytest.raises(InputError, match=r"column tau3_N: the force of joint 3 is .* N \(median\) while the weight"):
        screen_torques(large, arm)
    data = screen_torques(recording, arm).data
    with pytest.raises(InputError, match=r"drag:joint3: is of a revolute joint, .* is prismatic; give of_slide=True"):
        torque_problem(data, [Drag(3)])
    assert Drag(3, of_slide=True) in torque_problem(data, [Drag(3, of_slide=True)]).candidates
    with pytest.raises(InputError, match="is of a prismatic joint, and joint 2 is revolute; give joints of one kind"):
        torque_problem(data, [CoupledFriction(3, 2, of_slide=True)])
    with pytest.raises(InputError, match="'amplitude_Nm' is unknown; the keys are joint, order, period_m, amplitude_N"):
        parse_effect("torque_ripple:joint=3,order=2,amplitude_Nm=1", TORQUE_EFFECTS, sliding=(2,))
    with pytest.raises(InputError, match="no period is given; say after which length the force repeats, as period_m="):
        parse_effect("torque_ripple:joint=3,amplitude_N=1", TORQUE_EFFECTS, sliding=(2,))
    with pytest.raises(InputError, match=r"period_m is -0\.01; give a positive length"):
        parse_effect("torque_ripple:joint=3,period_m=-0.01,amplitude_N=1", TORQUE_EFFECTS, sliding=(2,))
    with pytest.raises(InputError, match=r"period_m 0.02 beside the fixed period_m 0.01; give one of them"):
        parse_effect("torque_ripple:joint=3,order=100,period_m=0.02,amplitude_N=1", TORQUE_EFFECTS, sliding=(2,))
    with pytest.raises(
        InputError, match="'viscous_Nm_s_per_rad' is unknown; the keys are joint, exponent, viscous_N_s_per_m"
    ):
        parse_effect("viscous_friction:joint=3,viscous_Nm_s_per_rad=1", TORQUE_EFFECTS, sliding=(2,))
    with pytest.raises(InputError, match="velocity_m_per_s is -1; give a positive number"):
        StribeckFriction(3, -1.0, of_slide=True)


def test_a_document_with_an_effect_of_the_other_kind_is_refused(diagnosed):
    document = json.loads(json.dumps(diagnosed))
    document["model"]["prismatic_joints"] = [2]
    with pytest.raises(InputError, match=r"is of a (revolute|prismatic) joint, and joint [23] is"):
        model_from_document(document)
    document["model"]["prismatic_joints"] = [9]
    with pytest.raises(InputError, match=r"its model is damaged .*sliding is \(8,\); give prismatic joints in order"):
        model_from_document(document)


def test_effects_of_one_name_at_joints_of_two_kinds_are_two():
    assert ViscousFriction(3) != ViscousFriction(3, of_slide=True)
    assert "of_slide" not in effect_as_dict(CoulombFriction(3), [1.0])["where"]
    assert effect_as_dict(CoulombFriction(3, of_slide=True), [1.0])["where"] == {"joint": 3, "of_slide": True}
