"""`lite6jax init` of two files: joints and poses that stand apart, by two clocks, become one table."""

import re

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from typed import flat, refused, run

from lite6jax.arms.description import load_bundled
from lite6jax.domains.pose.joining import with_joints
from lite6jax.recordings import read_recording
from lite6jax.recordings.columns.inspection import InspectedTable
from tests.oracles.chains import six_parameter_poses
from tests.oracles.sliding_arms import ARMS

LITE6 = load_bundled("lite6").kinematics
OFFSET, DRIFT = 1234.567, 80e-6
TOOL = np.array([0.03, -0.02, 0.09])


def path(seed, duration=24.0):
    """A smooth motion of all joints that does not repeat itself, `(sample, joint)` at times."""
    rng = np.random.default_rng(seed)
    knots = np.arange(0, duration + 2, 1.5)
    middle, width = np.array([0, 0.2, 1.6, 0, 0.6, 0]), np.array([1, 0.4, 0.4, 1, 0.4, 1])
    return CubicSpline(knots, middle + width * rng.uniform(-1, 1, (len(knots), 6)))


def tracked(motion, at, rng, noise=5e-5):
    """Positions `(sample, 3)` and rotations `(sample, 3, 3)` that a sensor somewhere shows, in m."""
    poses = six_parameter_poses(LITE6, motion(at))
    turned = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    point = (poses[:, :3, 3] + poses[:, :3, :3] @ TOOL) @ turned.T + rng.normal(size=3)
    return point + noise * rng.normal(size=point.shape), turned @ poses[:, :3, :3]


def write(path, columns):
    names = list(columns)
    rows = [",".join(names)]
    rows += [",".join("" if np.isnan(v) else f"{v:.9f}" for v in row) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join(rows) + "\n")
    return path


def robot_file(folder, motion, start=0.0, rate=100.0, duration=24.0):
    t = np.arange(0, duration, 1 / rate)
    joints = {f"actual_q_{k}": np.rad2deg(column) for k, column in enumerate(motion(t).T)}
    return write(folder / "robot.csv", {"timestamp": start + t} | joints)


def sensor_times(rng, duration=24.0, rate=37.0):
    """True times at which a sensor measured, and what its clock then showed, which is slower and began elsewhere."""
    at = np.arange(2.0, duration - 2.0, 1 / rate) + rng.uniform(0, 1 / rate)
    middle = at.mean()
    return at, middle - OFFSET + (at - middle) / (1 + DRIFT)


def test_two_files_become_one_table(tmp_path, capsys):
    rng, motion = np.random.default_rng(1), path(1)
    robot = robot_file(tmp_path, motion, start=50.0)
    at, shown = sensor_times(rng)
    point, _ = tracked(motion, at, rng)
    lost = np.arange(len(at)) % 97 == 5
    columns = {"time_ms": 1e3 * (shown + OFFSET)} | dict(
        zip("xyz", np.where(lost[:, None], 0, 1e3 * point).T, strict=True)
    )
    tracker = write(tmp_path / "tracker.csv", columns)
    code, out, err = run(capsys, "init", robot, tracker, "--arm", "lite6", "--yes", width=300)
    assert (code, err) == (0, "")
    said = flat(out)
    ahead = float(re.search(r"clock of robot.csv is ahead of that of tracker.csv by (-?[\d.]+) s", said)[1])
    assert ahead == pytest.approx(50.0 - 0, abs=1e-4)  # both clocks were moved by whole offsets
    assert re.search(r"± [\d.]+ ms .* ppm", said)
    assert "interpolated by cubics" in said
    table = tmp_path / "robot_tracker.csv"
    assert f"lite6jax diagnose {table} --out diagnosis.json" in out
    recording = read_recording(table)
    assert recording.samples == np.sum(~lost)
    assert recording.settings.arm == "lite6"
    assert recording.motion == "trajectory"
    np.testing.assert_allclose(recording.joint_position, motion(at[~lost]), atol=5e-5)
    np.testing.assert_allclose(recording.position, point[~lost], atol=1e-9)
    assert run(capsys, "fit", table)[0] == 0

    assert "exists already; choose another name or add --force" in refused(
        capsys, "init", robot, tracker, "--arm", "lite6", "--yes"
    )
    assert run(capsys, "init", tracker, robot, "--arm", "lite6", "--yes")[0] == 0  # in either order
    np.testing.assert_allclose(
        read_recording(tmp_path / "tracker_robot.csv").joint_position, recording.joint_position, atol=1e-9
    )


def test_captures_without_times_are_paired_in_their_order(tmp_path, capsys):
    rng, motion = np.random.default_rng(2), path(2)
    at = rng.permutation(np.arange(0.5, 23.5, 0.7))
    robot = write(tmp_path / "r.csv", {f"joint{k + 1}": column for k, column in enumerate(np.rad2deg(motion(at)).T)})
    point, _ = tracked(motion, at, rng)
    tracker = write(tmp_path / "t.csv", dict(zip(("x_mm", "y_mm", "z_mm"), 1e3 * point[1:].T, strict=True)))
    code, out, _ = run(capsys, "init", robot, tracker, "--arm", "lite6", "--yes", width=300)
    assert code == 0
    assert f"{len(at) - 1} joint states and poses were captured one by one and are paired in their order" in flat(out)
    assert "the first 1 and the last 0 joint states of r.csv are left out" in flat(out)
    recording = read_recording(tmp_path / "r_t.csv")
    np.testing.assert_allclose(recording.joint_position, motion(at)[1:], atol=1e-9)
    assert recording.motion == "static"
    write(tracker, dict(zip(("x_mm", "y_mm", "z_mm"), 1e3 * rng.permutation(point).T, strict=True)))
    message = refused(capsys, "init", robot, tracker, "--arm", "lite6", "--yes", "--force")
    assert "do not agree in their order; name the column of the times of" in message


def test_captures_at_times_are_found_in_a_log(tmp_path, capsys):
    """The arm dwells and moves on; a tracker measured once in each dwell."""
    rng = np.random.default_rng(3)
    stops = path(3)(np.arange(0.7, 23, 0.7))
    t = np.arange(0, 3.0 * len(stops), 0.02)
    which, share = np.divmod(t, 3.0)
    share = np.clip(share - 2, 0, 1) ** 2 * (3 - 2 * np.clip(share - 2, 0, 1))
    to = np.minimum(which.astype(int) + 1, len(stops) - 1)
    q = stops[which.astype(int)] + (stops[to] - stops[which.astype(int)]) * share[:, None]
    robot = write(tmp_path / "r.csv", {"t": t} | {f"joint{k + 1}": c for k, c in enumerate(np.rad2deg(q).T)})
    at = 3.0 * np.arange(len(stops)) + rng.uniform(0.8, 1.4, len(stops))
    point, _ = tracked(lambda at: stops[(at // 3).astype(int)], at, rng)
    tracker = write(
        tmp_path / "t.csv", {"time_s": at + 77} | dict(zip(("x_mm", "y_mm", "z_mm"), 1e3 * point.T, strict=True))
    )
    code, out, _ = run(capsys, "init", robot, tracker, "--arm", "lite6", "--yes", width=300)
    assert code == 0
    assert "the arm stood still at every pose" in flat(out)
    recording = read_recording(tmp_path / "r_t.csv")
    assert recording.samples >= len(stops) - 1
    np.testing.assert_allclose(recording.joint_position, stops[: recording.samples], atol=2e-4)


def test_what_cannot_be_joined_is_refused_in_one_line(tmp_path, capsys):
    rng, motion = np.random.default_rng(4), path(4)
    robot = robot_file(tmp_path, motion)
    at, shown = sensor_times(rng)
    point, _ = tracked(motion, at, rng)
    xyz = dict(zip(("x_mm", "y_mm", "z_mm"), 1e3 * point.T, strict=True))
    tracker = write(tmp_path / "tracker.csv", {"time_s": shown} | xyz)
    other, _ = tracked(path(5), at, rng)
    foreign = write(tmp_path / "foreign.csv", {"time_s": shown} | dict(zip("xyz", other.T, strict=True)))
    still = write(tmp_path / "still.csv", {"time_s": shown} | {axis: 1e-5 * rng.normal(size=len(at)) for axis in "xyz"})
    timeless = write(tmp_path / "timeless.csv", xyz)
    unsaid = write(tmp_path / "unsaid.csv", {"t": shown} | dict(zip("xyz", other.T, strict=True)))
    for files, arm, message in (
        ((robot, tracker), None, f"name it, `lite6jax init {robot} {tracker} --arm NAME`"),
        ((robot, tracker, foreign), "lite6", "3 recordings: name one, or two"),
        ((robot, foreign), "lite6", "agree at no offset of the clocks"),
        (
            (robot, unsaid),
            "lite6",
            "; timestamp of robot.csv was taken in s, t of unsaid.csv in s; if that is wrong, give "
            "--column timestamp=time_ms or --column t=time_ms",
        ),
        ((robot, still), "lite6", "hardly moves, so that nothing shows the offset of the clocks"),
        ((robot, timeless), "lite6", f"name the column of the times of {timeless}, such as --column NAME=time_s"),
        ((robot, robot), "lite6", "both have joint positions; if one has the commands, call it commands.csv"),
        ((tracker, foreign), "lite6", "has neither joint positions nor positions with orientations"),
        ((robot, tracker), "ur5e", "agree at no offset of the clocks"),
    ):
        said = refused(capsys, "init", *files, *(("--arm", arm) if arm else ()), "--yes")
        assert message in said, said
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(
        p.name for p in (robot, tracker, foreign, still, timeless, unsaid)
    )


def test_assumed_units_are_said_of_each_file_with_what_would_give_others(tmp_path, capsys):
    rng, t = np.random.default_rng(8), np.arange(0, 24, 0.01)
    (tmp_path / "scara.urdf").write_text(ARMS["scara"])
    joints = {f"joint{k + 1}": column for k, column in enumerate(path(8)(t).T[:4])}
    joints |= {"joint1": 90 * joints["joint1"], "joint3": 0.1 * joints["joint3"]}
    point = dict(zip("xyz", path(9)(t).T[:3] + 1e-5 * rng.normal(size=(3, len(t))), strict=True))
    files = [
        write(tmp_path / f"{name}.csv", {"time": t} | found) for name, found in (("robot", joints), ("tracker", point))
    ]
    said = refused(capsys, "init", *files, "--arm", tmp_path / "scara.urdf", "--yes")
    assert (
        "; joint1 … of robot.csv was taken in deg, joint3 of robot.csv in m, time of robot.csv in s, time of " in said
    )
    assert said.rstrip().endswith(
        "; if that is wrong, give --column joint1=q1_rad and so on or --column joint3=q3_mm or --column time=time_ms"
    )


def test_a_motion_that_repeats_itself_is_not_decided(tmp_path, capsys):
    rng, once = np.random.default_rng(6), path(6, 6.0)
    turn = CubicSpline(np.arange(0, 6.5, 0.5), np.vstack([once(np.arange(0, 6, 0.5)), once([0.0])]), bc_type="periodic")

    def motion(at):
        return turn(at % 6.0)

    at, shown = sensor_times(rng)
    point, _ = tracked(motion, at, rng)
    robot = robot_file(tmp_path, motion)
    tracker = write(tmp_path / "tracker.csv", {"time_s": shown} | dict(zip("xyz", point.T, strict=True)))
    said = refused(capsys, "init", robot, tracker, "--arm", "lite6", "--yes")
    assert "the motion repeats itself: offsets of the clocks that differ by" in said
    # where both are stamped by the time of day, the least offset is meant
    robot = robot_file(tmp_path, motion, start=1.76e9)
    write(tracker, {"time_s": shown + OFFSET + 1.76e9 + 0.2} | dict(zip("xyz", point.T, strict=True)))
    code, out, _ = run(capsys, "init", robot, tracker, "--arm", "lite6", "--yes", width=300)
    assert code == 0
    ahead = float(re.search(r"ahead of that of tracker.csv by (-?[\d.]+) s", flat(out))[1])
    assert ahead == pytest.approx(-0.2, abs=1e-4)


def test_points_on_one_body_become_its_pose(tmp_path, capsys):
    rng, motion = np.random.default_rng(7), path(7)
    at = np.sort(rng.uniform(1, 23, 150))
    _, rotation = tracked(motion, at, rng, noise=0.0)
    rng = np.random.default_rng(7)
    at = np.sort(rng.uniform(1, 23, 150))
    center, rotation = tracked(motion, at, rng, noise=0.0)
    body = np.array([[0, 0, 0], [0.08, 0, 0], [0, 0.06, 0], [0.02, 0.03, 0.05]])
    points = center[:, None] + np.einsum("sij,pj->spi", rotation, body) + 1e-4 * rng.normal(size=(150, 4, 3))
    points[20:40, 2] = np.nan
    points[60:65, :2] = 0.0
    columns = {f"joint_{k + 1}": column for k, column in enumerate(motion(at).T)}
    columns |= {f"Marker{p + 1} {axis}": points[:, p, k] for p in range(4) for k, axis in enumerate("XYZ")}
    table = write(tmp_path / "mocap.csv", columns)
    code, out, _ = run(capsys, "init", table, "--arm", "lite6", "--yes", width=300)
    assert code == 0
    assert "4 points (Marker1 X, Marker2 X, Marker3 X, Marker4 X) keep their distances" in flat(out)
    assert "5 rows without a pose" in flat(out)
    recording = read_recording(tmp_path / "mocap_poses.csv")
    seen = ~np.isin(np.arange(150), range(60, 65))
    assert recording.samples == seen.sum()
    wanted = center + rotation @ body.mean(0)
    assert np.sqrt(np.mean((recording.position - wanted[seen]) ** 2)) < 7e-5
    turned = Rotation.from_quat(recording.quaternion, scalar_first=True).as_matrix()
    constant = np.swapaxes(rotation[seen], 1, 2) @ turned  # the axes on the body are any, but fixed
    mean = Rotation.from_matrix(constant).mean()
    spread = (mean.inv() * Rotation.from_matrix(constant)).magnitude()
    said = float(re.search(r"mm and ([\d.e-]+) rad per axis", flat(out))[1])
    assert 0.6 < np.sqrt(np.mean(spread**2) / 3) / said < 1.7


def test_points_that_move_against_each_other_are_no_body(tmp_path, capsys):
    rng, motion = np.random.default_rng(8), path(8)
    at = np.sort(rng.uniform(1, 23, 60))
    points = six_parameter_poses(LITE6, motion(at))[:, :3, 3]
    columns = {f"joint_{k + 1}": column for k, column in enumerate(motion(at).T)}
    columns |= {f"tcp_{axis}": points[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"{name}_{axis}": rng.normal(size=60) for name in ("cup", "box") for axis in "xyz"}
    table = write(tmp_path / "scene.csv", columns)
    code, _, _ = run(capsys, "init", table, "--arm", "lite6", "--yes", "--column", "cup_x=ignore", width=300)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["scene.csv"] + ["scene.yaml"] * (code == 0)


def test_joints_follow_from_the_poses_of_the_controller(tmp_path, capsys):
    rng, motion = np.random.default_rng(9), path(9, 12.0)
    t = np.arange(0, 12, 0.05)
    flange = six_parameter_poses(LITE6, motion(t))
    turned = Rotation.from_matrix(flange[:, :3, :3]).as_euler("ZYX")[:, ::-1]
    columns = {"t": t} | dict(zip(("tcp_x", "tcp_y", "tcp_z"), np.round(1e3 * flange[:, :3, 3].T, 3), strict=True))
    columns |= dict(zip(("tcp_roll", "tcp_pitch", "tcp_yaw"), np.round(np.rad2deg(turned).T, 4), strict=True))
    robot = write(tmp_path / "controller.csv", columns)
    at, shown = sensor_times(rng, 12.0)
    point, _ = tracked(motion, at, rng)
    tracker = write(tmp_path / "tracker.csv", {"time_s": shown} | dict(zip("xyz", point.T, strict=True)))
    code, out, _ = run(capsys, "init", tracker, robot, "--arm", "lite6", "--yes", width=300)
    assert code == 0
    said = flat(out)
    assert (
        "controller.csv has poses and no joints: these are assumed to be of the flange in the base of the lite6" in said
    )
    assert re.search(r"\d branches \(shoulder, elbow, wrist\) reach the first pose alike", said)
    recording = read_recording(tmp_path / "tracker_controller.csv")
    found = six_parameter_poses(LITE6, recording.joint_position)[:, :3, 3]
    wanted = six_parameter_poses(LITE6, motion(at))[:, :3, 3]
    assert recording.samples > 0.95 * len(at)
    distance = np.linalg.norm(found[:, None] - wanted, axis=2).min(1)
    assert np.quantile(distance, 0.9) < 2e-4
    assert np.quantile(np.abs(np.diff(recording.joint_position, axis=0)).max(1), 0.9) < 0.2


def test_joints_follow_from_poses_as_matrices():
    motion = path(9, 12.0)
    t = np.arange(0, 12, 0.05)
    flange = six_parameter_poses(LITE6, motion(t))
    columns = {"t": t} | {f"O_T_EE_{k}": flange.swapaxes(1, 2).reshape(-1, 16)[:, k] for k in range(16)}
    arm = load_bundled("lite6")
    found = with_joints(InspectedTable.of(columns, "robot.csv", arm), arm)
    assert found.form == "r11"
    assert found.path.reached.all()
    reached = six_parameter_poses(LITE6, found.path.position)
    np.testing.assert_allclose(reached, flange, atol=1e-6)
