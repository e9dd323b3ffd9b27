"""One recording reduced to what pooling needs: white residuals and the columns of what is tested, without a robot.

A recording is diagnosed once, where its problem and its noise model are at hand. What is kept of it is linear: then any
set of effects that the type is found to have is fitted to it by linear algebra alone, without the files and the
kinematics.
"""

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, final
from zipfile import BadZipFile

import msgspec
import numpy as np
from numpy.typing import NDArray

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.domains.torque.filtering import LowPass
from lite6jax.effects import kernels
from lite6jax.errors import InputError
from lite6jax.estimation.noise import Autocorrelation, NoiseModel
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.projection import orthonormal, outside, unit_rows
from lite6jax.estimation.score_test import block_covariance, sums_by_block
from lite6jax.estimation.thresholds import CONFOUNDED, LOWEST_ORDER
from lite6jax.fields import field_values
from lite6jax.fleet.terms import (
    CUBICS,
    SPLINES,
    Candidate,
    FleetComponent,
    FleetProcess,
    PooledTerm,
    Tested,
    Varied,
)

SCREENED = {
    SPLINES: tuple(kernels.kernel_of(name).root for name in ("cubic", "medium", "rough")),
    CUBICS: (np.eye(kernels.kernel_of(CUBICS).size(())),),
}
"""`(function, feature)`, by which functions become those of the kernels that processes are screened by."""
_ORDERS_AT_ONCE = 1 << 21
"""Numbers of columns that are in memory at once: 16 MB."""
_ROUNDING = 1e-9
_ARRAYS = ("places", "values", "run", "training", "basis", "residual", "blocks")


def readings(columns: Array, noise: NoiseModel, training: Mask, number: int) -> Array:
    """Columns `(…, row, sample)`, of unit noise, as those of all `number` readings: white, zero at samples that are not
    fitted. Readings of the prior come after all samples."""
    white = noise.whitened(columns) * training
    *leading, rows, samples = white.shape
    stacked = np.zeros((*leading, number))
    stacked[..., : rows * samples] = white.reshape(*leading, rows * samples)
    return stacked


class Heading(NamedTuple):
    """What is said of a recording before the numbers.

    Attributes:
        about: `what` was measured ("poses" or "torques"), `arm`, `joints`, `rows`, `date`, `verdict`.
        found: by the diagnosis of the recording alone: name and site, and the family-wise p-value.
        candidates: that can be tested here.
        families: of waves, each of an angle that is one of the quantities.
        places: where processes can act.
        quantities: what they can depend on.
        version: of the file.
    """

    about: dict[str, Any]
    found: tuple[tuple[str, float], ...]
    candidates: tuple[Candidate, ...]
    families: tuple[Candidate, ...]
    places: tuple[FleetComponent, ...]
    quantities: tuple[Varied, ...]
    version: int = 4


class RecordingEvidence(NamedTuple):
    """What a recording says of one effect beside others, as a likelihood that is normal in its numbers.

    Attributes:
        score: `(number,)`, the derivative of the log-likelihood at zero.
        information: `(number, number)`, minus its second derivative.
        covariance: `(number, number)` of the score, by the scatter between blocks of samples.
        left: the sum of squares that is left without it.
        freedom: its degrees of freedom.
    """

    score: Array
    information: Array
    covariance: Array
    left: float
    freedom: float


class GroupScores(NamedTuple):
    """What a recording says of groups of functions.

    Attributes:
        score: `(group, number)`.
        information: `(group, number, number)`.
        sums: `(3, group, kernel)`; of processes the square of the score, the trace of the information and that of its
            square, with the features of each kernel that vary; of waves χ² and twice its degrees of freedom.
    """

    score: Array
    information: Array
    sums: Array


class RecordingScan(NamedTuple):
    """What a recording says of all that is tested.

    Attributes:
        named: of each candidate by its key; None where it says nothing.
        groups: by the key of each family its waves at the orders of `order_grid`; by `SPLINES` and `CUBICS` processes.
        left, freedom: as in `Evidence`.
    """

    named: dict[str, RecordingEvidence | None]
    groups: dict[str, GroupScores]
    left: float
    freedom: float


@final
@dataclass(frozen=True, eq=False)
class ReducedArm:
    """The linear model of one recording; readings are all rows of all samples, and then those of the nuisance's prior.

    Attributes:
        heading: what is said of it.
        columns: `(number, reading)`, white, of unit noise, of all candidates one after the other.
        places: `(place, row, sample)`, how residuals change with what acts there, of unit noise.
        values: `(quantity, moment)`; the moments are the samples, unless there is a `smoothing`.
        run: `(2, moment)`, the first and the last moment of the run of each.
        noise: the filter that makes columns white.
        training: `(sample,)` bool.
        basis: `(k, reading)`, orthonormal, the span of the nuisance and of effects that are not pooled.
        residual: `(reading,)` white, of unit noise, predicted less measured, with all pooled effects zero.
        blocks: the first sample of each block of neighbouring samples.
        smoothing: the low pass that waves and processes pass, and which of its moments are samples; None where they
            pass none.
    """

    heading: Heading
    columns: Array
    places: Array
    values: Array
    run: Integers
    noise: NoiseModel
    training: Mask
    basis: Array
    residual: Array
    blocks: Integers
    smoothing: LowPass | None = None

    def to_bytes(self) -> bytes:
        """A file of NumPy (.npz); columns are in single precision, which is a ten-millionth of each."""
        filtered = self.smoothing
        smoothing = {} if filtered is None else {
            "smoothing": np.array([filtered.rate, filtered.cutoff, filtered.every]),
            "runs": filtered.runs,
            "kept": filtered.kept,
        }  # fmt: skip
        stored = field_values(self)
        sink = io.BytesIO()
        np.savez(
            sink,
            heading=np.frombuffer(msgspec.msgpack.encode(self.heading), np.uint8),
            columns=self.columns.astype(np.float32),
            noise=np.array([(model.coefficient, model.share) for model in self.noise.models]),
            groups=self.noise.groups,
            starts=np.array(self.noise.starts),
            **{name: stored[name] for name in _ARRAYS},
            **smoothing,
        )
        return sink.getvalue()

    @classmethod
    def from_bytes(cls, stored: bytes, place: str = "a reduced recording") -> "ReducedArm":
        """What `to_bytes` wrote; the message on other bytes begins with `place`."""
        with _readable(place), np.load(io.BytesIO(stored), allow_pickle=False) as file:
            models = tuple(Autocorrelation(float(c), float(s)) for c, s in file["noise"])
            smoothing = None
            if "smoothing" in file:
                rate, cutoff, decimation = map(float, file["smoothing"])
                smoothing = LowPass(rate, cutoff, int(decimation), file["runs"], file["kept"])
            return cls(
                heading=_heading(file["heading"]),
                columns=file["columns"].astype(float),
                noise=NoiseModel(models, file["groups"], tuple(map(int, file["starts"]))),
                smoothing=smoothing,
                **{name: file[name] for name in _ARRAYS},
            )

    # -------------------------------------------------------------- columns

    @cached_property
    def parts(self) -> dict[str, slice]:
        """Where the columns of each candidate stand."""
        ends = np.cumsum([0, *(len(candidate.names) for candidate in self.heading.candidates)]).tolist()
        keys = (candidate.key for candidate in self.heading.candidates)
        return dict(zip(keys, map(slice, ends[:-1], ends[1:]), strict=True))

    @cached_property
    def _values(self) -> dict[str, Array]:
        return dict(zip((quantity.driver.phrase for quantity in self.heading.quantities), self.values, strict=True))

    @cached_property
    def _places(self) -> dict[tuple[str, str], Array]:
        return dict(zip((place[:2] for place in self.heading.places), self.places, strict=True))

    def columns_of(self, term: Tested) -> Array:
        """`(number, reading)`; none where the recording cannot show the term."""
        if isinstance(term, FleetProcess):
            if not self._has(term):
                return self.columns[:0]
            return self._moved(self._places[term.site, term.component], self._functions(term))
        if term.order is None:
            part = self.parts.get(term.key)
            return self.columns[:0] if part is None else self.columns[part]
        family = next((family for family in self.heading.families if family.key == term.key), None)
        if family is None:
            return self.columns[:0]
        return self._moved(self._place_of(family), self._waves(family, np.array([term.order]))[0])

    def _has(self, process: FleetProcess) -> bool:
        return (process.site, process.component) in self._places and set(process.drivers) <= set(self._values)

    def _place_of(self, family: Candidate) -> Array:
        return next(column for (site, _), column in self._places.items() if site == family.site)

    def _waves(self, family: Candidate, orders: Array) -> Array:
        """Sine and cosine `(order, 2, sample)`, as the measurements show them."""
        turned = np.multiply.outer(orders, self._values[family.driver])
        return self._seen(np.stack([np.sin(turned), np.cos(turned)], 1))

    def _functions(self, process: FleetProcess) -> Array:
        """`(function, sample)`, as the measurements show them."""
        return self._seen(process.functions(np.stack([self._values[phrase] for phrase in process.drivers]), self.run))

    def _seen(self, values: Array) -> Array:
        """Values `(…, moment)` as the measurements show them, `(…, sample)`."""
        return values if self.smoothing is None else self.smoothing(values)

    def _moved(self, place: Array, functions: Array) -> Array:
        """Columns `(…, reading)` of what moves a place by functions `(…, sample)`."""
        return readings(functions[..., None, :] * place, self.noise, self.training, self.residual.size)

    # -------------------------------------------------------------- evidence

    @cached_property
    def left(self) -> Array:
        """`(reading,)`, the residual outside the span of the model."""
        return self.residual - (self.basis @ self.residual) @ self.basis

    @property
    def freedom(self) -> float:
        """Degrees of freedom of what is left."""
        rows = len(self.noise.groups)
        return float(max(self.residual.size - rows * np.sum(~self.training) - len(self.basis), 1))

    def beside(self, terms: Sequence[Tested]) -> "ReducedArm":
        """The same with further terms in the model: they join the basis, and leave the residual."""
        columns = [self.columns_of(term) for term in terms]
        flat = unit_rows(np.concatenate([self.columns[:0], *columns]))
        new = orthonormal(outside(flat, self.basis), CONFOUNDED) if len(flat) else flat
        basis = np.concatenate([self.basis, new])
        return replace(self, basis=basis, residual=self.residual - (new @ self.residual) @ new)

    def evidence(self, term: Tested) -> RecordingEvidence | None:
        """Evidence of a term beside the model; None where the recording cannot show it, or the model confounds it."""
        columns = self.columns_of(term)
        projected = outside(columns, self.basis)
        norms = np.linalg.norm(columns, axis=1)
        # what is confounded with the model is rounding, in the score and in the information alike
        threshold = CONFOUNDED
        length = np.where(norms > 0, norms, 1.0)
        C = projected @ projected.T / np.outer(length, length)
        unconfounded = np.diagonal(C) > threshold
        eigenvalues, V = np.linalg.eigh(np.where(np.outer(unconfounded, unconfounded), C, 0.0))
        V = np.where(unconfounded[:, None], V, 0.0)[:, eigenvalues > threshold]
        eigenvalues = eigenvalues[eigenvalues > threshold]
        if not eigenvalues.size:
            return None
        per_block = self._by_block(projected * self.left)
        along = V.T @ (per_block.sum(1) / length)
        information = (V * eigenvalues) @ V.T * np.outer(length, length)
        covariance = block_covariance(projected, per_block, V @ (along / eigenvalues) / length, self._by_block)
        return RecordingEvidence(
            -V @ along * length, information, covariance, float(self.left @ self.left), self.freedom
        )

    def scan(self, processes: Sequence[FleetProcess], options: EngineOptions) -> RecordingScan:
        """What the recording says of all candidates, of all waves, and of functions that processes are screened by."""
        candidate_evidence = {
            candidate.key: self.evidence(PooledTerm(candidate.key)) for candidate in self.heading.candidates
        }
        groups = {family.key: self._spectrum(family, options) for family in self.heading.families}
        for kernel in SCREENED:
            groups[kernel] = self._screened(
                [process for process in processes if process.kernel == kernel], SCREENED[kernel]
            )
        return RecordingScan(candidate_evidence, groups, float(self.left @ self.left), self.freedom)

    def _spectrum(self, family: Candidate, options: EngineOptions) -> GroupScores:
        """Scores of the waves of a family."""
        orders = order_grid(options)
        place = self._place_of(family)
        acting = place.any(1)
        white = self.noise.white
        noise = replace(self.noise, groups=self.noise.groups[acting])
        site = place[acting]
        # autocorrelated noise mixes samples: then rows do not add up before waves are multiplied
        measured = self._over_rows(place) if white else (1.0, self._measured[:, acting].reshape(-1, site.size))
        score = np.zeros((orders.size, 2))
        information = np.zeros((orders.size, 2, 2))
        step = max(1, _ORDERS_AT_ONCE // (2 * max(site.size, self.run.shape[1])))
        for first in range(0, orders.size, step):
            part = slice(first, first + step)
            waves = self._waves(family, orders[part])
            if not white:
                waves = (noise.whitened(waves[:, :, None] * site) * self.training).reshape(len(waves), 2, -1)
            score[part], information[part] = _equations(waves, *measured, CONFOUNDED)
        statistic, size = chi_squared(score, information)
        return GroupScores(score, information, np.stack([statistic, size, size])[..., None])

    def _screened(self, processes: Sequence[FleetProcess], roots: Sequence[Array]) -> GroupScores:
        """Scores of processes; in autocorrelated noise of those that vary slowly beside their places."""
        groups = len(processes)
        size = len(roots[0])
        score = np.zeros((groups, size))
        information = np.zeros((groups, size, size))
        functions = dict[tuple[str, ...], Array]()
        members = dict[tuple[str, str], list[int]]()
        for k, process in enumerate(processes):
            if self._has(process):
                members.setdefault((process.site, process.component), []).append(k)
                if process.drivers not in functions:
                    functions[process.drivers] = self._functions(process)
        for where, group_indices in members.items():
            f = np.stack([functions[processes[k].drivers] for k in group_indices])
            measured = self._over_rows(self._places[where])
            score[group_indices], information[group_indices] = _equations(f, *measured, CONFOUNDED)
        sums = np.zeros((3, groups, len(roots)))
        for k, R in enumerate(roots):
            varying = R[:, 1:]  # without the constant, which is larger than all else
            G = varying.T @ information @ varying
            sums[:, :, k] = np.sum((score @ varying) ** 2, 1), np.trace(G, axis1=1, axis2=2), np.sum(G**2, (1, 2))
        return GroupScores(score, information, sums)

    def _over_rows(self, place: Array) -> tuple[Array, Array]:
        """Sums over the rows of each sample of a place's square, and of it times what is left and the basis."""
        site = self.noise.whitened(place) * self.training
        return np.sum(site**2, 0), np.sum(site * self._measured, 1)

    @cached_property
    def _measured(self) -> Array:
        """What is left, and the basis, of the measurements alone: `(1 + k, row, sample)`."""
        shape = len(self.noise.groups), self.training.size
        return np.concatenate([self.left[None], self.basis])[:, : shape[0] * shape[1]].reshape(-1, *shape)

    def _by_block(self, products: Array) -> Array:
        return sums_by_block(products, len(self.noise.groups), self.training.size, self.blocks)


ORDER_STEP = 0.125
"""Step of the orders that are pooled, a quarter of a line's width over two turns: it costs 5 % of a line's power."""


def order_grid(options: EngineOptions) -> Array:
    """The orders at which families are scored, `(order,)`, the same for all recordings."""
    return np.arange(LOWEST_ORDER, options.highest_order + 1e-9, ORDER_STEP)


def chi_squared(score: Array, information: Array) -> tuple[Array, Array]:
    """bᵀ G⁺ b and the rank of G, `(…,)` each, of scores `(…, number)` and information `(…, number, number)`."""
    size = np.sqrt(np.maximum(np.diagonal(information, axis1=-2, axis2=-1), np.finfo(float).tiny))
    eigenvalues, V = np.linalg.eigh(information / (size[..., None] * size[..., None, :]))
    used = eigenvalues > _ROUNDING
    along = np.einsum("...ij,...i->...j", V, score / size)
    return np.sum(np.where(used, along**2 / np.where(used, eigenvalues, 1.0), 0.0), -1), np.sum(used, -1, dtype=float)


def _equations(functions: Array, weight: Array | float, measured: Array, confounded: float) -> tuple[Array, Array]:
    """Score `(group, number)` and information of functions `(group, number, sample)`, zero of what is confounded."""
    along = functions @ measured.T
    gram = (functions * weight) @ functions.swapaxes(1, 2)
    inside = along[..., 1:]
    information = gram - inside @ inside.swapaxes(1, 2)
    shown = np.diagonal(information, axis1=1, axis2=2) > confounded * np.diagonal(gram, axis1=1, axis2=2)
    return np.where(shown, -along[..., 0], 0.0), np.where(shown[:, :, None] & shown[:, None], information, 0.0)


def read_heading(path: Path) -> Heading:
    """The heading of a file, without its arrays."""
    with _readable(str(path)), open(path, "rb") as opened, np.load(opened, allow_pickle=False) as file:
        return _heading(file["heading"])


def _heading(stored: NDArray[np.uint8]) -> Heading:
    heading = msgspec.msgpack.decode(stored.tobytes(), type=Heading)
    if heading.version != Heading._field_defaults["version"]:
        raise ValueError("another version")
    return heading


@contextmanager
def _readable(place: str) -> Iterator[None]:
    try:
        yield
    except (ValueError, KeyError, TypeError, EOFError, OSError, BadZipFile, msgspec.MsgspecError) as error:
        raise InputError(
            f"{place}: is no reduced recording of this version; give the command again with --force"
        ) from error
