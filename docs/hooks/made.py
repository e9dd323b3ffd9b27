"""Parts of the documents that the code says of itself: what stands in a page between two marks.

`<!-- made: NAME -->` begins a part and `<!-- end -->` ends it. `python -m docs.hooks.made` (`make made`) writes all
parts anew; a test compares each with what the code says now, and names an effect, a column or a key without a text
here. In the built pages mkdocstrings describes the public names, for which MkDocs calls `on_page_markdown`.
"""

import contextlib
import io
import itertools
import os
import re
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import yaml

import lite6jax
from docs.hooks import screens
from lite6jax.arms.description import bundled_arms, load_bundled
from lite6jax.cli import main
from lite6jax.cli.program import COMMANDS
from lite6jax.controller import rows
from lite6jax.effects import catalogue, drivers, user_effects
from lite6jax.effects.effect import Effect
from lite6jax.effects.resemblance import resemblances
from lite6jax.fleet import diagnoses
from lite6jax.fleet.folder import tabulate_rows
from lite6jax.formatting import joined
from lite6jax.recordings import RecordingSettings, settings
from lite6jax.recordings.columns import column as columns
from lite6jax.recordings.columns.documented import TEXTS
from lite6jax.report import remedies, tracking
from lite6jax.report.inspection import KEYS
from lite6jax.report.sentences import listings

HERE = Path(__file__).parent
DOCS = HERE.parent
PART = re.compile(r"^<!-- made: (?P<name>\w+) -->\n(?P<body>.*?)^<!-- end -->$", re.MULTILINE | re.DOTALL)
WIDTH = 100
"""Columns of a screen in the documents."""
PLACES = {"joint": 2, "link": 2, "source_joint": 1}
"""Where the effects that are described act: N is 2 and M is 1."""
WHOLE: Mapping[str, Mapping[str, Any]] = {
    "base_compliance": {"cross": True, "shift": True},
    "joint_backlash": {"friction_torque_Nm": 0.1},
    "tool_offset": {"turned": True},
}
"""The form of an effect that has all of its numbers."""
COLUMNS = {
    "q": "joint positions; required, but in targets and predictions",
    "dq": "joint velocities; a trajectory with times and without them gets them by differentiation, and says so",
    "ddq": "joint accelerations, used for torques",
    "tau": "joint torques: what the motor exerts about +z of its joint",
    "current": "motor currents; torques with `torque_constant_Nm_per_A` in the sidecar",
    "temp": "temperatures of the joints",
    "cmd": "commanded joint positions beside the measured ones, to which servos are fitted",
    "cmd_dq": "commanded joint velocities, which are integrated where no positions were commanded",
    "time": "time of the sample; without it the order of the rows is the sequence",
    **dict.fromkeys("xyz", "measured position of the tool point"),
    **dict.fromkeys(columns.DEVIATION, "deviation of the measured position from `x y z`, which are nominal beside it"),
    **dict.fromkeys(("qw", "qx", "qy", "qz"), "measured orientation as a unit quaternion, scalar first"),
    **dict.fromkeys(("rx", "ry", "rz"), "the same as a rotation vector, axis times angle (Universal Robots)"),
    **dict.fromkeys(
        ("roll", "pitch", "yaw"),
        "the same as Rz(yaw) Ry(pitch) Rx(roll) (UFACTORY, URDF; the C, B, A of KUKA and W, P, R of Fanuc)",
    ),
    **dict.fromkeys(("rotx", "roty", "rotz"), "the same as Rx(rotx) Ry(roty) Rz(rotz) (Stäubli, Mecademic)"),
    **dict.fromkeys(("alpha", "beta", "gamma"), "the same as Rz(alpha) Ry(beta) Rz(gamma) (Kawasaki, Doosan)"),
    **dict.fromkeys(columns.MATRIX, "the same as a rotation matrix, row by row"),
    "ambient": "temperature of the surroundings",
    "payload": "mass at the flange; 0 where the column is missing",
    "run": "an integer that changes where a new run starts",
    "missing": "how many reports of a controller are missing before the row",
    "gap": "why they are missing, in words",
    "contact": "which contact the tool's point touched, a word: rows of one contact touched one point",
    "plane": "which plane the tool's point touched, a word",
    "distance": "distance of the tool's point from an anchor",
    "anchor": "which anchor, a word, where there are several",
    "axis": "height of the tool's point along an axis",
    "image": "which image a corner was seen in, a word or a number; a row is then a corner",
    "corner": "which corner of the board, counted from 0: at column i mod `columns`",
    **dict.fromkeys("uv", "where a corner was seen in an image"),
}
_JOINTS, _SPEEDS = "`q1_rad` …", "`time_s`, or `dq1_rad_per_s` …"
_SLIDES, _SLIDE_SPEEDS = "`q1_m` …", "`time_s`, or `dq1_m_per_s` …"
_LOADS = "`q1_rad` …, `payload_kg`; masses of the arm"
_TEMPERATURES = "`temp1_degC` …, or `ambient_degC`"
_MEASURED = "`x_m`, `y_m`, `z_m`"
DRIVERS = {
    "position": ("q", "the joint's position, as the encoder reads it", _JOINTS),
    "slide position": ("q", "the same of a prismatic joint", _SLIDES),
    "direction of motion": ("sign q̇", "from which side the joint came: −1, 0 or 1", f"{_JOINTS} in their order"),
    "velocity": ("q̇", "the joint's velocity", _SPEEDS),
    "speed": ("abs q̇", "its magnitude", _SPEEDS),
    "slide velocity": ("q̇", "the velocity of a prismatic joint", _SLIDE_SPEEDS),
    "slide speed": ("abs q̇", "its magnitude", _SLIDE_SPEEDS),
    "travel since reversal": ("s", "how far the joint has moved since it last turned round", _SPEEDS),
    "slide travel since reversal": ("s", "the same of a prismatic joint", _SLIDE_SPEEDS),
    "acceleration": ("q̈", "the joint's acceleration", "`time_s`, or `ddq1_rad_per_s2` …"),
    "slide acceleration": ("q̈", "the same of a prismatic joint", "`time_s`, or `ddq1_m_per_s2` …"),
    "command velocity": ("u̇", "how fast the joint's command changes, in logs of commands", "`time_s`, `cmd1_rad` …"),
    "gravity torque": ("τ", "the torque of gravity about +z of the joint, payload included", _LOADS),
    "gravity force": ("F", "the force of gravity along +z of a prismatic joint", _LOADS),
    "gravity moment x": ("M_x", "the moment of gravity about x of the link's frame", _LOADS),
    "gravity moment y": ("M_y", "the same about y", _LOADS),
    "base moment x": ("M_x", "the moment of gravity about x of the base", _LOADS),
    "base moment y": ("M_y", "the same about y", _LOADS),
    "tool moment x": ("M_x", "the moment of the payload about x of the flange", _LOADS),
    "tool moment y": ("M_y", "the same about y", _LOADS),
    "temperature rise": ("ΔT", "of the arm above `reference_temperature_degC`", _TEMPERATURES),
    "temperature": ("ΔT", "of the joint above it", _TEMPERATURES),
    "time": ("t", "since the recording began", "`time_s`"),
    "order of recording": (
        "k",
        "from 0 at the first row to 1 at the last: what nothing recorded drives may wander along it",
        "the rows in their order",
    ),
    "payload": ("m", "the mass at the flange", "`payload_kg`"),
    **{f"measured position {axis}": (axis, f"where the sensor shows the tool, along its {axis}", _MEASURED)
       for axis in "xyz"},
    "measured position's distance": ("r", "of the tool from the sensor's origin", _MEASURED),
    "measured position's azimuth": ("α", "of the line of sight about the sensor's z", _MEASURED),
    "measured position's elevation": ("β", "of the line of sight above the sensor's x-y plane", _MEASURED),
}  # fmt: skip
"""Of each driver its symbol, what it is, and the columns from which it follows."""
EXAMPLES = {
    "check": ("check", str(Path(lite6jax.__file__).parent / "demo" / "lite6_simulated.yaml")),
    "convert": ("convert", "lite6", "lite6.xml"),
    "emulate": ("emulate", "--faults"),
    "arms": ("arms",),
    "detect": ("detect", "images", "--board", "charuco:7x5,20mm", "--joints", "joints.csv", "--arm", "lite6"),
}
"""Commands that are run for the reference, where no page shows them or shows less."""
PYTHON = {
    "Fit": (
        "fit", "Solution", "Result", "fit_fleet", "fit_fleet_calibrations", "FleetSolution",
        "six_parameter_to_hayati", "hayati_to_six_parameter",
    ),
    "Diagnose": ("diagnose", "Diagnosis", "TorqueDiagnosis", "Options", "EngineOptions"),
    "Use a diagnosis": ("read_model", "predict", "predicted", "compensate", "register", "register_model"),
    "Recordings": ("Recording", "RecordingSettings", "read_recording", "join_recordings", "write_recording"),
    "Arms": (
        "read_arm", "Arm", "HayatiForm", "read_factory", "write_factory", "hayati_fk", "six_parameter_fk",
        "inverse_dynamics", "link_parameters",
    ),
    "Simulate": ("simulate", "UndeclaredNoise", "draw_calibration", "draw_sensor_frame"),
    "Plan a measurement": (
        "plan_experiment", "Experiment", "Sensor", "plan_sensor", "identify", "identify_recording", "plan_poses",
        "candidates", "above_floor", "all_pass", "clear_of_itself", "link_frames", "self_collision", "sensitivity",
    ),
    "Effects of your own": (
        "Effect", "JointEffect", "Bending", "JointTorque", "TorqueEffect", "Coordinate", "Driver", "Motion", "Loads",
        "Deflection", "twist", "place_at_joint", "Dynamics", "load_effects",
    ),
    "Errors": ("InputError",),
}  # fmt: skip
"""Where each public name is described."""


def on_page_markdown(markdown: str, **_: object) -> str:
    """Replaces the list of public names by what mkdocstrings describes in full."""
    return PART.sub(lambda part: described_names() if part["name"] == "python" else part["body"], markdown)


def made_parts(markdown: str) -> dict[str, str]:
    """The made parts of a page by name, as they stand in it."""
    return {part["name"]: part["body"].strip("\n") for part in PART.finditer(markdown)}


def write_parts(markdown: str) -> str:
    """The page with all of its made parts written anew.

    Raises:
        KeyError: a part has a name that nothing makes.
    """
    return PART.sub(lambda part: f"<!-- made: {part['name']} -->\n\n{MADE[part['name']]()}\n\n<!-- end -->", markdown)


def write_pages() -> None:
    """Writes the made parts of every page anew."""
    for page in sorted(DOCS.rglob("*.md")):
        markdown = page.read_text(encoding="utf-8")
        page.write_text(write_parts(markdown), encoding="utf-8")


def command_help() -> str:
    """What `--help` of the program and of each command prints."""
    sections = ["## lite6jax\n\n" + _screen("--help")]
    shown = _shown_in()
    if silent := set(COMMANDS) - set(EXAMPLES) - set(shown):
        raise SystemExit(f"docs/hooks/made.py: no page shows what these commands print: {sorted(silent)}")
    for name in COMMANDS:
        sections.append(f"## {name}\n\n{_screen(name, '--help')}")
        if name in EXAMPLES:
            with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
                if name == "detect":
                    _draw_boards(12)
                sections.append(f"For example:\n\n{_screen(*EXAMPLES[name])}")
        if name in shown:
            sections.append(f"What it prints: {', '.join(shown[name])}.")
    return "\n\n".join(sections)


def _draw_boards(count: int) -> None:
    """Images of a tilted board in the folder `images`, and the joints of each in `joints.csv`, drawn by OpenCV."""
    import cv2
    import numpy as np

    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    board = cv2.aruco.CharucoBoard((7, 5), 0.02, 0.015, dictionary).generateImage((700, 500))
    flat = np.array([[-350, -250, 0], [350, -250, 0], [350, 250, 0], [-350, 250, 0]], float)
    rng, K = np.random.default_rng(0), np.array([[900, 0, 640], [0, 900, 480], [0, 0, 1.0]])
    Path("images").mkdir()
    joints = np.array([0, 0.5, 1.2, 0, 0.8, 0]) + rng.uniform(-0.5, 0.5, (count, 6))
    for k in range(count):
        corners, _ = cv2.projectPoints(flat, rng.uniform(-0.5, 0.5, 3), np.array([0, 0, 900.0]), K, None)
        view = cv2.getPerspectiveTransform(
            np.array([[0, 0], [700, 0], [700, 500], [0, 500]], np.float32), corners[:, 0].astype(np.float32)
        )
        cv2.imwrite(f"images/{k:02d}.png", cv2.warpPerspective(board, view, (1280, 960), borderValue=255))
    head = ",".join(f"q{j}_rad" for j in range(1, 7))
    np.savetxt("joints.csv", joints, delimiter=",", header=head, comments="", fmt="%.6f")


def _shown_in() -> dict[str, list[str]]:
    """For each command links to the pages that show what it prints, which tests compare with what it does print."""
    found: dict[str, list[str]] = {}
    for page in screens.pages():
        text = page.read_text()
        title = text.partition("\n")[0].removeprefix("# ")
        link = f"[{title}](../{page.relative_to(HERE.parent).as_posix()})"
        for name in dict.fromkeys(screen.words[1] for screen in screens.screens(text)):
            found.setdefault(name, []).append(link)
    return found


def column_table() -> str:
    """Every column of a recording, with the units that are read."""
    of_joints_first = sorted(columns.QUANTITIES.items(), key=lambda item: not item[1].per_joint)
    accepted = {name: one.units for name, one in of_joints_first} | {name: {"": 1.0} for name in TEXTS}
    _check("columns", COLUMNS, accepted)
    lines = []
    for meaning, group in itertools.groupby(accepted, COLUMNS.__getitem__):
        quantities = list(group)
        spelled = [_spelled(quantities, unit) for unit in accepted[quantities[0]]]
        lines.append((" or ".join(spelled), meaning))
    return _table(("columns", "meaning"), lines)


def _spelled(quantities: Iterable[str], unit: str) -> str:
    """The columns of quantities in a unit; of those of every joint the first and the last."""
    end = unit and f"_{unit}"
    names = [
        f"`{name}1{end}` … `{name}N{end}`" if columns.is_per_joint(name) else f"`{name}{end}`" for name in quantities
    ]
    return ", ".join(names)


def sidecar_table() -> str:
    """Every key of a sidecar, with what it accepts and what holds without it."""
    defaults = {field.name: field.default for field in fields(RecordingSettings)}
    _check("keys of a sidecar", KEYS, defaults)
    lines = [(f"`{name}`", KEYS[name][0], settings.form_of(name), _default(value)) for name, value in defaults.items()]
    return _table(("key", "meaning", "accepted", "without it"), lines)


def _default(value: Any) -> str:
    if value is None:
        return "not declared"
    return f"`{list(value) if isinstance(value, tuple) else value}`"


def arm_table() -> str:
    """The bundled arms."""
    lines = []
    for name in bundled_arms():
        arm = load_bundled(name)
        known = "masses and inertias" if arm.inertia is not None else "masses" if arm.mass is not None else "geometry"
        lines.append((f"`{name}`", str(arm.dof), f"{arm.reach:.2f} m", known, arm.source))
    return _table(("name", "joints", "reach", "known", "source"), lines)


def recorded_table() -> str:
    """The columns that `record` writes, with the source of each."""
    found: dict[str, list[str]] = {}
    for name, source in rows.SOURCES.items():
        found.setdefault(source, []).append(re.sub(r"[1-7]", "N", name, count=1) if name[-1] not in "wxyz" else name)
    lines = [(", ".join(f"`{name}`" for name in dict.fromkeys(names)), source) for source, names in found.items()]
    return _table(("columns", "source"), lines)


def fleet_table() -> str:
    """The columns of a fleet's table."""
    return ", ".join(f"`{name}`" for name in tabulate_rows([]).column_names)


def diagnoses_table() -> str:
    """The columns of the table of a folder's diagnoses."""
    return ", ".join(f"`{name}`" for name in diagnoses.SCHEMA.names)


def pose_effects() -> str:
    """The catalogue of effects on poses."""
    return _effects("poses", catalogue.POSE_EFFECTS, _actions(remedies.REMEDIES["poses"]))


def torque_effects() -> str:
    """The catalogue of effects on torques."""
    return _effects("torques", catalogue.TORQUE_EFFECTS, _actions(remedies.REMEDIES["torques"]))


def tracking_effects() -> str:
    """The catalogue of effects on how joints follow their commands."""
    remedy_texts = {name: tracking.action_of({"effect": name}) for name in catalogue.TRACKING_EFFECTS}
    return _effects("tracking", catalogue.TRACKING_EFFECTS, remedy_texts)


def own_effect(place: int = 0) -> str:
    """An example of an effect of a user's own; the first one is a whole file."""
    example = re.findall(r"```python\n.*?```", user_effects.__doc__ or "", re.DOTALL)[place]
    return example.replace("```python", '```python title="mine.py"' if place == 0 else "```py")


def driver_table() -> str:
    """Every driver: its symbol, its unit, what it is, and what has to be recorded for it."""
    _check("drivers", DRIVERS, drivers.QUANTITIES)
    lines = []
    for quantity, (symbol, meaning, needed) in DRIVERS.items():
        place = drivers.place_of(quantity)
        driver = drivers.Driver(quantity, 1 if place else 0)
        lines.append((f"`{quantity}`", symbol, driver.unit, place or "whole arm", meaning, needed))
    return _table(("driver", "symbol", "unit", "of a", "what it is", "columns it needs"), lines)


def public_names() -> str:
    """Every public name with the first sentence of its docstring, a table for each group."""
    sections = []
    for title, names in PYTHON.items():
        lines = [(f"`{name}`", _first_sentence(getattr(lite6jax, name).__doc__ or "")) for name in names]
        sections.append(f"## {title}\n\n{_table(('name', 'what it is'), lines)}")
    return "\n\n".join(sections)


def described_names() -> str:
    """Every public name, in groups, for mkdocstrings."""
    _check("public names", [name for names in PYTHON.values() for name in names], lite6jax.__all__)
    sections = []
    for title, names in PYTHON.items():
        described = "\n\n".join(f"::: {lite6jax._MODULES[name]}.{name}" for name in names)
        sections.append(f"## {title}\n\n{described}")
    return "\n\n".join(sections)


def _first_sentence(docstring: str) -> str:
    paragraph = " ".join(re.split(r"\n\s*\n", docstring.strip())[0].split())
    return re.split(r"(?<=[.]) (?=[A-Z`])", paragraph)[0].replace("|", "\\|")


def _actions(known: Mapping[str, remedies.Remedy]) -> dict[str, str]:
    return {name: remedy.action for name, remedy in known.items()}


def _effects(part: str, kinds: Mapping[str, type[Effect]], actions: Mapping[str, str]) -> str:
    looks = _looks(part)
    _check("effects.yaml", looks, kinds)
    _check("remedies", actions, kinds)
    return "\n\n".join(_effect(part, kind, looks[name], actions[name]) for name, kind in kinds.items())


def _effect(part: str, kind: type[Effect], looks: str, remedy: str) -> str:
    told = [f"### {kind.name}", _formula(kind)]
    if not kind.nonparametric:
        made = _examples(kind)
        whole = made[-1]
        sites = " or ".join(dict.fromkeys(f"`{_general(effect.site)}`" for effect in made))
        driven = ", ".join(_driver(whole, driver.phrase) for driver in whole.drivers) or "nothing: it is constant"
        place = f"**Where:** {sites}."
        if part != "tracking" or whole.drivers:  # what a servo does depends on its command
            place += f" **Depends on:** {driven}."
        told.append(place)
        told.append(_table(("parameter", "physically possible"), list(_parameters(whole))))
    if part != "poses":
        parameters = listings.simulator_parameters(kind.in_simulators._asdict())
        told.append(f"**In simulators.** {parameters or 'No parameter of MuJoCo, Isaac Lab or URDF'}.")
    told.append(f"**What it looks like.** {looks}")
    if part == "tracking":
        alike = [_resemblance(group.describe(kind.name)) for group in resemblances(kind.name)]
        told += ["**What looks alike.**\n\n" + "\n".join(alike)] if alike else []
    told.append(f"**What to do.** {remedy}")
    return "\n\n".join(told)


def _resemblance(group: Mapping[str, Any]) -> str:
    names = joined((f"`{name}`" for name in group["effects"]), "or")
    return f"- {names} {group['alike']}. Told apart by {group['told_apart']}."


def _examples(kind: type[Effect]) -> list[Effect]:
    """An effect of this kind: of the whole arm first where it has such a form, and last with all of its numbers."""
    own = {item.name: item for item in fields(kind)}  # type: ignore[arg-type]
    placed = {name: place for name, place in PLACES.items() if name in own}
    forms = [{**placed, **WHOLE.get(kind.name, {})}]
    if any(own[name].default is not MISSING for name in placed):
        forms.insert(0, {name: place for name, place in placed.items() if own[name].default is MISSING})
    return [kind(**form) for form in forms]


def _formula(kind: type[Effect]) -> str:
    """The first paragraph of the docstring; the others are for those who read the code."""
    first = re.split(r"\n\s*\n", (kind.__doc__ or "").strip())[0]
    return " ".join(line.strip() for line in first.splitlines()).replace("|", "\\|")


def _parameters(effect: Effect) -> Iterable[tuple[str, str]]:
    for name, (least, largest) in catalogue.possible_values(effect).items():
        known = least is not None or largest is not None
        yield f"`{name}`", listings.between(least, largest) if known else ""


def _driver(effect: Effect, phrase: str) -> str:
    """A driver; an effect of the whole arm names joint 1 where it means every joint."""
    if not set(PLACES) & {item.name for item in fields(effect)}:  # type: ignore[arg-type]
        return re.sub(r" of joint 1$", " of the joints", phrase)
    return _general(phrase)


def _general(place: str) -> str:
    return re.sub(r"(?<=[a-z])2$|(?<=[a-z] )2\b", "N", re.sub(r"(?<=joint )1\b", "M", place))


def _looks(part: str) -> Mapping[str, str]:
    return yaml.safe_load((HERE / "effects.yaml").read_text(encoding="utf-8"))[part]


def _check(what: str, described: Iterable[str], there: Iterable[str]) -> None:
    missing, surplus = set(there) - set(described), set(described) - set(there)
    if missing or surplus:
        raise SystemExit(f"docs/hooks: {what}: {sorted(missing)} need a description, {sorted(surplus)} do not exist")


def _table(head: tuple[str, ...], lines: Iterable[tuple[str, ...]]) -> str:
    cells = [head, tuple("---" for _ in head), *lines]
    return "\n".join("| " + " | ".join(line) + " |" for line in cells)


def _screen(*arguments: str) -> str:
    said = io.StringIO()
    os.environ["COLUMNS"] = str(WIDTH)
    with contextlib.redirect_stdout(said):
        main(list(arguments))
    printed = "\n".join(line.rstrip() for line in said.getvalue().strip().splitlines())
    whole = f"$ lite6jax {' '.join(arguments)}\n{printed}"
    return f"```text\n{whole.replace(f'{HERE.parents[1]}{os.sep}', '')}\n```"  # a file is named by its place


MADE: Mapping[str, Callable[[], str]] = {
    "arms": arm_table,
    "columns": column_table,
    "commands": command_help,
    "fleet": fleet_table,
    "diagnoses": diagnoses_table,
    "drivers": driver_table,
    "own_effect": own_effect,
    "own_link_effect": lambda: own_effect(1),
    "own_torque_effect": lambda: own_effect(2),
    "pose_effects": pose_effects,
    "python": public_names,
    "recorded": recorded_table,
    "sidecar": sidecar_table,
    "torque_effects": torque_effects,
    "tracking_effects": tracking_effects,
}


if __name__ == "__main__":
    write_pages()
