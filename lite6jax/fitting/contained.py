"""Files fitted in another process: a file at which it dies costs its own row and no other."""

import multiprocessing
import signal
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import TYPE_CHECKING, final

from lite6jax import interruption

if TYPE_CHECKING:
    from lite6jax.arms.arm import Arm
    from lite6jax.fitting.folder_fit import RecordingFit
    from lite6jax.fitting.folder_rows import Row

    Given = tuple[Arm | None, RecordingFit]


@final
class Contained:
    """A process that fits files, started by the `with` statement, and anew where it has died.

    One process does all, because to start one takes a second; it uses every core by itself. This module imports little,
    so that the process starts while the program imports the rest.
    """

    def __init__(self) -> None:
        """Starts nothing."""
        self._process: SpawnProcess | None = None
        self._connection: Connection | None = None

    def __enter__(self) -> "Contained":
        self._undone = interruption.undone(self._kill)
        self._undone.__enter__()
        self._started()
        return self

    def __exit__(self, *error: object) -> None:
        self._kill()
        self._end()
        self._undone.__exit__(None, None, None)

    def _kill(self) -> None:
        if self._process is not None:
            self._process.kill()

    def fit(
        self,
        files: "Sequence[Path]",
        nominal: "Arm | None",
        fit_one: "RecordingFit",
        progress: Callable[[int], object] = lambda done: None,
    ) -> "list[Row]":
        """A row a file, in their order.

        Args:
            files, nominal, fit_one: as `fit_files` takes them; `fit_one` is a function of a module.
            progress: called with the number of files done since the last call.
        """
        reported = 0

        def report(done: int) -> None:
            nonlocal reported
            progress(max(0, done - reported))
            reported = max(reported, done)

        rows = self._fit(list(files), (nominal, fit_one), report)
        report(len(files))
        return [rows[path] for path in files]

    def _fit(self, files: list[Path], given: "Given", report: Callable[[int], object]) -> "dict[Path, Row]":
        from lite6jax.fitting.folder_rows import Row, kind_of
        from lite6jax.fitting.solution import Result

        died: dict[Path, Row] = {}
        while files:
            found, at, how = self._attempt(files, given, report)
            if found is not None:
                return died | dict(zip(files, found, strict=True))
            if at is None and len(files) > 1:  # in a batch: one by one
                for path in files:
                    died |= self._fit([path], given, lambda done: None)
                return died
            at = at or files[0]
            message = (
                f"{at}: the process that read it was ended ({how}); the file is damaged or too large for this machine"
            )
            died[at] = Row(at.name, kind_of(at), Result.UNREADABLE, message)
            files.remove(at)
        return died

    def _attempt(
        self, files: list[Path], given: "Given", report: Callable[[int], object]
    ) -> "tuple[list[Row] | None, Path | None, str]":
        """The rows; or None, the file at which the process died (None in a batch), and how."""
        at: Path | None = None
        try:
            connection = self._started()
            connection.send((files, *given))
            while True:
                said = connection.recv()
                if isinstance(said, list):
                    return said, None, ""
                at, done = said
                report(done)
        except (EOFError, OSError):
            return None, at, self._end()

    def _started(self) -> Connection:
        if self._connection is None:
            context = multiprocessing.get_context("spawn")
            self._connection, theirs = context.Pipe()
            process = context.Process(target=_serve, args=(theirs,), daemon=True)
            # it inherits a blocked Ctrl-C, which is this process's to answer
            blocks = hasattr(signal, "pthread_sigmask")
            before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT]) if blocks else ()
            try:
                process.start()
            finally:
                if blocks:
                    signal.pthread_sigmask(signal.SIG_SETMASK, before)
            self._process = process
            theirs.close()
        return self._connection

    def _end(self) -> str:
        """Forgets a process that ends; returns how it ended."""
        process, connection = self._process, self._connection
        self._process = self._connection = None
        if process is None or connection is None:
            return ""
        connection.close()
        process.join()
        code = process.exitcode
        process.close()
        return signal.Signals(-code).name if code is not None and code < 0 else f"exit code {code}"


def _serve(connection: Connection) -> None:
    """Fits what is asked for until the other process closes the connection, or ends."""
    from lite6jax.fitting.compiled import keep_compiled_code
    from lite6jax.fitting.folder_fit import fit_files

    keep_compiled_code()
    try:
        while True:
            files, nominal, fit_one = connection.recv()
            connection.send(fit_files(files, nominal, fit_one, lambda path, done: connection.send((path, done))))
    except (EOFError, BrokenPipeError):
        return
