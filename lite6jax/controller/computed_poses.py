"""A recording of the poses that the controller computes for given joint positions, without a move."""

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from lite6jax.arms.factory import write_factory
from lite6jax.controller import protocol
from lite6jax.controller.exchange import Address
from lite6jax.controller.gaps import Gaps
from lite6jax.controller.recorded import Recorded, check_targets, factory_path
from lite6jax.controller.sdk import Sdk, SdkError, connected
from lite6jax.controller.station import Station
from lite6jax.controller.verification import as_sent
from lite6jax.errors import InputError
from lite6jax.recordings import Recording, sidecar_path, write_recording

RETRY_S = 0.5
TRIES = 5
"""The number of consecutive connections without a pose after which the recording ends."""

_JOINTS, _POSE = "as requested, not measured", "computed by the controller, for these joints"


def record_poses(
    address: Address,
    out: Path,
    station: Station,
    poses: Recording,
    *,
    overwrite: bool = False,
    stop: threading.Event | None = None,
    advance: Callable[[int], object] = lambda done: None,
) -> Recorded:
    """Records the controller's forward kinematics of the flange, or of the tool, at given joint positions.

    The arm does not move. Joint positions are recorded as sent, rounded to 32 bits. After a lost connection the row is
    requested again; rows that the controller refuses are omitted and noted.

    Args:
        address: of the controller.
        out: a `.csv` or `.parquet` file; its sidecar, and the calibration of the arm if available, are written beside.
        station: the arm and its settings, from `read_station`.
        poses: the joint positions and the notes about omitted rows; other columns are ignored.
        overwrite: whether the files may be replaced.
        stop: ends the recording when set, from any thread; the poses received so far are written.
        advance: called with 1 after each row.

    Raises:
        InputError: the files cannot be written, the number of joints differs, or no pose was received.
    """
    check_targets(out, overwrite, station.calibration is not None)
    if poses.dof != station.arm.dof:
        raise InputError(f"{poses.source}: has {poses.dof} joints, the {station.arm.name} {station.arm.dof}")
    stop = stop or threading.Event()
    joints = as_sent(poses.joint_position)
    rows: list[int] = []
    answers: list[np.ndarray] = []
    refused: list[tuple[int, str]] = []
    failure = ""
    started = time.monotonic()
    with ExitStack() as held:
        sdk: Sdk | None = None
        tries = row = 0
        while row < len(joints) and not stop.is_set():
            try:
                if sdk is None:
                    tries += 1
                    sdk = held.enter_context(connected(address))
                pose = sdk.forward_kinematics(joints[row])
            except SdkError as error:
                held.close()
                sdk, failure = None, str(error)
                if not answers or tries == TRIES:
                    break
                stop.wait(RETRY_S)
                continue
            tries, failure = 0, ""
            if pose.values is None:
                refused.append((int(poses.row[row]), pose.refusal))
            else:
                rows.append(row)
                answers.append(pose.values)
            row += 1
            advance(1)
    if not answers and not stop.is_set():
        reason = (
            failure or f"{address}: refuses all joints of {poses.source}, the first with {refused[0][1]}; check them"
        )
        raise InputError(reason)
    written: list[Path] = []
    columns = {}
    if answers:
        recording = _as_recording(station, out, joints[rows], np.array(answers), str(address))
        columns = recording.columns()
        written += [write_recording(recording, out, overwrite), sidecar_path(out)]
        if station.calibration is not None:
            written.append(write_factory(station.calibration.kinematics, factory_path(out), overwrite=overwrite))
    missing = len(joints) - len(rows) - len(refused)
    return Recorded(
        written=tuple(written),
        rows=len(answers),
        unwritten=0,
        refusal=failure,
        duration=time.monotonic() - started,
        rate=0.0,
        runs=1,
        asked=len(joints),
        short=len(rows) < len(joints),
        gaps=Gaps(count=1 if missing else 0, within=missing),
        repeated=0,
        sources={name: _JOINTS if name.startswith("q") and name[1].isdigit() else _POSE for name in columns},
        settings=station.settings_beside(out, joints="commanded"),
        notes=(*station.notes, *(note for note in poses.notes if note.startswith("dropped")), *_refusals(refused)),
    )


def _as_recording(station: Station, out: Path, joints: np.ndarray, poses: np.ndarray, source: str) -> Recording:
    rotations = Rotation.from_matrix(protocol.transform_of_wire_pose(poses)[:, :3, :3])
    return Recording.assembled(
        joints,
        position=poses[:, :3] / protocol.MM,
        quaternion=rotations.as_quat(scalar_first=True),
        settings=station.settings_beside(out, joints="commanded"),
        source=source,
    )


def _refusals(refused: list[tuple[int, str]]) -> list[str]:
    if not refused:
        return []
    row, reason = refused[0]
    return [f"{len(refused)} rows were refused and are omitted, the first is row {row}: {reason}"]
