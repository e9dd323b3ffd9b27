"""Functions for workers, in a module that takes no time to load there."""

import os
import signal
import time
from pathlib import Path

import pyarrow as pa


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
            time.sleep(0.3)
        with open(Path(folder, "done"), "a") as file:
            file.write(f"{value}\n")
    return pa.table({"input": [str(value) for value in inputs], "length": [len(str(value)) for value in inputs]})


def dead(value):
    """The row of an input at which workers die."""
    return pa.table({"input": [str(value)], "length": [-1]})


def content(inputs):
    return "\0".join(map(str, inputs)).encode()


def diagnosed(names, place, folder):
    """Rows of diagnoses that are none, of files whose content is the verdict; of an empty file a refusal."""
    from lite6jax.distribution.batches import concatenated
    from lite6jax.folders.diagnoses import refusal, row_of

    rows = []
    for name in names:
        with place.at_hand([name]) as here:
            verdict = (here / name).read_text()
        with open(Path(folder, "done"), "a") as file:
            file.write(f"{name}\n")
        errors = {"heldout_position_rms_m": 0.5}
        document = {
            "schema": "lite6jax/diagnosis/2",
            "verdict": verdict,
            "quality": {"verdict": "good"},
            "before": errors,
            "after": errors,
            "samples": 7,
            "data_faults": [{"fault": "outliers"}],
            "findings": [{"effect": "joint_lag", "site": "joint1", "p_value": 0.5}],
        }
        rows.append(row_of(name, document, f"document of {name}") if verdict else refusal(name, f"{here / name}: no"))
    return concatenated(rows)
