"""The file of a reduced recording, a file of NumPy (.npz)."""

import io
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.torque.filtering import LowPass
from lite6jax.errors import InputError
from lite6jax.estimation.noise import Autocorrelation, NoiseModel
from lite6jax.populations.candidate import Candidate
from lite6jax.populations.functions import Function
from lite6jax.populations.reduced import Found, PooledTerm, ReducedArm

_VERSION = 3
_ARRAYS = ("sites", "angles", "training", "basis", "residual", "blocks")


def to_bytes(arm: ReducedArm) -> bytes:
    """The file; columns are in single precision, which is a ten-millionth of each."""
    about = {
        "version": _VERSION,
        "about": dict(arm.about),
        "found": [asdict(found) for found in arm.found],
        "candidates": [asdict(candidate) for candidate in arm.candidates],
        "families": [asdict(family) for family in arm.families],
        "functions": [asdict(function) for function in arm.functions],
        "places": [*arm.places],
        "drivers": [*arm.drivers],
    }
    rows, samples, filtered = len(arm.noise.groups), arm.training.size, arm.smoothing
    smoothing = {} if filtered is None else {
        "smoothing": np.array([filtered.rate, filtered.cutoff, filtered.every]),
        "runs": filtered.runs,
        "kept": filtered.kept,
    }  # fmt: skip
    sink = io.BytesIO()
    np.savez(
        sink,
        about=np.frombuffer(json.dumps(about).encode(), np.uint8),
        columns=arm.columns.astype(np.float32),
        noise=np.array([(model.coefficient, model.share) for model in arm.noise.models]),
        groups=arm.noise.groups,
        starts=np.array(arm.noise.starts),
        places=np.array([*arm.places.values()]).reshape(-1, rows, samples),
        drivers=np.array([*arm.drivers.values()]).reshape(-1, samples if filtered is None else len(filtered.runs)),
        **{name: getattr(arm, name) for name in _ARRAYS},
        **smoothing,
    )
    return sink.getvalue()


def from_bytes(stored: bytes, place: str = "a reduced recording") -> ReducedArm:
    """What `to_bytes` wrote.

    Raises:
        InputError: the bytes are no such file; the message begins with `place`.
    """
    with _readable(place), np.load(io.BytesIO(stored), allow_pickle=False) as file:
        heading, said = _heading(file["about"])
        models = tuple(Autocorrelation(float(c), float(s)) for c, s in file["noise"])
        smoothing = None
        if "smoothing" in file:
            rate, cutoff, every = map(float, file["smoothing"])
            smoothing = LowPass(rate, cutoff, int(every), file["runs"], file["kept"])
        return ReducedArm(
            smoothing=smoothing,
            **heading._asdict(),
            noise=NoiseModel(models, file["groups"], tuple(map(int, file["starts"]))),
            columns=file["columns"].astype(float),
            places=dict(zip(said["places"], file["places"], strict=True)),
            drivers=dict(zip(said["drivers"], file["drivers"], strict=True)),
            **{name: file[name] for name in _ARRAYS},
        )


class Heading(NamedTuple):
    """What a file says of its recording before the numbers; attributes as those of `ReducedArm`."""

    about: Mapping[str, Any]
    found: tuple[Found, ...]
    candidates: tuple[Candidate, ...]
    families: tuple[Candidate, ...]
    functions: tuple[Function, ...]


def read_heading(path: Path) -> Heading:
    """The heading of a file, without its arrays.

    Raises:
        InputError: as `from_bytes`.
    """
    with _readable(str(path)), open(path, "rb") as opened, np.load(opened, allow_pickle=False) as file:
        return _heading(file["about"])[0]


def _heading(stored: NDArray[np.uint8]) -> tuple[Heading, Mapping[str, Any]]:
    said = json.loads(stored.tobytes())
    if said["version"] != _VERSION:
        raise ValueError("another version")
    found = (
        Found(None if one["term"] is None else PooledTerm(*one["term"]), one["label"], one["p_value"])
        for one in said["found"]
    )
    candidates, families = (tuple(map(Candidate.of, said[name])) for name in ("candidates", "families"))
    functions = tuple(map(Function.of, said["functions"]))
    return Heading(said["about"], tuple(found), candidates, families, functions), said


@contextmanager
def _readable(place: str) -> Iterator[None]:
    try:
        yield
    except (ValueError, KeyError, TypeError, EOFError, OSError, BadZipFile) as error:
        raise InputError(
            f"{place}: is no reduced recording of this version; give the command again with --force"
        ) from error
