"""Logs of ROS with commands beside joint states: states of trajectory controllers, command topics, two rates."""

import numpy as np
import pytest
from typed import unread

from lite6jax.diagnosis.diagnose import domains_of
from lite6jax.recordings import read_recording
from lite6jax.recordings.ros import UR_JOINTS
from tests.logs import SECOND, Topic, joints, poses, write

pytest.importorskip("rosbags.rosbag2", reason="the package of the extra `rosbag` is not installed")

STATES = np.arange(60) / 100
SENT = np.arange(18) / 30 + 0.011
NAMES = [f"{part}_joint" for part in UR_JOINTS]
ALPHABETICAL = np.argsort(NAMES)


def position(times, late=0.0):
    """`(sample, 6)` rad of joints that swing, each in its own way."""
    k = np.arange(6)
    return 0.5 * np.sin(np.multiply.outer(times - late, 1 + k) + k)


def in_force(times, sent=SENT):
    """The command in force at a time by counting, and where there is one: none was logged long after the last."""
    number = (sent[None] <= times[:, None] + 1e-12).sum(1) - 1
    usable = (number >= 0) & (times <= sent[-1] + 2 * np.median(np.diff(sent)) + 1e-12)
    return position(sent)[number[usable]], usable


def states(names=NAMES, q=None, times=STATES):
    return joints(times, position(times, 0.03) if q is None else q, names)


def controller_state(times=SENT, order=ALPHABETICAL, names=("reference", "feedback")):
    sent, measured = (position(times, late)[:, order] for late in (0.0, 0.03))
    rows = [
        {"joint_names": [NAMES[k] for k in order], names[0]: list(u), names[1]: list(y)}
        for u, y in zip(sent, measured, strict=True)
    ]
    return Topic("control_msgs/msg/JointTrajectoryControllerState", [round(t * SECOND) for t in times], rows)


def array(times=SENT, numbers=None):
    rows = [{"data": list(row)} for row in (position(times) if numbers is None else numbers)]
    return Topic("std_msgs/msg/Float64MultiArray", [round(t * SECOND) for t in times], rows)


def trajectory(times=SENT, points=1, order=ALPHABETICAL):
    rows = [
        {"joint_names": [NAMES[k] for k in order], "points": [(list(row),)] * points}
        for row in position(times)[:, order]
    ]
    return Topic("trajectory_msgs/msg/JointTrajectory", [round(t * SECOND) for t in times], rows)


def is_the_motion(recording):
    """Whether measured joints and the commands in force are those of the topics, in the order along the arm."""
    commands, usable = in_force(STATES)
    assert domains_of(recording) == ("tracking",)
    np.testing.assert_allclose(recording.joint_position, position(STATES, 0.03)[usable], atol=1e-12)
    np.testing.assert_allclose(recording.commanded_position, commands, atol=1e-12)
    np.testing.assert_allclose(recording.time, STATES[usable] - STATES[usable][0], atol=1e-9)


@pytest.mark.parametrize(
    ("topic", "commands"),
    [
        ("/joint_trajectory_controller/controller_state", controller_state()),
        ("/joint_trajectory_controller/state", controller_state(names=("desired", "actual"))),
        ("/joint_commands", states(NAMES[::-1], position(SENT)[:, ::-1], SENT)),
        ("/forward_position_controller/commands", array()),
        ("/scaled_joint_trajectory_controller/joint_trajectory", trajectory()),
    ],
)
@pytest.mark.parametrize("suffix", [".mcap", ".bag"])
def test_commands_of_a_topic_are_held_beside_the_joint_states(tmp_path, topic, commands, suffix):
    topics = {"/joint_states": states([NAMES[k] for k in ALPHABETICAL], position(STATES, 0.03)[:, ALPHABETICAL])}
    path = write(tmp_path / f"run{suffix}", topics | {topic: commands})
    recording = read_recording(path)
    is_the_motion(recording)
    assert f"the commands are those of {topic}, each held until the next" in recording.notes
    assert "dropped 2 joint states before the first command" in recording.notes
    in_order = f"the numbers of {topic} are taken in the order of the joints: assumed, as they state no names"
    assert (in_order in recording.notes) == topic.startswith("/forward")
    is_the_motion(read_recording(f"{path}#/joint_states,{topic}"))
    assert read_recording(f"{path}#/joint_states").commanded_position is None


def test_the_state_of_a_controller_is_enough(tmp_path):
    path = write(tmp_path / "run.mcap", {"/arm_controller/controller_state": controller_state(STATES)})
    recording = read_recording(path)
    np.testing.assert_allclose(recording.joint_position, position(STATES, 0.03), atol=1e-12)
    np.testing.assert_allclose(recording.commanded_position, position(STATES), atol=1e-12)


def test_a_gripper_that_is_not_commanded_is_left_out(tmp_path):
    q = np.column_stack([np.full(60, 0.4), position(STATES, 0.03)])
    topics = {"/joint_states": states(["finger_joint", *NAMES], q), "/controller_state": controller_state()}
    recording = read_recording(write(tmp_path / "run.mcap", topics))
    is_the_motion(recording)
    assert recording.notes[0].endswith("q6 is wrist_3_joint; left out: finger_joint")


def test_poses_stay_what_is_read_and_commands_are_named(tmp_path):
    at = STATES[5:-5] + 0.003
    topics = {"/joint_states": states(), "/controller_state": controller_state()}
    path = write(tmp_path / "run.mcap", topics | {"/tool": poses(at, np.outer(at, [1, 2, 3]))})
    assert domains_of(read_recording(path)) == ("poses",)
    is_the_motion(read_recording(f"{path}#/joint_states,/controller_state"))
    assert unread(f"{path}#/joint_states,/controller_state,/tool") == (
        "poses and commands are diagnosed apart, and /tool and /controller_state are named; name the joint states and "
        "one of them"
    )


def test_stamps_of_another_clock_than_the_log_are_left(tmp_path):
    """A simulation stamps joint states by its own clock; an array of commands has the times of the log alone."""
    stamped = states()._replace(logged=[round((t + 50) * SECOND) for t in STATES])
    sent = array()._replace(logged=[round((t + 50) * SECOND) for t in SENT])
    path = write(tmp_path / "run.mcap", {"/joint_states": stamped, "/forward_position_controller/commands": sent})
    recording = read_recording(path)
    is_the_motion(recording)
    assert (
        "times are the log times (no header stamps) of /joint_states, the log times (no header stamps) of "
        "/forward_position_controller/commands"
    ) in recording.notes


def test_topics_of_commands_that_cannot_be_read(tmp_path):
    path = tmp_path / "run.mcap"
    both = {
        "/joint_states": states(),
        "/a/controller_state": controller_state(),
        "/b/controller_state": controller_state(),
    }
    assert unread(write(path, both)) == (
        "has 2 topics of control_msgs/JointTrajectoryControllerState: /a/controller_state, /b/controller_state; "
        "choose, as in run.mcap#/joint_states,/a/controller_state"
    )
    goals = {"/joint_states": states(), "/joint_trajectory": trajectory(points=5)}
    needs = (
        f"has the positions of all of {', '.join(NAMES)}, one for each; name a topic that streams the commanded "
        "positions of these joints, as a controller's state does"
    )
    assert unread(write(path, goals)) == f"no message of /joint_trajectory {needs}"
    few = {"/joint_states": states(), "/position_controller/commands": array(numbers=position(SENT)[:, :5])}
    assert unread(write(path, few)) == f"no message of /position_controller/commands {needs}"
    apart = {"/joint_states": states(times=STATES + 100), "/controller_state": controller_state()}
    assert unread(write(path, apart)) == (
        "no joint state lies between commands (joints 99.989 to 100.579 s, commands 0.000 to 0.567 s); stamp both by "
        "one clock"
    )


def velocity(times):
    """`(sample, 6)` rad/s of the joints' motion."""
    k = np.arange(6)
    return 0.5 * (1 + k) * np.cos(np.multiply.outer(times, 1 + k) + k)


def velocity_array(times=SENT):
    return array(times, velocity(times))


def velocity_trajectory(times=SENT):
    rows = [
        {"joint_names": [NAMES[k] for k in ALPHABETICAL], "points": [((), list(row))]}
        for row in velocity(times)[:, ALPHABETICAL]
    ]
    return Topic("trajectory_msgs/msg/JointTrajectory", [round(t * SECOND) for t in times], rows)


def velocity_states(times=SENT):
    rows = [{"name": NAMES, "position": [], "velocity": list(row), "effort": []} for row in velocity(times)]
    return Topic("sensor_msgs/msg/JointState", [round(t * SECOND) for t in times], rows)


def is_integrated(recording):
    """Whether the commands are the velocities in force, each held over a row, from the first measured joints."""
    number = (SENT[None] <= STATES[:, None] + 1e-12).sum(1) - 1
    _, usable = in_force(STATES)
    held = velocity(SENT)[number[usable]]
    moved = np.cumsum(held[:-1] * np.diff(STATES[usable])[:, None], 0)
    first = position(STATES, 0.03)[usable][0]
    np.testing.assert_allclose(recording.commanded_position, first + np.vstack([np.zeros(6), moved]), atol=1e-9)
    assert domains_of(recording) == ("tracking",)
    assert any(note.startswith("commands of velocity are taken as commands of position") for note in recording.notes)


@pytest.mark.parametrize(
    ("topic", "commands"),
    [
        ("/forward_velocity_controller/commands", velocity_array()),
        ("/joint_group_velocity_controller/command", velocity_array()),
        ("/joint_trajectory", velocity_trajectory()),
        ("/joint_commands", velocity_states()),
    ],
)
@pytest.mark.parametrize("suffix", [".mcap", ".bag"])
def test_commanded_velocities_are_integrated(tmp_path, topic, commands, suffix):
    path = write(tmp_path / f"run{suffix}", {"/joint_states": states(), topic: commands})
    recording = read_recording(path)
    is_integrated(recording)
    assert f"the commands are the velocities of {topic}, each held until the next" in recording.notes
    is_integrated(read_recording(f"{path}#/joint_states,{topic}"))
    is_integrated(read_recording(f"{path}#/joint_states,{topic}:velocity"))


def test_numbers_that_may_be_positions_or_velocities_are_asked_for(tmp_path):
    ask = "the commands of {0} may be positions or velocities; name {0}:position or {0}:velocity beside the joint "
    ask += "states"
    path = write(tmp_path / "plain.mcap", {"/joint_states": states(), "/arm_controller/commands": velocity_array()})
    assert unread(path) == ask.format("/arm_controller/commands")
    is_integrated(read_recording(f"{path}#/joint_states,/arm_controller/commands:velocity"))
    as_positions = read_recording(f"{path}#/joint_states,/arm_controller/commands:position")
    np.testing.assert_allclose(as_positions.commanded_position[0], velocity(SENT)[0], atol=1e-12)
    full = velocity_trajectory()
    for message, place in zip(full.messages, position(SENT)[:, ALPHABETICAL], strict=True):
        ((_, speed),) = message["points"]
        message["points"] = [(list(place), speed)]
    is_the_motion(read_recording(write(tmp_path / "full.mcap", {"/joint_states": states(), "/joint_trajectory": full})))
    path = write(tmp_path / "named.mcap", {"/joint_states": states(), "/velocity_controller/joint_trajectory": full})
    assert unread(path) == ask.format("/velocity_controller/joint_trajectory")


def test_commands_of_position_go_before_those_of_velocity(tmp_path):
    topics = {
        "/joint_states": states(),
        "/forward_position_controller/commands": array(),
        "/forward_velocity_controller/commands": velocity_array(),
    }
    path = write(tmp_path / "run.mcap", topics)
    is_the_motion(read_recording(path))
    is_integrated(read_recording(f"{path}#/joint_states,/forward_velocity_controller/commands"))


def test_efforts_are_no_commands(tmp_path):
    path = write(tmp_path / "run.mcap", {"/joint_states": states(), "/forward_effort_controller/commands": array()})
    assert unread(path).startswith("has no topic of geometry_msgs/PoseStamped; it has /forward_effort_controller/")


def test_velocities_of_few_joints(tmp_path):
    few = array(numbers=velocity(SENT)[:, :5])
    path = write(tmp_path / "run.mcap", {"/joint_states": states(), "/velocity_controller/commands": few})
    assert unread(path) == (
        f"no message of /velocity_controller/commands has the velocities of all of {', '.join(NAMES)}, one for each; "
        "name a topic that streams the commanded velocities of these joints, as a controller's state does"
    )


def test_messages_that_the_log_does_not_define(tmp_path, monkeypatch):
    from rosbags.highlevel import AnyReader

    path = write(tmp_path / "run.mcap", {"/joint_states": states(), "/controller_state": controller_state()})
    opened = AnyReader.open

    def forget(reader):
        opened(reader)
        reader.typestore.fielddefs.pop("control_msgs/msg/JointTrajectoryControllerState", None)
        reader.typestore.types.pop("control_msgs/msg/JointTrajectoryControllerState", None)

    monkeypatch.setattr(AnyReader, "open", forget)
    assert unread(path) == (
        "does not say what messages of control_msgs/JointTrajectoryControllerState on /controller_state hold; record "
        "as MCAP, which does, or convert it with `ros2 bag convert`"
    )
