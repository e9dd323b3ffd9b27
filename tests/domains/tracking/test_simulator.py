"""A simulator as the nominal arm of a log: what is read of MJCF, how near rollouts are to MuJoCo, and what is found."""

import json
import sys

import numpy as np
import pytest
from typed import flat, refusal, refused, run

from lite6jax import cli
from lite6jax.arms.simulator import read_simulator
from lite6jax.diagnosis.diagnose import diagnose
from lite6jax.domains.tracking.rows import tracking_rows
from lite6jax.domains.tracking.simulator import compare_simulator, with_simulator
from lite6jax.recordings import Recording
from lite6jax.report.tracking import simulator_statements
from tests.domains.tracking.test_servo_fit import commands_of

mujoco = pytest.importorskip("mujoco")

PERIOD = 0.01
STEP = 2e-5
"""s, of MuJoCo's steps: half of one is a time by which joints are early."""
POSITION = '<position joint="{joint}" kp="300" kv="12"/>'
JOINT = 'damping="1" frictionloss="0.3" solreffriction="0.002 1"'


def model_text(actuator=POSITION, joint=JOINT, step=1e-4, base="", body="", beside=""):
    """Two links with position servos, an upright axis and a level one."""
    servos = "".join(actuator.format(joint=name) for name in ("pan", "lift"))
    return f"""<mujoco model="two"><compiler angle="radian"/><option timestep="{step}" integrator="implicitfast"/>
<worldbody>{base}<body name="shoulder" pos="0 0 0.2" {body}>
  <joint name="pan" axis="0 0 1" armature="0.15" range="-3 3" {joint}/>
  <inertial pos="0.01 0.02 0.03" mass="1.5" diaginertia="2e-3 3e-3 2.5e-3"/>
  <body name="upper" pos="0.05 0 0.1" {body}>
    <joint name="lift" axis="0 1 0" armature="0.1" range="-3 3" {joint}/>
    <inertial pos="0.15 0.01 0" mass="1.2" diaginertia="2e-3 6e-3 6e-3"/>{beside}
  </body>
</body></worldbody><actuator>{servos}</actuator></mujoco>"""


def write_model(folder, name="model.xml", **changed):
    path = folder / name
    path.write_text(model_text(**changed))
    return path


def two_commands(samples):
    """`(sample, joint)` rad."""
    return np.column_stack([commands_of(samples), 0.7 * commands_of(samples, seed=3) - 0.4])


def recorded(simulator, samples=300, **settings):
    """A recording whose read-outs are near its commands."""
    command = two_commands(samples)
    time = PERIOD * np.arange(samples)
    return Recording.from_arrays(
        command + 1e-3 * np.sin(7 * time)[:, None],
        arm=simulator.arm,
        time=time,
        commanded_position=command,
        motion="trajectory",
        joint_noise_rad=2e-5,
        **settings,
    )


def compared(path, recording=None):
    """The comparison of a simulator with a recording."""
    simulator = read_simulator(path)
    recording = recorded(simulator) if recording is None else recording
    payload = float(recording.payload.max())
    data = tracking_rows(with_simulator(recording, simulator), simulator.arm)
    return compare_simulator(simulator, data, payload)


# ------------------------------------------------------------------ what is read


@pytest.mark.parametrize(
    ("actuator", "expected"),
    [
        (POSITION, (300.0, 12.0, np.inf, 0.0)),
        ('<position joint="{joint}" kp="75" kv="3" gear="-2"/>', (300.0, 12.0, np.inf, 0.0)),
        (
            '<general joint="{joint}" gainprm="50" biastype="affine" biasprm="0 -50 -2" forcerange="-7 7"/>',
            (50.0, 2.0, 7.0, 0.0),
        ),
        ('<position joint="{joint}" kp="50" timeconst="0.03" armature="0.02"/>', (50.0, 0.0, np.inf, 0.03)),
    ],
)
def test_servos_are_those_of_the_file(tmp_path, actuator, expected):
    simulator = read_simulator(write_model(tmp_path, actuator=actuator))
    read = (simulator.stiffness, simulator.damping, simulator.torque_limit, simulator.time_constant)
    for numbers, number in zip(read, expected, strict=True):
        np.testing.assert_allclose(numbers, [number, number], rtol=1e-12)
    assert simulator.arm.rotor_inertia is not None
    more = 0.02 if "armature" in actuator else 0.0
    np.testing.assert_allclose(simulator.arm.rotor_inertia, [0.15 + more, 0.1 + more], rtol=1e-12)
    assert not simulator.compensated


def test_compensated_weight_and_turned_gravity_are_those_of_the_file(tmp_path):
    floating = read_simulator(write_model(tmp_path, body='gravcomp="1"'))
    assert floating.compensated
    text = model_text().replace(
        '<body name="shoulder"', '<body name="wall" euler="1.5707963267948966 0 0"><body name="shoulder"'
    )
    turned = tmp_path / "turned.xml"
    turned.write_text(text.replace("</worldbody>", "</body></worldbody>"))
    np.testing.assert_allclose(read_simulator(f"{turned}#wall:").gravity, [0, -9.81, 0], atol=1e-12)
    np.testing.assert_allclose(read_simulator(turned).gravity, [0, 0, -9.81], atol=1e-12)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (
            {"actuator": ""},
            'joint \'pan\' has no actuator; add <position joint="pan" kp="…" kv="…"/>, or leave the simulator out and'
            " declare servo: in the sidecar",
        ),
        ({"actuator": 2 * POSITION}, "joint 'pan' has 2 actuators; leave one there, <position"),
        (
            {"actuator": '<motor joint="{joint}"/>'},
            "the actuator of joint 'pan' is no position servo: its force is not kp (command - position); write <posit",
        ),
        ({"actuator": '<position joint="{joint}" kp="0"/>'}, "its gain is not a positive number"),
        (
            {"actuator": '<general joint="{joint}" gainprm="9" biastype="affine" biasprm="1 -9 0"/>'},
            "its bias has a constant, or a negative damping",
        ),
        ({"actuator": '<intvelocity joint="{joint}" kp="9" actrange="-1 1"/>'}, "its activation is no filter"),
        (
            {"actuator": '<position joint="{joint}" kp="9" forcerange="-3 5"/>'},
            "the torque of joint 'pan' is limited to -3 and 5 Nm; give a forcerange of the same size in either",
        ),
        ({"body": 'gravcomp="0.5"'}, "gravcomp of the bodies of the arm is from 0.5 to 0.5; give all of them 0 or 1"),
    ],
)
def test_what_is_no_simulator_of_servos_is_refused(tmp_path, changed, message):
    path = write_model(tmp_path, **changed)
    said = refusal(read_simulator, path)
    assert said.startswith(f"{path}: ")
    assert message in said


def test_slides_several_delays_and_a_missing_package_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "slide.xml"
    path.write_text(model_text().replace('name="pan" axis', 'name="pan" type="slide" axis'))
    assert "joint 'pan' is prismatic, whose commands are not diagnosed; end the chain" in refusal(read_simulator, path)
    late = model_text(actuator='<position joint="{joint}" kp="50" delay="0.01" nsample="200"/>')
    path.write_text(late.replace('delay="0.01"', 'delay="0.005"', 1))
    assert "its actuators have several delays, and a log has one" in refusal(read_simulator, path)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert refusal(read_simulator, path) == f"{path}: MJCF files take the package mujoco; pip install 'lite6jax[mjcf]'"


# ------------------------------------------------------------------ rollouts beside MuJoCo


@pytest.mark.parametrize(
    "changed",
    [
        {"step": STEP},
        {"step": STEP, "actuator": '<position joint="{joint}" kp="75" kv="3" gear="2" timeconst="0.02"/>'},
        {"step": STEP, "actuator": '<position joint="{joint}" kp="300" kv="12" delay="0.03" nsample="2000"/>'},
        {"step": STEP, "body": 'gravcomp="1"'},
        {"step": STEP, "joint": 'damping="1" stiffness="20" springref="0.3"'},
    ],
)
@pytest.mark.filterwarnings("ignore::lite6jax.errors.InputWarning")
def test_rollouts_are_within_20_microradians_of_mujoco(tmp_path, changed):
    comparison = compared(write_model(tmp_path, **changed))
    assert comparison.apart.max() < 20e-6
    assert comparison.apart_fine is None
    assert simulator_statements({"simulator": comparison.to_dict()}) == []


def test_steps_of_the_file_that_make_a_difference_are_said(tmp_path):
    comparison = compared(write_model(tmp_path, step=0.002))
    assert comparison.apart.max() > 1e-4
    assert comparison.apart_fine is not None
    assert comparison.apart_fine.max() < 60e-6
    (said,) = simulator_statements({"simulator": comparison.to_dict()})
    assert said.startswith(f"At joint 1 MuJoCo is {1e3 * comparison.apart[0]:.4f} mrad RMS")
    assert (
        "mrad RMS from the rollout here of the same model: its steps of 2.0000 ms, with steps of 0.1 ms it is" in said
    )


def test_what_only_the_file_has_is_said(tmp_path):
    narrow = '<position joint="{joint}" kp="300" kv="12" ctrlrange="-0.3 0.3" forcerange="-2 2"/>'
    simulator = read_simulator(write_model(tmp_path, actuator=narrow))
    comparison = compared(tmp_path / "model.xml", recorded(simulator, payload=np.full(300, 0.5)))
    assert comparison.clipped > 0.1
    payload, differs = simulator_statements({"simulator": comparison.to_dict()})
    assert payload == (
        "The payload of 0.5000 kg in the log is not added to model.xml: give the file a body of that mass."
    )
    assert "commands are outside a ctrlrange, to which it clips them" in differs
    assert "a servo is at its forcerange, which limits its damping too" in differs


def test_joints_beside_the_chain_stand_still(tmp_path):
    finger = (
        '<body name="jaw" pos="0.3 0 0"><joint name="jaw" axis="0 1 0"/>'
        '<inertial pos="0.05 0 0" mass="0.3" diaginertia="1e-4 1e-4 1e-4"/></body>'
    )
    path = write_model(tmp_path, step=STEP, beside=finger)
    comparison = compared(f"{path}#upper")
    assert comparison.apart.max() < 20e-6


def test_gravity_of_the_simulator_is_that_of_its_file(tmp_path):
    path = write_model(tmp_path)
    path.write_text(path.read_text().replace("<option", '<option gravity="0 0 -1.62"'))
    simulator = read_simulator(path)
    nominal = with_simulator(recorded(simulator), simulator)
    assert nominal.settings.gravity_m_per_s2 == (0.0, 0.0, -1.62)


# ------------------------------------------------------------------ the command


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The log of a simulator whose level joint has more friction, and the simulator without."""
    folder = tmp_path_factory.mktemp("simulated")
    write_model(folder, step=STEP)
    real = model_text(step=STEP).replace(
        'armature="0.1" range="-3 3" damping="1" frictionloss="0.3"',
        ('armature="0.1" range="-3 3" damping="1" frictionloss="1.5"'),
    )
    assert real != model_text(step=STEP)
    (folder / "real.xml").write_text(real)
    simulator = read_simulator(folder / "real.xml")
    command = two_commands(300)
    motion = simulator.rolled_out(command, np.zeros(300, int), PERIOD, command)
    noise = 2e-4 * np.random.default_rng(2).standard_normal(command.shape)
    rows = np.column_stack([PERIOD * np.arange(300), motion.position + noise, command])
    names = "time_s,q1_rad,q2_rad,cmd1_rad,cmd2_rad"
    np.savetxt(folder / "log.csv", rows, fmt="%.9g", delimiter=",", header=names, comments="")
    (folder / "log.yaml").write_text(
        "recording:\n  joint_source: measured\n  motion: trajectory\n  joint_noise_rad: 2.0e-4\n"
    )
    return folder


@pytest.fixture(scope="module")
def document(folder):
    words = ["--simulator", "model.xml", "--out", "d.json", "--corrected", "corrected.xml"]
    files = [str(folder / word) if "." in word else word for word in ("log.csv", *words)]
    assert cli.main(["diagnose", *files]) == 0
    return json.loads((folder / "d.json").read_text())


def test_what_the_simulator_lacks_is_found(document):
    assert [(finding["effect"], finding["site"]) for finding in document["findings"]] == [
        ("coulomb_friction", "joint2")
    ]
    friction = document["findings"][0]["parameters"]["coulomb_Nm"]
    assert friction["value"] == pytest.approx(1.2, abs=0.06)
    assert document["servos"][1]["coulomb_Nm"] == pytest.approx(1.5, abs=0.06)


def test_the_simulator_is_a_peer_and_before(document, folder):
    peer = document["peers"]["simulator"]["heldout_rollout_rms_by_joint_rad"]
    before = document["before"]["heldout_rollout_rms_by_joint_rad"]
    assert peer == pytest.approx(before, rel=0.05)
    assert document["after"]["heldout_rollout_rms_by_joint_rad"][1] < 0.2 * peer[1]
    assert document["simulator"]["file"] == "model.xml"
    assert document["simulator"]["timestep_s"] == STEP
    roles = {entry["role"]: entry["file"] for entry in document["inputs"]}
    assert roles["simulator"] == "model.xml"


def test_a_model_and_a_log_become_a_corrected_model(capsys, document, folder):
    corrected = read_simulator(folder / "corrected.xml")
    friction = [servo["coulomb_Nm"] for servo in document["servos"]]
    np.testing.assert_allclose(corrected.arm.coulomb_friction, friction, rtol=1e-6)
    assert friction[1] == pytest.approx(1.5, abs=0.06)
    code, *_ = run(capsys, "convert", folder / "d.json", folder / "converted.xml")
    assert code == 0
    assert (folder / "converted.xml").read_text() == (folder / "corrected.xml").read_text()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--corrected", "model.json"], "the form table holds a chain only"),
        (["--corrected", "model.txt"], "no form has this suffix"),
    ],
)
def test_a_corrected_model_that_holds_no_servos_is_refused_before_any_work(capsys, folder, options, message):
    assert message in refused(capsys, "diagnose", folder / "log.csv", "--simulator", folder / "model.xml", *options)


def test_the_report_names_the_simulator(capsys, document, folder):
    code, out, _ = run(capsys, "report", folder / "d.json", width=120)
    said = flat(out)
    assert code == 0
    assert "your simulator" in said
    assert "the servos are those of your simulator, model.xml." in said
    assert "MuJoCo itself, from the same commands, is your simulator." in said


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--arm", "lite6"], "--arm: does not go with --simulator, the nominal arm of commands; keep one"),
        (["--poses"], "--poses: does not go with --simulator, the nominal arm of commands; keep one"),
        (
            ["--reference", "log.csv"],
            "--reference: does not go with --simulator, the nominal arm of commands; keep one",
        ),
    ],
)
def test_options_that_do_not_go_together_are_refused(capsys, folder, options, message):
    said = refused(capsys, "diagnose", folder / "log.csv", "--simulator", folder / "model.xml", *options)
    assert said == message


def test_other_chains_and_other_logs_are_refused(capsys, folder):
    said = refused(capsys, "diagnose", folder / "log.csv", "--simulator", f"{folder}/model.xml#shoulder")
    assert said == (
        f"{folder}/log.csv: has 2 joints (q1 ... q2), the arm has 1; name the chain of the log, model.xml#TIP or "
        "model.xml#BASE:TIP, in place of pan"
    )
    said = refused(capsys, "diagnose", folder, "--simulator", folder / "model.xml", "--out", folder / "results")
    assert said == f"--simulator: is of one recording, and {folder} is a folder; leave it out"
    simulator = read_simulator(folder / "model.xml")
    still = Recording.from_arrays(two_commands(60), position=np.zeros((60, 3)), arm=simulator.arm)
    said = refusal(diagnose, still, simulator=folder / "model.xml")
    assert said == f"simulator: is not of poses, by which {still.source} is diagnosed; leave it out"
    assert refusal(diagnose, folder / "log.csv", "lite6", simulator=folder / "model.xml") == (
        "simulator: is the nominal arm as well; leave the arm out"
    )
