"""How many threads this process computes with: several processes that each take every core wait for each other."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Part = TypeVar("Part")
Result = TypeVar("Result")

_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "PJRT_NPROC", "NPROC")
"""Read once, by BLAS where it is loaded and by XLA where it first computes."""

_limit: int | None = None


def limit(count: int) -> None:
    """Has everything here compute with so many threads from now on; XLA only where it has not computed yet.

    Sums of a matrix product depend on how it is divided among threads, so results that are to be the same to the last
    bit are computed with as many.
    """
    global _limit
    _limit = count
    os.environ.update((name, str(count)) for name in _VARIABLES)
    from threadpoolctl import threadpool_limits

    threadpool_limits(count)  # of libraries that are loaded already


def available() -> int:
    """The threads to compute with: what `limit` said, else one for each core that this process may use."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return cores if _limit is None else min(cores, _limit)


def by_parts(work: Callable[[Part], Result], parts: Sequence[Part]) -> list[Result]:
    """What `work` makes of each part, in their order, in as many threads as `available` says.

    The first is done before the others begin, as each could compile the same function.
    """
    first = [work(part) for part in parts[:1]]
    if available() == 1 or len(parts) < 3:
        return [*first, *map(work, parts[1:])]
    with ThreadPoolExecutor(available()) as pool:
        return [*first, *pool.map(work, parts[1:])]
