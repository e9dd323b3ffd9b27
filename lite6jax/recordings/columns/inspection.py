"""What a table with column names of its own holds: it is read as a whole.

Names give candidates for each quantity, units in names bind, and numbers may object. Of what is left open the arm's
kinematics decide where one is known or recognised, and sizes elsewhere. What none decides is left to the caller. The
words are those of `report.inspection`, but for why a motion is one.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, final

import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.arms.description import bundled_of
from lite6jax.arms.factory import RECOGNISED_WITHIN
from lite6jax.array_types import Array
from lite6jax.errors import InputError
from lite6jax.recordings import streams
from lite6jax.recordings.alignment import computed_by_controller, digit_step, median_distance
from lite6jax.recordings.columns import sizes
from lite6jax.recordings.columns.cells import Words, is_label, write_whole
from lite6jax.recordings.columns.column import (
    COMMANDS,
    DEVIATION,
    FORMS,
    IGNORED,
    KINDS,
    MATRIX,
    PLACE,
    Block,
    Column,
    Decision,
    by_name,
    differs_by_joint,
    in_si,
    is_per_joint,
    list_columns,
    units_allowed,
    units_of,
)
from lite6jax.recordings.columns.documented import (
    is_refused,
    is_standard,
    known_column,
    list_names,
    nearest_known,
    reading_of,
)
from lite6jax.recordings.columns.kinematics import CLEARLY, CLOSE, ArmAgreement, agreement, decide, motion_of
from lite6jax.recordings.columns.names import (
    Role,
    Source,
    candidate_blocks,
    choose_blocks,
    of_whom,
    pose_sources,
    reading_words,
    source_words,
    tells_of_commands,
    unit_of,
)
from lite6jax.recordings.columns.orientations import is_no_rotation, quaternions

ALIKE = 2.0
"""Times the error of the best arm, within which another one is as likely, as in `calibration.source`."""
WIDEST_ANGLE = 1e3
"""Beyond, numbers are no angles of an orientation, unless they are whole ones of a unit of `FINE`."""
WIDEST_WHOLE = 4e6
"""Beyond, they are none in any unit."""
BEYOND = 1e100
"""No quantity is as large: such numbers are read as missing here, and refused or dropped by what reads the table."""
SENSORS = ("laser_tracker", "motion_capture", "camera")
"""The values of `pose_source` of what was measured."""


class Pose(NamedTuple):
    """A pose of the table by one source, as an arm agrees with it best.

    Attributes:
        blocks: its position, and its orientation where it has one.
        role: whose it is by its name, or the controller's where it is computed.
        arm: the given one, or the bundled one that clearly fits best; None where several do.
        agreements: of the arms that were tried, the nearest first.
        agreed: the units and the form with which the arm agrees, and the median error of its positions.
        travel: the largest extent of its positions along an axis, in their unit.
        computed: whether the arm reproduces it as exactly as only the controller's own computation.
        taken: whether it is the one that the table is read with.
    """

    blocks: tuple[Block, ...] = ()
    role: Role | None = None
    arm: Arm | None = None
    agreements: Sequence[tuple[Arm, ArmAgreement]] = ()
    agreed: ArmAgreement = ArmAgreement()
    travel: float = 0.0
    computed: bool = False
    taken: bool = False

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the position and the orientation."""
        return tuple(name for block in self.blocks for name in block.columns)

    @property
    def error(self) -> float:
        """m, the median error of the positions by the nearest arm; infinite where none was tried or rows are few."""
        return self.agreed.error

    def to_dict(self) -> dict[str, Any]:
        """As JSON values, of which the error may be infinite."""
        return {
            "columns": self.columns,
            "role": self.role,
            "error": self.error,
            "computed": self.computed,
            "taken": self.taken,
        }


@final
@dataclass(frozen=True)
class Inspection:
    """What a table holds.

    Attributes:
        blocks: that were recognised, with their units and forms.
        given: columns whose meaning was given.
        unused: columns of numbers that mean nothing here, and `texts` those without numbers.
        denied: columns that are called a time or a quaternion and whose values are not one, with which of the two.
        samples: rows.
        arm: given or recognised; None where it is neither.
        arms: name and error in m of each arm that was tried, the nearest first: the given one, or the bundled ones.
        error: m, the median error of the arm as read; infinite where there is none, or no poses.
        motion: `static` or `trajectory`, and why in words.
        sources: the poses; where several are possible and none is taken, the caller is to choose.
        motors: groups of joint positions of which nothing says which are the arm's; empty where that is clear.
        in_file: of columns that are called otherwise in the file, their names there.
        announced: columns of `given` that are readings as `pose_source` says, a block each, of a kind of reading.
        likely_readings: where `pose_source` does not say of readings, what it would say, of which column, and what that
            would be.
        unclear_deviations: columns of deviations from positions of which nothing says that they are nominal.
        unread_commands: groups of columns that are commands by name and are not read, each with why: `not_followed`
            of positions, `velocities`, `torques`.
    """

    blocks: tuple[Block, ...]
    given: Mapping[str, str]
    unused: tuple[str, ...]
    texts: tuple[str, ...]
    denied: Mapping[str, str]
    samples: int
    arm: Arm | None
    arms: tuple[tuple[str, float], ...]
    error: float
    motion: tuple[str, str]
    sources: tuple[Pose, ...]
    motors: tuple[tuple[str, ...], ...] = ()
    in_file: Mapping[str, str] = field(default_factory=dict)
    announced: tuple[Block, ...] = ()
    likely_readings: tuple[tuple[str, str, str], ...] = ()
    unclear_deviations: tuple[str, ...] = ()
    unread_commands: tuple[tuple[str, tuple[str, ...]], ...] = ()

    @property
    def columns(self) -> dict[str, str]:
        """The sidecar's `columns`, by their names in the file; empty where every name is one of a recording already."""
        pairs = [pair for block in self.blocks for pair in block.renamed().items()]
        given_quantities = {name.partition("_")[0] for name in self.given.values()}
        meanings = {
            column: IGNORED if name.partition("_")[0] in given_quantities else name for column, name in pairs
        } | dict(self.given)
        unused = {name: IGNORED for name in self.texts if not is_standard(name)}
        read = [name for name in self.unused if (parsed := known_column(name)) and parsed.quantity != "missing"]
        unused |= {name: IGNORED for name in self.unused if name in read or not is_standard(name)}
        needed = read or any(column != name for column, name in meanings.items()) or any(map(is_refused, unused))
        needed = needed or bool(self.in_file)
        return (
            {self.in_file.get(column, column): name for column, name in (meanings | unused).items()} if needed else {}
        )

    @property
    def readings(self) -> tuple[str, ...]:
        """The kinds of readings that its columns hold."""
        return tuple(dict.fromkeys(kind for name in self.given.values() if (kind := reading_of(name))))

    @property
    def undecided(self) -> bool:
        """Tells whether there are several poses and none is taken."""
        return bool(self.sources) and not any(source.taken for source in self.sources)

    @property
    def computed(self) -> bool:
        """Tells whether the poses that are taken are the controller's own computation."""
        return any(source.taken and source.computed for source in self.sources)

    @property
    def joint_columns(self) -> tuple[str, ...]:
        """The names of the joint positions in a recording, along the arm: `q1_deg`, `q2_mm`."""
        members = [column for block in self.blocks if block.kind == "q" for column in block.members]
        return tuple(column.documented for column in sorted(members, key=lambda column: column.joint))

    def holds(self, quantity: str) -> bool:
        """Tells whether a column holds a quantity, as recognised or as given."""
        recognised = [column.quantity for block in self.blocks for column in block.members]
        given = [column.quantity for name in self.given.values() if (column := known_column(name))]
        return quantity in (*recognised, *given)

    def of(self, kind: str) -> Block | None:
        """The block of a kind: of revolute joints where there are some."""
        return next((block for block in self.blocks if block.kind == kind), None)

    def to_dict(self) -> dict[str, Any]:
        """As JSON values, of which some numbers may be infinite; the reasons are codes."""
        return {
            "columns": self.columns,
            "blocks": [block.to_dict() for block in self.blocks],
            "unused": [*self.unused, *self.texts],
            "denied": dict(self.denied),
            "samples": self.samples,
            "arm": None if self.arm is None else self.arm.name,
            "arms_m": dict(self.arms),
            "motion": self.motion[0],
            "poses": [source.to_dict() for source in self.sources],
        }


def inspect(
    columns: Sequence[tuple[str, Array | None]],
    arm: Arm | None = None,
    given: Mapping[str, str] | None = None,
    source: str = "recording",
    pose_source: str | None = None,
    motion: str | None = None,
    assumed: Collection[str] = (),
    words: Mapping[str, Words] | None = None,
) -> Inspection:
    """What a table holds.

    Args:
        columns: names, and `(sample,)` numbers; None where a column holds none.
        arm: whose recording it is; where not given, every bundled one of as many joints is tried.
        given: columns with the names that they have in a recording, where the caller knows better; or `IGNORED`.
        source: what messages begin with.
        pose_source: what measured the poses, as in a sidecar; of several poses it decides which are taken.
        motion: where it is known.
        assumed: columns whose unit is stated by nothing but a name that the reader of the file gave them; it is decided
            as if no name stated it.
        words: of the columns of text.

    Raises:
        InputError: a column that is given is not there, there are no rows, or rows of poses are at no known joints.
    """
    given = dict(given or {})
    samples = max((len(values) for _, values in columns if values is not None), default=1)
    if not samples:
        raise InputError(f"{source}: has column names but no rows; record again")
    numbers = {
        name: np.where(np.abs(values) < BEYOND, values, np.nan) for name, values in columns if values is not None
    }
    numbers = {name: values for name, values in numbers.items() if np.isfinite(values).any()}
    texts = tuple(name for name, values in columns if values is None)
    for name in given:
        if name not in dict(columns):
            raise InputError(f"{source}: has no column {name[:60]!r}; {near(name, list(dict(columns)))}")
    if not any(block.kind == "position" for block in candidate_blocks([*numbers], ())):
        given = {name: name for name, _ in columns if reading_of(name)} | given
    free = [name for name in numbers if given.get(name) != IGNORED]
    joint_names, dof = ((), None) if arm is None else (arm.joint_names, arm.dof)
    possible, denied = _possible(candidate_blocks(free, joint_names), numbers)
    declared = {
        name: column for name, meaning in given.items() if name in numbers and (column := known_column(meaning))
    }
    slots = {(column.quantity, column.joint): column._replace(name=name) for name, column in declared.items()}
    said_joints = [column.name for column in slots.values() if column.quantity == "q"]
    chosen = choose_blocks(possible, dof, said_joints)
    blocks = _of_given_motors(_merge_given(chosen, slots, dof), chosen)
    all_joints = next((block for block in blocks if block.kind == "q"), None)
    blocks = _split_by_joint(blocks, declared, arm)
    unsaid = {*assumed} - given.keys()
    blocks = [replace(block, unit=None) if {*block.columns} <= unsaid else block for block in blocks]
    joints = {name for block in blocks for name in block.columns}
    poses = _merge_given_poses([block for block in possible if not joints & set(block.columns)], slots)
    possible_sources = {block.source for block in poses if block.kind == "position"}
    lost = {
        block.source for block in candidate_blocks([*numbers], joint_names) if block.kind == "position"
    } - possible_sources
    poses = [block for block in poses if block.kind == "position" or block.source not in lost]
    numbers = _with_held_commands(_at_poses(numbers, [*blocks, *poses], source), blocks, source)
    poses = _without_differences(poses, numbers)
    declared_deviations = {name for name, column in declared.items() if column.quantity in DEVIATION}
    at_times = any(block.kind == "time" for block in blocks)
    read = []
    unclear = []
    for pose in pose_sources(poses):
        read.append(_read_pose(pose, blocks, numbers, arm))
        if (deviation := pose.deviation) is None:
            continue
        nominal = pose.position.rank == 2 or (read[-1].computed and not at_times)
        if nominal or declared_deviations >= {*deviation.columns}:
            read[-1] = _read_sum(pose.position, deviation, read[-1], blocks, numbers, arm)
        elif not _read_sum(pose.position, deviation, read[-1], blocks, numbers, arm, sign=-1.0).computed:
            unclear += deviation.columns
    read = [pose for pose in read if pose.travel > 0] or read
    selected = _choose_pose(read, pose_source)
    if selected is not None:
        best_pose = read[selected]
    elif read:
        best_pose = Pose(arm=read[0].arm)
    else:
        best_pose = Pose(arm=arm)
    nearest = min((pose.agreed for pose in read), key=lambda candidate: candidate.error, default=ArmAgreement())
    of_joints = {of: unit for of, unit in nearest.units.items() if of[0] == "q"}
    agreed = best_pose.agreed._replace(units={**of_joints, **best_pose.agreed.units})
    if any(block.kind == "rotation" and given.keys() >= {*block.columns} for block in best_pose.blocks):
        units = {of: unit for of, unit in agreed.units.items() if of[0] != "rotation"}
        agreed = agreed._replace(units=units, form=None)
    blocks += best_pose.blocks
    decided = decide(blocks, numbers, agreed, arm)
    used = {name for block in blocks if block.kind not in COMMANDS for name in block.columns} | given.keys()
    used |= {name for block in decided for name in block.columns}
    announced: tuple[Block, ...] = ()
    likely: list[tuple[str, str, str]] = []
    if not read and not any(map(reading_of, given.values())):
        unread = {name: values for name, values in numbers.items() if name not in used}
        cells = {name: column_words for name, column_words in (words or {}).items() if name not in given}
        if pose_source is not None and pose_source in READINGS_OF:
            announced = _readings(pose_source, unread, cells)
        else:
            called = [(of, reading) for of in READINGS_OF for reading in _readings(of, unread, cells, only_called=True)]
            likely = [(of, reading.columns[0], reading.kind) for of, reading in called]
        for reading in announced:
            given |= reading.renamed()
        used |= given.keys()
    return Inspection(
        blocks=decided,
        given=given,
        unused=tuple(name for name, values in columns if values is not None and name not in used),
        texts=tuple(name for name in texts if name not in given),
        denied={name: why for name, why in denied.items() if name not in used},
        samples=samples,
        arm=best_pose.arm,
        arms=tuple((candidate.name, agreement.error) for candidate, agreement in best_pose.agreements),
        error=best_pose.error,
        motion=(motion, "as given") if motion else motion_of(decided, numbers),
        sources=tuple(pose._replace(taken=place == selected) for place, pose in enumerate(read)),
        motors=() if dof is None or all_joints is None else _motors(all_joints, dof, possible, numbers, decided),
        announced=announced,
        likely_readings=tuple(likely),
        unclear_deviations=tuple(unclear),
        unread_commands=_unread_commands(chosen, possible, decided, given.values()),
    )


def _unread_commands(
    chosen: Sequence[Block], possible: Sequence[Block], decided: Sequence[Block], declared_names: Collection[str]
) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Columns that are commands by name and are not read, with why, where no other commands are read."""
    joints = next((block.columns for block in decided if block.kind == "q"), ())
    declared = [known_column(name) for name in declared_names]
    if not joints or any(block.kind in COMMANDS for block in decided):
        return ()
    if any(column is not None and column.quantity in COMMANDS for column in declared):
        return ()
    unread = [("not_followed", block.columns) for block in chosen if block.kind == "cmd"]
    groups = [block.columns for block in possible if block.kind == "tau" and block.rank == 2]
    unread += [("torques", columns) for columns in groups if len(columns) >= len(joints)]
    return tuple(unread)


READINGS_OF: Mapping[str, tuple[str, ...]] = {
    "touch": ("contact", "plane"),
    "draw_wire": ("distance",),
    "height_gauge": ("axis",),
}
"""What is read by what measures no poses, by `pose_source`."""


def _readings(
    pose_source: str, numbers: Mapping[str, Array], words: Mapping[str, Words], only_called: bool = False
) -> tuple[Block, ...]:
    """The columns that are readings of a source, a block each: those that are called so, or the only ones that may be.

    Args:
        pose_source: of `READINGS_OF`.
        numbers: columns that mean nothing else, `(sample,)` each.
        words: of the columns of text.
        only_called: whether only those are wanted that are called so.

    Returns:
        none where several columns may be meant.
    """
    kinds = READINGS_OF[pose_source]
    labels = {name: [*cells] for name, cells in words.items()}
    labels |= {name: write_whole(values) for name, values in numbers.items() if is_label(name)}
    labels = {name: cells for name, cells in labels.items() if 2 * len({*cells} - {""}) <= len(cells) and any(cells)}
    if pose_source == "touch":
        possible = [*labels]
    else:
        possible = [name for name, values in numbers.items() if np.nanmax(values) > np.nanmin(values)]
        possible = [name for name in possible if unit_of(name) in (None, *units_of(kinds[0]))]
    called = [name for name in possible if reading_words(name) & {*kinds}]
    chosen = called
    if not called and not only_called:
        chosen = possible
    if len(chosen) != 1:
        return ()
    name = chosen[0]
    if pose_source == "touch":
        is_plane = reading_words(name) & {*kinds} == {"plane"}
        return (Block("plane" if is_plane else "contact", (name,)),)
    stated = unit_of(name)
    unit = by_name(stated) if stated else sizes.length_unit(numbers[name][:, None])
    readings = (Block(kinds[0], (name,), unit),)
    anchors = [label for label in labels if "anchor" in reading_words(label)]
    if kinds == ("distance",) and len(anchors) == 1:
        readings += (Block("anchor", (anchors[0],)),)
    return readings


def _motors(
    joints: Block,
    dof: int,
    possible: Sequence[Block],
    numbers: Mapping[str, Array],
    decided: Sequence[Block],
) -> tuple[tuple[str, ...], ...]:
    """Groups of joint positions of which any may be the arm's: too many columns, or several blocks."""
    if len(joints.columns) > dof + 1:  # one more is a gripper's
        return (joints.columns,)
    q, *mixed = (block for block in decided if block.kind == "q")
    if mixed:
        return ()
    position = q.in_si(numbers)
    rivals = [
        block.columns
        for block in possible
        if block.kind == "q"
        and block.columns[0] in joints.rivals
        and len(block.columns) == len(joints.columns)
        and sizes.unit_of_command(block.values(numbers)[:, :dof], position, q.slides) is None
    ]
    return (joints.columns, *rivals) if rivals else ()


def _at_poses(numbers: dict[str, Array], blocks: Sequence[Block], source: str) -> dict[str, Array]:
    """The rows with poses, where joints and poses stand in different rows: the joints are interpolated there."""
    joints = list_columns(blocks, "q")
    time = next(iter(list_columns(blocks, "time")), "")
    for position in (block.columns for block in blocks if block.kind == "position"):
        try:
            if (merged := streams.merge(numbers, joints, position, time, [])) is not None:
                return merged[0]
        except InputError as error:
            raise InputError(f"{source}: {error}") from error
    return numbers


def _with_held_commands(numbers: dict[str, Array], blocks: Sequence[Block], source: str) -> dict[str, Array]:
    """The rows with joints, where commands stand in other rows: each is held until the next."""
    joints, time, run = (list_columns(blocks, kind) for kind in ("q", "time", "run"))
    commands = [name for kind in COMMANDS for name in list_columns(blocks, kind)]
    if not time:
        return numbers
    of_run = {"run": numbers[run[0]]} if run else {}
    try:
        held = streams.hold_commands(numbers | of_run, joints, commands, time[0], [])
    except InputError as error:
        raise InputError(f"{source}: {error}") from error
    return numbers if held is None else {name: held[0][name] for name in numbers}


def poses_of(roles: Sequence[Role | None], pose_source: str | None) -> list[int]:
    """Which of several poses may be of a source: those of its name, else those that do not say whose they are."""
    indices = [*range(len(roles))]
    if pose_source in SENSORS:
        role = "sensor"
    elif pose_source == "controller_fk":
        role = "controller"
    else:
        return indices
    of_role, open_ = ([k for k in indices if roles[k] == of] for of in (role, None))
    return of_role or open_ or indices


def near(name: str, names: Sequence[str]) -> str:
    """What may be meant by a name that a table does not have."""
    present = f"it has {list_names(names)}"
    nearest = nearest_known(name)
    if nearest is None:
        return present
    return f"write COLUMN=MEANING, such as joint_1={nearest}; {present}"


def _possible(blocks: Sequence[Block], numbers: Mapping[str, Array]) -> tuple[list[Block], dict[str, str]]:
    """The blocks to which the numbers do not object, and of the others the times and quaternions by name."""
    run: Array | None = None
    unit_length: set[tuple[str, ...]] = set()
    possible: list[Block] = []
    denied: dict[str, str] = {}
    for block in sorted(blocks, key=lambda block: block.kind not in ("run", "rotation")):
        names = block.matrix or block.columns
        step = 1
        if block.kind not in ("run", "time"):
            step = max(len(numbers[names[0]]) // _ENOUGH, 1)
        values = np.stack([numbers[name][::step] for name in names], 1)
        if block.kind == "run":
            right = sizes.in_whole_numbers(values)
            if right and run is None:
                run = values[:, 0]
        elif block.matrix:
            right = _matrix(values)
        elif block.kind == "rotation" and len(block.columns) == 4:
            right = sizes.has_unit_length(values)
            if right:
                unit_length.add(block.columns)
        elif block.kind == "rotation":
            widest = WIDEST_WHOLE if sizes.in_whole_numbers(values) else WIDEST_ANGLE
            right = bool(np.nanmax(np.abs(values), initial=0.0) < widest)
        else:
            right = block.kind != "time" or sizes.increases(values[:, 0], run)
            right = right and not (block.kind == "q" and block.columns in unit_length)
        if right:
            possible.append(block)
        elif block.kind == "time":
            denied |= dict.fromkeys(block.columns, "time")
        elif len(block.columns) == 4 and block.kind == "rotation" and not block.weak:
            denied |= dict.fromkeys(block.columns, "quaternion")
    return [block for block in blocks if block in possible], denied


def _matrix(entries: Array) -> bool:
    """Tells whether rows of 9, 12 or 16 numbers are poses, but for a few."""
    M = sizes.complete_rows(entries)
    M = M.reshape(len(M), *{9: (3, 3), 12: (3, 4), 16: (4, 4)}[entries.shape[1]])
    wrong = is_no_rotation(M[:, :3, :3].reshape(-1, 9))
    if M.shape[1] == 4:
        wrong |= (np.abs(M[:, 3] - [0, 0, 0, 1]) > 1e-6).any(1)
    return bool(len(M)) and float(np.mean(wrong)) < 0.1


_ENOUGH = 5000
"""Rows that show whether numbers are quaternions or rotations."""
_Slots = Mapping[tuple[str, int], Column]
"""The columns that are given, by quantity and joint."""


def _merge_given(blocks: Sequence[Block], slots: _Slots, dof: int | None) -> list[Block]:
    """With the given columns in their places, of all but poses; those of all joints replace the others."""
    by_kind = {block.kind: block for block in blocks}
    given_names = {column.name for column in slots.values()}
    for kind in {quantity for quantity, _ in slots} & set(KINDS):
        by_joint = {column.joint: column.name for column in slots.values() if column.quantity == kind}
        first = int(is_per_joint(kind))
        before = {}
        if kind in by_kind:
            before = dict(enumerate(by_kind[kind].columns, first))
        columns = {joint: name for joint, name in before.items() if name not in given_names} | by_joint
        contiguous = sorted(by_joint) == [*range(first, first + len(by_joint))]
        if contiguous and (len(by_joint) == dof or not given_names & set(before.values())):
            columns = by_joint
        if sorted(columns) == [*range(first, first + len(columns))]:
            unit = "" if first else slots[kind, 0].unit  # those of joints may differ by joint
            stated = by_name(unit) if unit else None
            by_kind[kind] = Block(kind, tuple(columns[joint] for joint in sorted(columns)), stated)
    elsewhere = {kind: {column.name for column in slots.values() if column.quantity != kind} for kind in by_kind}
    return [by_kind[kind] for kind in KINDS if kind in by_kind and not elsewhere[kind] & {*by_kind[kind].columns}]


def _of_given_motors(blocks: Sequence[Block], chosen: Sequence[Block]) -> list[Block]:
    """With velocities, torques and the like of those motors alone that are given as the joints of a log of more."""
    joints, motors = (next((b.columns for b in of if b.kind == "q"), ()) for of in (blocks, chosen))
    if not {*joints} < {*motors}:
        return [*blocks]
    of_all = [b.columns for b in chosen if is_per_joint(b.kind) and len(b.columns) == len(motors)]
    places = [motors.index(name) for name in joints]
    return [replace(b, columns=tuple(b.columns[k] for k in places)) if b.columns in of_all else b for b in blocks]


def _merge_given_poses(blocks: Sequence[Block], slots: _Slots) -> list[Block]:
    """Positions and orientations, those that are given in place of others."""
    merged = [*blocks]
    for form, parts in {"": PLACE, "deviation": DEVIATION, **FORMS}.items():
        if form == "scalar_last" or not all((part, 0) in slots for part in parts):
            continue
        columns, units = zip(*((slots[part, 0].name, slots[part, 0].unit) for part in parts), strict=True)
        unit = None
        if units[0] and len({*units}) == 1:
            unit = by_name(units[0])
        if not form:
            block = Block("position", columns, unit, source=source_words(columns))
        elif parts == DEVIATION:
            places = [of_whom(position.source) for position in merged if position.kind == "position"]
            block = Block("deviation", columns, unit, source=places[0] if len(places) == 1 else ())
        else:
            source = next((position.source for position in merged if position.kind == "position"), ())
            block = Block("rotation", columns, unit, by_name(form), source=source)
        retained = (
            existing for existing in merged if existing.kind != block.kind and not {*columns} & {*existing.columns}
        )
        merged = [*retained, block]
    return merged


def _split_by_joint(blocks: Sequence[Block], declared: Mapping[str, Column], arm: Arm | None) -> list[Block]:
    """Splits blocks of revolute and prismatic joints, with their units and without joints that the arm has not."""

    def unit(name: str) -> str | None:
        if name in declared:
            return declared[name].unit
        return unit_of(name)

    joints = next((block.columns for block in blocks if block.kind == "q"), ())
    dof = len(joints) if arm is None else arm.dof
    stated_sliding = [joint for joint, name in enumerate(joints) if unit(name) in units_allowed("q", True)]
    sliding = stated_sliding if arm is None else arm.sliding
    split = []
    for block in blocks:
        if not is_per_joint(block.kind):
            split.append(block)
            continue
        # nothing says which of more columns are the joints'
        surplus = len(block.columns) > len(joints) + 1 > 1 and block.kind != "temp"
        if block.kind != "q" and (len(block.columns) < dof or surplus):
            continue
        within = range(len(block.columns[: dof or None]))
        for slides in (False, True):
            members = [joint for joint in within if (differs_by_joint(block.kind) and joint in sliding) == slides]
            if members:
                columns = tuple(block.columns[joint] for joint in members)
                units = {unit(name) for name in columns}
                unit_name = units.pop() if len(units) == 1 else None
                stated = None
                if unit_name in units_allowed(block.kind, slides):
                    stated = by_name(unit_name)
                joints_of = tuple(joint + 1 for joint in members)
                split.append(replace(block, columns=columns, joints=joints_of, slides=slides, unit=stated))
    return split


def _read_pose(source: Source, blocks: Sequence[Block], numbers: Mapping[str, Array], arm: Arm | None) -> Pose:
    """A pose with the reading of its orientation and the units with which the arm, or a bundled one, agrees best."""
    position = source.position.values(numbers)
    finite = sizes.complete_rows(position)
    travel = float(np.ptp(finite, axis=0).max()) if len(finite) else 0.0
    pose = Pose((source.position, *source.rotations[:1]), source.role, arm, travel=travel)
    q = [block for block in blocks if block.kind == "q"]
    columns = list_columns(q, "q")
    if not columns:
        return pose
    sliding = tuple(joint - 1 for block in q if block.slides for joint in block.joints)
    arms = bundled_of(len(columns)) if arm is None else [arm]
    arms = [candidate for candidate in arms if (candidate.dof, candidate.sliding) == (len(columns), sliding)]
    joint = np.stack([numbers[name] for name in columns], 1)
    read = []
    wobbles = []
    for rotation in source.rotations or (None,):
        parts = [joint, position]
        pose_blocks = (source.position, *(() if rotation is None else (rotation,)))
        by_matrix = rotation is not None and rotation.form is not None and rotation.form.choice == MATRIX[0]
        if rotation is not None:
            turned = rotation.values(numbers)
            parts.append(quaternions(MATRIX, turned) if by_matrix else turned)
        complete = np.logical_and.reduce([np.isfinite(part).all(axis=1) for part in parts])
        q_there, p_there, *turned_there = (part[complete] for part in parts)
        known_units = {block.key: block.unit.choice for block in (*q, *pose_blocks) if block.unit}
        agreements = [
            (candidate, agreement(candidate, q_there, p_there, next(iter(turned_there), None), known_units))
            for candidate in arms
        ]
        agreements = sorted(agreements, key=lambda entry: entry[1].error)
        chosen, agreed = _choose_arm(arm, agreements)
        if by_matrix and agreed.form is not None:
            form = None
            if agreed.form.choice == "scalar_first":
                form = agreed.form._replace(choice=MATRIX[0])
            agreed = agreed._replace(form=form)
        wobbles.append(np.inf if agreed.form is None else agreed.form.numbers["error"])
        computed = False
        if agreements and (nearest := agreements[0][1]).close:
            length, angle = (nearest.units.get(of) for of in (("position", False), ("q", False)))
            in_m = p_there / units_of("x")[length.choice if length else "m"]
            in_rad = q_there / units_of("q")[angle.choice if angle else "rad"]
            computed = computed_by_controller(nearest.error, in_m, in_rad)
        role = source.role
        if computed:
            role = "controller"
        read.append(
            pose._replace(
                blocks=pose_blocks, role=role, arm=chosen, agreements=agreements, agreed=agreed, computed=computed
            )
        )
    steadiest = read[int(np.argmin(wobbles))]
    form = steadiest.agreed.form
    if form is not None and len(wobbles) > 1 and np.partition(wobbles, 1)[1] < CLEARLY * min(wobbles):
        return steadiest._replace(agreed=steadiest.agreed._replace(form=form._replace(sure="likely")))
    return steadiest


def _without_differences(blocks: Sequence[Block], numbers: Mapping[str, Array]) -> list[Block]:
    """Blocks without positions that are the difference of two others, to the digits written, whatever they are called.

    Which of the two is nominal their names say, or that it is computed; it is not needed beside them.
    """
    places = [block for block in blocks if block.kind in ("position", "deviation") and block.weak < 2]
    values = [block.values(numbers) for block in places]
    steps = [digit_step(of_block) for of_block in values]
    differences = set()
    for k, nominal, measured in permutations(range(len(places)), 3):
        small = 10 * _median_size(values[k]) < median_distance(sizes.complete_rows(values[nominal]))
        for scale in (1.0, 1e3, 1e-3) if small else ():
            missed = values[nominal] + scale * values[k] - values[measured]
            tolerance = 0.6 * (steps[nominal] + scale * steps[k] + steps[measured]) + 1e-9
            missed = np.abs(missed[np.isfinite(missed)])
            if missed.size and np.mean(missed <= tolerance) > 0.99:
                differences.add(places[k].columns)
    return [block for block in blocks if block.columns not in differences]


def _median_size(values: Array) -> float:
    complete = sizes.complete_rows(values)
    if len(complete):
        return float(np.median(np.linalg.norm(complete, axis=1)))
    return np.inf


def _read_sum(
    position: Block,
    deviation: Block,
    alone: Pose,
    blocks: Sequence[Block],
    numbers: Mapping[str, Array],
    arm: Arm | None,
    sign: float = 1.0,
) -> Pose:
    """The measured pose that is the sum of a nominal position and its deviation; the orientation is nominal too.

    Args:
        position: nominal.
        deviation: of the measured position from it.
        alone: the position as it is read without the deviation.
        blocks: of everything else.
        numbers: `(sample,)` by name.
        arm: as given.
        sign: −1 for the nominal position, where the other is measured.
    """
    places = position.values(numbers)
    offsets = deviation.values(numbers)
    of_places = position.unit or alone.agreed.units.get(position.key) or sizes.length_unit(places)
    unit = deviation.unit
    spread = median_distance(sizes.complete_rows(places))
    if unit is None and _median_size(offsets) > CLOSE * spread and of_places.choice == "m":
        unit = Decision("mm", "likely", "beside_nominal", {"largest": float(np.nanmax(np.abs(offsets)))})
    scale = 1.0
    if unit is not None:
        scale = deviation.units[of_places.choice] / deviation.units[unit.choice]
    summed = {**numbers, **dict(zip(position.columns, (places + sign * scale * offsets).T, strict=True))}
    pose = _read_pose(Source(position, ()), blocks, summed, arm)
    return pose._replace(blocks=(position, replace(deviation, unit=unit)), role="sensor")


def _choose_pose(read: Sequence[Pose], pose_source: str | None) -> int | None:
    """Which pose the source that is declared has, or the only one; None where that does not tell."""
    pool = poses_of([pose.role for pose in read], pose_source)
    if len({read[k].role for k in pool}) == 1:
        turned = [k for k in pool if len(read[k].blocks) > 1]
        if len(turned) == 1:
            pool = turned
    return pool[0] if len(pool) == 1 else None


def _choose_arm(arm: Arm | None, agreements: Sequence[tuple[Arm, ArmAgreement]]) -> tuple[Arm | None, ArmAgreement]:
    """The arm whose kinematics decide, where it agrees; the nearest bundled one where no other is as near."""
    if not agreements:
        return arm, ArmAgreement()
    first, agreed = agreements[0]
    if not agreed.close:
        return arm, agreed.undecided()
    if arm is not None:
        return arm, agreed
    if agreed.error > RECOGNISED_WITHIN:
        return None, agreed.undecided()
    if len(agreements) > 1 and agreements[1][1].error <= max(ALIKE * agreed.error, 1e-9):
        return None, agreed  # arms that are alike agree on the units
    return first, agreed


# ------------------------------------------------------------------ tables that are joined


class InspectedTable(NamedTuple):
    """A table with names of its own, and what it holds.

    Attributes:
        source: what messages begin with.
        stem: of its name, before columns whose names both of two tables have.
        columns: `(row,)` numbers by name.
        inspection: what they mean.
        words: its columns of text.
    """

    source: str
    stem: str
    columns: Mapping[str, Array]
    inspection: Inspection
    words: Mapping[str, Words] = MappingProxyType({})

    @classmethod
    def of(
        cls,
        columns: Mapping[str, Array],
        path: Path | str,
        arm: Arm | None,
        given: Mapping[str, str] = MappingProxyType({}),
        words: Mapping[str, Words] = MappingProxyType({}),
        pose_source: str | None = None,
    ) -> "InspectedTable":
        """The table of a file, looked at by `inspect`; `given` may have columns that are not there."""
        present = {name: meaning for name, meaning in given.items() if name in columns}
        inspection = inspect(list(columns.items()), arm, present, str(path), pose_source)
        return cls(str(path), Path(path).stem, columns, inspection, words)

    @property
    def row_names(self) -> dict[str, Words]:
        """Columns that may name the rows: of text, and of whole numbers that are called so."""
        used = {name for block in self.inspection.blocks if block.kind != "run" for name in block.columns}
        row_labels = {name: values for name, values in self.columns.items() if name not in used and is_label(name)}
        return {**self.words, **{name: write_whole(values) for name, values in row_labels.items()}}

    def list_columns(self, kind: str) -> list[str]:
        """Its columns of a kind, those of joints along the arm."""
        return list_columns(self.inspection.blocks, kind)

    def in_si(self, kind: str) -> Array | None:
        """`(row, column)` in SI units of a kind, those of joints along the arm; None where it has none."""
        return in_si(self.inspection.blocks, kind, self.columns)


def find_commands(tables: Sequence[InspectedTable]) -> int | None:
    """Which of two tables with joint positions has the commands; None where nothing says it of one alone.

    The names of its columns say it, else its own, else a text column that says so in all rows.
    """
    joints = [table.inspection.of("q") for table in tables]
    by_columns = [q is not None and q.rank == 2 for q in joints]
    by_name = [tells_of_commands(table.stem) for table in tables]
    constant = [[words for cells in table.words.values() if len(words := {*cells}) == 1] for table in tables]
    by_cells = [any(tells_of_commands(*words) for words in vocabularies) for vocabularies in constant]
    for commanded in (by_columns, by_name, by_cells):
        if sum(commanded) == 1:
            return commanded.index(True)
    return None
