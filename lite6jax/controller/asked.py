"""The controller's own forward kinematics at given joints, as a recording: what it computes, without a move."""

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
from lite6jax.controller.recorded import Recorded, check_targets, factory_path
from lite6jax.controller.sdk import Sdk, SdkError, connected
from lite6jax.controller.station import Station
from lite6jax.controller.verification import as_sent
from lite6jax.errors import InputError
from lite6jax.recordings import Recording, sidecar_path, write_recording

RETRY_S = 0.5
TRIES = 5
"""Connections one after the other without a pose between them, after which no more is asked."""

_JOINTS, _POSE = "as asked, not measured", "computed by the controller, for these joints"


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
    """Asks the controller where the flange, or the tool, is at each row's joints, and writes the answers.

    Nothing moves. Joints are recorded as they were sent, in 32-bit numbers. A lost connection is made anew and the row
    asked again; a row that the controller refuses is left out and said.

    Args:
        address: the controller's.
        out: a `.csv` or `.parquet` file; its sidecar, and the arm's calibration where there is one, stand beside it.
        station: what is known of the arm, from `read_station`.
        poses: the joints, and what is said of rows that are not among them; all else of it is ignored.
        overwrite: whether the files may be replaced.
        stop: ends the asking when set, from any thread; what was answered is written.
        advance: called with 1 after each row.

    Raises:
        InputError: the targets cannot be written, another number of joints, or not one row was answered.
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
    return Recorded(
        written=tuple(written),
        rows=len(answers),
        unwritten=0,
        refusal=failure,
        duration=time.monotonic() - started,
        rate=0.0,
        runs=1,
        missing=len(joints) - len(rows) - len(refused),
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
    row, why = refused[0]
    return [f"{len(refused)} rows were refused and are left out, the first is row {row}: {why}"]
