"""What every public name promises: shapes and units in words, degrees refused, a summary that a person can read."""

import ast
import inspect
import re
from pathlib import Path

import numpy as np
import pytest

import lite6jax
from lite6jax import InputError, Recording
from lite6jax.results import PublicResult

PACKAGE = Path(lite6jax.__file__).parent
LITE6 = lite6jax.read_arm("lite6")
ANGLES = {"joint_position", "candidates", "recorded", "limits", "joint_limits", "joint_velocity"}
"""Arguments whose unit must be given as rad."""
UNCHECKED = {
    *("hayati_fk", "six_parameter_fk", "hayati_to_six_parameter", "inverse_dynamics"),
    *("above_floor", "all_pass", "clear_of_itself", "self_collision", "register", "twist", "place_at_joint"),
}
"""They check nothing, so they refuse nothing: formulas that may be traced and differentiated, and parts that are handed
what the library has checked."""
NAMED_TUPLE = {"_fields", "_replace", "_asdict"}
"""Public in spite of their underscore."""
FUNCTIONS = [name for name in lite6jax.__all__ if inspect.isfunction(getattr(lite6jax, name))]


@pytest.fixture(scope="module")
def recording():
    return lite6jax.simulate("lite6", samples=60, sensor="tracker_6d", T_sensor_base=np.eye(4))


@pytest.fixture(scope="module")
def results(recording):
    """One of each kind of result."""
    rng = np.random.default_rng(0)
    experiment = lite6jax.plan_experiment("lite6", frame=False)
    kinematics = np.stack([LITE6.kinematics + 1e-3 * rng.standard_normal((6, 6)) for _ in range(3)])
    kinematics[2, 0, 0] = np.nan
    q = rng.uniform(*LITE6.joint_limits.T, (60, 6))
    return {
        "Recording": recording,
        "Solution": lite6jax.fit(recording),
        "a calibration's Solution": lite6jax.fit(kinematics[0], "lite6"),
        "FleetSolution": lite6jax.fit_fleet_calibrations(kinematics, nominal="lite6"),
        "Identification": lite6jax.identify(experiment, q[:20]),
        "Plan": lite6jax.plan_poses(experiment, q, 12),
    }


# ------------------------------------------------------------------ docstrings


@pytest.mark.parametrize("name", lite6jax.__all__)
def test_every_public_name_says_what_it_is(name):
    documentation = inspect.getdoc(getattr(lite6jax, name)) or ""
    assert len(documentation) > 20
    assert documentation.split("\n\n")[0].endswith((".", ":"))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_public_functions_give_shapes_units_and_errors(name):
    function = getattr(lite6jax, name)
    documentation = inspect.getdoc(function) or ""
    assert "Raises:" in documentation or name in UNCHECKED
    for parameter in inspect.signature(function).parameters.values():
        described = described_argument(documentation, parameter.name)
        if "Array" not in str(parameter.annotation):
            continue
        assert described, f"{parameter.name} is not described"
        referred = "as in" in described or "`Recording.from_arrays`" in described
        assert referred or "`(" in described, f"{parameter.name} has no shape"
        if parameter.name in ANGLES:
            assert referred or re.search(r"\brad\b", described), f"{parameter.name} has no unit"


def described_argument(documentation, name):
    """The words on one argument below `Args:`, or, of a docstring of one line, those behind its name."""
    _, _, arguments = documentation.partition("Args:\n")
    entry = re.search(rf"^ {{4}}(?:[\w, ]+, )?{name}(?:, [\w, ]+)?: (.+(?:\n {{8,}}.+)*)", arguments, re.MULTILINE)
    if entry:
        return entry[1]
    inline = re.search(rf"`{name}` (`\(.*)", documentation)
    return inline[1] if inline else ""


# ------------------------------------------------------------------ private names


def private_uses(source):
    """Names with a leading underscore that a module takes from another one of the package."""
    tree = ast.parse(source)
    modules = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("lite6jax"):
            modules |= {alias.asname or alias.name for alias in node.names}
            yield from (alias.name for alias in node.names if alias.name.startswith("_"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in modules:
            private = node.attr.startswith("_") and not node.attr.startswith("__") and node.attr not in NAMED_TUPLE
            yield from [f"{node.value.id}.{node.attr}"] * private


@pytest.mark.parametrize(
    "path", sorted([*(PACKAGE / "report").rglob("*.py"), *(PACKAGE / "cli").rglob("*.py")]), ids=lambda path: path.name
)
def test_reports_and_commands_use_no_private_name(path):
    assert list(private_uses(path.read_text())) == []


# ------------------------------------------------------------------ degrees


DEGREES = np.random.default_rng(1).uniform(-150, 150, (40, 6))
POSITIONS = np.random.default_rng(2).uniform(-0.3, 0.3, (40, 3))


def degrees_recorded():
    """A recording that was made without checks, as by another program."""
    return Recording.assembled(DEGREES, position=POSITIONS)


@pytest.mark.parametrize(
    "call",
    [
        lambda: Recording.from_arrays(DEGREES, POSITIONS),
        lambda: Recording.from_dataframe({f"q{j + 1}_rad": DEGREES[:, j] for j in range(6)}),
        lambda: lite6jax.simulate("lite6", DEGREES),
        lambda: lite6jax.fit(degrees_recorded()),
        lambda: lite6jax.fit_fleet(DEGREES, np.tile(np.eye(4), (2, 40, 1, 1)), nominal="lite6"),
        lambda: lite6jax.fit(LITE6.kinematics, "lite6").predict(DEGREES),
        lambda: lite6jax.identify(lite6jax.plan_experiment("lite6"), DEGREES),
        lambda: lite6jax.identify_recording(degrees_recorded()),
        lambda: lite6jax.plan_poses(lite6jax.plan_experiment("lite6"), DEGREES, 10),
        lambda: lite6jax.plan_poses(lite6jax.plan_experiment("lite6"), np.deg2rad(DEGREES), 10, recorded=DEGREES),
        lambda: lite6jax.sensitivity("lite6", joint_position=DEGREES),
        lambda: lite6jax.diagnose(degrees_recorded()),
    ],
    ids=[
        *("from_arrays", "from_dataframe", "simulate", "fit", "fit_fleet", "Solution.predict", "identify"),
        *("identify_recording", "plan_poses", "plan_poses, recorded", "sensitivity", "diagnose"),
    ],
)
def test_degrees_given_for_radians_are_refused_with_the_remedy(call):
    with pytest.raises(InputError) as caught:
        call()
    assert re.search(
        r"row \d+ is at -?[\d.]+ rad while the arm's joint \d goes from -?[\d.]+ to [\d.]+ rad; are these degrees\? "
        r"(give radians: np\.deg2rad\(joint_position\)|name the columns q1_deg \.\.\.)$",
        str(caught.value),
    )


# ------------------------------------------------------------------ summaries

KINDS = ("Recording", "Solution", "a calibration's Solution", "FleetSolution", "Identification", "Plan")
HOUSEHOLD = re.compile(r"\b(told|tells|felt|feels|asks|lived|plain|remembers|sure|hidden|they stand)\b", re.IGNORECASE)


@pytest.mark.parametrize("kind", KINDS)
def test_a_summary_is_a_few_whole_sentences_with_units(results, kind):
    text = results[kind].summary()
    assert isinstance(results[kind], PublicResult)
    assert text.endswith(".")
    assert "\n" not in text
    assert 2 <= len(re.findall(r"\.(?: |$)", text)) <= 12
    assert re.search(r"\d (mm|m|samples|poses)\b", text)
    assert not HOUSEHOLD.search(text)
    assert "nan" not in text


@pytest.mark.parametrize("kind", KINDS)
def test_what_a_notebook_shows_is_well_formed_and_needs_nothing_else(results, kind):
    from xml.etree import ElementTree as ET

    text = results[kind]._repr_html_()
    tree = ET.fromstring(f"<div>{text}</div>")
    said = [entry.text for entry in tree.findall(".//li")]
    assert " ".join(said).startswith(results[kind].summary())
    assert not re.search(r"https?:|src=|href=|style|script", text)
    assert len(text) < 4000


def test_the_numbers_of_a_summary_are_those_of_plain_numpy(results):
    solution, fleet, plan = results["Solution"], results["FleetSolution"], results["Plan"]
    rms = 1e3 * np.sqrt(np.mean(solution.checked.position**2))
    assert f"The error on held-out blocks is {rms:.4f} mm RMS" in solution.summary()
    turned = np.rad2deg(np.sqrt(np.mean(solution.checked.orientation**2)))
    assert f" and {turned:.3f} deg RMS; that of the nominal geometry" in solution.summary()
    assert fleet.summary().startswith("2 of 3 fits converged, each of 28 parameters.")
    assert "For 1 arm the fit met a number that is not finite; check the input." in fleet.summary()
    assert f"predict positions to ±{1e3 * plan.accuracy[11]:.4f} mm" in plan.summary()
    q = np.rad2deg(np.ptp(results["Recording"].joint_position, axis=0))
    assert f"over ranges of {q.min():.0f} deg to {q.max():.0f} deg" in results["Recording"].summary()
    assert "60 samples of 6 joints in 1 run (static), with positions and orientations" in results["Recording"].summary()
    found = results["Identification"]
    assert f"These poses determine {found.determination.rank} of 28 unknown parameters." in found.summary()
