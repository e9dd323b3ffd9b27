"""Columns of a recording read otherwise, and another nominal table: what makes a recording fit that does not."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.bundled import VARIANTS, bundled_arms, load_bundled
from lite6jax.domains.pose.screening.projection import estimated
from lite6jax.domains.pose.screening.rigid import Rigid, physics_columns
from lite6jax.fitting.start import frames_from_poses
from lite6jax.recordings import Recording

Array = NDArray[np.floating]

LEVER = 0.1
"""m; a turn counts as much as the displacement of a point this far away."""
GROSS = 0.01
"""Share of the reach that the median misfit must exceed: physics hardly moves an arm so far, a wrong column does."""
GROSS_SIGMA = 10.0
LARGE = 5.0
"""How many times smaller another reading must make the misfit."""
PLAUSIBLE = 0.05
"""Share of the reach that the misfit may have then: what a clock's offset leaves in a fast motion."""
_ALIKE = 1.5
_SCREENED, _SCREENED_PAIRS, _FIRST_OF_PAIRS = 200, 60, 8
_SLACK = 0.01
TRUSTED = float(np.log(300.0))
"""Log-likelihood that it takes to doubt what a sidecar says: of 300 that are right, one."""
_TABLE_AS_IS = 2e-5
"""m and rad within which a factory calibration is a published table and not an arm's own."""


@dataclass(frozen=True)
class Reading:
    """How columns are to be read: joint i is `factor[i]·column[order[i]] + offset[i]`.

    Attributes:
        faults: name of each fault and its words, two where two come together.
        order: of the columns, from 0.
        factor, offset: per joint; rad.
        quaternion: of the recorded components, scalar first, which are the true w, x, y, z.
        inverted: whether the orientation is that of the sensor's frame in the tool's.
    """

    faults: tuple[tuple[str, str], ...]
    order: tuple[int, ...]
    factor: tuple[float, ...]
    offset: tuple[float, ...]
    quaternion: tuple[int, int, int, int] = (0, 1, 2, 3)
    inverted: bool = False

    def then(self, other: "Reading") -> "Reading":
        """This one, and another after it."""
        return Reading(
            (*self.faults, *other.faults),
            tuple(self.order[i] for i in other.order),
            tuple(other.factor[k] * self.factor[i] for k, i in enumerate(other.order)),
            tuple(other.factor[k] * self.offset[i] + other.offset[k] for k, i in enumerate(other.order)),
            self.quaternion if other.quaternion == (0, 1, 2, 3) else other.quaternion,
            self.inverted != other.inverted,
        )

    @property
    def words(self) -> str:
        return " and ".join(words for _, words in self.faults)

    def joints(self, position: Array) -> Array:
        """The joint positions `(sample, joint)`."""
        return position[:, list(self.order)] * np.array(self.factor) + np.array(self.offset)

    def rotations(self, quaternion: Array) -> Array:
        """The measured orientations `(sample, 3, 3)`."""
        w, *vector = (quaternion[:, i] for i in self.quaternion)
        R = Rotation.from_quat(np.stack([*vector, w], 1)).as_matrix()
        return np.swapaxes(R, 1, 2) if self.inverted else R

    def recording(self, recording: Recording) -> Recording:
        """The recording read so: velocities, directions and what else is per joint go with the positions."""
        order, factor = list(self.order), np.array(self.factor)
        changed = {"joint_position": self.joints(recording.joint_position)}
        changed["direction_of_motion"] = recording.direction_of_motion[:, order] * np.sign(factor)
        if recording.joint_velocity is not None:
            changed["joint_velocity"] = recording.joint_velocity[:, order] * factor
        for name in ("joint_torque", "motor_current"):
            column = getattr(recording, name)
            if column is not None:
                changed[name] = column[:, order] * np.sign(factor)
        if recording.joint_temperature is not None:
            changed["joint_temperature"] = recording.joint_temperature[:, order]
        if recording.quaternion is not None:
            turned = Rotation.from_matrix(self.rotations(recording.quaternion)).as_quat()
            unit = np.roll(turned, 1, axis=1)
            leading = np.argmax(np.abs(np.sign(unit)), axis=1)
            changed["quaternion"] = unit * np.sign(unit[np.arange(len(unit)), leading, None])
        return replace(recording, **changed)


class Reread(NamedTuple):
    """What trying other readings gave.

    Attributes:
        misfit: m, the median with the columns as they are.
        gross: m above which others are tried.
        reading: the one to be used; None where the columns are to be left.
        left: m, the median misfit of the best other reading, fitted; None where none was tried.
        alike: words of those that cannot be told from it.
    """

    misfit: float
    gross: float
    reading: Reading | None = None
    left: float | None = None
    alike: tuple[str, ...] = ()


def readings(dof: int, orientation: bool) -> Iterator[Reading]:
    """Every single other reading, the simplest first."""
    same = Reading((), tuple(range(dof)), (1.0,) * dof, (0.0,) * dof)

    def with_joint(values: tuple[float, ...], joint: int, value: float) -> tuple[float, ...]:
        return (*values[:joint], value, *values[joint + 1 :])

    for i, j in combinations(range(dof), 2):
        order = list(same.order)
        order[i], order[j] = j, i
        words = f"joints {i + 1} and {j + 1} exchanged"
        yield replace(same, faults=(("swapped_joints", words),), order=tuple(order))
    for i in range(dof):
        words = f"joint {i + 1} with its sign reversed"
        yield replace(same, faults=(("mirrored_joint", words),), factor=with_joint(same.factor, i, -1.0))
    for i in range(dof):
        for factor, words in (
            (np.pi / 180, "in degrees"),
            (180 / np.pi, "in radians though the others are in degrees"),
        ):
            fault = ("joint_unit", f"joint {i + 1} {words}")
            yield replace(same, faults=(fault,), factor=with_joint(same.factor, i, factor))
    if orientation:
        for quaternion, inverted, words in (
            ((0, 1, 2, 3), True, "inverted orientations"),
            ((3, 0, 1, 2), False, "quaternions with the scalar last"),
            ((3, 0, 1, 2), True, "inverted quaternions with the scalar last"),
        ):
            fault = ("orientation_convention", words)
            yield replace(same, faults=(fault,), quaternion=quaternion, inverted=inverted)
    for i in range(dof):
        for quarters in (2, -2, 1, -1):
            away = "half a turn" if abs(quarters) == 2 else f"{90 * quarters:+d}°"
            fault = ("joint_turns", f"joint {i + 1} with its zero {away} away")
            yield replace(same, faults=(fault,), offset=with_joint(same.offset, i, quarters * np.pi / 2))


def reread(arm: Rigid) -> Reread:
    """The reading of the columns with which a recording fits, where as they stand it misses grossly.

    All are screened on some rows of the nominal arm, frames in closed form; the best are fitted, and must leave a fifth
    of the misfit at most, and be likelier than a fit as they stand. Pairs are tried where no single one does.

    Args:
        arm: not fitted yet, of a recording with poses.
    """
    gross = max(GROSS * arm.arm.reach, GROSS_SIGMA * arm.noise[0])
    screen = _Screen(arm, _SCREENED)
    misfit = screen.misfit(None)
    if misfit <= gross:
        return Reread(misfit, gross)
    limit = min(misfit / LARGE, PLAUSIBLE * arm.arm.reach)
    singles = list(readings(arm.recording.dof, arm.rows == 6))
    tried = [(screen.misfit(one), one) for one in singles]
    if min(tried, key=lambda item: item[0])[0] > 2 * limit:
        few = _Screen(arm, _SCREENED_PAIRS)
        first = [one for _, one in sorted(tried, key=lambda item: item[0])[:_FIRST_OF_PAIRS]]
        pairs = {tuple(sorted(map(singles.index, (a, b)))) for a in first for b in singles if not _overlap(a, b)}
        tried = [(few.misfit(pair), pair) for pair in (singles[a].then(singles[b]) for a, b in sorted(pairs))]
    best = sorted(tried, key=lambda item: item[0])[:8]
    near = [reading for left, reading in best if left <= max(2 * limit, 3 * best[0][0])]
    fits = [(_median_misfit(_read(arm, reading).fitted()), k, reading) for k, reading in enumerate(near)]
    least = min(fits)[0]
    if least > limit:
        return Reread(misfit, gross, left=least)
    alike = [item for item in fits if item[0] <= max(_ALIKE * least, least + 0.1 * arm.noise[0])]
    rank = {reading: k for k, reading in enumerate(singles)}
    inside = [(_outside(arm, reading), rank.get(reading, 0), k) for k, (_, _, reading) in enumerate(alike)]
    chosen = alike[min(inside)[-1]][2]
    # a chain that is not known may be further from its table than is gross, and fit as the columns stand
    read, stands = _read(arm, chosen).fitted(), arm.fitted()
    scale = min(read.scale, stands.scale)
    if read.log_likelihood(scale) < stands.log_likelihood(scale) + TRUSTED:
        return Reread(_median_misfit(stands), gross)
    others = [reading for _, _, reading in alike if reading is not chosen]
    words = dict.fromkeys(reading.words for reading in others if not _a_turn_away(reading, chosen))
    return Reread(misfit, gross, chosen, least, tuple(words))


class OtherTable(NamedTuple):
    """How a nominal table compares with another of the same model.

    Attributes:
        name: of the other arm; None where there is none, or the chain is the arm's own.
        share: of the way from the declared table to the other at which the data lie, and its standard deviation; None
            where the chain is fitted.
        scales: of the residual with the declared table, the other and a fitted chain; None where it is not fitted.
        decided: whether the data are the other's.
        likelier: whether they are likelier with the other, if no physics is at work.
    """

    name: str | None
    share: tuple[float, float] | None = None
    scales: tuple[float, float, float] | None = None
    decided: bool = False
    likelier: bool = False


def other_table(arm: Rigid) -> OtherTable:
    """Whether the data are of another table of the same model than the one declared.

    Where the chain is declared and is a published table, one number along the line to the other table is estimated with
    all physics beside it; where that leaves it vague, the other table must halve the residuals. Where the chain is
    fitted, the other table must be likelier than the declared one, and than a fitted chain for so many more numbers.

    Args:
        arm: fitted.
    """
    tables = [load_bundled(name) for name in _family(arm.arm.name)]
    declared = [t for t in tables if np.abs(t.links - arm.links).max() < _TABLE_AS_IS] if arm.exact else [arm.arm]
    others = [t for t in tables if declared and t.name != declared[0].name]
    if not others:
        return OtherTable(None)
    other = others[0]
    if arm.exact:
        between = np.zeros((len(arm.links) + 1, 6))
        for k, (link, there) in enumerate(zip(arm.links, other.links, strict=True)):
            T = there @ np.linalg.inv(link)
            between[k] = np.concatenate([T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_rotvec()])
        column = np.einsum("k,krs->rs", between.ravel(), arm.twists)[None]
        share, std = (float(value[0]) for value in estimated(arm, physics_columns(arm, skip=("links",)), column))
        rival = _with_table(arm, other).fitted()
        clear = std < 0.1 or rival.scale < 0.5 * arm.scale
        told = clear and abs(share - 1) < 0.1 + 4 * std and share > 6 * std
        return OtherTable(other.name, (share, std), decided=told, likelier=rival.scale < arm.scale)
    ours, theirs = (_with_table(arm, table).fitted() for table in (arm.arm, other))
    numbers = len(arm.unknown) - len(theirs.unknown)
    fitted = arm.log_likelihood(arm.scale) - 0.5 * numbers * np.log(arm.rows * arm.samples)
    likely = theirs.log_likelihood(arm.scale)
    told = likely > max(fitted, ours.log_likelihood(arm.scale) + TRUSTED)
    return OtherTable(other.name, scales=(ours.scale, theirs.scale, arm.scale), decided=told)


def with_table(recording: Recording, name: str) -> tuple[Recording, Arm]:
    """The recording with another bundled arm named, and no factory calibration, as that was no arm's own; the arm."""
    settings = replace(recording.settings, factory_calibration=None, factory_uncertainty=None)
    if not settings.arm_is_file:
        settings = replace(settings, arm=name)
    return replace(recording, settings=settings), load_bundled(name)


@dataclass(frozen=True, eq=False)
class _Screen:
    """The nominal arm with some rows of a recording."""

    arm: Rigid
    count: int

    def misfit(self, reading: Reading | None) -> float:
        """m, the median with frames in closed form."""
        arm = self.arm.select(np.unique(np.linspace(0, self.arm.samples - 1, self.count).astype(int)))
        return _median_misfit(arm if reading is None else _read(arm, reading))


def _read(arm: Rigid, reading: Reading) -> Rigid:
    """With the columns read otherwise, and frames in closed form."""
    recording, dof = reading.recording(arm.recording), arm.recording.dof
    flange = frames.chain(arm.links, recording.joint_position) @ arm.arm.T_joint_flange
    assert recording.position is not None
    rotation = None if recording.quaternion is None else Rotation.from_quat(np.roll(recording.quaternion, -1, 1))
    free_frame = recording.settings.pose_frame != "base"
    free_tool = recording.settings.tool == "unknown"
    known_tool = np.linalg.inv(arm.arm.T_joint_flange) @ arm.T_flange_tool
    T_frame, T_tool = frames_from_poses(
        flange,
        recording.position,
        None if rotation is None else rotation.as_matrix(),
        None if free_frame else arm.T_sensor_base,
        None if free_tool else known_tool,
    )
    assert dof == len(arm.links)
    return replace(arm, recording=recording, T_sensor_base=T_frame, T_flange_tool=arm.arm.T_joint_flange @ T_tool)


def _median_misfit(arm: Rigid) -> float:
    return float(np.median(np.hypot(arm.distance, LEVER * arm.turn)))


def _outside(arm: Rigid, reading: Reading) -> int:
    """How many joint positions a reading puts outside the limits."""
    q, (low, high) = reading.joints(arm.recording.joint_position), arm.arm.joint_limits.T
    return int(np.sum((q < low - _SLACK) | (q > high + _SLACK)))


def _a_turn_away(a: Reading, b: Reading) -> bool:
    """Whether two readings differ by whole turns of joints."""
    turns = (np.array(a.offset) - np.array(b.offset)) / (2 * np.pi)
    return replace(a, offset=b.offset, faults=b.faults) == b and bool(np.allclose(turns, np.round(turns)))


def _overlap(a: Reading, b: Reading) -> bool:
    """Whether two readings change the same columns."""
    return bool(_touched(a) & _touched(b))


def _touched(reading: Reading) -> set[int]:
    changed = zip(reading.order, reading.factor, reading.offset, strict=True)
    joints = {i for i, (order, factor, offset) in enumerate(changed) if (order, factor, offset) != (i, 1.0, 0.0)}
    return joints or {-1}


def _family(name: str) -> list[str]:
    """The bundled tables of a model."""
    model = name.split("_")[0]
    return [other for other in bundled_arms() if other == model or (other in VARIANTS and other.startswith(model))]


def _with_table(arm: Rigid, table: Arm) -> Rigid:
    """With a chain that is not fitted, the sensor's frame and the tool as far as they are free."""
    frame = arm.recording.settings.pose_frame != "base"
    last = 6 * arm.recording.dof
    kept = (arm.unknown >= last) | ((arm.unknown < 6) & frame)
    none = np.zeros(int(kept.sum()))
    T = arm.T_sensor_base if frame else np.eye(4)  # where it is known, it moved as the first link's
    return replace(arm, links=table.links, T_sensor_base=T, unknown=arm.unknown[kept], precision=none, offset=none)


__all__ = ["OtherTable", "Reading", "Reread", "other_table", "readings", "reread", "with_table"]
