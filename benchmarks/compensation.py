"""The error that a diagnosis has found, removed: a soft arm in MuJoCo is measured, diagnosed, and driven to targets."""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.concealed.chain import MADE, Array, factory_text, lite6, quaternion_from_rotation, rotation_from_vector
from benchmarks.concealed.mujoco_physics import Arm
from benchmarks.concealed.plain_physics import Hidden, Motion, Setup
from benchmarks.measure import OURS, Record, time_call
from lite6jax.diagnosis.diagnose import diagnose_poses
from lite6jax.diagnosis.document import read_model, write_document
from lite6jax.domains.pose.compensate import compensate, read_pose_targets
from lite6jax.domains.pose.fit import fit
from lite6jax.recordings import Recording, RecordingSettings, read_recording, write_recording
from lite6jax.storage import write_atomically

WORK = "soft Lite 6 in MuJoCo"
NOISE = (2e-5, 1e-4)  # m and rad per axis
SPRINGS = {2: 9e-5, 3: 6e-5, 5: 1.2e-4}  # rad/Nm of the joints' springs
BASE = (1.5e-5, 2.5e-5)  # rad/Nm of what it stands on
PAYLOADS = (0.0, 0.8)
CENTER = (0.01, 0.0, 0.05)
FLOOR = 1.5  # after compensation the error may be so many times what the tracker's own noise makes of a position


class Soft(NamedTuple):
    """An arm with springs, seen from somewhere."""

    setup: Setup  # as it was made and where the sensor stands
    arms: dict[float, Arm]  # one a payload

    def poses(self, q: Array, payload: Array) -> tuple[Array, Array]:
        """Rotations and positions in the sensor's frame with the arm at rest where its encoders say `q`."""
        rotation, position = np.empty((len(q), 3, 3)), np.empty((len(q), 3))
        for mass, arm in self.arms.items():
            rows = payload == mass
            zero = np.zeros_like(q[rows])
            seen = arm.at_rest(Motion(q[rows], zero, zero, zero[:, 0], zero + 25.0, payload[rows]))
            rotation[rows], position[rows] = seen.rotation, seen.position
        return rotation, position

    def recording(
        self, q: Array, payload: Array, rng: np.random.Generator, turned: bool, calibration: Path | None
    ) -> Recording:
        """What a tracker makes of it; frame and tool unknown, and the geometry where there is no calibration."""
        rotation, position = self.poses(q, payload)
        position = position + NOISE[0] * rng.standard_normal(position.shape)
        rotation = rotation @ rotation_from_vector(NOISE[1] * rng.standard_normal(position.shape))
        noise = {"position_noise_m": NOISE[0], "orientation_noise_rad": NOISE[1] if turned else None}
        where = {"arm": "lite6", "factory_calibration": str(calibration) if calibration else None, "motion": "static"}
        source = {"joint_source": "measured", "pose_source": "laser_tracker", "payload_com_m": CENTER}
        told = RecordingSettings(**where, **source, **noise)
        quaternion = quaternion_from_rotation(rotation) if turned else None
        return Recording.from_arrays(q, position=position, quaternion=quaternion, payload=payload, settings=told)


def soft_arm(rng: np.random.Generator) -> Soft:
    """A Lite 6 as one is made, with soft joints on a soft base."""
    sensor, tool = np.eye(4), np.eye(4)
    sensor[:3, :3], sensor[:3, 3] = rotation_from_vector(rng.uniform(-1, 1, 3)), rng.uniform(-2, 2, 3)
    tool[:3, :3], tool[:3, 3] = rotation_from_vector(rng.uniform(-1, 1, 3)), (0.02, -0.01, 0.06)
    hidden = [Hidden("joint_compliance", f"joint{joint}", (c,)) for joint, c in SPRINGS.items()]
    hidden.append(Hidden("base_compliance", "base", BASE))
    setup = Setup(lite6().moved(rng, *MADE), sensor, tool, np.array(CENTER))
    return Soft(setup, {mass: Arm(setup, tuple(hidden), mass) for mass in PAYLOADS})


def draw_poses(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Joint positions within the limits and a turn, and a payload for each."""
    lower, upper = np.clip(lite6().limits, -np.pi, np.pi).T
    return rng.uniform(lower, upper, (count, len(lower))), rng.choice(PAYLOADS, count)


def compensation(
    rows: int = 300,
    targets: int = 200,
    kinds: Sequence[str] = ("poses", "positions"),
    known: bool = False,
    seed: int = 5,
) -> Iterator[Record]:
    """True errors at targets that the diagnosed arm never went to, before and after, and the seconds it takes."""
    for name in kinds:
        kind, turned = f"{WORK}, {name}", name == "poses"
        rng = np.random.default_rng(seed)
        soft = soft_arm(rng)
        with tempfile.TemporaryDirectory() as folder:
            calibration = Path(folder) / "factory.yaml" if known else None
            if calibration:
                write_atomically(calibration, factory_text(soft.setup.chain.rows))
            recorded = soft.recording(*draw_poses(rng, rows), rng, turned, calibration)
            path = write_recording(recorded, Path(folder) / "run.csv")
            recording = read_recording(path)
            plain = fit(recording)  # the fitted geometry is what there is without a diagnosis
            seconds, found = time_call(partial(diagnose_poses, recording))
            document = Path(folder) / "diagnosis.json"
            write_document(found.to_dict(), document)
            wanted_q, payload = draw_poses(rng, targets)
            wanted = np.asarray(plain.predict(wanted_q), np.float64)
            asked = Recording.from_arrays(
                wanted_q,
                position=wanted[:, :3, 3],
                quaternion=quaternion_from_rotation(wanted[:, :3, :3]) if turned else None,
                payload=payload,
                settings=replace(recording.settings, motion="static"),
            )
            model = read_model(document, domain="poses")
            asked_path = write_recording(asked, Path(folder) / "targets.csv")
            taken, solved = time_call(partial(compensate, model, read_pose_targets(asked_path, model)))
        before, after = (
            np.linalg.norm(soft.poses(q, payload)[1] - wanted[:, :3, 3], axis=1)
            for q in (wanted_q, np.asarray(solved.joint_position, np.float64))
        )
        names = {f"{finding.effect.name}:{finding.effect.site}" for finding in found.findings}
        floor = float(np.sqrt(3)) * NOISE[0]
        rms = float(np.sqrt(np.mean(after**2)))
        missed = int((~solved.reached).sum())
        failed = "" if rms < FLOOR * floor else f"{1e3 * rms:.3g} mm left, the sensor's noise is {1e3 * floor:.3g} mm"
        yield Record(kind, OURS, f"found: {', '.join(sorted(names))}", float(len(names)), "effects")
        for subject, errors, wrong in (("fitted geometry", before, ""), ("compensated", after, failed)):
            yield Record(kind, subject, "error, RMS", 1e3 * float(np.sqrt(np.mean(errors**2))), "mm", wrong)
            yield Record(kind, subject, "error, largest", 1e3 * float(errors.max()), "mm")
        yield Record(kind, "the tracker's noise", "of one position, RMS", 1e3 * floor, "mm")
        wrong = f"{missed} not reached" if missed else ""
        yield Record(kind, "compensated", "targets not reached", float(missed), "", wrong)
        yield Record(kind, OURS, "diagnosis", seconds, "s")
        yield Record(kind, OURS, f"{targets} targets", taken, "s")
