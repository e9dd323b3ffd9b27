"""Score tests of every candidate at once: what each would explain of the residuals, without a refit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, fdtrc

from lite6jax.domains.pose.problem import Case
from lite6jax.effects.effect import Effect
from lite6jax.estimation.least_squares import Fitted
from lite6jax.estimation.noise import WHITE, Colour, colour_of, correlation_length, stretches

Array = NDArray[np.floating]

HIDDEN = 1e-6
"""Share of a candidate's columns that the nuisance leaves, under which nothing tells them apart."""
WINSOR = 4.0
"""Standard deviations per number beyond which a sample's residual counts no more than that."""
_MOST_BLOCKS = 60
_LEAST_IN_BLOCK = 6
_LENGTHS = 2.0
"""Correlation lengths in a block."""


class Score(NamedTuple):
    """What a candidate would explain.

    Attributes:
        gain: of the log-likelihood, by a quadratic.
        size: numbers that are told, of those it has.
        p: that noise alone explains so much; the larger of what white noise and correlated noise would say.
        hidden: whether the nuisance, or what is in the model already, can do all that it does.
        values: `(number,)` of the candidate, estimated.
    """

    gain: float
    size: int
    p: float
    hidden: bool
    values: Array

    def familywise(self, tried: float) -> float:
        """That noise alone explains so much by one or other of so many independent candidates."""
        return min(self.p * tried, 1.0)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Projected columns of candidates, ready to be scored against any residuals.

    Attributes:
        case: the data.
        fitted: the model that the candidates are added to.
        basis: orthonormal rows `(k, reading)` that span what the nuisance and the model's effects can do, once the
            noise is made white. Readings are the rows of all samples, and then what is known beforehand of each
            number, a reading each.
        residual: `(reading,)` white, of unit noise, wild samples cut down to what four standard deviations would be.
        blocks: where blocks of neighbouring samples begin.
        freedom: numbers measured, less those fitted.
        memory: over how many samples the residual remembers; 1 where it is white.
        scale: of the noise, over the whitener's.
    """

    case: Case
    fitted: Fitted
    basis: Array
    residual: Array
    blocks: NDArray[np.integer]
    freedom: float
    memory: float
    scale: float

    def score(self, effects: Sequence[Effect]) -> list[Score]:
        """A score for each effect."""
        columns = self.case.columns(effects, beside=(self.fitted.physics, self.fitted.values))
        sizes = [effect.size for effect in effects]
        ends = np.cumsum([0, *sizes])
        return self.score_columns([columns[a:b] for a, b in pairwise(ends)])

    def given(self, columns: Array) -> "Evidence":
        """The evidence once columns `(number, row, sample)` are fitted as well, to first order."""
        flat = self._flat(columns)
        flat /= np.maximum(np.linalg.norm(flat, axis=1), 1e-300)[:, None]
        new = _orthonormal(flat - (flat @ self.basis.T) @ self.basis)
        residual = self.residual - (new @ self.residual) @ new
        return replace(self, basis=np.concatenate([self.basis, new]), residual=residual)

    def gains(self, groups: Array) -> Array:
        """What each of some groups of columns `(group, number, row, sample)` would explain, `(group,)`; no more."""
        shape = groups.shape[:2]
        flat = self._flat(groups.reshape(-1, *groups.shape[2:]))
        hidden = (flat @ self.basis.T).reshape(*shape, -1)
        pull = (flat @ self.residual).reshape(shape) - hidden @ (self.basis @ self.residual)
        flat = flat.reshape(*shape, -1)
        gram = flat @ flat.swapaxes(1, 2)
        norms = np.sqrt(np.maximum(np.diagonal(gram, axis1=1, axis2=2), 1e-300))
        left = (gram - hidden @ hidden.swapaxes(1, 2)) / (norms[:, :, None] * norms[:, None])
        pull = pull / norms
        eigenvalues, V = np.linalg.eigh(left)
        told = np.where(eigenvalues > HIDDEN, 1 / np.maximum(eigenvalues, HIDDEN), 0.0)
        return 0.5 * np.sum(told * np.einsum("gji,gj->gi", V, pull) ** 2, 1)

    def score_columns(self, groups: Sequence[Array]) -> list[Score]:
        """A score for each group of columns `(number, row, sample)`."""
        flat = self._flat(np.concatenate(groups))
        norms = np.linalg.norm(flat, axis=1)
        projected = flat - (flat @ self.basis.T) @ self.basis
        per_block = self._by_block(projected * self.residual)
        scores, at = [], 0
        for group in groups:
            part = slice(at, at + len(group))
            at += len(group)
            scores.append(self._of(projected[part], norms[part], per_block[part]))
        return scores

    def _of(self, projected: Array, norms: Array, per_block: Array) -> Score:
        size = len(projected)
        scale = np.where(norms > 0, norms, 1.0)
        G = projected / scale[:, None]
        eigenvalues, V = np.linalg.eigh(G @ G.T)
        told = eigenvalues > HIDDEN
        if not told.any():
            return Score(0.0, 0, 1.0, True, np.zeros(size))
        T = V[:, told] / np.sqrt(eigenvalues[told])  # of unit information
        s = T.T @ (per_block / scale[:, None])
        total = s.sum(1)
        k = int(told.sum())
        statistic = float(total @ total)
        white = float(chdtrc(k, statistic))
        B = s.shape[1]
        # what each block pulls beyond its share of the whole effect, which is not noise
        Z = T.T @ G
        share = np.stack([self._by_block(z * Z) for z in Z])
        centred = s - np.einsum("ijb,j->ib", share, total)
        spread = centred @ centred.T * B / (B - 1)
        robust = 1.0
        if k + 2 < B:
            t2 = float(total @ np.linalg.lstsq(spread, total, rcond=None)[0])
            robust = float(fdtrc(k, B - k, t2 * (B - k) / (k * (B - 1))))
        values = -(T @ total) / scale * self.scale
        return Score(0.5 * statistic, k, max(white, robust), False, values)

    def _flat(self, columns: Array) -> Array:
        """Columns `(number, row, sample)` as the residual is: white, of the rows used, `(number, reading)`."""
        flat = np.zeros((len(columns), len(self.residual)))
        white = self.fitted.colour.whitened(columns) * self.fitted.used
        flat[:, : self.case.rows * self.case.samples] = white.reshape(len(columns), -1)
        return flat

    def _by_block(self, products: Array) -> Array:
        """Sums over blocks of samples, `(column, block)`, of products `(column, reading)`; the last: known before."""
        measured = self.case.rows * self.case.samples
        per_sample = products[:, :measured].reshape(len(products), -1, self.case.samples).sum(1)
        sums = np.add.reduceat(per_sample, self.blocks, axis=1)
        known = products[:, measured:]
        return np.concatenate([sums, known.sum(1, keepdims=True)], 1) if known.shape[1] else sums


def evidence_of(case: Case, fitted: Fitted, memory: float | None = None, within: Fitted | None = None) -> Evidence:
    """The evidence against a fitted model.

    Args:
        case: the data.
        fitted: the model.
        memory: over how many samples noise remembers; from the residual where not given.
        within: a model with more effects: what these do is put back into what it leaves, and is judged in its noise.
            What a model that lacks a large effect takes for noise hides how others differ from that effect.
    """
    used = np.tile(fitted.used, case.rows).astype(float)
    columns = fitted.colour.whitened(_columns(case, fitted)).reshape(-1, used.size) * used
    known = np.flatnonzero(case.precision)
    before = np.zeros((len(columns), len(known)))  # a few more readings, which no candidate changes
    before[known, np.arange(len(known))] = np.sqrt(case.precision[known]) * fitted.residual.scale
    norms = np.linalg.norm(columns, axis=1)
    columns = np.concatenate([columns, before], 1)[norms > 0] / norms[norms > 0, None]
    basis = _orthonormal(columns)
    best, n = within or fitted, float(used.sum())
    residual = _tamed(best.residual.innovations, best.residual.scale).ravel() * used
    rms = np.sqrt(max(np.sum(residual**2) / max(n - best.parameters, 1.0), 1e-300))
    residual = residual / rms
    memory = correlation_length(residual.reshape(case.rows, -1)) if memory is None else memory
    if within:
        more, values = within.physics.part(
            within.values, [effect not in fitted.physics.effects for effect in within.physics.effects]
        )
        done = fitted.colour.whitened(np.tensordot(values, case.columns(more.effects, values), 1)).ravel() * used
        residual = residual - done / (rms * within.residual.scale)
    if case.recording.settings.factory_uncertainty:  # else the prior is a gauge, and no knowledge
        off = np.sqrt(case.precision[known]) * (case.offset + best.moved)[known]
        residual = np.concatenate([residual, off])
    basis = basis[:, : len(residual)]
    blocks, scale = _blocks(case.samples, memory), rms * best.residual.scale
    return Evidence(case, fitted, basis, residual, blocks, n - fitted.parameters, memory, scale)


def colour_left(case: Case, fitted: Fitted) -> Colour:
    """How the noise remembers that a fit leaves; held-out rows, and other runs, are not remembered."""
    used = fitted.used
    begins = np.diff(np.asarray(case.motion.run[0]), prepend=0).astype(bool) | np.diff(used, prepend=True)
    stretch = np.cumsum(begins, dtype=int)
    prior = np.zeros(len(case.precision) + fitted.physics.size)
    prior[: len(case.precision)] = np.sqrt(case.precision) * fitted.residual.scale
    rows = _tamed(fitted.residual.rows, fitted.residual.scale)
    colour = colour_of(rows[:, used], _columns(case, fitted)[..., used], prior, stretch[used])
    return colour if colour is WHITE else replace(colour, starts=stretches(stretch))


def chance(gain: float, size: int, memory: float) -> float:
    """That noise alone gains so much log-likelihood by `size` numbers, of as many samples as forget each other.

    For effects of too many numbers for a test by blocks.
    """
    return float(chdtrc(size, 2 * max(gain, 0.0) / max(memory, 1.0)))


def _columns(case: Case, fitted: Fitted) -> Array:
    """What was fitted: how residuals change with the nuisance and the effects."""
    return np.concatenate([case.nuisance, case.columns(fitted.physics.effects, fitted.values)])


def _tamed(rows: Array, scale: float) -> Array:
    """Residuals `(row, sample)` over the scale, wild samples cut down."""
    rows = rows / scale
    length = np.sqrt(np.sum(rows**2, 0) / len(rows))
    return rows * np.minimum(1.0, WINSOR / np.maximum(length, 1e-300))


def _orthonormal(columns: Array) -> Array:
    """An orthonormal basis `(rank, …)` of rows."""
    if not len(columns):
        return columns
    eigenvalues, V = np.linalg.eigh(columns @ columns.T)
    kept = eigenvalues > 1e-12 * eigenvalues[-1]
    basis = (V[:, kept] / np.sqrt(eigenvalues[kept])).T @ columns
    return np.linalg.qr(basis.T)[0].T


def _blocks(samples: int, memory: float) -> NDArray[np.integer]:
    """Where blocks of neighbouring samples start: longer than what correlates, and enough of them to see a spread."""
    length = max(_LEAST_IN_BLOCK, int(np.ceil(_LENGTHS * memory)))
    count = int(np.clip(samples // length, 4, _MOST_BLOCKS))
    return (np.arange(count) * samples) // count
