"""`python -m benchmarks ladder`: a diagnosis of real torques beside the usual ladder of friction terms.

The rival is what identification of robot dynamics usually does (Swevers, Verdonck & De Schutter, IEEE Control Systems
Magazine 27(5), 2007): one zero-phase low pass, the regressor of the inertial numbers, the same friction terms at every
joint, least squares weighted by the residual of each joint; nothing is chosen. It shares no code with the library but
the reading of the files. Each half of the recording is fitted and the other one predicted.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.signal import butter, sosfiltfilt

from benchmarks.measure import DONE, run_command
from lite6jax.calibration.compiled import keep_compiled_code
from lite6jax.calibration.source import declared_arm_of
from lite6jax.diagnosis.torque_diagnosis import diagnose_torques
from lite6jax.domains.predict import predict
from lite6jax.domains.torque.filtering import sample_rate
from lite6jax.errors import InputError
from lite6jax.recordings import Recording, read_recording
from tests.oracles.pinocchio_dynamics import pinocchio_model, pinocchio_regressor

Array = NDArray[np.floating]
LowPass = Callable[[Array], Array]  # of rows `(…, sample)`, zero phase, of fourth order

STEPS = ("rigid body alone", "+ viscous, Coulomb, offset", "+ all other terms")
_SMOOTH = 2e-3  # rad/s within which the direction of motion turns
_STRIBECK = (0.05, 0.15)  # rad/s, velocities of the Stribeck terms
_DETERMINED = 1e-4  # singular value over the largest, below which a combination of columns is not determined
_WEIGHTINGS = 3  # rounds of weighting by what is left
_EDGE = 0.25  # s at each end of a half that are not scored, as the filter rings there


class Half(NamedTuple):
    """A stretch of a recording, low-passed, `(joint, sample)` each."""

    q: Array  # rad
    dq: Array  # rad/s
    ddq: Array  # rad/s²
    torque: Array  # Nm
    scored: NDArray[np.bool_]  # `(sample,)` bool, away from its ends

    @classmethod
    def of(cls, recording: Recording, rate: float, low: LowPass) -> "Half":
        """Of a recording of torques in order of time."""
        dq = low(recording.velocities().T)
        edge, samples = int(_EDGE * rate), np.arange(recording.samples)
        scored = (samples >= edge) & (samples < recording.samples - edge)
        ddq = np.gradient(dq, 1 / rate, axis=1)
        return cls(low(recording.joint_position.T), dq, ddq, low(recording.torques().T), scored)


def columns(model: Any, half: Half, step: int, rigid: Array, low: LowPass) -> Array:
    """Columns `(joint, number, sample)` of a step of the ladder.

    Args:
        model: Pinocchio's, of bodies of which nothing is known.
        half: the motion.
        step: index into `STEPS`.
        rigid: `(joint, sample)` Nm, of the rigid bodies, on which friction by the load depends.
        low: what the torques passed.
    """
    dof = len(half.q)
    blocks = [low(pinocchio_regressor(model, half.q, half.dq, half.ddq))]
    turned = np.tanh(half.dq / _SMOOTH)
    added = [half.dq, turned, np.ones_like(half.q)] if step >= 1 else []
    if step >= 2:
        added += [half.ddq, half.q, np.abs(rigid) * turned]
        added += [np.exp(-((half.dq / v) ** 2)) * turned for v in _STRIBECK]
    blocks += [low(np.eye(dof)[:, :, None] * rows) for rows in added]
    for joint in range(dof - 1 if step >= 2 else 0):  # motors that drive two joints
        both = half.dq[joint] + half.dq[joint + 1]
        pair = np.zeros((dof, 2, half.q.shape[1]))
        pair[joint : joint + 2] = low(np.stack([both, np.tanh(both / _SMOOTH)]))
        blocks.append(pair)
    return np.concatenate(blocks, 1)


def climb(model: Any, train: Half, test: Half, low: LowPass) -> Iterator[tuple[str, Array]]:
    """Each step of the ladder with its errors `(joint, sample)` Nm on the other half."""
    rigid = [np.zeros_like(train.q), np.zeros_like(test.q)]
    for step, name in enumerate(STEPS):
        ours, theirs = (columns(model, *each, low) for each in zip((train, test), (step, step), rigid, strict=True))
        scale = np.maximum(np.sqrt(np.mean(ours**2, (0, 2))), 1e-12)
        weight, numbers = 1 / train.torque.std(1), np.zeros(len(scale))
        for _ in range(_WEIGHTINGS):
            A = (ours / scale[:, None] * weight[:, None, None])[..., train.scored]
            y = (train.torque * weight[:, None])[:, train.scored].ravel()
            rows = A.transpose(0, 2, 1).reshape(-1, len(scale))
            numbers = np.linalg.lstsq(rows, y, rcond=_DETERMINED)[0] / scale
            weight = 1 / rms(np.einsum("jns,n->js", ours, numbers) - train.torque, train)
        if step == 0:
            rigid = [np.einsum("jns,n->js", part, numbers) for part in (ours, theirs)]
        yield name, np.einsum("jns,n->js", theirs, numbers) - test.torque


def rms(errors: Array, half: Half) -> Array:
    """`(joint,)` Nm, of the samples that are scored."""
    return np.sqrt(np.mean(errors[:, half.scored] ** 2, 1))


def tables(recording: Recording, cutoff: float, ours: bool) -> Iterator[Table]:
    """A table for each half that is predicted, with a row for each step.

    Raises:
        InputError: no torques or times, or no arm declared.
    """
    arm, recording = declared_arm_of(recording), recording.sorted_by_time()
    rate, dof = sample_rate(recording), arm.dof
    if cutoff >= rate / 2:
        raise InputError(f"{recording.source}: has {rate:.4g} rows a second; give a --cut below {rate / 2:.4g} Hz")
    low = partial(sosfiltfilt, butter(4, cutoff, fs=rate, output="sos"))
    first = np.arange(recording.samples) < recording.samples // 2
    parts = [recording.select(first), recording.select(~first)]
    halves = [Half.of(part, rate, low) for part in parts]
    # of unit bodies: the regressor does not depend on them
    bodies = np.ones(dof), np.zeros((dof, 3)), np.tile(np.eye(3), (dof, 1, 1))
    model = pinocchio_model(arm.kinematics, *bodies, recording.settings.gravity_m_per_s2)
    for train, name in ((0, "first half fitted, second predicted"), (1, "second half fitted, first predicted")):
        test = halves[1 - train]
        table = Table(title=f"{recording.source}: {name}, RMS in Nm below {cutoff:g} Hz", title_justify="left")
        table.add_column("")
        for joint in range(dof):
            table.add_column(f"joint {joint + 1}", justify="right")
        errors = dict(climb(model, halves[train], test, low))
        if ours:
            found, unseen = diagnose_torques(parts[train]).model, parts[1 - train]
            errors["diagnosis"] = low((predict(found, unseen) - unseen.torques()).T)
        for step, off in errors.items():
            table.add_row(step, *(f"{value:.3f}" for value in rms(off, test)))
        yield table


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code: 0, 2 for arguments that cannot be used, 130 where interrupted."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks ladder", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("recording", type=Path, help="a table of joints, velocities and torques, its sidecar beside it")
    parser.add_argument("--cut", type=float, default=10.0, metavar="HZ", help="of the low pass; 10 if not given")
    parser.add_argument("--rivals-only", action="store_true", help="leave the diagnosis out, which takes minutes")
    options = parser.parse_args(arguments)
    if not options.cut > 0:
        parser.error("--cut: give a frequency above zero")
    keep_compiled_code()

    def shown() -> int:
        for table in tables(read_recording(options.recording), options.cut, not options.rivals_only):
            Console(highlight=False).print(table)
        return DONE

    return run_command(shown)
