"""Functions for workers, in a module that takes no time to load there."""

import os
import signal
import time
from pathlib import Path

import pyarrow as pa

from lite6jax.storage import temporary_folder


def spelled(inputs, folder):
    """A row an input. `die` ends the process whenever it is met, `die once` the first time, `fail` raises."""
    for value in inputs:
        once = Path(folder, "died")
        if value == "die" or (value == "die once" and not once.exists()):
            once.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if value == "fail":
            raise KeyError(value)
        if value == "slow":
            with temporary_folder():
                time.sleep(0.3)
        with open(Path(folder, "done"), "a") as file:
            file.write(f"{value}\n")
    return pa.table({"input": [str(value) for value in inputs], "length": [len(str(value)) for value in inputs]})


_hoard = []


def hoarded(inputs, size):
    """A row an input: the process that worked on it, and what it had of memory before. It keeps `size` bytes more."""
    before = resident()
    _hoard.append(b"x" * size)
    return pa.table({"input": inputs, "process": [os.getpid()] * len(inputs), "resident": [before] * len(inputs)})


def resident():
    """Bytes of memory of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def freed(inputs):
    """A row an input: bytes of memory with blocks freed between what stays, and without what is between."""
    blocks = [bytearray(64 * 1024) for _ in range(1600)]
    _hoard.extend(blocks[::16])
    del blocks
    return pa.table({"held": [resident()] * len(inputs)})


def unsendable(inputs):
    """Raises what cannot be pickled."""

    class Unsendable(Exception):  # noqa: N818
        pass

    raise Unsendable("no")


def ends_at_once(lifeline, imports):
    """In the place of what a process does first."""
    os._exit(3)


def dead(value):
    """The row of an input at which workers die."""
    return pa.table({"input": [str(value)], "length": [-1]})


def diagnosed(names, place, folder):
    """Rows of diagnoses that are none, of files whose content is the verdict; of an empty file a refusal."""
    from lite6jax.fleet.diagnoses import make_refusal, make_row
    from lite6jax.workers import concatenate

    rows = []
    for name in names:
        with place.local_folder([name]) as here:
            verdict = (here / name).read_text()
        with open(Path(folder, "done"), "a") as file:
            file.write(f"{name}\n")
        if verdict == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        document = document_of(verdict)
        rows.append(
            make_row(name, document, f"document of {name}") if verdict else make_refusal(name, f"{here / name}: no")
        )
    return concatenate(rows)


def reduced(names, place, command):
    """Rows of recordings of a fleet without a diagnosis, of files whose content is the seed of a linear arm."""
    import numpy as np

    from lite6jax.fleet.diagnoses import make_row
    from lite6jax.fleet.terms import PooledTerm
    from lite6jax.workers import concatenate
    from tests.fleet.linear_arms import arm

    rows = []
    for name in names:
        with place.local_folder([name]) as here:
            rng = np.random.default_rng(int((here / name).read_text()))
        made = arm(rng, [(PooledTerm("soft"), [0.6])]).to_bytes()
        rows.append(make_row(name, document_of("consistent"), f"document of {name}", made))
    return concatenate(rows)


def document_of(verdict):
    """As much of a diagnosis as a row tells."""
    errors = {"heldout_position_rms_m": 0.5}
    return {
        "schema": "lite6jax/diagnosis/3",
        "domain": "poses",
        "verdict": verdict,
        "quality": {"verdict": "good"},
        "before": errors,
        "after": errors,
        "samples": 7,
        "data_faults": [{"fault": "outliers"}],
        "findings": [{"effect": "joint_lag", "site": "joint1", "p_value": 0.5}],
    }


def folded(fold, what, mother):
    """A fold and the process that worked on it. In all processes but `mother`, `die` ends it, and `fail` raises."""
    if os.getpid() == mother:
        time.sleep(0.05)
    elif what == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    elif what == "fail":
        raise KeyError(what)
    return int(fold[0]), os.getpid()
