"""What was recognised in a table, in words: on the screen, and as the comments of the sidecar that `init` writes.

The sentences are functions of `sentences.inspection`; `templates/inspection.yaml` has single words and the keys of a
sidecar.
"""

import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import yaml
from rich.console import RenderableType

from lite6jax.domains.pose.joining import JoinedFiles, SolvedPairs, WithJoints
from lite6jax.domains.pose.screening.thresholds import SUSPECT_REACH
from lite6jax.domains.tracking.joining import JoinedCommands
from lite6jax.errors import command_line
from lite6jax.formatting import shortened
from lite6jax.recordings.columns.cells import NamedColumns, Points
from lite6jax.recordings.columns.column import (
    COMMANDS,
    DEVIATION,
    FINE,
    IGNORED,
    MATRIX,
    Block,
    Decision,
    spelled,
    units_allowed,
    units_of,
)
from lite6jax.recordings.columns.inspection import READINGS_OF, Inspection, Pose, poses_of
from lite6jax.recordings.columns.names import Role, says_torque, unit_of
from lite6jax.recordings.reflectors import WithPose
from lite6jax.recordings.streams import said_of
from lite6jax.report.screen import indented, unbroken
from lite6jax.report.sentences import inspection as sentences
from lite6jax.report.words import fill, read_texts, say
from lite6jax.sensors.kinds import KINDS

_TEXTS = read_texts("inspection.yaml")
_MANY = 3
"""Columns that are named one by one; of more, the first and the last."""
_LONGEST_NAME = 40
"""Characters of a column's name that are shown in a list."""
_SHOWN = 8
"""Columns that are left out and named."""

KEYS: Mapping[str, tuple[str, str]] = {
    key: (entry["meaning"], entry["example"]) for key, entry in _TEXTS["keys"].items()
}
"""The keys of `recording` in a sidecar: what each means, and an example."""

_NOISES: Mapping[str, tuple[str, ...]] = {
    "tau": ("torque_noise_Nm",),
    "position": ("position_noise_m",),
    "rotation": ("orientation_noise_rad",),
    **{name: (kind.noise,) for name, kind in KINDS.items()},
}
"""The keys of the noise of each kind of block and of reading."""


def inspection_report(inspection: Inspection, path: str) -> Iterator[RenderableType]:
    """What each column means, how sure that is, and why."""
    used = len({column for block in inspection.blocks for column in block.columns} | set(inspection.given))
    unused = len(inspection.unused) + len(inspection.texts)
    yield unbroken(path)
    yield from (sentences.rows_and_columns(inspection.samples, used, unused), "")
    recognised: dict[str, str] = {}
    for block in inspection.blocks:
        yield indented(statement(block))
        recognised |= block.renamed()
    for reading in inspection.announced:
        meaning = _TEXTS["readings"][reading.kind]
        sure = "" if reading.unit is None else _sure(reading.unit)
        for column, name in reading.renamed().items():
            yield indented(sentences.announced_column(column, meaning, name, sure))
        recognised |= reading.renamed()
    for column, name in inspection.given.items():
        if recognised.get(column) != name:
            yield indented(f"{column}: {name}, {'by name' if column == name else 'as given'}.")
    for column, why in inspection.denied.items():
        yield indented(f"{column}: {_TEXTS['denied'][why]}, so it is not used.")
    yield from map(indented, unread_commands(inspection))
    unread = [name for name in (*inspection.unused, *inspection.texts) if name not in inspection.denied]
    if unread:
        yield indented(f"Not used: {_listed(unread)}.")
    yield ""
    for source in inspection.sources if len(inspection.sources) > 1 else ():
        yield f"{source_statement(source)}{' It is taken.' if source.taken else ''}"
    yield arm_statement(inspection)
    yield from [_TEXTS["computed"]] if inspection.computed else []
    yield f"Motion: {inspection.motion[0]}; {inspection.motion[1]}."


def unread_commands(inspection: Inspection) -> list[str]:
    """Which columns are commands by name and are not read, and what to do."""
    q = inspection.of("q")
    unit = "rad" if q is None or q.unit is None else q.unit.choice
    lines = []
    for why, columns in inspection.unread_commands:
        ways = " ".join(_column_option(name, spelled("cmd", k, unit)) for k, name in enumerate(columns[:2], 1))
        lines.append(sentences.unread_commands(_columns(columns), why, ways))
    return lines


def no_angles(joints: Block) -> str:
    """Joint positions that may be no angles, and what to do."""
    reason = joints.unit.reason if joints.unit else "percent"
    unit = "mdeg" if reason == "whole" else "deg"
    ways = [_column_option(column, f"q{k}_{unit}") for k, column in enumerate(joints.columns, 1)]
    finer = []
    if reason == "whole":
        finer = [spelled("q", 1, alternative) for alternative in units_of("q") if alternative in FINE - {unit}]
    columns = _columns(joints.columns)
    return sentences.joints_without_angles(columns, _TEXTS["angles"][reason], _TEXTS["units"][unit], ways, finer)


def source_statement(source: Pose) -> str:
    """One of several poses: whose it is, and how well the arm reproduces it."""
    role = _TEXTS["roles"][source.role or "unknown"]
    return sentences.pose_source(_columns(source.columns), role, source.computed, source.error)


def choice_of_pose(inspection: Inspection) -> str:
    """Several poses of which none is taken, and how to say which is meant."""
    roles: list[Role | None] = [source.role for source in inspection.sources]
    keys = {"laser_tracker": "laser_tracker (or motion_capture, camera)", "controller_fk": "controller_fk"}
    ways = [f"--set pose_source={text}" for key, text in keys.items() if len(poses_of(roles, key)) == 1]
    ignored = (_column_option(name, IGNORED) for name in inspection.sources[0].columns)
    ways.append(f"leaving out what is not meant, such as {' '.join(ignored)}")
    descriptions = list(map(source_statement, inspection.sources))
    return fill(_TEXTS["poses"], {"count": len(descriptions), "said": descriptions, "ways": ways})


def choice_of_motors(inspection: Inspection) -> str:
    """More motors than the arm has joints, and how to say which are meant."""
    arm = inspection.arm
    motors = inspection.motors
    assert arm is not None
    names = arm.joint_names or [f"q{k + 1}" for k in range(arm.dof)]
    ways = list(map(_column_option, motors[0], inspection.joint_columns))
    facts = {"count": sum(map(len, motors)), "motors": list(map(_columns, motors)), "arm": arm, "names": names}
    return fill(_TEXTS["motors"], facts, ways=ways)


def _column_option(name: str, meaning: str) -> str:
    """`--column name=meaning`, as it is typed."""
    return command_line("--column", f"{name}={meaning}").partition(" ")[2]


def statement(block: Block) -> str:
    """A block in one or two sentences."""
    form = block.form
    unit = block.unit.choice if block.unit else ""
    if block.unit and unit:
        unit = _TEXTS["units"].get(unit, unit.replace("_per_s2", "/s²").replace("_per_s", "/s"))
        unit = f"{'in ' if form is None else ''}{unit} ({_sure(block.unit)})"
    shown_form = form and f"{sentences.form_of_rotation(form.choice, _order(block.columns))} ({_sure(form)})"
    meaning = [f"{_kind(block)}: {_columns(block.columns)}", shown_form or "", unit]
    rivals = _listed(block.rivals) if block.rivals else ""
    return sentences.block_statement(meaning, block.kind in COMMANDS, _commanded(block), rivals)


def _order(columns: Sequence[str]) -> str:
    """In which order the columns r11, r12, …, r33 of a matrix are numbered."""
    numbers = [int(number) for name in columns for number in re.findall(r"\d+", name)[-1:]]
    if len(numbers) != len(MATRIX) or len({*numbers}) < len(MATRIX):
        return "rows"
    return "rows" if numbers[1] < numbers[3] else "columns"


def _commanded(block: Block) -> bool:
    """Tells whether joint columns are taken for measured ones that by name were commanded or computed."""
    return block.rank == 2 and bool(block.joints) and block.kind not in COMMANDS


def _kind(block: Block) -> str:
    return _TEXTS["slides" if block.slides else "kinds"][block.kind]


def _sure(decision: Decision) -> str:
    return f"{decision.sure}: {sentences.reason_of_decision(decision.reason, decision.numbers)}"


def arm_statement(inspection: Inspection) -> str:
    """Which arm it is, and how well its nominal kinematics agree."""
    arm = inspection.arm
    if arm is None:
        tried = "; ".join(f"{arm_name}: {1e3 * error:.3g} mm" for arm_name, error in inspection.arms[:4])
        return sentences.arm_unknown(tried)
    if not inspection.arms:
        return f"Arm: {arm.name}, as given; there are no poses to compare it with."
    missed = inspection.error > SUSPECT_REACH * arm.reach
    others = "; ".join(f"{arm_name} to {1e3 * error:.3g} mm" for arm_name, error in inspection.arms[1:3])
    return sentences.arm_compared(arm.name, inspection.error, missed, others)


def sidecar_text(inspection: Inspection, settings: Mapping[str, Any], table: str) -> str:
    """The YAML of a table's sidecar with every key and what it means; keys without a value are commented out.

    `settings` are the keys of `recording` that are known, as plain YAML values.
    """
    lines = [
        f"# How lite6jax reads {' '.join(table.split())}. Written by `lite6jax init`, to be corrected by hand;",
        "# docs/reference/recordings.md has all columns and keys. A line that begins with # is not in force.",
        "",
    ]
    if inspection.columns:
        lines += _column_lines(inspection)
    of = {*inspection.readings, *(["readings"] if inspection.readings else ())}
    if inspection.of("tau") is not None or inspection.of("current") is not None:
        of.add("torques")
    if any(inspection.of(kind) is not None for kind in COMMANDS):
        of.add("commands")
    if inspection.holds("x"):
        of.add("poses")
    lines.append("recording:" if settings else "recording: {}  # nothing is declared yet")
    for key, (meaning, example) in KEYS.items():
        applies = _TEXTS["keys"][key].get("of")
        if key not in settings and applies is not None and not of & set(applies):
            continue
        lines += _wrapped(meaning)
        value = _flow(settings[key]) if key in settings else example
        lines.append(f"  {key}: {value}" if key in settings else f"  # {key}: {example}")
    return "\n".join(lines) + "\n"


def _column_lines(inspection: Inspection) -> list[str]:
    lines = ["# What each column is: its name in the table, then what it holds and its unit; `ignore` for nothing."]
    lines.append("columns:")
    meanings = dict(inspection.columns)
    for block in inspection.blocks:
        lines += _wrapped(statement(block))
        in_file = [inspection.in_file.get(column, column) for column in block.columns]
        lines += [_entry(column, meanings.pop(column)) for column in in_file if column in meanings]
    as_given = {column: name for column, name in meanings.items() if name != IGNORED}
    unused = {column: name for column, name in meanings.items() if name == IGNORED}
    for comment, entries in (("As given.", as_given), ("Not used.", unused)):
        if entries:
            lines += [f"  # {comment}", *(_entry(column, name) for column, name in entries.items())]
    return [*lines, ""]


def _entry(column: str, name: str) -> str:
    dumped = yaml.safe_dump({column: name}, allow_unicode=True, width=1 << 20, default_flow_style=False).rstrip("\n")
    return "\n".join(f"  {line}" for line in dumped.split("\n"))


def _flow(value: Any) -> str:
    dumped = yaml.safe_dump(value, default_flow_style=True, allow_unicode=True, width=1 << 20)
    return dumped.removesuffix("\n").removesuffix("...").strip()


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(
        text, 118, initial_indent="  # ", subsequent_indent="  # ", break_long_words=False, break_on_hyphens=False
    )


def _columns(names: Sequence[str]) -> str:
    if len(names) <= _MANY:
        return ", ".join(map(sentences.in_line, names))
    return f"{sentences.in_line(names[0])} … {sentences.in_line(names[-1])}"


def _listed(names: Sequence[str]) -> str:
    return shortened([repr(_ending(name)) for name in names], _SHOWN)


def _ending(name: str) -> str:
    """A name, of a long one its end, by which columns of one topic differ."""
    return name if len(name) <= _LONGEST_NAME else f"…{name[1 - _LONGEST_NAME :]}"


def next_steps(inspection: Inspection, settings: Mapping[str, Any], source: str) -> Iterator[RenderableType]:
    """What is still unknown, and the command that follows."""
    q, tau, current, position = map(inspection.of, ("q", "tau", "current", "position"))
    efforts = tau and tau.unit and tau.unit.sure == "assumed" and not says_torque(tau.columns[0])
    timed = inspection.holds("time")
    noises = []
    if tau is not None or current is not None:
        noises = list(_NOISES["tau"])
    for measured in ("position", "rotation") if position is not None and not inspection.computed else ():
        noises += _NOISES[measured] if inspection.of(measured) is not None else ()
    noises += [key for kind in inspection.readings for key in _NOISES[kind]]
    matrix = inspection.of("rotation")
    matrix = matrix if matrix and matrix.form and matrix.form[:2] == (MATRIX[0], "assumed") else None
    transposed = [f"r{name[2]}{name[1]}" for name in MATRIX]
    alone = position is None and tau is None and current is None and not inspection.given
    commanded = q is not None and any(inspection.of(kind) is not None for kind in COMMANDS)
    tracked = alone and commanded
    # torques and commands are diagnosed together, and poses without them
    commands_left_out = commanded and (position is not None or bool(inspection.given))
    nothing = alone and not tracked
    noises += ["joint_noise_rad"] if commanded and not commands_left_out else []
    deviations = [
        _column_option(column, f"{name}_{unit_of(column) or 'mm'}")
        for column, name in zip(inspection.unclear_deviations, DEVIATION, strict=False)
    ]
    by_columns = []
    if matrix:
        by_columns = [_column_option(column, name) for column, name in zip(matrix.columns, transposed, strict=True)]
    doubtful = [
        _kind(block).lower()
        for block in inspection.blocks
        if "assumed" in [decision.sure for decision in (block.unit, block.form) if decision] or _commanded(block)
    ]
    questions = [
        sentences.unclear_deviations(deviations),
        sentences.unclear_matrix(by_columns),
        sentences.assumed_kinds(doubtful),
        *sentences.unclear_sources(
            joints_commanded=q is not None and _commanded(q) and "joint_source" not in settings,
            torques_estimated=tau is not None and _commanded(tau) and "torque_source" not in settings,
            as_current=_column_option(tau.columns[0], f"current{tau.joints[0]}_A") if tau and efforts else "",
            currents=tau is None and current is not None and "torque_constant_Nm_per_A" not in settings,
        ),
        sentences.computed_or_measured(
            inspection.computed,
            settings.get("pose_source", "unknown"),
            any(source.taken and source.role == "controller" for source in inspection.sources),
        ),
    ]
    if nothing:
        declared = settings.get("pose_source", "")
        readings = [
            (reading_source, column, _TEXTS["readings"][quantity])
            for reading_source, column, quantity in inspection.likely_readings
        ]
        questions.append(sentences.only_a_motion(readings, declared if declared in READINGS_OF else ""))
    elif not (position or timed) and (tau or current or tracked):
        questions.append(sentences.without_times(tracked, _named_time(inspection.unused)))
    questions.append(sentences.undeclared_noises([key for key in noises if key not in settings]))
    yield from filter(None, questions)
    if not nothing:
        yield "Next:" if "arm" in settings else "Name the arm in the sidecar, then:"
        yield unbroken(command_line("diagnose", source, "--out", "diagnosis.json"))
        if commands_left_out:
            yield sentences.commands_beside("joint_noise_rad" not in settings)
            yield unbroken(command_line("diagnose", source, "--tracking", "--out", "tracking.json"))


def _named_time(unused: Sequence[str]) -> str:
    """How to name a column of times: one whose name has a unit of time, or the first that means nothing."""
    timed = {name: unit for name in unused if (unit := unit_of(name)) in units_allowed("time")}
    name, unit = next(iter(timed.items()), (next(iter(unused), None), "s"))
    if name is None:
        return "record them"
    return f"say in the sidecar which it is, such as `{name}: time_{unit}`"


# ------------------------------------------------------------------ what was joined to one table


def describe_joined_files(joined_files: JoinedFiles, joints: str, poses: str) -> list[str]:
    """How the joints of one file and the poses of another were joined."""
    lines = []
    if joined_files.clocks is not None:
        lines += sentences.joined_by_clocks(joined_files.clocks, joined_files.start, joints, poses)
    if joined_files.pairing is not None:
        lines.append(sentences.joined_by_order(joined_files.pairing, joined_files, joints, poses))
    if joined_files.names is not None:
        first_alone, second_alone = (shortened(names, _SHOWN) for names in joined_files.names.alone)
        columns = joined_files.names.columns
        lines.append(sentences.joined_by_names(columns, (first_alone, second_alone), joined_files.error, joints, poses))
    if joined_files.joined is not None:
        lines += said_of(joined_files.joined, joined_files.unit)
    lines.append(fill(_TEXTS["joined_rows"], joined_files._asdict()))
    if joined_files.left_out:
        shown = ", ".join(joined_files.left_out[:_SHOWN]) + (", …" if len(joined_files.left_out) > _SHOWN else "")
        lines.append(f"left out, as they are neither of joints nor of the measured pose: {shown}")
    return lines


def describe_joined_commands(joined: JoinedCommands, states: int, names: tuple[str, str]) -> list[str]:
    """How the commands of one file and the measured joints of another were joined, in `states` rows."""
    return [sentences.joined_commands(joined.commands, states, names), *joined.dropped]


def describe_solved_joints(solved: WithJoints, arm: str) -> list[str]:
    """How joints were found from poses."""
    reached = solved.path.reached
    facts = {"source": solved.file.source, "arm": arm, "branches": solved.path.branches}
    return [*say(_TEXTS["solved"], facts), *sentences.poses_not_reached(int(np.sum(~reached)), len(reached))]


def describe_pairs(pairs: SolvedPairs, arm: str) -> list[str]:
    """How pairs of poses became joints and poses."""
    return [*describe_solved_joints(pairs.solved, arm), *sentences.inverted_targets(pairs.inverted, pairs.errors)]


def describe_named_columns(named_columns: NamedColumns) -> list[str]:
    """Whose numbers cells name."""
    words = shortened(named_columns.words, _SHOWN)
    return [sentences.named_columns(_columns(named_columns.by), words, bool(named_columns.in_file))]


def describe_points(points: Points, measured_point: str) -> list[str]:
    """How rows of points became rows of states; `measured_point` is the one point whose position is read, or none."""
    counts = dict(zip(points.labels, points.counts, strict=True))
    states = len(next(iter(points.columns.values())))
    incomplete = not measured_point and min(points.counts) < states
    labels = shortened(points.labels, _SHOWN)
    lines = [sentences.points_of_states(points.by, labels, len(points.labels), states, incomplete)]
    if measured_point:
        lines.append(sentences.one_point_read(measured_point, counts.get(measured_point)))
    return lines


def describe_reflectors(with_pose: WithPose) -> list[str]:
    """How points became a pose."""
    names = ", ".join(point[0] for point in with_pose.points[:4]) + (", …" if len(with_pose.points) > 4 else "")
    lost = int(np.sum(~with_pose.pose.rows)) - with_pose.pose.outlying
    mm = 1e3 if with_pose.unit == "m" else 1.0
    return sentences.pose_of_points(with_pose.pose, names, lost, mm)
