"""What was recognised in a table, in words: on the screen, and as the comments of the sidecar that `init` writes.

The texts are in `templates/inspection.yaml`, with the keys of a sidecar.
"""

import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import yaml
from rich.console import RenderableType

from lite6jax.domains.pose.inspection import READINGS_OF, Inspection, Pose, poses_of
from lite6jax.domains.pose.joining import JoinedFiles, SolvedPairs, WithJoints
from lite6jax.domains.pose.reflectors import WithPose
from lite6jax.domains.pose.screening.options import ScreeningOptions
from lite6jax.errors import command_line
from lite6jax.recordings.columns import DEVIATION, FINE, IGNORED, MATRIX, spelled, units_of
from lite6jax.recordings.naming import Block, Role, says_torque, unit_of, units_allowed
from lite6jax.recordings.sizes import Decision
from lite6jax.recordings.streams import said_of
from lite6jax.recordings.words import NamedColumns, Points
from lite6jax.report.screen import indented, unbroken
from lite6jax.report.words import fill, read_texts, say

_TEXTS = read_texts("inspection.yaml")
_MANY = 3
"""Columns that are named one by one; of more, the first and the last."""
_SHOWN = 8
"""Columns that are left out and named."""

KEYS: Mapping[str, tuple[str, str]] = {key: (one["meaning"], one["example"]) for key, one in _TEXTS["keys"].items()}
"""The keys of `recording` in a sidecar: what each means, and an example."""

_NOISES: Mapping[str, tuple[str, ...]] = {
    "tau": ("torque_noise_Nm",),
    "position": ("position_noise_m",),
    "rotation": ("orientation_noise_rad",),
    "contact": ("contact_noise_m",),
    "plane": ("plane_noise_m",),
    "distance": ("distance_noise_m",),
    "axis": ("axis_noise_m",),
    "camera": ("pixel_noise_px",),
}
"""The keys of the noise of each kind of block and of reading."""


def inspection_report(found: Inspection, path: str) -> Iterator[RenderableType]:
    """What each column means, how sure that is, and why."""
    used = len({column for block in found.blocks for column in block.columns} | set(found.given))
    unused = len(found.unused) + len(found.texts)
    yield unbroken(path)
    yield from (fill(_TEXTS["rows"], {"found": found, "used": used, "unused": unused}), "")
    recognised: dict[str, str] = {}
    for block in found.blocks:
        yield indented(statement(block))
        recognised |= block.renamed()
    for own, (quantity, unit) in found.announced.items():
        facts = {"own": own, "quantity": _TEXTS["readings"][quantity], "name": found.given[own]}
        yield indented(fill(_TEXTS["announced"], facts, sure="" if unit is None else _sure(unit)))
    for own, name in found.given.items():
        if recognised.get(own) != name and own not in found.announced:
            yield indented(f"{own}: {name}, {'by name' if own == name else 'as given'}.")
    for own, why in found.denied.items():
        yield indented(f"{own}: {_TEXTS['denied'][why]}, so it is not used.")
    rest = [name for name in (*found.unused, *found.texts) if name not in found.denied]
    if rest:
        yield indented(f"Not used: {_listed(rest)}.")
    yield ""
    for source in found.sources if len(found.sources) > 1 else ():
        yield f"{source_statement(source)}{' It is taken.' if source.taken else ''}"
    yield arm_statement(found)
    yield from [_TEXTS["computed"]] if found.computed else []
    yield f"Motion: {found.motion[0]}; {found.motion[1]}."


def no_angles(joints: Block) -> str:
    """Joint positions that may be no angles, and what to do."""
    reason = joints.unit.reason if joints.unit else "percent"
    unit = "mdeg" if reason == "whole" else "deg"
    facts = {
        "columns": _columns(joints.columns),
        "wrong": _TEXTS["angles"][reason],
        "unit": _TEXTS["units"][unit],
        "ways": [_column_option(own, f"q{k}_{unit}") for k, own in enumerate(joints.columns, 1)],
        "fine": [spelled("q", 1, other) for other in units_of("q") if other in FINE - {unit}] * (reason == "whole"),
    }
    return fill(_TEXTS["no_angles"], facts)


def source_statement(source: Pose) -> str:
    """One of several poses: whose it is, and how well the arm reproduces it."""
    more = {"columns": _columns(source.columns), "role": _TEXTS["roles"][source.role or "unknown"]}
    return fill(_TEXTS["source"], {"computed": source.computed, "error": source.error, **more})


def choice_of_pose(found: Inspection) -> str:
    """Several poses of which none is taken, and how to say which is meant."""
    roles: list[Role | None] = [source.role for source in found.sources]
    keys = {"laser_tracker": "laser_tracker (or motion_capture, camera)", "controller_fk": "controller_fk"}
    ways = [f"--set pose_source={text}" for key, text in keys.items() if len(poses_of(roles, key)) == 1]
    ignored = (_column_option(name, IGNORED) for name in found.sources[0].columns)
    ways.append(f"leaving out what is not meant, such as {' '.join(ignored)}")
    said = list(map(source_statement, found.sources))
    return fill(_TEXTS["poses"], {"count": len(said), "said": said, "ways": ways})


def choice_of_motors(found: Inspection) -> str:
    """More motors than the arm has joints, and how to say which are meant."""
    arm, motors = found.arm, found.motors
    assert arm is not None
    names = arm.joint_names or [f"q{k + 1}" for k in range(arm.dof)]
    ways = list(map(_column_option, motors[0], found.joint_columns))
    facts = {"count": sum(map(len, motors)), "motors": list(map(_columns, motors)), "arm": arm, "names": names}
    return fill(_TEXTS["motors"], facts, ways=ways)


def _column_option(name: str, meaning: str) -> str:
    """`--column name=meaning`, as it is typed."""
    return command_line("--column", f"{name}={meaning}").partition(" ")[2]


def statement(block: Block) -> str:
    """A block in one or two sentences."""
    form, unit = block.form, block.unit.choice if block.unit else ""
    if block.unit and unit:
        unit = _TEXTS["units"].get(unit, unit.replace("_per_s2", "/s²").replace("_per_s", "/s"))
        unit = f"{'in ' if form is None else ''}{unit} ({_sure(block.unit)})"
    facts = {
        "kind": _kind(block),
        "columns": _columns(block.columns),
        "form": form and f"{fill(_TEXTS['forms'][form.choice], {'order': _order(block.columns)})} ({_sure(form)})",
        "unit": unit,
        "commanded": block.kind == "cmd",
        "assumed": _commanded(block),
        "rivals": _listed(block.rivals) if block.rivals else "",
    }
    return fill(_TEXTS["block"], facts)


def _order(columns: Sequence[str]) -> str:
    """In which order the columns r11, r12, …, r33 of a matrix are numbered."""
    numbers = [int(number) for name in columns for number in re.findall(r"\d+", name)[-1:]]
    if len(numbers) != len(MATRIX) or len({*numbers}) < len(MATRIX):
        return "rows"
    return "rows" if numbers[1] < numbers[3] else "columns"


def _commanded(block: Block) -> bool:
    """Whether joint columns are taken for measured ones that by name were commanded or computed."""
    return block.rank == 2 and bool(block.joints) and block.kind != "cmd"


def _kind(block: Block) -> str:
    return _TEXTS["slides" if block.slides else "kinds"][block.kind]


def _sure(decision: Decision) -> str:
    n = dict(decision.numbers)
    if decision.reason == "kinematics":
        other = min(n["others"].values(), default=None)
        n["ratio"] = None if other is None else other / max(n["error"], 1e-12)
    return f"{decision.sure}: {fill(_TEXTS['reasons'][decision.reason], n)}"


def arm_statement(found: Inspection) -> str:
    """Which arm it is, and how well its nominal kinematics agree."""
    name = found.arm and found.arm.name
    return fill(
        _TEXTS["arm"],
        {
            "name": name,
            "tried": "; ".join(f"{other}: {1e3 * error:.3g} mm" for other, error in found.arms[:4]),
            "compared": bool(found.arms),
            "missed": found.arm and found.error > ScreeningOptions().suspect_reach * found.arm.reach,
            "error": found.error,
            "others": "; ".join(f"{other} to {1e3 * error:.3g} mm" for other, error in found.arms[1:3]),
        },
    )


def sidecar_text(found: Inspection, settings: Mapping[str, Any], table: str) -> str:
    """The YAML of a table's sidecar with every key and what it means; keys without a value are commented out.

    `settings` are the keys of `recording` that are known, as plain YAML values.
    """
    lines = [
        f"# How lite6jax reads {' '.join(table.split())}. Written by `lite6jax init`, to be corrected by hand;",
        "# docs/reference/recordings.md has all columns and keys. A line that begins with # is not in force.",
        "",
    ]
    if found.columns:
        lines += _column_lines(found)
    of = {*found.readings, *(["readings"] if found.readings else ())}
    if found.of("tau") is not None or found.of("current") is not None:
        of.add("torques")
    if found.of("cmd") is not None:
        of.add("commands")
    if found.of("position") is not None or any(name.startswith("x_") for name in found.given.values()):
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


def _column_lines(found: Inspection) -> list[str]:
    lines = ["# What each column is: its name in the table, then what it holds and its unit; `ignore` for nothing."]
    lines.append("columns:")
    told = dict(found.columns)
    for block in found.blocks:
        lines += _wrapped(statement(block))
        in_file = [found.in_file.get(own, own) for own in block.columns]
        lines += [_entry(own, told.pop(own)) for own in in_file if own in told]
    rest = {own: name for own, name in told.items() if name != IGNORED}
    unused = {own: name for own, name in told.items() if name == IGNORED}
    for comment, entries in (("As given.", rest), ("Not used.", unused)):
        if entries:
            lines += [f"  # {comment}", *(_entry(own, name) for own, name in entries.items())]
    return [*lines, ""]


def _entry(own: str, name: str) -> str:
    dumped = yaml.safe_dump({own: name}, allow_unicode=True, width=1 << 20, default_flow_style=False).rstrip("\n")
    return "\n".join(f"  {line}" for line in dumped.split("\n"))


def _flow(value: Any) -> str:
    dumped = yaml.safe_dump(value, default_flow_style=True, allow_unicode=True, width=1 << 20)
    return dumped.removesuffix("\n").removesuffix("...").strip()


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(
        text, 118, initial_indent="  # ", subsequent_indent="  # ", break_long_words=False, break_on_hyphens=False
    )


def _columns(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= _MANY else f"{names[0]} … {names[-1]}"


def _listed(names: Sequence[str], most: int = 8) -> str:
    return ", ".join(repr(name[:40]) for name in names[:most]) + (
        f" and {len(names) - most} more" if len(names) > most else ""
    )


def next_steps(found: Inspection, settings: Mapping[str, Any], source: str) -> Iterator[RenderableType]:
    """What is still unknown, and the command that follows."""
    q, tau, current, position = map(found.of, ("q", "tau", "current", "position"))
    efforts = tau and tau.unit and tau.unit.sure == "assumed" and not says_torque(tau.columns[0])
    timed = found.of("time") is not None or any(name.startswith("time") for name in found.given.values())
    noises = list(_NOISES["tau"]) if tau is not None or current is not None else []
    for measured in ("position", "rotation") if position is not None and not found.computed else ():
        noises += _NOISES[measured] if found.of(measured) is not None else ()
    noises += [key for kind in found.readings for key in _NOISES[kind]]
    matrix = found.of("rotation")
    matrix = matrix if matrix and matrix.form and matrix.form[:2] == (MATRIX[0], "assumed") else None
    transposed = [f"r{name[2]}{name[1]}" for name in MATRIX]
    alone = position is None and tau is None and current is None and not found.given
    tracked = alone and q is not None and found.of("cmd") is not None
    nothing = alone and not tracked
    noises += ["joint_noise_rad"] if tracked else []
    facts = {
        "doubtful": [
            _kind(block).lower()
            for block in found.blocks
            if "assumed" in [one.sure for one in (block.unit, block.form) if one] or _commanded(block)
        ],
        "q_commanded": q is not None and _commanded(q) and "joint_source" not in settings,
        "tau_commanded": tau is not None and _commanded(tau) and "torque_source" not in settings,
        "as_current": tau and efforts and _column_option(tau.columns[0], f"current{tau.joints[0]}_A"),
        "currents": tau is None and current is not None and "torque_constant_Nm_per_A" not in settings,
        "computed": found.computed,
        "said": settings.get("pose_source", "unknown"),
        "of_controller": any(one.taken and one.role == "controller" for one in found.sources),
        "turned": matrix and [_column_option(own, name) for own, name in zip(matrix.columns, transposed, strict=True)],
        "deviations": [
            _column_option(own, f"{name}_{unit_of(own) or 'mm'}")
            for own, name in zip(found.unclear_deviations, DEVIATION, strict=False)
        ],
        "noises": [key for key in noises if key not in settings],
        "announced": settings["pose_source"] if settings.get("pose_source") in READINGS_OF else "",
        "nothing": nothing,
        "readings": [(source, own, _TEXTS["readings"][quantity]) for source, own, quantity in found.likely_readings],
        "tracked": tracked,
        "untimed": "" if position or timed or not (tau or current or tracked) else _named_time(found.unused),
    }
    yield from say(_TEXTS["next"], facts)
    if not nothing:
        yield "Next:" if "arm" in settings else "Name the arm in the sidecar, then:"
        yield unbroken(command_line("diagnose", source, "--out", "diagnosis.json"))


def _named_time(unused: Sequence[str]) -> str:
    """How to name a column of times: one whose name has a unit of time, or the first that means nothing."""
    timed = {name: unit for name in unused if (unit := unit_of(name)) in units_allowed("time")}
    name, unit = next(iter(timed.items()), (next(iter(unused), None), "s"))
    return "record them" if name is None else f"say in the sidecar which it is, such as `{name}: time_{unit}`"


# ------------------------------------------------------------------ what was joined to one table


def describe_joined_files(found: JoinedFiles, joints: str, poses: str) -> list[str]:
    """How the joints of one file and the poses of another were joined."""
    clocks = found.clocks
    facts: dict[str, Any] = {"found": found, "clocks": clocks, "pairing": found.pairing}
    facts |= {"joints": joints, "poses": poses, "names": found.names}
    if found.names is not None:
        facts["alone"] = [_named(names) for names in found.names.alone]
    if clocks is not None:
        facts["offset"] = clocks.offset + found.start
        facts["drifts"], facts["fitted"] = np.isfinite(clocks.drift_std), np.isfinite(clocks.fitted_error)
    said = _sentences("joined", facts)
    if found.joined is not None:
        said += said_of(found.joined, found.unit)
    said.append(fill(_TEXTS["joined_rows"], found._asdict()))
    if found.left_out:
        shown = ", ".join(found.left_out[:_SHOWN]) + (", …" if len(found.left_out) > _SHOWN else "")
        said.append(f"left out, as they are neither of joints nor of the measured pose: {shown}")
    return said


def _named(names: Sequence[str]) -> str:
    """Some names of rows, and how many more there are."""
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + more


def describe_solved_joints(found: WithJoints, arm: str) -> list[str]:
    """How joints were found from poses."""
    facts = {"count": len(found.path.reached), "missing": int(np.sum(~found.path.reached))}
    return _sentences("solved", {**facts, "source": found.file.source, "arm": arm, "branches": found.path.branches})


def describe_pairs(found: SolvedPairs, arm: str) -> list[str]:
    """How pairs of poses became joints and poses."""
    facts = {"inverted": found.inverted, "errors": found.errors, "solved": found.solved}
    return [*describe_solved_joints(found.solved, arm), *_sentences("pairs", facts)]


def describe_named_columns(found: NamedColumns) -> list[str]:
    """Whose numbers cells name."""
    facts = {"by": _columns(found.by), "words": _named(found.words), "ordered": bool(found.in_file)}
    return _sentences("named", facts)


def describe_points(found: Points, taken: str) -> list[str]:
    """How rows of points became rows of states; `taken` is the one point whose position is read, or none."""
    counts = dict(zip(found.labels, found.counts, strict=True))
    states = len(next(iter(found.columns.values())))
    facts = {"by": found.by, "labels": _named(found.labels), "count": len(found.labels), "states": states}
    return _sentences("points", {**facts, "taken": taken, "seen": counts.get(taken), "whole": min(found.counts)})


def describe_reflectors(found: WithPose) -> list[str]:
    """How points became a pose."""
    names = ", ".join(point[0] for point in found.points[:4]) + (", …" if len(found.points) > 4 else "")
    lost = int(np.sum(~found.pose.rows)) - found.pose.outlying
    mm = 1e3 if found.unit == "m" else 1.0
    return _sentences("reflectors", {"pose": found.pose, "names": names, "lost": lost, "mm": mm})


def _sentences(name: str, facts: Mapping[str, Any]) -> list[str]:
    small = lambda seconds: f"{1e3 * seconds:.2g} ms" if seconds < 1 else f"{seconds:.2g} s"  # noqa: E731
    return list(say(_TEXTS[name], facts, small=small))
