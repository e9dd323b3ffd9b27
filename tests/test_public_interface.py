"""What every public name promises: shapes and units in words, and degrees refused."""

import ast
import inspect
import re
from pathlib import Path

import numpy as np
import pytest

import lite6jax
from lite6jax import InputError, Recording

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
