"""Ctrl-C and SIGTERM in the first second of a command: how many end it at once, in one line and with the right code."""

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from benchmarks.measure import ROOT, Record
from lite6jax.cli.command import INTERRUPTED, TERMINATED

COMMAND = (sys.executable, "-m", "lite6jax.cli", "design", "lite6", "--poses", "60", "--out", "poses.csv")
"""Longer than the second, with all that a command imports."""
SAID = {
    signal.SIGINT: ("interrupted: nothing is left half-written\n", INTERRUPTED),
    signal.SIGTERM: ("ended by SIGTERM: nothing is left half-written\n", TERMINATED),
}
RIGHT, BEFORE, TRACEBACK, SWALLOWED, OTHER = (
    "right",
    "before the program's first line",
    "traceback",
    "swallowed",
    "other",
)


def interrupts(times: int = 40, within: float = 1.0) -> Iterator[Record]:
    """Counts of outcomes, of as many runs as times, each signalled that much later.

    Args:
        times: instants, equally spaced, the first after `within / times`.
        within: s after the start of the process.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # of a shell that runs this in the background
        signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in SAID:
        with tempfile.TemporaryDirectory() as folder:
            found = Counter(outcome(number, within * (i + 1) / times, Path(folder)) for i in range(times))
        name = signal.Signals(number).name
        for kind in (RIGHT, BEFORE, TRACEBACK, SWALLOWED, OTHER):
            wrong = f"{found[kind]} of {times}" if found[kind] and kind not in (RIGHT, BEFORE) else ""
            better = "higher" if kind == RIGHT else "lower"
            yield Record("interrupts", f"{times} × {name}", kind, float(found[kind]), "", better, wrong)


def outcome(number: signal.Signals, after: float, folder: Path, command: tuple[str, ...] = COMMAND) -> str:
    """What a signal does to a command.

    Args:
        number: the signal.
        after: s after the start of the process.
        folder: in which it runs, and which must be empty in the end.
        command: the program with its arguments.

    Returns:
        `BEFORE` where Python had not reached the program: then it ends by the signal itself, or by a traceback through
        Python's own modules only. No program can change that.
    """
    environment = os.environ | {"PYTHONPATH": str(ROOT), "TMPDIR": str(folder)}
    started = time.monotonic()
    process = subprocess.Popen(
        command, cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    time.sleep(max(0.0, started + after - time.monotonic()))
    process.send_signal(number)
    try:
        _, err = process.communicate(timeout=30)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        return SWALLOWED
    if (err, process.returncode) == SAID[number] and not any(folder.iterdir()):
        return RIGHT
    if process.returncode == 0:
        return SWALLOWED
    if process.returncode == -number and not err:
        return BEFORE
    if "Traceback" in err or "Exception ignored" in err:
        files = re.findall(r'File "([^"]+)"', err)
        return TRACEBACK if any(file.startswith(str(ROOT / "lite6jax")) for file in files) else BEFORE
    return OTHER
