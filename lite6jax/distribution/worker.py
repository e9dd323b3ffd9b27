"""What a worker does, on this machine or of a cluster: it is set up once, and works on one batch at a time."""

import ctypes
import gc
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import pyarrow as pa

Function = Callable[..., pa.Table]
"""Of the inputs of a batch and what is given to all: a row an input, in their order. It stands in a module, so that
other processes find it."""

_MOST_MAPPINGS = 40_000
"""Of memory; Linux lets a process have 65 530, and every compiled function takes several."""

_one_at_a_time = threading.Lock()
_is_set_up = False


def work(function: Function, inputs: Sequence[Any], given: tuple[Any, ...]) -> bytes:
    """The rows of a batch, as `of_table` makes them.

    A worker of a cluster may call this from several threads: one computes, as compiled code and what libraries set for
    a whole process are shared.
    """
    with _one_at_a_time:
        set_up()
        rows = of_table(function(inputs, *given))
        _forget_compiled()
        _give_back_memory()
        return rows


def set_up() -> None:
    """One thread, and the compiled code of all workers of this user on this machine."""
    global _is_set_up
    if _is_set_up:
        return
    from lite6jax import threads

    threads.limit(1)  # before what computes is loaded
    from lite6jax.fitting.compiled import keep_compiled_code

    keep_compiled_code()
    gc.set_threshold(200_000)  # tracing makes objects that stay
    _is_set_up = True


def of_table(table: pa.Table) -> bytes:
    """A table as a stream of Arrow."""
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as stream:
        stream.write_table(table)
    return sink.getvalue().to_pybytes()


def table_of(stream: bytes) -> pa.Table:
    """The table of `of_table`."""
    return pa.ipc.open_stream(stream).read_all()


def _forget_compiled() -> None:
    try:
        mappings = Path("/proc/self/maps").read_bytes().count(b"\n")
    except OSError:
        return
    if mappings > _MOST_MAPPINGS:
        import jax

        jax.clear_caches()


def _give_back_memory() -> None:
    """Has the allocator return what it holds of freed memory: a heap in fragments else grows with every batch."""
    with suppress(OSError, AttributeError, TypeError):  # a C library other than glibc
        ctypes.CDLL(None).malloc_trim(0)
