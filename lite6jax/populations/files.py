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
from lite6jax.effects.drivers import driver_of
from lite6jax.errors import InputError
from lite6jax.estimation.noise import Autocorrelation, NoiseModel
from lite6jax.estimation.problem import Component, Quantity
from lite6jax.populations.reduced import Found, ReducedArm
from lite6jax.populations.terms import Candidate, quarters

_VERSION = 4
_ARRAYS = ("run", "training", "basis", "residual", "blocks")


def to_bytes(arm: ReducedArm) -> bytes:
    """The file; columns are in single precision, which is a ten-millionth of each."""
    about = {
        "version": _VERSION,
        "about": dict(arm.about),
        **{name: [asdict(one) for one in getattr(arm, name)] for name in ("found", "candidates", "families")},
        "components": [[one.site, one.name, unit] for one, unit in zip(arm.components, arm.units, strict=True)],
        "quantities": [
            [one.driver.phrase, quarters(one).values.tolist(), sorted(one.own), one.only] for one in arm.quantities
        ],
    }
    rows, filtered = len(arm.noise.groups), arm.smoothing
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
        places=np.array([one.column for one in arm.components]).reshape(-1, rows, arm.training.size),
        drivers=np.array([one.values for one in arm.quantities]).reshape(-1, arm.run.shape[1]),
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
        heading = _heading(file["about"])._asdict()
        models = tuple(Autocorrelation(float(c), float(s)) for c, s in file["noise"])
        smoothing = None
        if "smoothing" in file:
            rate, cutoff, every = map(float, file["smoothing"])
            smoothing = LowPass(rate, cutoff, int(every), file["runs"], file["kept"])
        columns = zip(heading.pop("components"), file["places"], strict=True)
        values = zip(heading.pop("quantities"), file["drivers"], strict=True)
        return ReducedArm(
            smoothing=smoothing,
            **heading,
            components=tuple(one._replace(column=column) for one, column in columns),
            quantities=tuple(one._replace(values=each) for one, each in values),
            noise=NoiseModel(models, file["groups"], tuple(map(int, file["starts"]))),
            columns=file["columns"].astype(float),
            **{name: file[name] for name in _ARRAYS},
        )


class Heading(NamedTuple):
    """What a file says of its recording before the numbers; attributes as those of `ReducedArm`.

    Components have no columns, and quantities a few of their values.
    """

    about: Mapping[str, Any]
    found: tuple[Found, ...]
    candidates: tuple[Candidate, ...]
    families: tuple[Candidate, ...]
    components: tuple[Component, ...]
    units: tuple[str, ...]
    quantities: tuple[Quantity, ...]


def read_heading(path: Path) -> Heading:
    """The heading of a file, without its arrays.

    Raises:
        InputError: as `from_bytes`.
    """
    with _readable(str(path)), open(path, "rb") as opened, np.load(opened, allow_pickle=False) as file:
        return _heading(file["about"])


def _heading(stored: NDArray[np.uint8]) -> Heading:
    said = json.loads(stored.tobytes())
    if said["version"] != _VERSION:
        raise ValueError("another version")
    return Heading(
        said["about"],
        tuple(Found(**one) for one in said["found"]),
        *(tuple(map(Candidate.of, said[name])) for name in ("candidates", "families")),
        tuple(Component(site, name, np.zeros((0, 0))) for site, name, _ in said["components"]),
        tuple(unit for *_, unit in said["components"]),
        tuple(
            Quantity(driver_of(phrase), np.array(values), frozenset(own), only)
            for phrase, values, own, only in said["quantities"]
        ),
    )


@contextmanager
def _readable(place: str) -> Iterator[None]:
    try:
        yield
    except (ValueError, KeyError, TypeError, EOFError, OSError, BadZipFile) as error:
        raise InputError(
            f"{place}: is no reduced recording of this version; give the command again with --force"
        ) from error
