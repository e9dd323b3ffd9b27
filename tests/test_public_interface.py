"""What every public name promises: shapes and units in words, degrees refused, files read, other types refused."""

import ast
import inspect
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from report import diagnosed
from typed import refused

import lite6jax
from lite6jax import InputError, Recording
from lite6jax.effects.kinematic import JointCompliance
from lite6jax.errors import name_options

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


def test_docstrings_begin_with_a_verb_or_a_noun():
    """A clause that begins with "Of" or "Whether" is read twice."""
    kinds = ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Module
    trees = (ast.parse(path.read_text()) for path in PACKAGE.rglob("*.py"))
    documented = (node for tree in trees for node in ast.walk(tree) if isinstance(node, kinds))
    begun = [text for node in documented if re.match(r"(Of|Whether)\b", text := ast.get_docstring(node) or "")]
    assert begun == []


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


# ------------------------------------------------------------------ arguments and options


def test_messages_name_arguments_in_python_and_options_on_the_command_line(capsys, tmp_path):
    path = tmp_path / "arm.yaml"
    lite6jax.write_factory(LITE6.kinematics, path)
    with pytest.raises(InputError, match=r"choose another name or add `overwrite=True` to replace it$"):
        lite6jax.write_factory(LITE6.kinematics, path)
    assert refused(capsys, "convert", "lite6", path).endswith("choose another name or add --force to replace it")
    with pytest.raises(InputError, match="has 6 joints, but xarm7 has 7; name another with `nominal=NAME`"):
        lite6jax.fit(path, "xarm7")
    with pytest.raises(InputError, match="has 6 joints, but xarm7 has 7; name another with `arm=NAME`"):
        lite6jax.read_factory(path, lite6jax.read_arm("xarm7"))
    assert refused(capsys, "fit", path, "--arm", "xarm7").endswith("name another with --arm NAME")


@pytest.mark.parametrize(
    ("message", "spelled"),
    [
        ("add `overwrite=True`", "add --force"),
        ("use `geometry='free'`, or `arm:` in the sidecar", "use --geometry free, or `arm:` in the sidecar"),
        ("take another place (`tool_at=(X, Y, Z)`)", "take another place (--tool-at X Y Z)"),
        ("name it with `nominal=NAME`", "name it with --arm NAME"),
        ("a == b and `c` = 1", "a == b and `c` = 1"),
    ],
)
def test_how_an_option_is_spelled(message, spelled):
    assert name_options(message) == spelled


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: lite6jax.Options(folds=0), "folds: 0; give 2 or more"),
        (lambda: lite6jax.Options(folds=1), "folds: 1; give 2 or more"),
        (
            lambda: lite6jax.simulate("lite6", effects=[JointCompliance(2)], samples=5),
            r"effects: joint_compliance:joint2 has no values; give \(effect, \[compliance_rad_per_Nm\]\)",
        ),
        (
            lambda: lite6jax.simulate("lite6", effects="joint_backlash:joint=4,gap_rad=1e-3", samples=5),
            "effects: has the type str; give a list of texts or of",
        ),
        (
            lambda: lite6jax.fit_fleet(np.stack([LITE6.kinematics] * 2)),
            r"T_base_flange: give the flange's poses, .*; calibrations, .*, are fitted by fit_fleet_calibrations",
        ),
        (
            lambda: lite6jax.fit_fleet(np.zeros((5, 6)), np.tile(np.eye(4), (2, 5, 1, 1))),
            "nominal: has the type NoneType; give an Arm or the name of a bundled one",
        ),
    ],
)
def test_mistakes_in_calls_are_refused_with_the_remedy(call, message):
    with pytest.raises(InputError, match=message):
        call()


# ------------------------------------------------------------------ paths and types


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A recording, a motion, targets, two calibrations and a diagnosis."""
    folder = tmp_path_factory.mktemp("files")
    recording, effects = diagnosed.recording_maker(folder)(diagnosed.COMPLIANCE)
    recording.save(folder / "run.csv")
    lite6jax.simulate("lite6", samples=60, seed=2).save(folder / "other.csv")
    diagnosed.diagnosed(recording, effects).save(folder / "diagnosis.json")
    table = recording.to_frame()
    table[[f"q{j}_rad" for j in range(1, 7)]].head(20).to_csv(folder / "motion.csv", index=False)
    table[["x_m", "y_m", "z_m"]].head(4).to_csv(folder / "targets.csv", index=False)
    for k in range(2):
        lite6jax.write_factory(lite6jax.draw_calibration(LITE6, k), folder / f"arm{k}.yaml")
    return folder


@pytest.fixture(scope="module")
def model(folder):
    return lite6jax.read_model(folder / "diagnosis.json")


def test_a_list_of_files_is_fitted_one_by_one(folder):
    files = [folder / "run.csv", str(folder / "other.csv"), folder / "arm0.yaml"]
    fits = lite6jax.fit(files)
    assert [fit.arm.name for fit in fits] == ["lite6"] * 3
    for file, fit in zip(files, fits, strict=True):
        np.testing.assert_array_equal(fit.parameters, lite6jax.fit(file).parameters)


def test_motions_and_targets_are_read_from_files(folder, model):
    q = lite6jax.read_recording(folder / "motion.csv").joint_position
    np.testing.assert_array_equal(lite6jax.predict(model, folder / "motion.csv"), lite6jax.predict(model, q))
    predicted = lite6jax.predicted(model, str(folder / "motion.csv"))
    np.testing.assert_array_equal(predicted.position_std, lite6jax.predicted(model, q).position_std)
    targets = pd.read_csv(folder / "targets.csv").to_numpy()
    compensated = lite6jax.compensate(model, folder / "targets.csv")
    np.testing.assert_array_equal(compensated.joint_position, lite6jax.compensate(model, targets).joint_position)
    assert lite6jax.register_model(model, folder / "run.csv")[1].rms < 1e-4


BARE = lite6jax.Recording.from_arrays(np.zeros((3, 6)), np.full((3, 3), 0.1))
FRAME = pd.DataFrame({"q1_rad": [0.0]})


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda _: lite6jax.diagnose(42), "recording: has the type int; give the path of a recording, or a Recording"),
        (lambda _: lite6jax.diagnose(FRAME), r"has the type DataFrame; .* Recording\.from_dataframe"),
        (lambda _: lite6jax.diagnose(None), "recording: has the type NoneType; give the path"),
        (lambda _: lite6jax.diagnose(BARE, domain="both"), 'domain=\'both\': is none; give "poses", "torques" or'),
        (lambda _: lite6jax.identify_recording({}), "recording: has the type dict; give the path"),
        (lambda _: lite6jax.diagnose("run.csv", 6), "arm: has the type int; give an Arm, the name of a bundled one"),
        (lambda _: lite6jax.fit(42), r"source: has the type int; give a file or a list of files, a Recording"),
        (lambda _: lite6jax.fit({"a": 1}), "source: has the type dict; give a file"),
        (lambda _: lite6jax.fit(["a.csv", 3]), r"a\.csv: .*not found|a\.csv"),
        (lambda _: lite6jax.fit([["a", "b"]]), "source: holds .*, not numbers"),
        (lambda _: lite6jax.predict("d.json", "m.csv"), r"model: has the type str; give lite6jax\.read_model"),
        (lambda _: lite6jax.compensate(None, [[0, 0, 0]]), r"model: has the type NoneType; give lite6jax\.read_model"),
        (lambda m: lite6jax.predict(m, object()), "motion: has the type object; give a Recording"),
        (lambda m: lite6jax.register_model(m, 3), "recording: has the type int; give the path"),
        (lambda _: lite6jax.simulate(3), "arm: has the type int; give an Arm, the name of a bundled one"),
        (lambda _: lite6jax.sensitivity(3), "arm: has the type int; give an Arm or the name"),
        (lambda _: lite6jax.identify("lite6"), r"experiment: has the type str; give an Experiment, as lite6jax\.plan"),
        (lambda _: lite6jax.read_model(3), "path: has the type int; give the path of a diagnosis"),
        (lambda _: lite6jax.write_recording(3, "a.csv"), "recording: has the type int; give a Recording"),
        (lambda _: lite6jax.fit_fleet_calibrations([3], nominal=6), "nominal: has the type int; give an Arm or"),
        (lambda _: lite6jax.diagnose(BARE, options=3), r"options: has the type int; give lite6jax\.Options"),
        (lambda _: lite6jax.diagnose(BARE, effects="mine.py"), r"effects: has the type str; .*lite6jax\.load_effects"),
        (lambda _: lite6jax.diagnose(BARE, effects=[3]), r"effects\[0\]: has the type int; give an effect"),
    ],
)
def test_another_type_is_refused_in_one_line_that_says_what_is_accepted(model, call, said):
    with pytest.raises(InputError) as caught:
        call(model)
    assert re.search(said, str(caught.value))
    assert "\n" not in str(caught.value)
