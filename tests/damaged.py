"""Readers with files to damage, and how a file is damaged; a further reader is one more entry of `READERS`."""

import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from lite6jax.arms.arm import Arm, sample_joints
from lite6jax.arms.description import load_bundled
from lite6jax.arms.factory import write_factory
from lite6jax.arms.files import read_arm, read_factory, write_arm, write_table, write_urdf
from lite6jax.errors import InputError, InputWarning
from lite6jax.recordings import Recording, read_recording, read_targets, sidecar_path, write_recording
from lite6jax.recordings.files import open_table
from lite6jax.recordings.ros import ArmJoints

SAMPLES = 60
LITE6 = load_bundled("lite6")


@dataclass(frozen=True)
class Reader:
    """A reader with a file for it.

    Attributes:
        name: of both.
        write: writes a whole file, and what belongs to it, into a folder; returns the file to read.
        read: reads it; raises `InputError` where it cannot.
        damaged: the file to damage, from the one to read; the same where not given.
    """

    name: str
    write: Callable[[Path], Path]
    read: Callable[[Path], Any]
    damaged: Callable[[Path], Path] = lambda path: path


# ------------------------------------------------------------------ damage

HOSTILE = (
    *(b"1e15", b"1e160", b"1e308", b"-1e308", b"3.4028235e38", b"1e-320", b"-0", b"nan", b".inf", b"1e999", b"0x10"),
    *(b"9223372036854775808", b"1:30", b"1_000", b"true", b"null", b"''", b"\x00", b"\xff", b"\xed\xa0\x80", b"\n"),
    *(b",", b'"', b": ", b"- ", b"{", b"}", b"[" * 200, b"&a [*a]", b"*a", b"!!python/object:os.system", b"<<: *a"),
    *(b"<!ENTITY a 'b'>", b"1:" * 300 + b"0.5", b"0001-01-01 00:00:00 +23:59", b"\xef\xbb\xbf", b"#", b"PAR1"),
)
"""Fragments that have confused readers of numbers, text, YAML, XML and Parquet."""
_NUMBER = re.compile(rb"[-+]?\d[\d.]*(?:e[-+]?\d+)?")


_KINDS = (*("bit",) * 3, "byte", "cut", "drop", "repeat", "zero", "insert", *("number",) * 3)
"""Faults of transmission, storage and editing; of text, a number is a frequent place."""


def damage(content: bytes, rng: Random) -> bytes:
    """Content with one to three faults."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        start = rng.randrange(len(content) + 1)
        end, put = min(start + rng.choice((1, 2, 8, 64, 512)), len(content)), b""
        kind = rng.choice(_KINDS)
        numbers = list(_NUMBER.finditer(content)) if kind == "number" else []
        if kind == "bit":
            content = flip_bit(content, rng)
            continue
        if numbers:
            (start, end), put = rng.choice(numbers).span(), rng.choice(HOSTILE)
        elif kind in ("insert", "number"):
            end, put = start, rng.choice(HOSTILE)
        elif kind == "byte":
            end, put = start + 1, bytes([rng.randrange(256)])
        elif kind == "cut":
            end = len(content)
        elif kind == "repeat":
            put = content[start:end] * rng.choice((2, 3, 21))
        elif kind == "zero":
            put = bytes(end - start)
        content = content[:start] + put + content[end:]
    return content


def flip_bit(content: bytes, rng: Random) -> bytes:
    """Content with one bit inverted."""
    if not content:
        return content
    place, bit = rng.randrange(len(content)), rng.randrange(8)
    return content[:place] + bytes([content[place] ^ 1 << bit]) + content[place + 1 :]


# ------------------------------------------------------------------ files and readers


def recording(samples: int = SAMPLES) -> Recording:
    """Poses of a Lite 6 that is slightly off, as a tracker measures them, with all kinds of columns."""
    from lite6jax.arms.frames import chain
    from lite6jax.simulation import draw_calibration

    rng = np.random.default_rng(0)
    lower, upper = LITE6.joint_limits.T
    q = (lower + upper) / 2 + 0.35 * (upper - lower) * sample_joints(LITE6.dof, samples) / np.pi
    arm = Arm("lite6", draw_calibration(LITE6, seed=1))
    poses = chain(arm.links, q)
    return Recording.from_arrays(
        q,
        poses[:, :3, 3] + 2e-5 * rng.standard_normal((samples, 3)),
        time=8.0 * np.arange(samples),
        joint_temperature=np.full_like(q, 25.0),
        payload=np.full(samples, 0.3),
        run=np.arange(samples) // (samples // 2),
        arm="lite6",
        pose_frame="base",
        tool="none",
        motion="static",
        position_noise_m=2e-5,
        pose_source="laser_tracker",
    )


def _written(suffix: str) -> Callable[[Path], Path]:
    """Writes the recording."""
    return lambda folder: write_recording(recording(), folder / f"run7{suffix}", overwrite=True)


def _read_recording(path: Path) -> Recording:
    return read_recording(path, dof=LITE6.dof, joint_limits=LITE6.joint_limits, reach=LITE6.reach)


def _exported(folder: Path) -> Path:
    """Such as a spreadsheet gives: a title, groups, names, units, decimal commas, Latin-1."""
    read = recording()
    assert read.position is not None
    lines = [
        "Messung 7;" + 8 * ";",
        "",
        "Gelenke" + 6 * ";" + "Pose;;",
        ";".join([*map("J{}".format, range(1, 7)), *"XYZ"]),
    ]
    lines.append(";".join(6 * ["[°]"] + 3 * ["[mm]"]))
    table = np.hstack([np.rad2deg(read.joint_position), 1e3 * read.position])
    lines += [";".join(f"{value:.3f}".replace(".", ",") for value in row) for row in table]
    path = folder / "run7.csv"
    path.write_bytes("\r\n".join([*lines, ""]).encode("latin-1"))
    return path


def _read_table(path: Path) -> list[Any]:
    _, table = open_table(path, (), ArmJoints(), [])
    return list(table.numbers())


def _targets(folder: Path) -> Path:
    path = folder / "targets.csv"
    path.write_text("note,x_m,y_m,z_m,payload_kg\na,0.2,0.1,0.3,0\nb,0.25,-0.1,0.2,0.5\n")
    return path


def _factory(folder: Path) -> Path:
    from lite6jax.simulation import draw_calibration

    return write_factory(draw_calibration(LITE6, seed=1), folder / "arm.yaml", overwrite=True)


def _mcap(folder: Path) -> Path:
    from tests import logs

    q = recording().joint_position
    names = [f"joint{joint + 1}" for joint in range(q.shape[1])]
    return logs.write(folder / "run7.mcap", {"/joint_states": logs.joints(8.0 * np.arange(len(q)), q, names)})


CSV = Reader("csv", _written(".csv"), _read_recording)
PARQUET = Reader("parquet", _written(".parquet"), _read_recording)
SIDECAR = Reader("sidecar", _written(".csv"), _read_recording, sidecar_path)
EXPORTED = Reader("table of a spreadsheet", _exported, _read_table)
TARGETS = Reader("targets", _targets, lambda path: read_targets(path, LITE6.dof, LITE6.joint_limits, LITE6.reach))
DESCRIPTION = Reader("description", lambda folder: write_arm(LITE6, folder / "arm.yaml", overwrite=True), read_arm)
FACTORY = Reader("factory file", _factory, read_factory)
TABLE = Reader(
    "table", lambda folder: write_table(LITE6.form, LITE6.hayati, folder / "arm.json", overwrite=True), read_factory
)
URDF = Reader("urdf", lambda folder: write_urdf(LITE6, folder / "arm.urdf", overwrite=True), read_arm)
MCAP = Reader("mcap", _mcap, lambda path: read_recording(f"{path}#/joint_states", dof=LITE6.dof))
READERS = (*(CSV, PARQUET, SIDECAR, TARGETS, DESCRIPTION, FACTORY, TABLE, URDF, MCAP, EXPORTED),)


class Trial:
    """A reader with its whole file in a folder."""

    def __init__(self, reader: Reader, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.reader = reader
        self._path = reader.write(folder)
        self._damaged = reader.damaged(self._path)
        self.content = self._damaged.read_bytes()
        reader.read(self._path)

    def judged(self, content: bytes) -> tuple[str, str]:
        """The outcome of reading `content`, and a detail: read, refused, or traceback."""
        self._damaged.write_bytes(content)
        try:
            with warnings.catch_warnings(record=True):
                warnings.simplefilter("error")
                warnings.simplefilter("always", InputWarning)  # what the command line prints as a line
                self.reader.read(self._path)
        except InputError as error:
            return ("traceback", repr(str(error))) if "\n" in str(error) else ("refused", "")
        except Exception as error:
            return "traceback", f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
        return "read", ""
