"""A motion seen by a sensor, what the sidecar leaves open of it, and how what is seen moves with every number."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from benchmarks.concealed.chain import Array, Poses, rotation_from_rpy, rotation_from_vector, vector_from_rotation
from benchmarks.concealed.plain_physics import COORDINATES, Effects, Hidden, Motion, Setup, poses

_ROUNDS, _HALVINGS = 3, 5  # of Gauss and Newton's method, which starts at the truth
_STEPS = {"m": 1e-5, "rad": 1e-5, "s": 1e-4, "Nm": 1e-6, "K": 1e-6, "kg": 1e-3}


@dataclass(frozen=True, eq=False)
class Reading:
    """What a sensor reads that measures no poses."""

    rows: int  # how many numbers a sample has
    # of poses without noise and its own numbers, readings over their noise `(sample, row)`
    read: Callable[[Poses, Array], Array]
    numbers: Array  # `(number,)`, its own, unknown to whoever reads: places, or the corners of a board
    known: Array  # `(row, number)`, by which what is known of these counts as measured


@dataclass(frozen=True)
class Open:
    """What the sidecar leaves open of a set-up."""

    frame: bool  # whether the sensor's frame is
    tool: int  # how many numbers of the tool are: 0, 3 or 6
    geometry: bool  # whether the chain is
    # m and rad, one standard deviation of each of its numbers where it is known so well; None where not
    prior: tuple[float, float] | None = None
    # rad, one standard deviation of sine and cosine of an error of every joint once a turn; 0 for none
    encoders: float = 0.0

    def size(self, dof: int) -> int:
        """How many numbers those are."""
        return 6 * self.frame + self.tool + 6 * dof * self.geometry

    def moved(self, setup: Setup, x: Array) -> Setup:
        """The set-up with those numbers changed by `x`."""
        chain, sensor, tool = setup.chain, setup.sensor, setup.tool
        if self.frame:
            step, x = x[:6], x[6:]
            sensor = sensor.copy()
            sensor[:3, :3], sensor[:3, 3] = rotation_from_vector(step[3:]) @ sensor[:3, :3], sensor[:3, 3] + step[:3]
        if self.tool:
            step, x = x[: self.tool], x[self.tool :]
            tool = tool.copy()
            tool[:3, 3] += step[:3]
            if self.tool == 6:
                tool[:3, :3] = tool[:3, :3] @ rotation_from_vector(step[3:])
        if self.geometry:
            chain = replace(chain, rows=chain.rows + x.reshape(-1, 6))
        return Setup(chain, sensor, tool, setup.payload_center)


@dataclass(frozen=True, eq=False)
class View:
    """A motion seen by a sensor."""

    setup: Setup  # the arm and the sensor as they are
    open: Open  # what is not known of them
    motion: Motion  # what the arm did
    # m and rad, one standard deviation; rad is None where only positions are measured
    noise: tuple[float, float | None]
    reading: Reading | None = None  # what is measured in place of poses, if anything is

    def thinned(self, most: int) -> tuple["View", NDArray[np.integer]]:
        """So many of the samples at most, each of which counts for those it stands for; and which they are."""
        kept = self.motion.kept(most)
        share = float(np.sqrt(len(kept) / len(self.motion.q)))
        noise = (self.noise[0] * share, None if self.noise[1] is None else self.noise[1] * share)
        return replace(self, motion=self.motion.thinned(most), noise=noise), kept

    def difference(self, a: Poses, b: Poses) -> Array:
        """Whitened numbers `(sample · row,)` by which poses b, or what is read of them, differ from a."""
        if self.reading:
            return (self.reading.read(b, self.reading.numbers) - self.reading.read(a, self.reading.numbers)).ravel()
        parts: list[Array] = [(b[1] - a[1]) / self.noise[0]]
        if self.noise[1]:
            parts.append(vector_from_rotation(np.swapaxes(a[0], 1, 2) @ b[0]) / self.noise[1])
        return np.concatenate(parts, 1).ravel()

    def columns(self, hidden: Effects, place: int) -> Array:
        """`(number, coordinate)`: how one of the hidden effects moves what is seen, where all are as they are."""
        effect = hidden[place]
        values = np.array(effect.values)

        def at(moved: Array) -> Poses:
            return poses(self.setup, (*hidden[:place], effect.sized(moved), *hidden[place + 1 :]), self.motion)

        steps = [_STEPS.get(name.rsplit("_", 1)[-1], 1e-5) for name in coordinates(effect)]
        return self._slopes(lambda a, b: self.difference(at(a), at(b)), values, steps)

    def nuisance(self, hidden: Effects = ()) -> Array:
        """`(number, open)`: what moves with the numbers that are left open, the prior's rows below."""
        size = self.open.size(self.setup.chain.dof)

        def at(x: Array) -> Poses:
            return poses(self.open.moved(self.setup, x), hidden, self.motion)

        found = self._slopes(lambda a, b: self.difference(at(a), at(b)), np.zeros(size), [1e-6] * size)
        if self.open.encoders:
            joints = range(1, self.setup.chain.dof + 1)
            waves = (Hidden("joint_harmonic", f"joint{k}", (0.0, 0.0), {"order": 1.0}) for k in joints)
            found = np.hstack([found, *(self.columns((*hidden, wave), len(hidden)) for wave in waves)])
        if self.reading:
            shown, read, own = poses(self.setup, hidden, self.motion), self.reading.read, self.reading.numbers
            by_own = self._slopes(lambda a, b: (read(shown, b) - read(shown, a)).ravel(), own, [1e-6] * len(own))
            found = np.hstack([found, by_own])
        known = self.prior()
        return np.concatenate([found, known]) if len(known) else found

    def prior(self) -> Array:
        """`(row, open)`: the rows by which what is known beforehand counts as measured."""
        dof, parts = self.setup.chain.dof, []
        if self.open.prior:
            size = self.open.size(dof)
            parts.append(np.eye(size)[size - 6 * dof :] / np.tile(np.repeat(self.open.prior, 3), dof)[:, None])
        elif size := self.open.size(dof):
            parts.append(np.zeros((0, size)))
        if self.open.encoders:
            parts.append(np.eye(2 * dof) / self.open.encoders)
        if self.reading:
            parts.append(self.reading.known)
        return np.asarray(block_diag(*parts)) if parts else np.zeros((0, 0))

    def padded(self, columns: Array) -> Array:
        """Columns with zeros for the prior's rows."""
        known = len(self.prior())
        return np.concatenate([columns, np.zeros((known, columns.shape[1]))]) if known else columns

    def _rows(self) -> int:
        """How many numbers a sample has."""
        return self.reading.rows if self.reading else 6 if self.noise[1] else 3

    def _slopes(self, between: Callable[[Array, Array], Array], x: Array, steps: Sequence[float]) -> Array:
        """`(number, coordinate)`: central differences of whitened numbers `between` two values of all coordinates."""
        found = np.empty((len(self.motion.q) * self._rows(), len(x)))
        for i, step in enumerate(steps):
            move = np.zeros(len(x))
            move[i] = step
            found[:, i] = between(x - move, x + move) / (2 * step)
        return found


def coordinates(effect: Hidden) -> tuple[str, ...]:
    """The names of an effect's numbers; a harmonic's order is one of them where it has three."""
    names = COORDINATES[effect.name][: len(effect.values)]
    return (*names, "order") if effect.name == "joint_harmonic" and len(effect.values) == 3 else names


def reported(effect: Hidden) -> dict[str, float]:
    """An effect's numbers under the names that the library reports."""
    if effect.name != "joint_harmonic":
        return dict(zip(COORDINATES[effect.name], effect.values, strict=False)) | source(effect)
    sine, cosine = effect.values[:2]
    order = effect.values[2] if len(effect.values) == 3 else effect.fixed["order"]
    return {
        "order": order,
        "amplitude_rad": float(np.hypot(sine, cosine)),
        "phase_rad": float(np.arctan2(cosine, sine)),
    }


def reported_slopes(effect: Hidden) -> tuple[tuple[str, ...], Array]:
    """Names of the estimated numbers that are reported, and their derivatives by the effect's own."""
    size = len(effect.values)
    if effect.name != "joint_harmonic":
        return coordinates(effect), np.eye(size)
    sine, cosine = effect.values[:2]
    length = max(float(np.hypot(sine, cosine)), 1e-300)
    J = np.zeros((size, size))
    J[0, :2] = sine / length, cosine / length
    J[1, :2] = -cosine / length**2, sine / length**2
    if size == 3:
        J[2, 2] = 1.0
    return ("amplitude_rad", "phase_rad", "order")[:size], J


def source(effect: Hidden) -> dict[str, float]:
    return {key: value for key, value in effect.fixed.items() if key == "source_joint"}


def transform(rpy: Array, position: Array) -> Array:
    """`(4, 4)` of roll, pitch, yaw and a position."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_from_rpy(*rpy), position
    return T


def oracle(
    view: View, believed: Setup, hidden: Effects, measured: Poses, used: NDArray[np.bool_]
) -> tuple[Setup, Effects]:
    """A least-squares fit that knows the form of the truth and starts there.

    Of the set-up that is `believed`, what is closed is held and a prior is centred there; rows that are `used` are no
    faults.
    """
    size = view.open.size(believed.chain.dof)
    rows = np.repeat(used, 6 if view.noise[1] else 3)

    def missed(x: Array, found: Effects) -> Array:
        shown = poses(view.open.moved(believed, x), found, view.motion)
        numbers = view.difference(measured, shown)[rows]
        return np.concatenate([numbers, view.prior() @ x]) if view.open.prior else numbers

    x, found = _open_difference(view, believed), hidden
    left = missed(x, found)
    for _ in range(_ROUNDS if size or hidden else 0):
        here = replace(view, setup=view.open.moved(believed, x))
        columns = [here.nuisance(found)] if size else []
        columns += [here.padded(here.columns(found, k)) for k in range(len(found))]
        slopes = np.concatenate(columns, 1)
        slopes = slopes[np.concatenate([rows, np.ones(len(slopes) - len(rows), bool)])]
        lengths = np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
        step = -np.linalg.lstsq(slopes / lengths, left)[0] / lengths
        for _ in range(_HALVINGS):
            tried = x + step[:size], _moved(found, step[size:])
            beyond = missed(*tried)
            if beyond @ beyond <= left @ left:
                (x, found), left = tried, beyond
                break
            step = step / 2
    return view.open.moved(believed, x), found


def _moved(hidden: Effects, step: Array) -> Effects:
    moved = []
    for effect in hidden:
        values = np.array(effect.values)
        moved.append(effect.sized(values + step[: len(values)]))
        step = step[len(values) :]
    return tuple(moved)


def _open_difference(view: View, believed: Setup) -> Array:
    """The open numbers by which the true set-up differs from the believed one."""
    x, open_ = [], view.open
    if open_.frame:
        turn = view.setup.sensor[:3, :3] @ believed.sensor[:3, :3].T
        x += [view.setup.sensor[:3, 3] - believed.sensor[:3, 3], vector_from_rotation(turn)]
    if open_.tool:
        x.append(view.setup.tool[:3, 3] - believed.tool[:3, 3])
        if open_.tool == 6:
            x.append(vector_from_rotation(believed.tool[:3, :3].T @ view.setup.tool[:3, :3]))
    if open_.geometry:
        x.append((view.setup.chain.rows - believed.chain.rows).ravel())
    return np.concatenate(x) if x else np.zeros(0)
