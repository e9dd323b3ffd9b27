"""The process of a fuzz run that may die: it damages files, reads them, and prints an outcome for each, one a line."""

import contextlib
import io
import json
import os
import resource
import sys
import tempfile
import warnings
from pathlib import Path
from random import Random

from benchmarks.fuzzed import Command, Reader, Seen, damage, targets
from lite6jax.cli.command import BAD_FIT, BAD_INPUT, DONE, NOT_REACHED
from lite6jax.errors import InputError, InputWarning

READY = "ready\n"
"""The line before the first outcome, after imports and a run on the whole file."""
MEMORY = 16 << 30
"""Bytes of address space; a file that makes a process ask for more is a traceback."""


def main() -> None:
    """Reads its arguments (target, seed, first and last mutation, folder to keep failures in), prints the outcomes."""
    name, seed, first, last, keep = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, resource.RLIM_INFINITY))
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a command prints is not an outcome
    with tempfile.TemporaryDirectory() as folder:
        trial = Trial(targets()[name], Path(folder))
        out.write(READY)
        for index in range(int(first), int(last)):
            out.flush()
            outcome, detail, content = trial.mutation(seed, index)
            if keep and outcome not in ("read", "refused"):
                path = Path(keep, f"{name.replace(' ', '_')}_{index}_{outcome.replace(' ', '_')}{trial.damaged.suffix}")
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
            out.write(json.dumps((outcome, detail)) + "\n")
        out.flush()


class Trial:
    """A target with its whole file in a folder of its own."""

    def __init__(self, target: Reader | Command, folder: Path) -> None:
        self.target = target
        self.reader = target if isinstance(target, Reader) else target.file
        self._out = folder / "out"
        self._out.mkdir(parents=True)
        inputs = folder / "in"
        inputs.mkdir()
        self._path = self.reader.write(inputs)
        self.damaged = self.reader.damaged(self._path)
        self.content = self.damaged.read_bytes()
        self._whole = self.reader.read(self._path)
        if isinstance(target, Command):
            outcome, detail = self._run(target)
            if outcome != "read":
                raise RuntimeError(f"{target.name}: on the whole file: {outcome}: {detail}")

    def mutation(self, seed: str, index: int) -> tuple[str, str, bytes]:
        """The outcome of one mutation, a detail, and what was read."""
        content = damage(self.content, Random(f"{seed} {self.target.name} {index}"))
        return *self.judged(content), content

    def judged(self, content: bytes) -> tuple[str, str]:
        """The outcome of reading `content`, and a detail."""
        self.damaged.write_bytes(content)
        if isinstance(self.target, Command):
            return self._run(self.target)
        try:
            with warnings.catch_warnings(record=True) as said:
                warnings.simplefilter("error")
                warnings.simplefilter("always", InputWarning)  # what the command line prints as a line
                seen = self.target.read(self._path)
        except InputError as error:
            return ("traceback", repr(str(error))) if "\n" in str(error) else ("refused", "")
        except Exception as error:
            return "traceback", f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
        silent = not said and self._silent(seen)
        return ("silent change", self._difference(seen)) if silent else ("read", "")

    def _silent(self, seen: Seen) -> bool:
        return self.reader.sealed and seen.value != self._whole.value and seen.remarks == self._whole.remarks

    def _difference(self, seen: Seen) -> str:
        pairs = zip(seen.value, self._whole.value, strict=False)
        place = next((k for k, (one, other) in enumerate(pairs) if one != other), 0)
        return f"{self._whole.value[place : place + 40]!r} became {seen.value[place : place + 40]!r}"

    def _run(self, command: Command) -> tuple[str, str]:
        """A command as the shell runs it, in this process."""
        from lite6jax import cli

        arguments = command.arguments(self._path, self._out)
        said = io.StringIO()
        try:
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
                code = cli.main(arguments)
        except Exception as error:
            return "traceback", f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
        if code not in (DONE, NOT_REACHED, BAD_INPUT, BAD_FIT):
            return "traceback", f"exit code {code}"
        if code == BAD_INPUT and not (said.getvalue().startswith("error: ") and said.getvalue().count("\n") == 1):
            return "traceback", f"not one line: {said.getvalue()[-200:]!r}"
        return ("refused" if code == BAD_INPUT else "read"), ""


if __name__ == "__main__":
    main()
