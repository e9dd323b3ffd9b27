"""Workers of a Dask cluster that runs already, by the address of its scheduler."""

import asyncio
import itertools
import time
import uuid
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, final

from lite6jax.distribution.processes import Died, Outcome
from lite6jax.errors import InputError

if TYPE_CHECKING:
    from lite6jax.distribution.worker import Function

ANSWERS_WITHIN = 10.0
"""s; a scheduler that takes longer is not there."""
WORKERS_WITHIN = 60.0
"""s; a cluster that adapts to its load needs a while to start workers."""
_IN_HAND = 2
"""Batches a thread of the workers that are sent ahead: what a scheduler holds does not grow with their number."""
_COUNTED_EVERY = 5.0


@final
class Cluster:
    """The cluster behind the address of a scheduler, connected by the `with` statement.

    Dask sends a batch to another worker where one dies, and gives it up after so many deaths as its setting
    `distributed.scheduler.allowed-failures` says.
    """

    def __init__(self, address: str) -> None:
        """Connects to nothing.

        Args:
            address: of the scheduler.
        """
        self._address = address

    def __enter__(self) -> "Cluster":
        """Connects.

        Raises:
            InputError: Dask is not installed, or no scheduler answers.
        """
        try:
            from distributed import Client
        except ImportError as error:
            raise InputError(
                f"--scheduler {self._address}: takes Dask; pip install 'lite6jax[distributed]', or leave it out"
            ) from error
        from lite6jax.fitting.compiled import versions

        try:
            self._client = Client(self._address, timeout=ANSWERS_WITHIN, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                f"--scheduler {self._address}: no scheduler answers there; start one by `dask scheduler`, or correct "
                "the address (tcp://HOST:8786)"
            ) from error
        self._run, self._counter = uuid.uuid4().hex, itertools.count()
        self._versions = versions()
        self._threads, self._counted = 0, -_COUNTED_EVERY
        return self

    def __exit__(self, *error: object) -> None:
        self._client.close(timeout=ANSWERS_WITHIN)

    def begin(self, function: "Function", given: tuple[Any, ...]) -> None:
        """As `Processes.begin`."""
        from distributed import as_completed

        self._function, self._given = function, given
        self._finished: Any = as_completed(loop=self._client.loop)
        self._numbers: dict[str, int] = {}

    @property
    def has_room(self) -> bool:
        """Whether the workers are soon through with what they have."""
        if time.monotonic() - self._counted > _COUNTED_EVERY:
            threads: Any = self._client.nthreads()
            self._threads = sum(threads.values())
            self._counted = time.monotonic()
        return len(self._numbers) < _IN_HAND * max(self._threads, 1)

    def submit(self, number: int, inputs: Sequence[Any]) -> None:
        """Sends a batch to the scheduler."""
        key = f"lite6jax-{self._run}-{next(self._counter)}"
        future = self._client.submit(
            _worked, self._function, list(inputs), self._given, self._versions, key=key, pure=False
        )
        self._numbers[key] = number
        self._finished.add(future)

    def next(self) -> tuple[int, Outcome]:
        """Waits for the next batch, as `Processes.next`.

        Raises:
            InputError: the cluster has no worker, one of them has another version of the package or of a library, or
                the scheduler is gone.
            Exception: what the function raised.
        """
        from distributed import KilledWorker
        from distributed.client import FutureCancelledError

        if self._threads == 0:
            self._wait_for_workers()
        future = next(self._finished)
        number = self._numbers.pop(future.key)
        try:
            return number, future.result()
        except KilledWorker:
            return number, Died()
        except (FutureCancelledError, asyncio.CancelledError) as error:
            raise InputError(
                f"--scheduler {self._address}: the scheduler is gone; start it, and the same command goes on where it "
                "stopped"
            ) from error

    def _wait_for_workers(self) -> None:
        try:
            self._client.wait_for_workers(1, timeout=WORKERS_WITHIN)
        except TimeoutError as error:
            raise InputError(
                f"--scheduler {self._address}: the cluster has no worker; start some by `dask worker {self._address} "
                "--nthreads 1`"
            ) from error


def _worked(function: "Function", inputs: Sequence[Any], given: tuple[Any, ...], expected: tuple[str, ...]) -> bytes:
    """The rows of a batch, by a worker with the same versions as the program that asks.

    Raises:
        InputError: they are others, which might compute other numbers.
    """
    from lite6jax.distribution.worker import work
    from lite6jax.fitting.compiled import versions

    if versions() != expected:
        raise InputError(
            "a worker of the cluster has another version of lite6jax, of Python or of a library than this program; "
            "install the same in both places, and start the workers again"
        )
    return work(function, inputs, given)
