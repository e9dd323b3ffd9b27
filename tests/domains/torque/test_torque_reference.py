"""Torques relative to a reference recording: of the same motion row by row, of another one effect by effect."""

import json
from dataclasses import replace

import numpy as np
import pytest
from domains.torque.moved import hidden, motion_of, recorded, setup_of
from report.torque_diagnosed import diagnosed
from typed import flat, run

from benchmarks.torque_trials.physics import torques
from lite6jax.arms.description import write_arm
from lite6jax.diagnosis import torque_diagnosis
from lite6jax.diagnosis.estimates import EffectComparison
from lite6jax.diagnosis.options import Options
from lite6jax.domains.torque.reference import RowComparison, compare_rows
from lite6jax.effects.dynamic import UnnamedTorque
from lite6jax.errors import InputError
from lite6jax.recordings import Recording, write_recording
from lite6jax.report.statements import with_comparison

FEW = Options(folds=2)
EARLIER = (
    hidden("viscous_friction", "joint2", viscous_Nm_s_per_rad=0.6),
    hidden("coulomb_friction", "joint3", coulomb_Nm=0.5),
)
WORN = (*EARLIER[:1], hidden("coulomb_friction", "joint3", coulomb_Nm=0.9))


def diagnose_torques_against(recording, reference, arm, **given):
    found = torque_diagnosis.diagnose_torques(recording, arm, reference=reference, **given)
    return found, found.against


def simulated(effects, seed=1):
    """The same motion as `recorded(seed=…)`, of a simulator: other sampling, no noise."""
    setup, _ = setup_of(seed)
    motion = motion_of(setup, seed + 100, rate=80.0)
    return Recording.from_arrays(
        motion.q,
        time=motion.time + 3.0,
        joint_velocity=motion.dq,
        joint_torque=torques(setup, effects, motion),
        motion="trajectory",
    )


def test_of_the_same_motion_only_the_difference_is_found():
    """Nor what the description declares of drives and neither of them has."""
    recording, arm = recorded(WORN, seed=1)
    arm = replace(arm, viscous_friction=np.array([0.0, 0.0, 0.0, 0.0, 0.3, 0.0]))
    found, seen = diagnose_torques_against(recording, simulated(EARLIER), arm, options=FEW)
    (finding,) = found.findings
    assert finding.effect.label == "coulomb_friction:joint3"
    (estimate,) = finding.parameters.values()
    assert abs(estimate.value - 0.4) < 4 * estimate.std < 0.2
    assert isinstance(seen, RowComparison)
    assert seen.matched > 0.95 * recording.samples
    assert seen.apart[2] == pytest.approx(0.4, abs=0.1)
    assert seen.from_model[1] > 0.2
    assert seen.from_model[0] < 0.02


def test_noise_of_both_counts():
    recording, arm = recorded(seed=1)
    reference = recorded(seed=1, noise=1.5)[0]
    seen = compare_rows(recording, reference, arm)
    noise = (side.settings.torque_noise_Nm for side in (recording, reference))
    np.testing.assert_allclose(seen.recording.settings.torque_noise_Nm, np.hypot(*noise))


def test_of_another_motion_what_each_shows_is_compared():
    recording, arm = recorded(WORN, seed=1)
    setup, _ = setup_of(1)
    motion = motion_of(setup, 500)
    rng = np.random.default_rng(3)
    tau = torques(setup, EARLIER, motion) + rng.normal(0, 0.5, motion.q.shape) * setup.arm.noise
    reference = Recording.from_arrays(
        motion.q, time=motion.time, joint_velocity=motion.dq, joint_torque=tau, settings=recording.settings,
        source="folder/earlier.csv",
    )  # fmt: skip
    found, seen = diagnose_torques_against(recording, reference, arm, options=FEW)
    assert isinstance(seen, EffectComparison)
    assert seen.file == "earlier.csv"
    assert {f.effect.label for f in found.findings} == {"viscous_friction:joint2", "coulomb_friction:joint3"}
    said = {(each["effect"], each["site"]): each for each in seen.to_dict()["differences"]}
    assert said["coulomb_friction", "joint3"]["p_value"] < 1e-4
    assert said["viscous_friction", "joint2"]["p_value"] > 0.0027
    assert all(each["agree"] == (effect == "viscous_friction") for (effect, _), each in said.items())


def sticky(q, v, size):
    """Torques of a zone of joint 2 in which it sticks."""
    zone = size * np.exp(-(((q[:, 1] - 0.2) / 0.25) ** 2)) * np.tanh(v[:, 1] / 0.002)
    return zone[:, None] * (np.arange(6) == 1)


@pytest.mark.parametrize(("before", "differs"), [(0.8, False), (0.4, True)])
def test_functions_without_a_name_are_compared_where_both_recordings_have_them(monkeypatch, before, differs):
    """Of processes of other kernels over other ranges, as two searches find them; only the searches are left out."""
    setup, _ = setup_of(1)
    settings, sides = recorded(seed=1)[0].settings, []
    for seed, size, kernel in ((500, 0.8, "medium*line"), (501, before, "fine*line")):
        motion, rng = motion_of(setup, seed), np.random.default_rng(seed)
        noise = 0.5 * rng.normal(0, 1, motion.q.shape) * setup.arm.noise
        tau = torques(setup, [], motion) + sticky(motion.q, motion.dq, size) + noise
        q = motion.q[:, 1]
        drivers = "position of joint 2 and direction of motion of joint 2"
        curve = UnnamedTorque(2, drivers, q.min(), q.max(), kernel, (-1.0, 1.0), 5.0)
        side = Recording.from_arrays(
            motion.q, time=motion.time, joint_velocity=motion.dq, joint_torque=tau, settings=settings
        )
        sides.append((side, curve))

    def searched(recording, arm, **given):
        curve = next(curve for side, curve in sides if side is recording)
        return diagnosed(recording, (curve,), arm=arm)

    monkeypatch.setattr("lite6jax.diagnosis.torque_diagnosis._diagnose_alone", searched)
    _, seen = diagnose_torques_against(sides[0][0], sides[1][0], setup_of(1)[1])
    (difference,) = seen.effects
    assert difference.p_value < 1e-6 if differs else difference.p_value > 0.0027
    document = with_comparison(seen.to_dict())["differences"][0]
    assert document["driver"] == "position of joint 2 and direction of motion of joint 2"
    assert document["statement"].startswith("Unnamed effect at joint2 over position of joint 2 and direction")
    assert ("differs (p = " in document["statement"]) == differs
    here, there = (document[side]["parameters"]["rms_Nm"] for side in ("recording", "reference"))
    assert there["value"] / here["value"] == pytest.approx(before / 0.8, abs=0.1)


def test_a_function_of_a_driver_that_the_reference_lacks_is_said(monkeypatch):
    (warm, arm), (cold, _) = (recorded(seed=1, warming=True), recorded(seed=1))
    cold = cold.select(np.arange(cold.samples) > 200)  # another motion
    curve = UnnamedTorque(2, "temperature of joint 2", 20.0, 60.0, "cubic", spread=5.0)
    monkeypatch.setattr(
        "lite6jax.diagnosis.torque_diagnosis._diagnose_alone",
        lambda recording, arm, **given: diagnosed(recording, (curve,) if recording is warm else (), arm=arm),
    )
    _, seen = diagnose_torques_against(warm, cold, arm)
    (difference,) = seen.effects
    assert difference.p_value is None
    assert difference.estimates["reference"] is None
    assert "the reference does not show it" in with_comparison(seen.to_dict())["differences"][0]["statement"]


def test_another_number_of_joints_is_refused():
    recording, arm = recorded(seed=1)
    five = Recording.from_arrays(
        recording.joint_position[:, :5], time=recording.time, joint_torque=recording.torques()[:, :5],
        motion="trajectory",
    )  # fmt: skip
    with pytest.raises(InputError, match=r"has 5 joints, but .* 6; give that arm's"):
        compare_rows(recording, five, arm)


def test_the_command_says_what_was_compared(tmp_path, capsys):
    recording, arm = recorded(WORN, seed=1)
    write_arm(arm, tmp_path / "arm.yaml")
    settings = replace(recording.settings, arm="arm.yaml")
    run_file = write_recording(replace(recording, settings=settings), tmp_path / "run.csv")
    reference = write_recording(simulated(EARLIER), tmp_path / "gazebo.csv")
    out = tmp_path / "d.json"
    code, said, _ = run(capsys, "diagnose", run_file, "--reference", reference, "--quick", "--out", out)
    assert code == 0
    assert "Reference gazebo.csv, " in flat(said)
    assert "Findings and model are the difference from gazebo.csv" in flat(said)
    against = json.loads(out.read_text())["against"]
    assert (against["basis"], against["file"]) == ("rows", "gazebo.csv")
    code, said, _ = run(capsys, "predict", out, run_file, "--out", tmp_path / "p.csv")
    assert code == 0
    assert "the difference from gazebo.csv" in flat(said)
