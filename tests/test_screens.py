"""What the documents show of commands is what these print, and every command that they name is accepted."""

import re
import shlex
from dataclasses import MISSING, fields, is_dataclass

import pytest
import tyro
from tyro.conf import FlagCreatePairsOff, OmitArgPrefixes

import lite6jax
from docs.hooks import made, screens
from docs.pictures import from_python
from lite6jax.cli.program import COMMANDS, load_command

DOCUMENTS = [screens.README, *sorted((screens.ROOT / "docs").rglob("*.md"))]
MADE_PAGES = [document for document in DOCUMENTS if made.PART.search(document.read_text())]
SHELL = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def named_commands():
    """The commands of `sh` blocks, which are not run: where each stands, and its words."""
    for document in DOCUMENTS:
        for block in SHELL.findall(document.read_text()):
            for line in block.replace("\\\n", " ").splitlines():
                if line.startswith("lite6jax "):
                    yield pytest.param(shlex.split(line, comments=True)[1:], id=f"{document.stem}: {line[:60]}")


@pytest.mark.parametrize("page", screens.pages(), ids=lambda path: path.stem)
def test_a_page_shows_what_its_commands_print(page, tmp_path):
    for screen, printed in screens.run(page.read_text(), tmp_path):
        assert screens.difference(screen.shown, printed) == "", f"$ {screen.typed}\n{printed}\n(make screens)"


@pytest.mark.parametrize("page", MADE_PAGES, ids=lambda path: path.stem)
def test_a_page_holds_what_the_code_says_of_itself(page):
    for name, written in made.made_parts(page.read_text()).items():
        now = made.MADE[name]()
        if name == "commands":  # printed by libraries too: line breaks and last digits may differ
            assert screens.difference(written, now) == "", "make made"
        else:
            assert written == now, f"{name} (make made)"


def test_every_made_part_stands_in_a_page_and_none_is_left_open():
    texts = [document.read_text() for document in DOCUMENTS]
    assert {name for text in texts for name in made.made_parts(text)} == {*made.MADE}
    assert sum(text.count("\n<!-- made: ") for text in texts) == len(made.MADE)


def test_a_part_is_replaced_and_the_rest_of_its_page_stays():
    page = "before\n\n<!-- made: fleet -->\nold\n<!-- end -->\n\nbehind\n"
    written = made.write_parts(page)
    assert written == f"before\n\n<!-- made: fleet -->\n\n{made.fleet_table()}\n\n<!-- end -->\n\nbehind\n"
    assert made.write_parts(written) == written
    assert made.made_parts(written) == {"fleet": made.fleet_table()}


def test_the_built_pages_describe_every_public_name():
    built = made.on_page_markdown("<!-- made: python -->\nold\n<!-- end -->\n")
    assert all(re.search(rf"^::: \S+\.{name}$", built, re.MULTILINE) for name in lite6jax.__all__)


def test_the_reference_shows_output_of_every_command(monkeypatch):
    monkeypatch.setattr(made, "_screen", lambda *words: f"({' '.join(words)})")
    sections = re.split(r"^## (\S+)$", made.command_help(), flags=re.MULTILINE)[1:]
    of_command = dict(zip(sections[::2], sections[1::2], strict=True))
    assert {*of_command} == {"lite6jax", *COMMANDS}
    for name in COMMANDS:
        assert "For example:" in of_command[name] or "What it prints: [" in of_command[name], name


def test_the_readme_shows_commands_of_the_pages():
    shown = {screen.words: screen.shown for page in screens.pages() for screen in screens.screens(page.read_text())}
    of_readme = screens.screens(screens.README.read_text())
    assert len(of_readme) >= 4
    for screen in of_readme:
        assert screens.difference(screen.shown, shown[screen.words]) == "", screen.typed


def test_the_python_of_the_readme_runs_and_is_drawn():
    names = from_python.run_readme()
    assert (names["fleet"].result == lite6jax.Result.CONVERGED).all()
    assert names["fleet"].parameters.shape == (1000, 28)
    drawn = {"error_by_joint": names["solution"], "deviations": names["known"], "workspace": names["sensitivities"]}
    assert all(name in found.plot() for name, found in drawn.items())
    pictures = sorted(path.name for path in from_python.HERE.glob("from_python_*.png"))
    shown = re.findall(r"\(docs/pictures/(from_python_\w+\.png)\)", screens.README.read_text())
    assert sorted(shown) == pictures


@pytest.mark.parametrize("words", list(named_commands()))
def test_a_command_that_is_named_is_accepted(words):
    name, *arguments = words
    tyro.cli(load_command(name), args=arguments, config=(FlagCreatePairsOff, OmitArgPrefixes))


def options_of(command):
    """The options of a command, and of the groups of options in it."""
    for item in fields(command):
        default = item.default if item.default_factory is MISSING else item.default_factory()
        yield from options_of(type(default)) if is_dataclass(default) else [f"--{item.name.replace('_', '-')}"]


def test_the_options_that_a_text_names_exist():
    known = {"--help", "--version"}.union(*(options_of(load_command(name)) for name in COMMANDS))
    of_benchmarks = {"CHANGELOG", "CONTRIBUTING", "benchmarks", "proof"}
    for document in DOCUMENTS:
        if document.stem not in of_benchmarks:
            named = set(re.findall(r"`[^`\n]*?(--[a-z][a-z-]*)", document.read_text()))
            assert named - known == set(), document.name


@pytest.mark.parametrize(
    ("shown", "printed", "right"),
    [
        ("a 1.00 b\n", "a 1.02\nb\n", True),
        ("a 1.00 b\n", "a 1.2 b\n", False),
        ("joint2\n", "joint3\n", False),
        ("p 2.6e-80\n", "p 3.1e-78\n", True),
        ("p 2.6e-80\n", "p 3.1e-8\n", False),
        ("a\n…\nd\n", "a b c d\n", True),
        ("a\n…\n", "a b c d\n", True),
        ("a\n…\nc\n", "a b c d\n", False),
        ("b\n…\n", "a b c d\n", False),
        ("a b\n", "a b c\n", False),
        ("", "a\n", False),
    ],
)
def test_what_the_comparison_finds(shown, printed, right):
    assert (screens.difference(shown, printed) == "") == right
