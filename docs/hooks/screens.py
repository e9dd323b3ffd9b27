"""The screens in the documents: runs what a page tells its reader to type, and compares or renews what it shows of it.

In a page, a block with `title="FILE"` is that file, a `python` block is run, and of a `console` block each
`$ lite6jax …` is run; all of a page in one folder, from its top to its end. A line `…` stands for lines that are left
out. A `sh` block is not run. The README shows commands of the pages again; it is compared with these. A command that
runs until Ctrl-C, such as an emulated controller, runs beside the others to the end of its page.

`python -m docs.hooks.screens` (`make screens`) writes what the commands print now into the pages and the README.
"""

import contextlib
import io
import math
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from lite6jax import cli

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
WIDTH = 100
LEFT_OUT = "…"
_BLOCK = re.compile(r"^```(?P<kind>\w+)(?P<info>[^\n]*)\n(?P<body>.*?)^```$", re.MULTILINE | re.DOTALL)
_TITLE = re.compile(r'title="([^"]+)"')
_ENTRY = re.compile(r"^\$ (?P<typed>(?:[^\n]*\\\n)*[^\n]*)\n(?P<shown>(?:(?!\$ )[^\n]*\n)*)", re.MULTILINE)
_STAYING = {"emulate", "view"}
"""Commands that run until Ctrl-C, and say so in the last line that they print at first."""
_LOOPBACK = "127.0.0.1"
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


class Screen(NamedTuple):
    """A command as it is typed, and what a page shows of its output."""

    typed: str
    shown: str

    @property
    def words(self) -> tuple[str, ...]:
        """The command's words, without the comment."""
        return tuple(shlex.split(self.typed.replace("\\\n", " "), comments=True))

    @property
    def stays(self) -> bool:
        """Whether it runs until Ctrl-C."""
        return len(self.words) > 1 and self.words[1] in _STAYING


def pages() -> list[Path]:
    """The pages of which something is run."""
    return [path for path in sorted((ROOT / "docs").rglob("*.md")) if "\n```console\n" in path.read_text()]


def screens(text: str) -> list[Screen]:
    """The commands of the `console` blocks of a text."""
    blocks = [block["body"] for block in _BLOCK.finditer(text) if block["kind"] == "console"]
    return [Screen(entry["typed"], entry["shown"]) for body in blocks for entry in _ENTRY.finditer(body)]


def run(text: str, folder: Path) -> Iterator[tuple[Screen, str]]:
    """Runs a page in a folder; yields each command with what it printed.

    Raises:
        RuntimeError: a command refused its input, or ended that should run until Ctrl-C.
    """
    os.environ["COLUMNS"] = str(WIDTH)
    with contextlib.chdir(folder), contextlib.ExitStack() as staying:
        for block in _BLOCK.finditer(text):
            title = _TITLE.search(block["info"])
            if title:
                Path(title[1]).write_text(block["body"])
            elif block["kind"] == "python":
                exec(compile(block["body"], "page", "exec"), {"__name__": "page"})
            elif block["kind"] == "console":
                for screen in screens(block[0]):
                    yield screen, _as_shown(_started(screen, staying) if screen.stays else _printed(screen))


def _printed(screen: Screen) -> str:
    said, complained = io.StringIO(), io.StringIO()
    words = [word.replace(_LOOPBACK, _own_loopback()) for word in screen.words[1:]]
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(complained):
        code = cli.main(words)
    if screen.words[0] != "lite6jax" or code not in (0, 1):
        raise RuntimeError(f"$ {screen.typed}\nended with {code}: {complained.getvalue()}")
    return said.getvalue()


def _started(screen: Screen, staying: contextlib.ExitStack) -> str:
    """Starts a command that runs until Ctrl-C, which `staying` ends; what it prints until it says that."""
    name, *words = screen.words[1:]
    host = {"emulate": "--address", "view": "--host"}[name]
    command = [sys.executable, "-m", "lite6jax.cli", name, *words, host, _own_loopback()]
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    process = staying.enter_context(
        subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env={**os.environ, "PYTHONPATH": path}
        )
    )
    staying.callback(process.terminate)
    assert process.stdout is not None
    said = ""
    for line in process.stdout:
        said += line
        if "Stop with Ctrl-C." in line:
            return said
    raise RuntimeError(f"$ {screen.typed}\nended: {said}")


def _own_loopback() -> str:
    """An address of loopback for this process: another may emulate a controller on the usual one, at the same ports."""
    return f"127.{96 + os.getpid() // 65025 % 32}.{os.getpid() // 255 % 255}.{os.getpid() % 255}"


def _as_shown(printed: str) -> str:
    """As a reader sees it: the usual address, and a file of the package by its place in it."""
    text = printed.replace(_own_loopback(), _LOOPBACK).replace(f"{ROOT}{os.sep}", "")
    return "\n".join(line.rstrip() for line in text.splitlines()) + "\n"


def difference(shown: str, printed: str) -> str:
    """The first words that a page shows and that were not printed so; empty where it is right.

    Line breaks do not count, numbers may differ by a twentieth or in their last digit, and p-values by their size.
    """
    there, at = _tokens(printed), 0
    parts = [_tokens(part) for part in re.split(rf"^{LEFT_OUT}$", shown, flags=re.MULTILINE)]
    for number, part in enumerate(parts):
        last = len(there) - len(part)
        starts: Sequence[int] = range(at, last + 1) if number else [0]
        if number == len(parts) - 1 and (part or not number):  # what is shown last is printed last
            starts = [start for start in starts if start == last]
        found = next((start for start in starts if _alike(part, there[start : start + len(part)])), None)
        if found is None:
            return " ".join(part[:40]) or "(nothing is shown)"
        at = found + len(part)
    return ""


def _tokens(text: str) -> list[str]:
    return [token for token in text.split() if set(token) - {"─"}]


def _alike(one: Sequence[str], other: Sequence[str]) -> bool:
    return len(one) == len(other) and all(map(_same, one, other))


def _same(one: str, other: str) -> bool:
    if _NUMBER.sub("#", one) != _NUMBER.sub("#", other):
        return False
    return all(map(_near, _NUMBER.findall(one), _NUMBER.findall(other)))


def _near(one: str, other: str) -> bool:
    a, b = float(one), float(other)
    if "e" in one + other and a > 0 and b > 0:
        return abs(math.log(a) - math.log(b)) <= 0.1 * abs(math.log(a)) + 1
    digits = max((len(text.partition(".")[2]) for text in (one, other)), default=0)
    return a == b or (digits > 0 and math.isclose(a, b, rel_tol=0.05, abs_tol=1.5 * 10.0**-digits))


def renewed(text: str, printed: dict[tuple[str, ...], str]) -> str:
    """A text with what was printed in place of what it shows, shortened as it was."""

    def renew(entry: re.Match[str]) -> str:
        screen = Screen(entry["typed"], entry["shown"])
        now = printed.get(screen.words)
        if now is None:
            return entry[0]
        blank = "\n" if screen.shown.endswith("\n\n") else ""
        return f"$ {screen.typed}\n{_shortened(screen, now.strip(chr(10)) + chr(10))}{blank}"

    return _BLOCK.sub(lambda block: block[0] if block["kind"] != "console" else _ENTRY.sub(renew, block[0]), text)


def _shortened(screen: Screen, printed: str) -> str:
    if not re.search(rf"^{LEFT_OUT}$", screen.shown, re.MULTILINE):
        return printed
    lines, at, kept = printed.splitlines(), 0, []
    for line in screen.shown.strip("\n").splitlines():
        if line == LEFT_OUT:
            kept.append(line)
            continue
        same = _found(line, lines, at)
        if same is None:
            print(
                f"$ {screen.typed}\n  {line!r} is no longer printed: all is shown; shorten it by hand", file=sys.stderr
            )
            return printed
        kept.append(lines[same])
        at = same + 1
    return "\n".join(kept) + "\n"


def _found(line: str, lines: Sequence[str], at: int) -> int | None:
    """The first line from a place on that is this one: unchanged, else with near numbers, else with any."""
    tests: tuple[Callable[[str], bool], ...] = (
        lambda other: other.split() == line.split(),
        lambda other: _alike(_tokens(line), _tokens(other)),
        lambda other: _shape(other) == _shape(line),
    )
    return next((k for test in tests for k in range(at, len(lines)) if test(lines[k])), None)


def _shape(line: str) -> str:
    return _NUMBER.sub("#", "".join(line.split()))


def main(chosen: Sequence[str]) -> None:
    """Renews the pages named, or all, and the README."""
    printed: dict[tuple[str, ...], str] = {}
    for page in [Path(name).resolve() for name in chosen] or pages():
        text = page.read_text()
        with tempfile.TemporaryDirectory() as folder:
            of_page = {screen.words: output for screen, output in run(text, Path(folder))}
        page.write_text(renewed(text, of_page))
        printed |= of_page
    README.write_text(renewed(README.read_text(), printed))


if __name__ == "__main__":
    main(sys.argv[1:])
