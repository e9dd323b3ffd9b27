"""Commands that make recordings of what people have: tables with column names of their own, and images of a board.

Two files with clocks of their own, and points on one body, are joined to one table before.
"""

import json
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, final

from tyro.conf import Positional, UseAppendAction, arg

from lite6jax import suffixes
from lite6jax.cli import command
from lite6jax.deferred import import_lazily
from lite6jax.errors import InputError, command_line, name_options
from lite6jax.storage import check, check_writable, write_atomically

with import_lazily():
    from lite6jax import recordings
    from lite6jax.arms import arm as arms
    from lite6jax.arms import files, urdf
    from lite6jax.calibration import source as sources
    from lite6jax.domains.pose import inspection as pose_inspection
    from lite6jax.domains.pose import joining as pose_joining
    from lite6jax.domains.pose import points as pose_points
    from lite6jax.domains.pose import reflectors
    from lite6jax.domains.pose.screening import options as screening_options
    from lite6jax.domains.pose.screening import screen as screening
    from lite6jax.recordings import boards, fault, formats, naming
    from lite6jax.recordings import columns as table_columns
    from lite6jax.recordings import files as tables
    from lite6jax.recordings import settings as sidecar_settings
    from lite6jax.recordings import table as tabulation
    from lite6jax.recordings import words as table_words
    from lite6jax.report import faults, inspection, screen

if TYPE_CHECKING:
    import numpy as np
    from rich.console import RenderableType

_QUESTIONS: dict[str, tuple[str, tuple[str, ...]]] = {
    "joint_source": ("Where are the joint positions from?", ("measured", "commanded", "unknown")),
    "pose_source": (
        "What measured the poses?",
        ("laser_tracker", "motion_capture", "camera", "controller_fk", "unknown"),
    ),
    "pose_frame": ("Are the poses in the arm's base frame (base), or in the sensor's (unknown)?", ("unknown", "base")),
    "tool": ("Are the poses of the flange itself (none), or of a tool (unknown)?", ("unknown", "none")),
    "torque_source": ("Where are the torques from?", ("measured", "current", "estimated", "unknown")),
}


class _Table(NamedTuple):
    """A table as it is looked at.

    Attributes:
        path: of its file, or of the one that it is written to.
        content: what the file holds.
        columns: their numbers; None of text.
        words: of the columns of text.
        notes: how it was read.
        in_file: of columns that are called otherwise here, their names in the file.
        given: meanings that are known, by the names here.
        made: what it is called after, where it is made of others; empty where it is a file's own.
    """

    path: Path
    content: "tabulation.RawTable"
    columns: "list[tuple[str, np.ndarray | None]]"
    words: Mapping[str, Sequence[str]]
    notes: list[str]
    in_file: Mapping[str, str] = MappingProxyType({})
    given: Mapping[str, str] = MappingProxyType({})
    made: str = ""

    @property
    def numbers(self) -> "dict[str, np.ndarray]":
        """The columns of numbers."""
        return {name: values for name, values in self.columns if values is not None}

    def called(self, names: Mapping[str, str]) -> "_Table":
        """With other names of some columns, which are given by the new one."""
        here = {before: name for name, before in names.items()}
        columns = [(here.get(name, name), values) for name, values in self.columns]
        words = {here.get(name, name): cells for name, cells in self.words.items()}
        given = {here.get(name, name): meaning for name, meaning in self.given.items()}
        in_file = {name: own for name, own in self.in_file.items() if name not in here}
        in_file |= {name: self.in_file.get(before, before) for name, before in names.items()}
        return self._replace(columns=columns, words=words, given=given, in_file=in_file)

    def remade(self, columns: "Mapping[str, np.ndarray]", words: Mapping[str, Sequence[str]], made: str) -> "_Table":
        """With other columns, which no file has."""
        return self._replace(columns=list(columns.items()), words=words, in_file={}, made=self.made or made)


@final
@dataclass(frozen=True)
class Init:
    """Look at a recording, whatever its columns are called, and write the sidecar that says how to read it.

    Joints, poses, torques and times are recognised by the names; degrees, millimetres and the form of rotations by size
    and, with an arm, by its kinematics. It asks on a terminal, and takes options elsewhere.

    For example:

        lite6jax init run7.csv --arm ur10
        lite6jax init robot.csv tracker.csv --arm ur10
        lite6jax init run7.csv --arm my_arm.urdf --set pose_source=laser_tracker --set pose_frame=base
        lite6jax init run7.csv --column tracker_x=x_mm --column spindle=ignore
    """

    source: Annotated[Positional[tuple[str, ...]], arg(metavar="RECORDING")]
    """A table (.csv, .parquet, .xlsx), arrays (.h5, .npz, .mat), samples of a hand-eye calibration (.yaml, .json), a
    program (.src, .ls, .mod), a log (.mcap, .bag, the folder of a rosbag2), or the folder of a LeRobot data set; or two
    files, one with the joints and one with the poses, which are joined to one table."""
    arm: command.ArmName = None
    """The nominal arm: a bundled name, or a description, URDF or MJCF. Recognised by the poses where not given."""
    column: Annotated[tuple[str, ...], UseAppendAction, arg(metavar="COLUMN=MEANING")] = ()
    """What a column is, such as joint_1=q1_deg, tcp_x=x_mm, or foo=ignore. May be repeated."""
    names: Annotated[tuple[str, ...], UseAppendAction, arg(metavar="NAME,NAME,...")] = ()
    """The names of the columns of a table without names, in order: q1_deg,q2_deg,x_mm, or SMR1_x,SMR1_y; nothing for
    one to be ignored. Of two such tables one after the other, or by one --names each."""
    set: Annotated[tuple[str, ...], UseAppendAction, arg(metavar="KEY=VALUE")] = ()
    """A key of the sidecar, such as pose_frame=base or tool=none. May be repeated."""
    yes: bool = False
    """Ask nothing."""
    json: bool = False
    """Print what was recognised as JSON, and ask nothing."""
    force: bool = False
    """Replace the sidecar if it exists, and the table that two files are joined to."""

    def run(self) -> int:
        """Looks, asks, writes, prints."""
        settings = command.parse_pairs("--set", self.set, as_yaml=True)
        given = command.parse_pairs("--column", self.column)
        sidecar_settings.declared_settings(None, None, settings)
        arm, shown = self.arm, False
        said = {key: settings[key] for key in ("pose_source", "motion") if isinstance(settings.get(key), str)}
        nominal = sources.load_nominal(arm)
        table = _read_table(self.source, nominal, given, self.names, said.get("pose_source"), self.force)
        source, file, notes = str(table.path) if table.made else self.source[0], table.path, [*table.notes]
        sidecar = check_writable(recordings.sidecar_path(tables.split_topics(source)[0]), self.force)
        given = dict(table.given)

        def look() -> "pose_inspection.Inspection":
            nominal, assumed = sources.load_nominal(arm), table.content.assumed
            found = pose_inspection.inspect(
                table.columns, nominal, given, str(file), assumed=assumed, words=table.words, **said
            )
            return replace(found, in_file=table.in_file)

        found = look()
        if arm and (shorter := _leave_out_jaw(arm, found)):
            arm = shorter
            found = look()
            notes.append(f"the jaw is left out, as its column is a gripper's: the arm is {arm}")
        if not (self.yes or self.json) and _on_a_terminal():
            screen.show(inspection.inspection_report(found, str(file)))
            if not arm and found.arm is None:
                arm = input("Arm (a bundled name or a file; nothing for later): ").strip() or None
            if arm and not self.arm and not table.made:  # the joint states of a log are in the units of its joints
                table = _read_table(self.source, sources.load_nominal(arm), given, self.names, None, self.force)
                notes = [*table.notes]
            before = dict(given)
            for ask in (_ask_motors, _ask_pose, _ask_columns):
                given |= ask(look())
            settings |= _ask_settings(look(), settings)
            found, shown = look(), bool(arm) == bool(self.arm) and given == before
        if found.motors:
            raise InputError(f"{file}: {inspection.choice_of_motors(found)}")
        if found.undecided:
            raise InputError(f"{file}: {inspection.choice_of_pose(found)}")
        named = command.name_arm(arm, sidecar) if arm else None if found.arm is None else found.arm.name
        settings = ({"arm": named} if named else {}) | settings
        settings.setdefault("motion", found.motion[0])
        if found.computed:
            settings.setdefault("pose_source", "controller_fk")
        _check(found, table.content, file, notes)
        text = inspection.sidecar_text(found, settings, file.name)
        made = [_write(table, self.force)] if table.made else []
        made.append(write_atomically(sidecar, text, self.force))
        data_faults = _find_gross_faults(source, found, settings, notes)
        if self.json:
            more = {"faults": [fault.to_dict() for fault in data_faults], "notes": notes, "sidecar": str(sidecar)}
            plain = check({**found.to_dict(), **more}, dict)  # a number that is not finite becomes null
            print(json.dumps(plain, indent=1, allow_nan=False))
            return command.DONE
        if not shown:
            screen.show(inspection.inspection_report(found, str(file)))
        if data_faults:
            screen.show(faults.fault_lines(data_faults))
        screen.show(screen.notes(notes))
        screen.written(made)
        screen.show(inspection.next_steps(found, settings, source))
        return command.DONE


def _check(found: "pose_inspection.Inspection", table: "tabulation.RawTable", path: "Path", notes: list[str]) -> None:
    """Refuses what the other commands would refuse, before anything is written."""
    q = found.of("q")
    if q is not None and q.unit and q.unit.reason in ("percent", "ticks", "whole"):
        raise InputError(f"{path}: {inspection.no_angles(q)}")
    if q is None and not any(name.startswith("q1_") for name in found.given.values()):
        raise InputError(
            f"{path}: no columns look like joint positions; say which they are, --column NAME=q1_deg --column "
            f"NAME=q2_deg and so on (q1_rad in radians, q1_mm of a prismatic joint); it has "
            f"{table_columns.list_names(table.names)}"
        )
    dof = None if found.arm is None else found.arm.dof
    tabulation.tabulate(table, str(path), notes, dof=dof, renamed=found.columns)


def _find_gross_faults(
    source: str, found: "pose_inspection.Inspection", settings: Mapping[str, Any], notes: list[str]
) -> "tuple[fault.DataFault, ...]":
    """Why the recording, read as its new sidecar says, misses the arm grossly: the answer of `check`, without a fit."""
    if found.arm is None or found.of("q") is None or found.of("position") is None or not isfinite(found.error):
        return ()
    declared = settings.get("pose_frame") == "base" or settings.get("tool", "unknown") != "unknown"
    agrees = found.error <= screening_options.ScreeningOptions().suspect_reach * found.arm.reach
    try:
        recording = recordings.read_recording(source)
        if agrees and not declared:  # nothing is declared that could be wrong
            return screening.screen_rows(recording, screening_options.ScreeningOptions()).found
        return screening.screen(recording, allow_undecided=True, coarse=True).found
    except InputError as error:  # of too few rows, and the like: the table was recognised all the same
        notes.append(name_options(str(error)))
        return ()


def _on_a_terminal() -> bool:
    return sys.stdin.isatty() and sys.stdout.isatty()


def _leave_out_jaw(arm: str, found: "pose_inspection.Inspection") -> str | None:
    """An arm's file with the tip before its jaw, where none is named and a table has a gripper for the jaw."""
    q = found.of("q")
    if not arm.endswith(".urdf") or q is None or not naming.is_of_gripper(q.columns[-1]):
        return None
    tip = urdf.tip_before_jaw(arm)
    return f"{arm}#{tip}" if tip else None


def _ask_motors(found: "pose_inspection.Inspection") -> dict[str, str]:
    """The columns of the arm's joints, where a table has more of them than the arm."""
    if not found.motors or found.arm is None:
        return {}
    print(inspection.choice_of_motors(found))
    every = [name for group in found.motors for name in group]
    usual = ",".join(every[: found.arm.dof])
    while True:
        answer = input(f"Which columns are the joints, in order? [nothing for {usual}]: ").strip() or usual
        said = [name.strip() for name in answer.split(",")]
        if len(said) == len({*said}) == found.arm.dof and {*said} <= {*every}:
            return dict(zip(said, found.joint_columns, strict=True))
        print(f"write {found.arm.dof} of {', '.join(every)}, between commas")


def _ask_settings(found: "pose_inspection.Inspection", settings: Mapping[str, Any]) -> dict[str, Any]:
    """Answers to the questions that the table raises and no option has answered."""
    poses = found.of("position") is not None
    torques = found.of("tau") is not None or found.of("current") is not None
    wanted = ["joint_source", *(("pose_source", "pose_frame", "tool") if poses else ())]
    wanted += ["torque_source"] if torques else []
    known = {*settings, *(("pose_source",) if found.computed else ())}
    answers = {key: _ask(*_QUESTIONS[key], "unknown") for key in wanted if key not in known}
    return {key: answer for key, answer in answers.items() if answer != "unknown"}


def _ask_pose(found: "pose_inspection.Inspection") -> dict[str, str]:
    """The columns of the poses that are not meant, to be ignored, where several are there and none is taken."""
    if not found.undecided:
        return {}
    for source in found.sources:
        print(inspection.source_statement(source))
    names = [source.columns[0] for source in found.sources]
    answer = _ask("Which pose is meant?", names, names[-1])
    return {name: "ignore" for source in found.sources if source.columns[0] != answer for name in source.columns}


def _ask_columns(found: "pose_inspection.Inspection") -> dict[str, str]:
    """The names of columns whose unit or form is only assumed."""
    given: dict[str, str] = {}
    for block in found.blocks:
        form, unit = (one if one and one.sure == "assumed" else None for one in (block.form, block.unit))
        forms, units = block.forms if form else (), block.units if unit else ()
        if not forms and len(units) < 2:
            continue
        print(inspection.statement(block))
        if form and forms:
            given |= block.renamed(form=_ask("Which form is it?", forms, form.choice))
        if unit and unit.choice:
            given |= block.renamed(unit=_ask("In which unit?", [*units], unit.choice))
    return given


def _ask(question: str, choices: Sequence[str], usual: str) -> str:
    while True:
        answer = input(f"{question} [{' | '.join(choices)}; nothing for {usual}]: ").strip() or usual
        if answer in choices:
            return answer
        print(f"write one of {', '.join(choices)}")


# ------------------------------------------------------------------ join


def _read_table(
    sources: tuple[str, ...],
    arm: "arms.Arm | None",
    given: Mapping[str, str],
    names: tuple[str, ...],
    pose_source: str | None,
    overwrite: bool,
) -> _Table:
    """The table of a file; or one that is made of two files, of points on one body, or of names that change places."""
    if not 1 <= len(sources) <= 2:
        raise InputError(f"{len(sources)} recordings: name one, or two, of which one has the joints and one the poses")
    if len(sources) == 2 and arm is None:
        example = command_line("init", *sources, "--arm", "NAME")
        raise InputError(f"two files are joined by the motion of the arm: name it, `{example}`")
    opened = _name_columns([_open(source, arm) for source in sources], names)
    for table in opened:
        table.content.renamed(str(table.path), table.in_file or given)  # without names it says what to do
    read = [_reshape(_give_meanings(table, given), arm, given, len(sources) == 2) for table in opened]
    names_there = [name for table in (*opened, *read) for name in (*dict(table.columns), *table.in_file.values())]
    unknown = [name for name in tabulation.resolve_names(names_there, given) if name not in names_there]
    if unknown:
        files = " and ".join(sources)
        raise InputError(f"{files}: has no column {unknown[0][:60]!r}; {pose_inspection.near(unknown[0], names_there)}")
    table, notes = read[0], read[0].notes
    if len(read) == 2:
        assert arm is not None
        table, notes = _join(read[0], read[1], arm, pose_source)
    else:
        table, notes = _solve_pairs(table, arm, sources[0])
    first = opened[0].path
    if not table.made and recordings.sidecar_path(first) == first:
        table = table.remade(table.numbers, table.words, "table")
    if not table.made:
        return table
    known = formats.find_format(first)
    written = known is not None and known.suffixes in (suffixes.TEXT_TABLES, (suffixes.PARQUET,))
    suffix = first.suffix.lower() if written else suffixes.WRITTEN_TABLES[0]
    place = check_writable(first.with_name(f"{first.stem}_{table.made}{suffix}"), overwrite)
    content = tabulation.RawTable.of_arrays(table.numbers)
    kept = {name: meaning for name, meaning in table.given.items() if name in content.names}
    return table._replace(path=place, content=content, columns=content.numbers(), given=kept, notes=notes)


def _open(source: str, arm: "arms.Arm | None") -> _Table:
    notes: list[str] = []
    path, content = tables.open_table(*tables.split_topics(source), recordings.ArmJoints.of(arm), notes)
    columns = content.numbers()
    words = content.words(name for name, numbers in columns if numbers is None)
    return _Table(path, content, columns, words, notes)


def _name_columns(opened: Sequence[_Table], names: Sequence[str]) -> list[_Table]:
    """Tables without names with those that are given, of one after the other."""
    nameless = [table for table in opened if table.content.nameless]
    if names and not nameless:
        raise InputError(f"{opened[0].path}: names its columns already; say what they are by --column NAME=MEANING")
    if not names:
        return [*opened]
    lists = [[name.strip() for name in listed.split(",")] for listed in names]
    counts = [len(table.content.names) for table in nameless]
    if len(lists) == 1 and len(lists[0]) == sum(counts):
        lists = [lists[0][sum(counts[:k]) : sum(counts[: k + 1])] for k in range(len(counts))]
    if len(lists) != len(nameless):
        columns = " and ".join(f"{count} of {table.path}" for count, table in zip(counts, nameless, strict=True))
        said = " and ".join(str(len(listed)) for listed in lists)
        raise InputError(f"--names gives {said} names for the columns {columns}; give each one, or one --names a file")
    in_order = iter(lists)
    return [_name_in_order(table, next(in_order)) if table.content.nameless else table for table in opened]


def _name_in_order(table: _Table, names: Sequence[str]) -> _Table:
    """A table without names with these; those that are empty are ignored."""
    if len(names) != len(table.content.names):
        count = len(table.content.names)
        raise InputError(f"{table.path}: --names gives {len(names)} names for {count} columns; give each one")
    if twice := [name for name, count in Counter(filter(None, names)).items() if count > 1]:
        raise InputError(f"{table.path}: --names gives {twice[0][:40]!r} twice; give each column a name of its own")
    in_file = {name: own for name, own in zip(names, table.content.names, strict=True) if name and name != "ignore"}
    rest = {own: "ignore" for own in table.content.names if own not in in_file.values()}
    return table.called(in_file)._replace(given=rest)


def _give_meanings(table: _Table, given: Mapping[str, str]) -> _Table:
    """With the meanings that are given, by names in the file or here; those of no column are left out."""
    here = {own: name for name, own in table.in_file.items()}
    names = [name for name, _ in table.columns]
    resolved = tabulation.resolve_names(names, {here.get(name, name): meaning for name, meaning in given.items()})
    known = {**table.given, **resolved}
    return table._replace(given={name: meaning for name, meaning in known.items() if name in names})


def _reshape(table: _Table, arm: "arms.Arm | None", given: Mapping[str, str], joined: bool) -> _Table:
    """With columns called by the words in cells beside them, a row for each state, and points on a body as its pose."""
    known = formats.find_format(table.path)
    if not joined and (known is None or not known.is_table):
        return table
    about = f"{table.path.name}: " if joined else ""
    notes = [*table.notes]
    if (named := table_words.name_by_cells(table.numbers, table.words)) is not None:
        notes += [f"{about}{said}" for said in inspection.describe_named_columns(named)]
        words = {name: cells for name, cells in table.words.items() if name not in named.by}
        table = table.called(named.in_file) if named.in_file else table.remade(named.columns, words, "named")
        table = _give_meanings(table, given)
    states = pose_points.gather_points(table.numbers, table.words, arm, table.given, str(table.path))
    if states is not None:
        notes += [f"{about}{said}" for said in inspection.describe_points(states.found, states.taken)]
        table = table.remade(states.columns, states.found.words, "poses")
    body = reflectors.with_pose_of_reflectors(table.numbers) if states is None else states.pose
    if body is not None:
        notes += [f"{about}{said}" for said in inspection.describe_reflectors(body)]
        table = table.remade(body.columns, table.words, "poses")
    return _give_meanings(table, given)._replace(notes=notes)


def _solve_pairs(table: _Table, arm: "arms.Arm | None", source: str) -> tuple[_Table, list[str]]:
    """Pairs of poses as joints and poses, as of a hand-eye calibration; any other table as it is."""
    given = {name: meaning for name, meaning in table.given.items() if name in table.numbers}
    meanings = pose_inspection.inspect([*table.numbers.items()], arm, given, str(table.path))
    alone = pose_joining.File(str(table.path), table.path.stem, table.numbers, meanings, table.words)
    if not pose_joining.is_of_pairs(alone):
        return table, table.notes
    if arm is None:
        named = command_line("init", source, "--arm", "NAME")
        raise InputError(
            f"{table.path}: holds pairs of poses and no joints, which the nominal kinematics of the arm give; name it, "
            f"`{named}`"
        )
    pairs = pose_joining.solve_pairs(alone, arm)
    return table.remade(pairs.columns, {}, "poses"), [*table.notes, *inspection.describe_pairs(pairs, arm.name)]


def _join(one: _Table, other: _Table, arm: "arms.Arm", pose_source: str | None) -> tuple[_Table, list[str]]:
    """The table of two files, called after the second, and how they were joined."""
    notes = [*one.notes, *other.notes]
    joined = []
    for table in (one, other):
        given = {name: meaning for name, meaning in table.given.items() if name in table.numbers}
        meanings = pose_inspection.inspect([*table.numbers.items()], arm, given, str(table.path), pose_source)
        joined.append(pose_joining.File(str(table.path), table.path.stem, table.numbers, meanings, table.words))
    joints, poses = _assign_roles(*joined)
    if joints.found.of("q") is None:
        moved = pose_joining.with_joints(joints, arm)
        joints = moved.file
        notes += inspection.describe_solved_joints(moved, arm.name)
    whole = pose_joining.join_files(joints, poses, arm)
    notes += inspection.describe_joined_files(whole, Path(joints.source).name, Path(poses.source).name)
    given = {name: meaning for name, meaning in {**one.given, **other.given}.items() if name in whole.columns}
    return one.remade(whole.columns, {}, "")._replace(made=other.path.stem, given=given), notes


def _write(table: _Table, overwrite: bool) -> Path:
    import pyarrow as pa

    numbers = pa.table(table.numbers)
    return write_atomically(table.path, lambda target: tables.write_table(numbers, target), overwrite)


def _assign_roles(
    one: "pose_joining.File", other: "pose_joining.File"
) -> "tuple[pose_joining.File, pose_joining.File]":
    """The file with the joints and the one with the poses, whatever their order.

    Where neither has joints, the robot's is the one whose poses are the controller's by their names, or the first.
    """
    with_joints = [file for file in (one, other) if file.found.of("q") is not None]
    if len(with_joints) == 2:
        raise InputError(
            f"{one.source} and {other.source}: both have joint positions; say which are none by --column NAME=ignore"
        )
    roles = [any(source.role == "controller" for source in file.found.sources) for file in (one, other)]
    joints = with_joints[0] if with_joints else other if roles == [False, True] else one
    poses = other if joints is one else one
    if poses.found.of("position") is None:
        raise InputError(
            f"{poses.source}: no columns look like positions of the tool; say which they are, --column NAME=x_mm "
            "--column NAME=y_mm --column NAME=z_mm"
        )
    return joints, poses


# ------------------------------------------------------------------ images


@final
@dataclass(frozen=True)
class Detect:
    """Find the corners of a board in images, by OpenCV, and write them as a recording of a camera.

    Joints are those of a table with a row an image, in the order of the images, or with a column `image` of their
    names. Where no camera is declared, its lens is calibrated from the images and refined with the arm.

    For example:

        lite6jax detect images --board charuco:7x5,20mm --joints joints.csv --arm lite6
        lite6jax detect images --board charuco:7x5,20mm,15mm,5X5_100 --joints joints.csv --mounted on_flange
        lite6jax detect images --board checkerboard:8x5,25mm --joints joints.csv --arm lite6
    """

    source: Annotated[Positional[tuple[str, ...]], arg(metavar="IMAGES")]
    """Images, or the folder that holds them."""
    board: Annotated[str, arg(metavar="charuco:7x5,20mm")]
    """The board by its squares, columns and rows, and their side. Of a ChArUco board a marker's side (three quarters of
    a square's) and the dictionary (4X4_50) may follow; a checkerboard has no markers."""
    joints: Annotated[Path, arg(metavar="FILE")]
    """The joints at which the images were taken (.csv, .parquet)."""
    out: command.OutFile = None
    """Write the recording here (.csv or .parquet); beside the joints, as NAME_corners.csv, where not given."""
    mounted: Literal["fixed", "on_flange"] = "fixed"
    """fixed: the camera stands, and the board is on the flange; on_flange: the other way round."""
    arm: command.ArmName = None
    """The nominal arm: a bundled name, or a file."""
    set: Annotated[tuple[str, ...], UseAppendAction, arg(metavar="KEY=VALUE")] = ()
    """A key of the sidecar, such as pixel_noise_px=0.2. May be repeated."""
    force: command.Force = False

    def run(self) -> int:
        """Detects, writes, prints."""
        import numpy as np

        out = self.out or self.joints.with_name(f"{self.joints.stem}_corners.csv")
        sidecar = recordings.sidecar_path(out)
        command.check_outputs([out, sidecar], [self.joints, *self.source], self.force)
        board, given = boards.parse_board(self.board), command.parse_pairs("--set", self.set, as_yaml=True)
        arm = None if self.arm is None else files.read_arm(self.arm)
        joints = recordings.read_recording(self.joints, arm=arm)
        images = boards.list_images(self.source)
        rows = boards.match_rows(images, self.joints)
        corners = boards.detect_corners(images, board)
        declared = {"pose_source": "camera", "motion": "static"} | given
        # beside the joints, as their sidecar's paths are; both move with the recording
        named = None if self.arm is None else command.name_arm(self.arm, self.joints)
        settings = sidecar_settings.declared_settings(joints.settings, named, declared)
        settings = replace(settings, board=settings.board or board.settings)
        error = None
        if settings.camera is None:
            camera, error = boards.calibrate_lens(corners, board, self.mounted)
            settings = replace(settings, camera=camera)
        at = {int(row): k for k, row in enumerate(joints.row)}
        kept = [k for k, row in enumerate(rows) if corners.shown[k] and int(row) in at]
        moved = joints.select(np.array([at[int(rows[k])] for k in kept]))
        readings = recordings.readings_from_arrays("camera", pixels=corners.pixels[kept])
        found = moved.made_anew(position=None, quaternion=None, readings=readings, settings=settings)
        written = [recordings.write_recording(found, out, self.force), sidecar]
        left_out = [images[k].name for k in range(len(images)) if k not in kept]
        screen.show(self._page(found, left_out, board, error))
        if corners.legacy:
            screen.show(
                screen.notes(["the board has the pattern of OpenCV before 4.6: its first square is white, not black"])
            )
        screen.written(written)
        return command.DONE

    def _page(
        self, found: "recordings.Recording", left_out: list[str], board: "boards.Board", error: float | None
    ) -> "Iterator[RenderableType]":
        import numpy as np
        from rich.text import Text

        assert found.readings is not None
        seen = np.isfinite(found.readings.pixels[..., 0]).sum()
        images, every = found.samples + len(left_out), board.settings.columns * board.settings.rows
        yield Text(f"{found.samples} of {images} images show the board: {seen} corners, {every} at most in each.")
        if left_out:
            listed = ", ".join(left_out[:6]) + (f" and {len(left_out) - 6} more" if len(left_out) > 6 else "")
            yield Text(f"Left out, as they show fewer than 6 corners or have no joints: {listed}.")
        camera = found.settings.camera
        if error is not None and camera is not None:
            yield Text(
                f"The camera, calibrated from the images: fx {camera.fx:.1f}, fy {camera.fy:.1f}, cx {camera.cx:.1f}, "
                f"cy {camera.cy:.1f} px; its corners are {error:.2f} px off (RMS). They are "
                "refined with the arm."
            )
