"""What was recognised in a table, in words: on the screen, and as the comments of the sidecar that `init` writes."""

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import yaml
from rich.console import RenderableType
from rich.padding import Padding
from rich.text import Text

from lite6jax.domains.pose.inspection import Inspection, PoseSource, poses_of
from lite6jax.domains.pose.joining import JoinedFiles, WithJoints, WithPose
from lite6jax.domains.pose.meanings import Meaning
from lite6jax.domains.pose.screening.options import ScreeningOptions
from lite6jax.errors import command_line
from lite6jax.recordings.columns import IGNORED
from lite6jax.recordings.naming import Role, says_torque, unit_of, units_allowed
from lite6jax.recordings.sizes import Decision
from lite6jax.recordings.streams import said_of

_KINDS = {
    "q": "Joint positions",
    "dq": "Joint velocities",
    "ddq": "Joint accelerations",
    "tau": "Joint torques",
    "current": "Motor currents",
    "temp": "Joint temperatures",
    "cmd": "Commanded positions",
    "position": "Tool position",
    "rotation": "Tool orientation",
    "time": "Time",
    "payload": "Payload",
    "ambient": "Ambient temperature",
    "run": "Runs",
}
_SLIDES = {
    "q": "Slide positions",
    "dq": "Slide velocities",
    "ddq": "Slide accelerations",
    "tau": "Slide forces",
    "cmd": "Commanded slide positions",
}
"""Of prismatic joints."""
_UNITS = {
    "rad": "radians",
    "deg": "degrees",
    "m": "metres",
    "mm": "millimetres",
    "Nm": "N m",
    "mNm": "mN m",
    "s": "seconds",
    "ms": "milliseconds",
    "us": "microseconds",
    "ns": "nanoseconds",
    "degC": "°C",
}
_FORMS = {
    "scalar_first": "a quaternion w x y z",
    "scalar_last": "a quaternion x y z w",
    "rx": "a rotation vector",
    "roll": "roll, pitch, yaw: Rz(yaw) Ry(pitch) Rx(roll)",
    "rotx": "angles Rx(rotx) Ry(roty) Rz(rotz)",
    "alpha": "Euler angles Rz(alpha) Ry(beta) Rz(gamma)",
    "r11": "a rotation matrix row by row",
}
_DENIED = {"time": "called a time, but it does not increase", "quaternion": "called a quaternion, but not of length 1"}
_ROLES = {"controller": "the controller's", "sensor": "a sensor's", None: "of a source that its name does not say"}
_MANY = 3
"""Columns that are named one by one; of more, the first and the last."""

KEYS: Mapping[str, tuple[str, str]] = {
    "arm": (
        "The arm: a bundled one (`lite6jax arms`), or the path of a description, URDF or MJCF, relative to this file.",
        "lite6",
    ),
    "factory_calibration": (
        "The path of the arm's own six-parameter file. With it the geometry is that, exactly; without, it is fitted.",
        "arm.yaml",
    ),
    "factory_uncertainty": (
        "Standard deviations of the numbers in that file: the geometry is then fitted near it.",
        "{position_m: 1.0e-5, rotation_rad: 1.0e-5}",
    ),
    "joint_source": ("Where the joint positions are from: measured (by encoders), commanded or unknown.", "measured"),
    "joint_noise_rad": ("Noise of the joint positions, one standard deviation in rad.", "1.0e-5"),
    "pose_source": (
        "What measured the poses: laser_tracker, motion_capture, camera, controller_fk (computed by the controller "
        "from the joints, as UR's actual_TCP_pose is: nothing was measured then) or unknown.",
        "laser_tracker",
    ),
    "motion": ("static (the arm stood still at each row) or trajectory.", "static"),
    "pose_frame": (
        "The frame of the poses: base (exactly the arm's base frame) or unknown (the sensor's own, which is fitted).",
        "unknown",
    ),
    "tool": (
        "What the poses are of: none (the flange), unknown (a tool, which is fitted), or its x, y, z, roll, pitch, yaw "
        "on the flange in m and rad.",
        "[0, 0, 0.1, 0, 0, 0]",
    ),
    "position_noise_m": ("Noise of the positions, one standard deviation per axis in m.", "2.0e-5"),
    "orientation_noise_rad": ("Noise of the orientations, one standard deviation per axis in rad.", "1.0e-4"),
    "payload_com_m": ("Centre of mass of the payload in the flange's frame, in m.", "[0, 0, 0.05]"),
    "payload_uncertainty_kg": ("Standard deviation of the payload's mass in kg.", "0.05"),
    "reference_temperature_degC": ("Temperature at which the geometry holds, in degrees Celsius.", "25.0"),
    "gravity_m_per_s2": ("Gravity in the arm's base frame; another on a wall or a ceiling.", "[0, 0, -9.81]"),
    "inertial_uncertainty": (
        "Of poses: relative standard deviation of the links' masses and of the lever arms of their centres.",
        "0.1",
    ),
    "torque_source": (
        "Of torques: measured, current (motor currents), estimated (by the controller's own model) or unknown.",
        "current",
    ),
    "torque_noise_Nm": (
        "Of torques: one standard deviation for each joint in N m (N of a slide).",
        "[0.1, 0.1, 0.1, 0.1, 0.1, 0.1]",
    ),
    "inertial": (
        "Of torques: declared (the arm's inertial numbers are exact), their relative standard deviation, or unknown.",
        "unknown",
    ),
    "torque_constant_Nm_per_A": (
        "Of currents: one number for each joint in N m per A (N per A of a slide), gear included.",
        "[12.0, 12.0, 9.0, 4.0, 4.0, 4.0]",
    ),
    "contact_noise_m": ("Of touches: one standard deviation in m of the touched point about its contact.", "1.0e-4"),
    "contact_distances": (
        "Known distances between contacts; without one the arm's own calibration is to be given.",
        "[{between: [left_0, left_1], distance_m: 0.05, noise_m: 5.0e-5}]",
    ),
    "contact_points": ("Contacts whose coordinates are known, in m.", "{left_0: [0.4, 0.0, 0.02]}"),
    "plane_noise_m": ("Of touches: one standard deviation in m of the touched point from its plane.", "2.0e-5"),
    "planes": ("Planes that are known in the arm's base frame.", "{table: {normal: [0, 0, 1], offset_m: 0.0}}"),
    "distance_noise_m": ("Noise of the distances, one standard deviation in m.", "5.0e-5"),
    "anchor_m": ("Where distances are measured from, in the arm's base frame, or unknown.", "unknown"),
    "distance_offset": ("unknown where a constant is added to each distance, else none.", "none"),
    "axis_noise_m": ("Noise of the heights, one standard deviation in m.", "2.0e-5"),
    "axis": ("The direction of the heights in the arm's base frame, or unknown.", "[0, 0, 1]"),
    "pixel_noise_px": ("Noise of a corner in an image, one standard deviation in pixels.", "0.15"),
    "camera": (
        "The camera by OpenCV's model; fixed, or on_flange.",
        "{mounted: fixed, fx: 1450, fy: 1452, cx: 958, cy: 603, distortion: [0, 0, 0, 0, 0]}",
    ),
    "board": ("The board: corner i is at column i mod columns.", "{columns: 7, rows: 5, square_m: 0.02}"),
    "points_m": ("The corners of a flat board of another form.", "[[0, 0, 0], [0.02, 0, 0], [0, 0.02, 0]]"),
    "date": ("The day of the measurement, for a certificate.", "2026-11-21"),
    "instrument": (
        "With what it was measured, such as type and serial number, for a certificate.",
        "Leica AT960, 750012",
    ),
}
"""The keys of `recording` in a sidecar: what each means, and an example."""
_OF_TORQUES = ("torque_source", "torque_noise_Nm", "inertial", "torque_constant_Nm_per_A")
_OF_POSES = (
    *("pose_source", "pose_frame", "tool", "position_noise_m", "orientation_noise_rad", "factory_calibration"),
    *("factory_uncertainty", "inertial_uncertainty"),
)


_OF_READINGS = {
    "contact": ("contact_noise_m", "contact_distances", "contact_points"),
    "plane": ("plane_noise_m", "planes"),
    "distance": ("distance_noise_m", "anchor_m", "distance_offset"),
    "axis": ("axis_noise_m", "axis"),
    "camera": ("pixel_noise_px", "camera", "board", "points_m"),
}
_TOUCHED = ("pose_source", "tool", "factory_calibration", "factory_uncertainty", "inertial_uncertainty")


def inspection_report(found: Inspection, path: str) -> Iterator[RenderableType]:
    """What each column means, how sure that is, and why."""
    yield Text(path, no_wrap=True, overflow="ignore")
    used = len({column for meaning in found.meanings for column in meaning.block.columns} | set(found.given))
    unused = len(found.unused) + len(found.texts)
    columns = f"{used + unused} columns, of which {used} are used" if unused else f"{used} columns"
    yield Text(f"{found.samples} rows, {columns}.")
    yield ""
    for meaning in found.meanings:
        yield Padding(Text(statement(meaning)), (0, 0, 0, 2))
    recognised = {
        own: name for meaning in found.meanings for own, name in zip(meaning.block.columns, meaning.names, strict=True)
    }
    for own, name in found.given.items():
        if recognised.get(own) == name:
            continue
        yield Padding(Text(f"{own}: {name}, {'by name' if own == name else 'as given'}."), (0, 0, 0, 2))
    for own, why in found.denied.items():
        yield Padding(Text(f"{own}: {_DENIED[why]}, so it is not used."), (0, 0, 0, 2))
    rest = [name for name in (*found.unused, *found.texts) if name not in found.denied]
    if rest:
        yield Padding(Text(f"Not used: {_listed(rest)}."), (0, 0, 0, 2))
    yield ""
    for source in found.sources if len(found.sources) > 1 else ():
        yield Text(f"{source_statement(source)}{' It is taken.' if source.taken else ''}")
    yield Text(arm_statement(found))
    if found.computed:
        yield Text(
            "The poses are the controller's own computation from the joints: no sensor is that exact. They show no "
            "error of the arm; their pose_source is controller_fk."
        )
    yield Text(f"Motion: {found.motion[0]}; {found.motion[1]}.")


def no_angles(joints: Meaning) -> str:
    """Joint positions that may be no angles, and what to do."""
    degrees = " ".join(_column_option(own, f"q{k}_deg") for k, own in enumerate(joints.block.columns, 1))
    if joints.unit.reason == "ticks":
        wrong = "look like raw ticks of servos (4096 a turn), which are no angles: write (ticks - 2048) * 360 / 4096"
    else:
        wrong = (
            "look like LeRobot's normalised values (-100 to 100 of each joint's calibrated range), which are no "
            "angles: record again with use_degrees=True, or convert them by the ranges of the arm's calibration"
        )
    return f"joints {_columns(joints.block.columns)} {wrong}. If they are degrees, say so: {degrees}"


def source_statement(source: PoseSource) -> str:
    """One of several poses: whose it is, and how well the arm reproduces it."""
    said = f"Pose {_columns(source.columns)}: {_ROLES[source.role]}"
    if source.computed:
        return f"{said}, computed from the joints: the nominal arm reproduces it to {1e3 * source.error:.2g} mm."
    return said + (f"; the nominal arm reproduces it to {1e3 * source.error:.3g} mm." if source.error < 1e3 else ".")


def choice_of_pose(found: Inspection) -> str:
    """Several poses of which none is taken, and how to say which is meant."""
    said = " ".join(map(source_statement, found.sources))
    roles: list[Role | None] = [source.role for source in found.sources]
    keys = {"laser_tracker": "laser_tracker (or motion_capture, camera)", "controller_fk": "controller_fk"}
    ways = [f"--set pose_source={text}" for key, text in keys.items() if len(poses_of(roles, key)) == 1]
    ignored = (_column_option(name, IGNORED) for name in found.sources[0].columns)
    ways.append(f"leaving out what is not meant, such as {' '.join(ignored)}")
    return f"it holds {len(found.sources)} poses. {said} Choose by {', or '.join(ways)}"


def choice_of_motors(found: Inspection) -> str:
    """More motors than the arm has joints, and how to say which are meant."""
    assert found.arm is not None
    names = ", ".join(found.arm.joint_names or (f"q{k + 1}" for k in range(found.arm.dof)))
    ways = " ".join(map(_column_option, found.motors[0], found.joint_columns))
    return (
        f"it holds {sum(map(len, found.motors))} joint positions ({'; '.join(map(_columns, found.motors))}), and "
        f"{found.arm.name} has {found.arm.dof} joints ({names}): say which they are, such as {ways}"
    )


def _column_option(name: str, meaning: str) -> str:
    """`--column name=meaning`, as it is typed."""
    return command_line("--column", f"{name}={meaning}").partition(" ")[2]


def statement(meaning: Meaning) -> str:
    """A block in one or two sentences."""
    block = meaning.block
    said = f"{_kind(meaning)}: {_columns(block.columns)}"
    if meaning.form is not None:
        said += f", {_FORMS[meaning.form.choice]} ({_sure(meaning.form)})"
    if meaning.unit.choice:
        unit = meaning.unit.choice
        unit = _UNITS.get(unit, unit.replace("_per_s2", "/s²").replace("_per_s", "/s"))
        said += f", {'in ' if meaning.form is None else ''}{unit} ({_sure(meaning.unit)})"
    said += "."
    if block.kind == "cmd":
        said += " They are kept beside the measured ones; nothing uses them yet."
    elif _commanded(meaning):
        said += " By name they were commanded or computed; that they were measured is assumed."
    if block.rivals:
        said += f" {_listed(block.rivals)} may be meant instead: choose with --column."
    return said


def _commanded(meaning: Meaning) -> bool:
    """Whether joint columns are taken for measured ones that by name were commanded or computed."""
    return meaning.block.rank == 2 and bool(meaning.block.joints) and meaning.block.kind != "cmd"


def _kind(meaning: Meaning) -> str:
    return (_SLIDES if meaning.block.slides else _KINDS)[meaning.block.kind]


def _sure(decision: Decision) -> str:
    return f"{decision.sure}: {_reason(decision)}"


def _reason(decision: Decision) -> str:
    n = decision.numbers
    if decision.reason == "kinematics":
        other = min(n["others"].values(), default=None)
        least = n["error"]
        if other is None:
            return "the arm's kinematics agree"
        ratio = other / max(least, 1e-12)
        times = f"{ratio:.3g} times" if ratio < 1e3 else "over 1000 times"
        return f"the arm's kinematics agree {times} better than with the next reading"
    if decision.reason == "slope":
        times = "" if 0.5 < n["ratio"] < 2 else f"{n['ratio']:.3g} times "
        return f"they are {times}what the positions change per second in {n['unit']}"
    return {
        "name": "by name",
        "beyond_turns": "they reach {largest:.4g}, beyond any joint's turns in rad",
        "encoder_steps": "they change in steps of a servo's encoder in degrees",
        "follows": "the joints follow them",
        "register": "whole numbers up to {largest:.4g}, so they may be the register of a drive and no torques",
        "endless": "they reach {largest:.4g}, and the joint turns without end",
        "percent": "the largest is {largest:.3g}, so they may be normalised: -100 to 100 of each joint's range",
        "ticks": "whole numbers up to {largest:.4g}, so they may be ticks of servos, 4096 a turn",
        "within_turns": "none is beyond {largest:.3g}",
        "as_positions": "as the positions",
        "beyond_reach": "they spread over {spread:.4g}, beyond any arm's reach in metres",
        "within_reach": "they spread over {spread:.3g}",
        "largest": "the largest is {largest:.3g}",
        "usual": "the usual unit",
        "orthogonal": "in no other order are they rotations",
        "usual_name": "as these names are usually meant",
        "usual_quaternion": "as ROS writes it",
        "largest_angle": "the largest is {largest:.3g}",
        "beyond_half_turn": "they reach {largest:.3g} rad, and a rotation vector ends at half a turn",
        "within_half_turn": "none is beyond half a turn",
        "usual_degrees": "as degrees usually are",
        "clock": "a clock that counts from 1970",
        "step": "rows would be {step_s:.3g} s apart",
    }[decision.reason].format(**n)


def arm_statement(found: Inspection) -> str:
    """Which arm it is, and how well its nominal kinematics agree."""
    if found.arm is None:
        tried = "; ".join(f"{name}: {1e3 * error:.3g} mm" for name, error in found.arms[:4])
        if not tried:
            return "Arm: unknown. Name it with --arm, or `arm:` in the sidecar; `lite6jax arms` lists the bundled ones."
        return f"Arm: none of the bundled ones alone agrees (median errors: {tried}). Name it with --arm."
    if not found.arms:
        return f"Arm: {found.arm.name}, as given; there are no poses to compare it with."
    near = f"its nominal kinematics agree with the poses to {1e3 * found.error:.3g} mm (median)"
    if found.error > ScreeningOptions().suspect_reach * found.arm.reach:
        missed = f"its nominal kinematics miss the poses by {1e3 * found.error:.3g} mm (median)"
        return f"Arm: {found.arm.name}, as given; as the columns are read, {missed}."
    others = "; ".join(f"{name} to {1e3 * error:.3g} mm" for name, error in found.arms[1:3])
    return f"Arm: {found.arm.name}; {near}" + (f", {others}." if others else ".")


def sidecar_text(found: Inspection, settings: Mapping[str, Any], table: str) -> str:
    """The YAML of a sidecar with every key and what it means; keys without a value are commented out.

    Args:
        found: the columns.
        settings: keys of `recording` that are known, as plain YAML values.
        table: the name of the recording's file.
    """
    lines = [
        f"# How lite6jax reads {' '.join(table.split())}. Written by `lite6jax init`, to be corrected by hand;",
        "# docs/reference/recordings.md has all columns and keys. A line that begins with # is not in force.",
        "",
    ]
    if found.columns:
        lines += _column_lines(found)
    torques = found.of("tau") is not None or found.of("current") is not None
    poses = found.of("position") is not None or any(name.startswith("x_") for name in found.given.values())
    lines.append("recording:" if settings else "recording: {}  # nothing is declared yet")
    shown = {*KEYS} - {*_OF_TORQUES, *_OF_POSES}.union(*_OF_READINGS.values())
    shown |= {*(_OF_TORQUES if torques else ()), *(_OF_POSES if poses else ()), *settings}
    shown |= {*(_TOUCHED if found.readings else ())}.union(*(_OF_READINGS[kind] for kind in found.readings))
    for key, (meaning, example) in KEYS.items():
        if key not in shown:
            continue
        lines += _wrapped(meaning)
        value = _flow(settings[key]) if key in settings else example
        lines.append(f"  {key}: {value}" if key in settings else f"  # {key}: {example}")
    return "\n".join(lines) + "\n"


def _column_lines(found: Inspection) -> list[str]:
    lines = ["# What each column is: its name in the table, then what it holds and its unit; `ignore` for nothing."]
    lines.append("columns:")
    told = dict(found.columns)
    for meaning in found.meanings:
        lines += _wrapped(statement(meaning))
        lines += [_entry(own, told.pop(own)) for own in meaning.block.columns if own in told]
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
    doubtful = [
        _kind(meaning).lower()
        for meaning in found.meanings
        if "assumed" in (meaning.unit.sure, meaning.form.sure if meaning.form else "") or _commanded(meaning)
    ]
    if doubtful:
        yield Text(f"Check in the sidecar what was assumed: {', '.join(doubtful)}.")
    q, tau, current = map(found.of, ("q", "tau", "current"))
    if q is not None and _commanded(q) and "joint_source" not in settings:
        yield Text("If the joint positions were commanded, write joint_source: commanded.")
    if tau is not None and _commanded(tau) and "torque_source" not in settings:
        yield Text("If the controller computed the torques by a model, write torque_source: estimated.")
    if tau is not None and tau.unit.sure == "assumed" and not says_torque(tau.block.columns[0]):
        as_current = _column_option(tau.block.columns[0], f"current{tau.block.joints[0]}_A")
        yield Text(f"If the efforts are currents, say so for each: {as_current}.")
    if tau is None and current is not None and "torque_constant_Nm_per_A" not in settings:
        yield Text("Currents become torques by torque_constant_Nm_per_A in the sidecar, one number for each joint.")
    said = settings.get("pose_source", "unknown")
    if found.computed and said not in ("controller_fk", "unknown"):
        yield Text(f"The poses were computed, not measured by a {said}: errors of the arm do not show in them.")
    elif said == "unknown" and any(source.taken and source.role == "controller" for source in found.sources):
        yield Text("The poses have a name of the controller's. If it computed them, write pose_source: controller_fk.")
    if found.of("position") is None and found.of("tau") is None and found.of("current") is None and not found.given:
        yield Text("There are neither poses nor torques: this is a motion, to predict or to compute with.")
        return
    torques = found.of("position") is None and (found.of("tau") or found.of("current")) is not None
    if torques and found.of("time") is None and not any(name.startswith("time") for name in found.given.values()):
        yield Text(f"Torques need times, and no column looks like them: {_named_time(found.unused)}.")
    yield Text("Next:" if "arm" in settings else "Name the arm in the sidecar, then:")
    yield Text(command_line("diagnose", source, "--out", "diagnosis.json"), no_wrap=True, overflow="ignore")


def _named_time(unused: Sequence[str]) -> str:
    """How to name a column of times: one whose name has a unit of time, or the first that means nothing."""
    timed = {name: unit for name in unused if (unit := unit_of(name)) in units_allowed("time")}
    name, unit = next(iter(timed.items()), (next(iter(unused), None), "s"))
    return "record them" if name is None else f"say in the sidecar which it is, such as `{name}: time_{unit}`"


# ------------------------------------------------------------------ what was joined to one table

_SHOWN = 8
"""Columns that are left out and named."""


def describe_joined_files(found: JoinedFiles, joints: str, poses: str) -> list[str]:
    """How the joints of one file and the poses of another were joined."""
    said = []
    if (clocks := found.clocks) is not None:
        offset = clocks.offset + found.start
        said.append(
            f"the clock of {joints} is ahead of that of {poses} by {offset:.6f} s ± {_small(clocks.offset_std)} in the "
            "middle of the poses: found from the motion, beside the sensor's frame, the tool and the arm's geometry"
        )
        if np.isfinite(clocks.drift_std):
            said.append(
                f"the clock of {joints} runs {1e6 * clocks.drift:.1f} ± {1e6 * clocks.drift_std:.2g} ppm faster; the "
                "joined table has its times"
            )
        else:
            said.append(
                f"the arm stood still at every pose: the offset is known within {_small(clocks.offset_std)} only, and "
                "the drift cannot be estimated"
            )
        fitted = f", with its geometry fitted to {1e3 * clocks.fitted_error:.3g} mm"
        said.append(
            f"at these times the nominal arm agrees with the poses to {1e3 * clocks.error:.3g} mm (median)"
            + (fitted if np.isfinite(clocks.fitted_error) else "")
            + "; a delay of the sensor is a part of the offset"
        )
    if (pairing := found.pairing) is not None:
        missing = [
            f"the first {first} and the last {count - first - pairing.rows} {what} are left out"
            for first, count, what in (
                (pairing.joint, found.states, f"joint states of {joints}"),
                (pairing.position, found.poses, f"poses of {poses}"),
            )
            if count > pairing.rows
        ]
        said.append(
            f"{pairing.rows} joint states and poses were captured one by one and are paired in their order, which the "
            f"nominal arm confirms to {1e3 * pairing.error:.3g} mm (median)" + "".join(f"; {part}" for part in missing)
        )
    if found.joined is not None:
        said += said_of(found.joined, found.unit)
    said.append(f"joined {found.rows} rows of {found.states} joint states and {found.poses} poses")
    if found.left_out:
        shown = ", ".join(found.left_out[:_SHOWN]) + (", …" if len(found.left_out) > _SHOWN else "")
        said.append(f"left out, as they are neither of joints nor of the measured pose: {shown}")
    return said


def describe_solved_joints(found: WithJoints, arm: str) -> list[str]:
    """How joints were found from poses."""
    count, missing = len(found.path.reached), int(np.sum(~found.path.reached))
    said = [
        f"{found.file.source} has poses and no joints: these are assumed to be of the flange in the base of the {arm}, "
        "and the joints are those of its kinematics, not what encoders read; where the controller computes with a "
        "calibration of the arm, name that as the arm",
        f"{found.path.branches} branches (shoulder, elbow, wrist) reach the first pose alike: the one nearest to the "
        "middle of the joints' limits that follows the others is assumed, and kept from row to row",
    ]
    return said + ([f"{missing} of {count} poses are not reached on it and are left out"] if missing else [])


def describe_reflectors(found: WithPose) -> list[str]:
    """How points became a pose."""
    pose, mm = found.pose, 1e3 if found.unit == "m" else 1.0
    lost = int(np.sum(~pose.rows)) - pose.outlying
    first = ", ".join(point[0] for point in found.points[:4]) + (", …" if len(found.points) > 4 else "")
    said = [
        f"{pose.points} points ({first}) keep their distances and became the pose of one body: its position is their "
        "centre, its axes are the sensor's at the first row with all points",
        f"the points differ from the body's shape by {mm * pose.misfit:.3g} mm RMS, {mm * pose.size:.3g} mm from its "
        f"centre: a noise of {mm * pose.position_noise:.2g} mm and {pose.orientation_noise:.2g} rad per axis of the "
        "pose",
    ]
    if lost:
        said.append(f"{lost} rows without a pose: fewer than three points are seen there")
    if pose.outlying:
        said.append(f"{pose.outlying} rows without a pose: their points show another shape, as exchanged points do")
    return said


def _small(seconds: float) -> str:
    return f"{1e3 * seconds:.2g} ms" if seconds < 1 else f"{seconds:.2g} s"
