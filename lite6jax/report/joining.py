"""What was joined to one table, in sentences."""

import numpy as np

from lite6jax.domains.pose.joining import JoinedFiles, WithJoints, WithPose
from lite6jax.recordings.streams import said_of

_SHOWN = 8
"""Columns that are left out and named."""


def describe_joined_files(found: JoinedFiles, joints: str, poses: str) -> list[str]:
    """How the joints of one file and the poses of another were joined."""
    said = []
    if (clocks := found.clocks) is not None:
        offset = clocks.offset + found.start
        said.append(
            f"the clock of {joints} is ahead of that of {poses} by {offset:.6f} s ± {_small(clocks.offset_std)} in the "
            "middle of the poses: found from the motion, beside the sensor's frame, the tool and the arm's geometry"
        )
        if np.isfinite(clocks.drift_std):
            said.append(
                f"the clock of {joints} runs {1e6 * clocks.drift:.1f} ± {1e6 * clocks.drift_std:.2g} ppm faster; the "
                "joined table has its times"
            )
        else:
            said.append(
                f"the arm stood still at every pose: the offset is known within {_small(clocks.offset_std)} only, and "
                "the drift cannot be estimated"
            )
        fitted = f", with its geometry fitted to {1e3 * clocks.fitted_error:.3g} mm"
        said.append(
            f"at these times the nominal arm agrees with the poses to {1e3 * clocks.error:.3g} mm (median)"
            + (fitted if np.isfinite(clocks.fitted_error) else "")
            + "; a delay of the sensor is a part of the offset"
        )
    if (pairing := found.pairing) is not None:
        missing = [
            f"the first {first} and the last {count - first - pairing.rows} {what} are left out"
            for first, count, what in (
                (pairing.joint, found.states, f"joint states of {joints}"),
                (pairing.position, found.poses, f"poses of {poses}"),
            )
            if count > pairing.rows
        ]
        said.append(
            f"{pairing.rows} joint states and poses were captured one by one and are paired in their order, which the "
            f"nominal arm confirms to {1e3 * pairing.error:.3g} mm (median)" + "".join(f"; {part}" for part in missing)
        )
    if found.joined is not None:
        said += said_of(found.joined, found.unit)
    said.append(f"joined {found.rows} rows of {found.states} joint states and {found.poses} poses")
    if found.left_out:
        shown = ", ".join(found.left_out[:_SHOWN]) + (", …" if len(found.left_out) > _SHOWN else "")
        said.append(f"left out, as they are neither of joints nor of the measured pose: {shown}")
    return said


def describe_solved_joints(found: WithJoints, arm: str) -> list[str]:
    """How joints were found from poses."""
    count, missing = len(found.path.reached), int(np.sum(~found.path.reached))
    said = [
        f"{found.file.source} has poses and no joints: these are assumed to be of the flange in the base of the {arm}, "
        "and the joints are those of its kinematics, not what encoders read; where the controller computes with a "
        "calibration of the arm, name that as the arm",
        f"{found.path.branches} branches (shoulder, elbow, wrist) reach the first pose alike: the one nearest to the "
        "middle of the joints' limits that follows the others is assumed, and kept from row to row",
    ]
    return said + ([f"{missing} of {count} poses are not reached on it and are left out"] if missing else [])


def describe_reflectors(found: WithPose) -> list[str]:
    """How points became a pose."""
    pose, mm = found.pose, 1e3 if found.unit == "m" else 1.0
    lost = int(np.sum(~pose.rows)) - pose.outlying
    first = ", ".join(point[0] for point in found.points[:4]) + (", …" if len(found.points) > 4 else "")
    said = [
        f"{pose.points} points ({first}) keep their distances and became the pose of one body: its position is their "
        "centre, its axes are the sensor's at the first row with all points",
        f"the points differ from the body's shape by {mm * pose.misfit:.3g} mm RMS, {mm * pose.size:.3g} mm from its "
        f"centre: a noise of {mm * pose.position_noise:.2g} mm and {pose.orientation_noise:.2g} rad per axis of the "
        "pose",
    ]
    if lost:
        said.append(f"{lost} rows without a pose: fewer than three points are seen there")
    if pose.outlying:
        said.append(f"{pose.outlying} rows without a pose: their points show another shape, as exchanged points do")
    return said


def _small(seconds: float) -> str:
    return f"{1e3 * seconds:.2g} ms" if seconds < 1 else f"{seconds:.2g} s"
