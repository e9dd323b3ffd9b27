"""Old spellings of options: they do what the new ones do, and one line on stderr names what replaces them."""

import pytest
from typed import run

from lite6jax.cli.deprecated import RENAMED, current_spelling
from lite6jax.cli.program import COMMANDS

OLD_AND_NEW = [(command, old, renamed) for command, names in RENAMED.items() for old, renamed in names.items()]
DISCRIMINATED = ("joint_compliance:joint=2,compliance_rad_per_Nm=5e-5", "joint_harmonic:joint=2,order=1")
SMALL = ("--candidates", "200", "--poses", "14", "--sensor", "tracker_6d", "--no-refine")


def test_the_old_spellings_are_those_of_the_changelog():
    assert {(command, old, renamed.new) for command, old, renamed in OLD_AND_NEW} == {
        ("design", "--rivals", "--discriminate"),
        ("design", "--geometry", "--collision-geometry"),
        ("diagnose", "--against", "--reference"),
    }


@pytest.mark.parametrize(("command", "old", "renamed"), OLD_AND_NEW)
def test_an_old_spelling_is_replaced_and_says_so_in_one_line(capsys, command, old, renamed):
    assert current_spelling([command, "lite6", old, "value"]) == [command, "lite6", renamed.new, "value"]
    warning = (
        f"warning: {command} {old} is deprecated since {renamed.since} and will be removed in {renamed.removed};"
        f" write {renamed.new}\n"
    )
    assert capsys.readouterr() == ("", warning)
    assert current_spelling([command, f"{old}=a=b"]) == [command, f"{renamed.new}=a=b"]
    assert capsys.readouterr() == ("", warning)


@pytest.mark.parametrize(("command", "old", "renamed"), OLD_AND_NEW)
def test_help_names_the_new_spelling_only(capsys, command, old, renamed):
    code, said, err = run(capsys, command, "--help")
    assert (code, err) == (0, "")
    assert f"{renamed.new} " in said
    assert f"{old} " not in said


@pytest.mark.parametrize("arguments", [["identify", "run.csv", "--geometry", "free"], ["design", "--rivalry"], []])
def test_the_options_of_other_commands_are_left(capsys, arguments):
    assert current_spelling(arguments) == arguments
    assert capsys.readouterr() == ("", "")


def test_a_command_takes_no_old_spelling_as_its_own():
    """Otherwise the replacement would hide an option that exists."""
    for command, old, renamed in OLD_AND_NEW:
        options = {f"--{name.replace('_', '-')}" for name in COMMANDS[command].__dataclass_fields__}
        assert old not in options
        assert renamed.new in options


@pytest.mark.long
def test_design_with_the_old_spelling_writes_the_same_poses(capsys, tmp_path):
    written = []
    for option in ("--rivals", "--discriminate"):
        out = tmp_path / f"{option[2:]}.csv"
        code, _, err = run(capsys, "design", "lite6", *SMALL, option, *DISCRIMINATED, "--out", out)
        assert code == 0
        assert err.count("\n") == (option == "--rivals")
        written.append(out.read_bytes())
    assert written[0] == written[1]


@pytest.mark.parametrize(
    ("arguments", "warning"),
    [
        (("design", "lite6", "--geometry", "none.urdf"), "warning: design --geometry is deprecated"),
        (("diagnose", "none.csv", "--against", "other.csv"), "warning: diagnose --against is deprecated"),
    ],
)
def test_bad_input_under_an_old_spelling_is_still_refused(capsys, tmp_path, arguments, warning):
    code, out, err = run(capsys, *arguments, "--out", tmp_path / ("p.csv" if arguments[0] == "design" else "d.json"))
    assert (code, out) == (2, "")
    first, second = err.splitlines()
    assert first.startswith(warning)
    assert second.startswith("error: none.")
