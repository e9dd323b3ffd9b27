"""What is declared wrongly of torques, and joints held at rest: located, corrected, weighed down, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from domains.torque.moved import GRAVITY, at_flange, hidden, motion_of, recorded, setup_of
from scipy.spatial.transform import Rotation

from benchmarks.torque_trials.physics import torques
from lite6jax.arms import frames
from lite6jax.arms.files import read_arm
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.torque_diagnosis import diagnose_torques
from lite6jax.domains.torque.screening import screen_torques
from lite6jax.errors import InputError
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault
from lite6jax.report.faults import fault_statement

FRICTION = (
    hidden("viscous_friction", "joint2", viscous_Nm_s_per_rad=0.6),
    hidden("coulomb_friction", "joint2", coulomb_Nm=0.8),
)


def also(*case):
    """A further case of what each run shows once; campaigns draw such faults too."""
    return pytest.param(*case, marks=pytest.mark.long)


def mounted(gravity, change=None, seed=7, **declared):
    """A recording of an arm in this gravity, that declares it upright."""
    setup, arm = setup_of(seed)
    motion = motion_of(setup, seed + 100)
    setup = replace(setup, gravity=np.asarray(gravity, float))
    tau = torques(setup, FRICTION, motion)
    tau += np.random.default_rng(seed).normal(0, 1, tau.shape) * 0.5 * setup.arm.noise
    return Recording.from_arrays(
        motion.q,
        time=motion.time,
        joint_velocity=motion.dq,
        joint_torque=tau if change is None else change(tau),
        motion="trajectory",
        payload_com_m=tuple(at_flange(arm)),
        torque_noise_Nm=tuple(setup.arm.noise),
        **declared,
    ), arm


def faults_of(recording, arm):
    return [(fault.code, fault.numbers) for fault in screen_torques(recording, arm).found]


@pytest.mark.parametrize("gravity", [(0, 0, 9.81), also((0, -9.81, 0))])
def test_an_arm_on_a_wall_or_a_ceiling_is_no_upright_one(gravity):
    screened = screen_torques(*mounted(gravity))
    ((code, numbers),) = [(fault.code, fault.numbers) for fault in screened.found]
    assert code == "wrong_gravity"
    assert numbers["found_m_per_s2"] == list(gravity)
    assert numbers["declared_m_per_s2"] == GRAVITY.tolist()
    assert numbers["tilt_rad"] == pytest.approx(np.pi if gravity[2] else np.pi / 2, abs=0.1)
    np.testing.assert_array_equal(screened.data.bodies.gravity, gravity)
    said = fault_statement(screened.found[0])
    assert f"Declare gravity_m_per_s2: [{', '.join(f'{g:g}' for g in gravity)}] in the sidecar." in said


def test_a_slanted_mount_is_found_as_it_is():
    tilt = 1.1
    gravity = 9.81 * np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    ((code, numbers),) = faults_of(*mounted(gravity))
    assert code == "wrong_gravity"
    np.testing.assert_allclose(numbers["found_m_per_s2"], gravity, atol=0.4)
    assert np.linalg.norm(numbers["found_m_per_s2"]) == pytest.approx(9.81, abs=1e-2)


def test_a_small_tilt_is_an_effect_and_no_fault():
    tilt = 0.3
    gravity = 9.81 * np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    screened = screen_torques(*mounted(gravity))
    assert screened.found == ()
    assert "wrong_gravity" in {fault.code for fault in screened.ruled_out}


def test_all_signs_reversed_is_not_taken_for_a_ceiling():
    ((code, numbers),) = faults_of(*mounted(GRAVITY, change=lambda tau: -tau))
    assert code == "reversed_torque"
    assert {1, 2, 3} <= set(numbers["joints"])


@pytest.mark.long
def test_gravity_and_columns_are_both_corrected():
    found = faults_of(*mounted((0, 0, 9.81), change=lambda tau: tau[:, [0, 2, 1, 3, 4, 5]]))
    assert [code for code, _ in found] == ["wrong_gravity", "swapped_torques"]


def test_a_wrong_constant_of_a_joint_is_said_and_divided_out():
    recording, arm = recorded(FRICTION, seed=7, change=lambda tau: tau * [1, 1, 2.2, 1, 1, 1])
    screened = screen_torques(recording, arm)
    ((code, numbers),) = [(fault.code, fault.numbers) for fault in screened.found]
    assert (code, numbers["joints"]) == ("wrong_torque_constant", [3])
    assert numbers["factors"] == [pytest.approx(2.2, abs=0.1)]
    assert numbers["constants_Nm_per_A"] is None
    straight = recorded(FRICTION, seed=7)[0].torques().T
    np.testing.assert_allclose(screened.data.torque[2], 2.2 / numbers["factors"][0] * straight[2])
    declared, noise = (side.settings.torque_noise_Nm for side in (recording, screened.data.recording))
    assert noise[2] == pytest.approx(declared[2] / numbers["factors"][0])
    assert "that of joint 3 2.2 times as much" in fault_statement(screened.found[0])


def test_of_currents_the_constant_to_declare_is_said():
    recording, arm = recorded(FRICTION, seed=7)
    constants = np.array([8.0, 8.0, 4.0, 4.0, 4.0, 4.0])
    currents = recording.torques() / constants
    settings = replace(recording.settings, torque_constant_Nm_per_A=tuple(constants * [1, 0.4, 1, 1, 1, 1]))
    wrong = replace(recording, joint_torque=None, motor_current=currents, settings=settings)
    ((code, numbers),) = faults_of(wrong, arm)
    assert (code, numbers["joints"]) == ("wrong_torque_constant", [2])
    assert numbers["constants_Nm_per_A"] == [pytest.approx(8.0, rel=0.03)]
    assert "Declare torque_constant_Nm_per_A 8" in fault_statement(DataFault(code, (), numbers))


@pytest.mark.parametrize(
    ("effects", "factor"),
    [
        (FRICTION, [1, 1, 1.5, 1, 1, 1]),  # an error of calibration: an effect
        also(FRICTION, 2.2),  # of all joints: rather other masses
        # other masses, though the torque of a joint may be a multiple of what it should be
        ([hidden("payload_error", "payload", mass_kg=0.9)], 1),
    ],
)
def test_what_is_no_wrong_constant(effects, factor):
    assert faults_of(*recorded(effects, seed=7, change=lambda tau: tau * factor)) == []


# ------------------------------------------------------------------ the table of hypotheses

SIZE = 8.0
"""Times the noise of a joint's sensor: friction of every joint, as real arms have."""


def rubbing(seed):
    """Friction at every joint: what tells signs apart, since it takes power."""
    setup, _ = setup_of(seed)
    return [
        hidden(name, f"joint{j}", **{number: float(SIZE * noise)})
        for j, noise in enumerate(setup.arm.noise, 1)
        for name, number in (("viscous_friction", "viscous_Nm_s_per_rad"), ("coulomb_friction", "coulomb_Nm"))
    ]


def changed(seed=11, effects=(), **columns):
    """A recording of an arm with friction, whose columns `q`, `dq` and `tau` `(sample, joint)` are altered by name."""
    recording, arm = recorded([*rubbing(seed), *effects], seed=seed, declare=False)
    names = {"q": "joint_position", "dq": "joint_velocity", "tau": "joint_torque"}
    new = {names[key]: change(np.array(getattr(recording, names[key]))) for key, change in columns.items()}
    return replace(recording, **new), arm


def reversed_at(*joints):
    return lambda column: column * np.where(np.isin(np.arange(6) + 1, joints), -1.0, 1.0)


def exchanged(i, j):
    order = np.arange(6)
    order[[i - 1, j - 1]] = order[[j - 1, i - 1]]
    return lambda column: column[:, order]


COUPLING = np.eye(6)
COUPLING[2, 1] = 1.0  # joint 3 as its motor turns, beside joint 2; motors exert what leaves the power as it is


def coupled(column):
    return column @ COUPLING.T


def added(joint, degrees):
    return lambda column: column + np.deg2rad(degrees) * (np.arange(6) + 1 == joint)


@pytest.mark.parametrize(
    ("columns", "code", "numbers"),
    [
        ({"tau": reversed_at(1, 5)}, "reversed_torque", {"joints": [1, 5]}),
        also({"q": reversed_at(4), "dq": reversed_at(4), "tau": reversed_at(4)}, "reversed_joint", {"joints": [4]}),
        ({"q": reversed_at(2), "dq": reversed_at(2)}, "reversed_positions", {"joints": [2]}),
        also({"q": exchanged(2, 3), "dq": exchanged(2, 3)}, "swapped_positions", {"joints": [2, 3]}),
        (
            {"q": exchanged(4, 5), "dq": exchanged(4, 5), "tau": exchanged(4, 5)},
            "swapped_columns",
            {"joints": [4, 5]},
        ),
        (
            {"q": coupled, "dq": coupled, "tau": lambda tau: tau @ np.linalg.inv(COUPLING)},
            "coupled_positions",
            {"joint": 3, "added_joint": 2, "factor": -1.0},
        ),
        also({"q": added(2, 90)}, "joint_zero", {"joint": 2, "added_rad": -np.pi / 2}),
        ({"q": added(3, 15)}, "joint_zero", {"joint": 3, "added_rad": np.deg2rad(-15)}),
    ],
)
def test_what_a_column_has_wrong_is_said_and_undone(columns, code, numbers):
    straight, _ = changed()
    screened = screen_torques(*changed(**columns))
    (fault,) = screened.found
    assert fault.code == code
    assert set(fault.numbers) == set(numbers)
    for name, value in numbers.items():
        assert fault.numbers[name] == pytest.approx(value, abs=0.02)
    np.testing.assert_allclose(screened.data.recording.joint_position, straight.joint_position, atol=0.02)
    np.testing.assert_allclose(screened.data.torque, straight.torques().T)
    for joint in numbers.get("joints", [numbers.get("joint")]):
        assert str(joint) in fault_statement(fault)


def test_zeros_of_two_joints_of_another_convention_are_both_found():
    found = screen_torques(*changed(q=lambda q: added(3, 90)(added(2, -90)(q)))).found
    assert [(fault.code, fault.numbers["joint"]) for fault in found] == [("joint_zero", 2), ("joint_zero", 3)]
    assert [fault.numbers["added_rad"] for fault in found] == pytest.approx([np.pi / 2, -np.pi / 2], abs=0.02)


def at_rest(effects=(), seed=7, shift=(0.0, 0.0, 0.0)):
    """Forty postures of an arm; its payload is declared by `shift` from where it is, in m."""
    setup, arm = setup_of(seed)
    motion = motion_of(setup, seed + 100)
    still = replace(motion, dq=0 * motion.dq, ddq=0 * motion.ddq)
    kept = np.linspace(0, len(motion.time) - 1, 40).astype(int)
    tau = torques(setup, effects, still)[kept]
    tau += np.random.default_rng(seed).normal(0, 1, tau.shape) * setup.arm.noise
    return Recording.from_arrays(
        motion.q[kept], joint_torque=tau, motion="static", payload_com_m=tuple(at_flange(arm) - np.array(shift))
    ), arm


def test_a_sign_and_a_zero_show_in_postures_at_rest():
    recording, arm = at_rest()
    assert not screen_torques(recording, arm).found
    turned = replace(recording, joint_torque=reversed_at(2)(recording.joint_torque))
    assert faults_of(turned, arm) == [("reversed_torque", {"joints": [2]})]
    ((code, numbers),) = faults_of(replace(recording, joint_position=added(3, 15)(recording.joint_position)), arm)
    assert (code, numbers["joint"]) == ("joint_zero", 3)
    assert numbers["added_rad"] == pytest.approx(np.deg2rad(-15), abs=0.03)


def test_a_payload_at_rest_is_one_body_with_its_centre():
    effects = [hidden("payload_error", "payload", mass_kg=0.62)]
    (finding,) = diagnose_torques(*at_rest(effects, shift=(0.03, 0.0, 0.07)), options=Options(folds=2)).findings
    assert finding.effect.name == "payload"
    assert finding.parameters["mass_kg"].value == pytest.approx(0.62, abs=0.05)
    assert finding.parameters["z_m"].value == pytest.approx(0.07, abs=0.02)


def test_one_factor_in_three_joints_is_one_factor():
    (fault,) = screen_torques(*changed(tau=lambda tau: tau * [4, 4, 4, 1, 1, 1])).found
    assert fault.code == "wrong_torque_constant"
    assert fault.numbers["joints"] == [1, 2, 3]
    assert fault.numbers["factors"] == pytest.approx([4, 4, 4], rel=0.02)
    assert len(set(fault.numbers["factors"])) == 1
    assert f"joint 2 {fault.numbers['factors'][0]:g} times" in fault_statement(fault)


@pytest.mark.parametrize(
    ("factors", "remedy"),
    [
        (
            [1 / 12.2, 1 / 12.2, 1 / 11, 1 / 9.1, 1 / 9.1, 1 / 9.3],
            "currents in A.*torque_constant_Nm_per_A: about 12, 12",
        ),
        ([100.0] * 6, "are these N cm\\? divide them by 100"),
        also([1e-3] * 6, "are these kN m\\?"),
        ([2.0, 2.0, 3.3, 10.0, 10.0, 12.5], "per cent of each joint's rating.*ratings of about 5"),
    ],
)
def test_torques_in_another_unit_are_asked_for(factors, remedy):
    with pytest.raises(InputError, match=remedy):
        screen_torques(*changed(tau=lambda tau: tau * factors))


def test_torques_without_gravity_are_compared_without_it():
    screened = screen_torques(*mounted((0, 0, 0)))
    (fault,) = screened.found
    assert fault.code == "no_gravity"
    assert not screened.data.bodies.gravity.any()
    assert "declare gravity_m_per_s2: [0, 0, 0]" in fault_statement(fault)


@pytest.mark.parametrize(
    "effect",
    [
        also(hidden("payload_error", "payload", mass_kg=0.9)),
        also(hidden("base_tilt", "base", tilt_x_rad=0.3, tilt_y_rad=0.1)),
        hidden("joint_spring", "joint2", stiffness_Nm_per_rad=8.0, rest_rad=0.3),
        also(hidden("time_offset", "clock", offset_s=0.04)),
    ],
)
def test_physics_is_no_fault_of_the_data(effect):
    found = screen_torques(*changed(effects=[effect])).found
    assert {fault.code for fault in found} <= {"torque_spikes"}  # where friction changes its sign within a sample


def test_corrections_that_explain_torques_alike_are_listed():
    fault = DataFault(
        "undecided_torques",
        (),
        {
            "alternatives": [
                [{"fault": "joint_zero", "joint": 2, "added_rad": np.pi / 2}],
                [{"fault": "reversed_torque", "joints": [2, 3]}, {"fault": "no_gravity"}],
            ]
        },
    )
    said = fault_statement(fault)
    assert "2 corrections explain that alike" in said
    assert "the zero of joint 2 off by -90°; or a reversed torque of joints 2 and 3 and torques without gravity" in said
    assert "Nothing was corrected" in said


def test_turns_of_an_encoder_are_removed_and_said():
    straight, _ = changed()
    screened = screen_torques(*changed(q=lambda q: np.mod(q, 2 * np.pi)))
    fault = screened.found[0]
    assert [fault.code for fault in screened.found] == ["joint_turns"]
    assert "off by whole turns" in fault_statement(fault)
    np.testing.assert_allclose(screened.data.recording.joint_position, straight.joint_position, atol=1e-9)


def test_torques_that_a_model_computed_have_neither_noise_nor_friction():
    computed = recorded(seed=11, noise=0.0, velocity_noise=1e-4, declare=False)
    (fault,) = screen_torques(*computed).found
    assert fault.code == "estimated_torque"
    assert "neither noise nor any friction" in fault_statement(fault)
    for measured in (recorded(seed=11, declare=False), recorded(rubbing(11), seed=11, noise=0.0, declare=False)):
        assert screen_torques(*measured).found == ()


# ------------------------------------------------------------------ rest


def dwelling(held, seed=7, seconds=24.0, rate=50.0):
    """A motion that stops now and then, of which friction holds joint 2 anywhere within `held` Nm at each stop."""
    setup, arm = setup_of(seed)
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate
    w = 2 * np.pi / 4.0  # s between two stops
    k = 12.0
    gate = 0.5 * (1 + np.tanh(k * (np.cos(w * t) + 0.5)))
    slope = -0.5 * k * w * np.sin(w * t) / np.cosh(k * (np.cos(w * t) + 0.5)) ** 2
    phase = np.cumsum(gate) / rate
    pulse, size = rng.uniform(1.2, 2.4, (2, 6)), rng.uniform(0.2, 0.4, (2, 6))
    angle = pulse[:, None] * phase[:, None] + rng.uniform(0, 6, (2, 1, 6))
    middle = np.clip(arm.joint_limits.mean(1), -1, 2)
    q = middle + np.sum(size[:, None] * np.sin(angle), 0)
    along = np.sum(size[:, None] * pulse[:, None] * np.cos(angle), 0)
    bent = -np.sum(size[:, None] * pulse[:, None] ** 2 * np.sin(angle), 0)
    dq = along * gate[:, None]
    ddq = bent * gate[:, None] ** 2 + along * slope[:, None]
    motion = replace(motion_of(setup, seed, seconds=seconds, rate=rate), time=t, q=q, dq=dq, ddq=ddq)
    tau = torques(setup, FRICTION, motion) + rng.normal(0, 1, q.shape) * 0.5 * setup.arm.noise
    stop = np.cumsum(np.diff(gate > 0.01, prepend=False)) // 2
    still = np.abs(dq[:, 1]) < 1e-3
    level = held * rng.choice([-1.0, 1.0], stop.max() + 1) * rng.uniform(0.5, 1.0, stop.max() + 1)
    tau[still, 1] += level[stop[still]]
    recording = Recording.from_arrays(
        q, time=t, joint_velocity=dq, joint_torque=tau, motion="trajectory", payload_com_m=tuple(at_flange(arm)),
        torque_noise_Nm=tuple(setup.arm.noise),
    )  # fmt: skip
    return recording, arm, still


def test_torques_that_friction_holds_at_rest_have_little_weight():
    recording, arm, still = dwelling(0.6)
    found = diagnose_torques(recording, arm, options=Options(folds=2))
    (fault,) = found.faults
    assert (fault.code, fault.numbers["joints"]) == ("held_by_friction", [2])
    assert 0.3 < fault.numbers["std_Nm"][0] < 0.6
    rows = set(1 + np.flatnonzero(still))
    assert len(rows & set(fault.rows)) > 0.8 * len(rows | set(fault.rows))
    assert "friction holds a joint wherever it stands" in fault_statement(fault)
    sigma = found.problem.sigma
    at = found.problem.data.filter.kept
    assert np.mean(sigma[1, still[at]] > 5 * found.problem.noise[1]) > 0.9
    np.testing.assert_array_equal(sigma[0], found.problem.noise[0])
    estimates = {f.effect.label: next(iter(f.parameters.values())) for f in found.findings}
    assert set(estimates) == {"viscous_friction:joint2", "coulomb_friction:joint2"}
    for label, truth in (("viscous_friction:joint2", 0.6), ("coulomb_friction:joint2", 0.8)):
        assert abs(estimates[label].value - truth) < 4 * estimates[label].std


def test_rest_that_the_model_explains_keeps_its_weight():
    recording, arm, _ = dwelling(0.0)
    screened = screen_torques(recording, arm)
    assert screened.found == ()
    assert screened.data.slack is None


def test_a_joint_about_another_axis_than_described_is_refused_with_the_axis():
    joint, (recording, arm) = 2, recorded(FRICTION, seed=7)
    R = Rotation.from_euler("x", 90, degrees=True)
    wrong = arm.kinematics.copy()
    before, after = np.eye(4), np.eye(4)
    before[:3, :3] = R.inv().as_matrix()
    after[:3, :3] = R.as_matrix()
    wrong[joint - 1] = frames.row_from_transform(frames.transform_from_row(wrong[joint - 1]) @ before)
    wrong[joint] = frames.row_from_transform(after @ frames.transform_from_row(wrong[joint]))
    center, inertia = np.array(arm.center_of_mass), np.array(arm.inertia)
    center[joint - 1] = after[:3, :3] @ center[joint - 1]
    inertia[joint - 1] = after[:3, :3] @ inertia[joint - 1] @ before[:3, :3]
    described = replace(arm, kinematics=wrong, center_of_mass=center, inertia=inertia)
    with pytest.raises(InputError, match="joint 2 turns about -y of its frame"):
        screen_torques(recording, described)
    assert screen_torques(recording, arm).found == ()


# ------------------------------------------------------------------ joints without weight, rows without measurement

TURNTABLE = """<robot name="turntable"><link name="base"/><link name="table"><inertial><origin xyz="0.15 0 0"/>
<mass value="4"/><inertia ixx="0.01" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j1" type="revolute"><parent link="base"/><child link="table"/><axis xyz="0 0 1"/>
<limit lower="-2.8" upper="2.8" effort="50" velocity="4"/></joint></robot>"""


def turned(folder, position=1.0, torque=1.0, **declared):
    """A joint about a vertical axis: inertia and friction alone, read with these signs."""
    path = folder / "turntable.urdf"
    path.write_text(TURNTABLE)
    time = np.arange(2000) / 100
    q = 1.2 * np.sin(0.9 * time) + 0.5 * np.sin(2.3 * time)
    dq = 1.08 * np.cos(0.9 * time) + 1.15 * np.cos(2.3 * time)
    ddq = -0.972 * np.sin(0.9 * time) - 2.645 * np.sin(2.3 * time)
    tau = (0.03 + 4 * 0.15**2) * ddq + 0.05 * np.sign(dq) + 0.03 * dq
    tau += 0.005 * np.random.default_rng(5).normal(size=len(time))
    return Recording.from_arrays(
        position * q[:, None],
        time=time,
        joint_velocity=position * dq[:, None],
        joint_torque=torque * tau[:, None],
        motion="trajectory",
        torque_source="measured",
        arm=str(path),
        **declared,
    ), read_arm(path)


@pytest.mark.parametrize("inertial", ["declared", "unknown"])
@pytest.mark.parametrize("signs", [{"position": -1.0}, {"torque": -1.0}])
def test_a_joint_without_weight_shows_its_sign_by_friction_and_inertia(tmp_path, inertial, signs):
    assert faults_of(*turned(tmp_path, inertial=inertial)) == []
    recording, arm = turned(tmp_path, inertial=inertial, **signs)
    screened = screen_torques(recording, arm)
    (fault,) = screened.found
    assert (fault.code, fault.numbers) == ("reversed_sign", {"joints": [1]})
    assert "sign of joint 1 is reversed" in fault_statement(fault)
    velocity = np.asarray(screened.data.motion.joint_velocity)[:, screened.data.filter.kept]
    assert np.sum(screened.data.measured * velocity) > 0  # friction takes power again


@pytest.mark.parametrize("gravity", [(0, 0, 0), (0, 0, -9.81)])
def test_a_reversed_torque_is_found_with_and_without_gravity(gravity):
    def reverse(tau):
        return tau * np.where(np.arange(tau.shape[1]) == 1, -1.0, 1.0)

    recording, arm = mounted(gravity, reverse, gravity_m_per_s2=gravity)
    assert faults_of(recording, arm) == [("reversed_torque", {"joints": [2]})]


@pytest.mark.parametrize(("array", "value"), [("joint_position", np.deg2rad(-1000.0)), ("joint_torque", 0.0)])
def test_rows_in_which_the_bus_did_not_answer_are_left_out(array, value):
    recording, arm = mounted(GRAVITY)
    silent = np.array([40, 41, 42, 90])
    values = getattr(recording, array).copy()
    values[silent] = value
    (fault, *others) = screen_torques(replace(recording, **{array: values}), arm).found
    assert (fault.code, fault.rows, fault.numbers["array"]) == ("placeholder", tuple(silent + 1), array)
    assert {other.code for other in others} <= {"uneven_times"}  # without them time has gaps
    assert "4 rows hold no measurement" in fault_statement(fault)
