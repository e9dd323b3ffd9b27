"""Runs the workloads, prints a table of each, writes the JSON, and fails where an answer was wrong."""

import argparse
import importlib.util
import json
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.measure import MissingError, Record, Workload
from lite6jax.errors import InputError
from lite6jax.storage import check_writable, write_atomically

COMPARED = ("models", "devices")
BY_NAME = ("growth", "devices", "ceres", "fleet_diagnosis")
"""Workloads that take minutes, a device or a compiler, and run only where they are named."""
NEEDS = {"scipy": "scipy", "pinocchio": "pin", "mujoco": "mujoco"}
RIVALS = {"mujoco": "mujoco", "sklearn": "scikit-learn"}


def workloads() -> dict[str, Workload]:
    """The workloads by name, in the order in which they run."""
    from benchmarks.ceres_rival import ceres
    from benchmarks.command import command
    from benchmarks.compensation import compensation
    from benchmarks.devices import devices
    from benchmarks.diagnose import diagnose
    from benchmarks.fits import fleet, one
    from benchmarks.fleet_diagnosis import fleet_diagnosis
    from benchmarks.folders import folders
    from benchmarks.growth import growth
    from benchmarks.interrupts import interrupts
    from benchmarks.models import models
    from benchmarks.profile import profile
    from benchmarks.regressor import regressor
    from benchmarks.samples import samples
    from benchmarks.soak import soak
    from benchmarks.study import study

    return {
        run.__name__: run
        for run in (
            one,
            fleet,
            samples,
            study,
            command,
            folders,
            growth,
            devices,
            ceres,
            diagnose,
            fleet_diagnosis,
            compensation,
            models,
            regressor,
            profile,
            soak,
            interrupts,
        )
    }


def main(arguments: Sequence[str] | None = None, known: Mapping[str, Workload] | None = None) -> int:
    """The exit code: 0, 1 where an answer was wrong, 2 where the benchmarks cannot run."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    if arguments[:1] == ["concealed"]:
        return _concealed(arguments[1:])
    if arguments[:1] == ["torque"]:
        return _torque(arguments[1:])
    if arguments[:1] == ["ladder"]:
        return _ladder(arguments[1:])
    if arguments[:1] == ["rivals"]:
        return _rivals(arguments[1:])
    if arguments[:1] == ["sensitivity"]:
        return _sensitivity(arguments[1:])
    if arguments[:1] == ["fuzz"]:
        from benchmarks.fuzz import main as fuzz

        return fuzz(arguments[1:])
    missing = [package for module, package in NEEDS.items() if importlib.util.find_spec(module) is None]
    if missing:
        print(f"benchmarks: {' and '.join(missing)} missing; pip install 'lite6jax[benchmark]'", file=sys.stderr)
        return 2
    from benchmarks.devices import DEVICES, absent

    known = dict(known or workloads())
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description=__doc__,
        epilog="`concealed`, `torque`, `ladder`, `rivals`, `sensitivity` and `fuzz` have options of their own: "
        "concealed --help.",
    )
    parser.add_argument(
        "name", nargs="?", choices=list(known), help=f"one workload; without it all but {', '.join(BY_NAME)}"
    )
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the records to this file, over an older one")
    parser.add_argument(
        "--recordings", type=int, metavar="N", help="of `diagnose`: so many with nothing missing, 300 where not given"
    )
    parser.add_argument("--device", choices=DEVICES, help="compare this device with the processor: runs `devices` only")
    options = parser.parse_args(arguments)
    if options.device is not None:
        if options.name not in (None, "devices"):
            parser.error("--device: is of `devices`; leave the name out")
        if said := absent(options.device):
            print(f"benchmarks: {said}", file=sys.stderr)
            return 2
        options.name = "devices"
        known["devices"] = partial(known["devices"], device=options.device)
    if options.recordings is not None:
        if options.recordings < 1 or options.name not in (None, "diagnose"):
            parser.error("--recordings: give 1 or more, and none but `diagnose`")
        known["diagnose"] = partial(known["diagnose"], recordings=options.recordings)
    if options.json:
        try:
            check_writable(options.json, overwrite=True)
        except InputError as error:
            print(f"benchmarks: {error}", file=sys.stderr)
            return 2

    console, records = Console(), []
    for name in [options.name] if options.name else [name for name in known if name not in BY_NAME]:
        try:
            with console.status(f"{name} …"):
                found = list(known[name]())
        except MissingError as error:
            print(f"benchmarks: {name}: {error}", file=sys.stderr)
            return 2
        console.print(table(name, found))
        records += found
    if options.json:
        text = json.dumps([record.as_json() for record in records], indent=1, allow_nan=False)
        write_atomically(options.json, text, overwrite=True)
    failed = [record for record in records if record.failed]
    for record in failed:
        console.print(f"wrong: {record.workload}, {record.subject}, {record.metric}: {record.failed}", style="red")
    return 1 if failed else 0


def _concealed(arguments: Sequence[str]) -> int:
    """The concealed trials, which take an hour and are run by name only."""
    if importlib.util.find_spec("mujoco") is None:
        print("benchmarks: mujoco missing; pip install 'lite6jax[benchmark]'", file=sys.stderr)
        return 2
    from benchmarks.concealed.command import main as concealed

    return concealed(arguments)


def _torque(arguments: Sequence[str]) -> int:
    """The concealed torque trials, which are run by name only."""
    if importlib.util.find_spec("mujoco") is None:
        print("benchmarks: mujoco missing; pip install 'lite6jax[benchmark]'", file=sys.stderr)
        return 2
    from benchmarks.torque_trials.command import main as torque

    return torque(arguments)


def _ladder(arguments: Sequence[str]) -> int:
    """Real torques beside least squares of friction terms, which needs data and is run by name only."""
    if importlib.util.find_spec("pinocchio") is None:
        print("benchmarks: pin missing; pip install 'lite6jax[benchmark]'", file=sys.stderr)
        return 2
    from benchmarks.ladder import main as ladder

    return ladder(arguments)


def _sensitivity(arguments: Sequence[str]) -> int:
    """What a diagnosis depends on, which takes long and is run by name only."""
    if importlib.util.find_spec("mujoco") is None:
        print("benchmarks: mujoco missing; pip install 'lite6jax[benchmark]'", file=sys.stderr)
        return 2
    from benchmarks.sensitivity import main as sensitivity

    return sensitivity(arguments)


def _rivals(arguments: Sequence[str]) -> int:
    """The diagnosis beside what others would do, which needs data or an hour and is run by name only."""
    missing = [package for module, package in RIVALS.items() if importlib.util.find_spec(module) is None]
    if missing:
        print(f"benchmarks: {' and '.join(missing)} missing; pip install 'lite6jax[benchmark]'", file=sys.stderr)
        return 2
    from benchmarks.residual.command import main as rivals

    return rivals(arguments)


def table(name: str, records: Sequence[Record]) -> Table:
    """The records of a workload, one a row; of one that compares like with like, a column a subject."""
    shown = Table(title=name, title_justify="left")
    if name in COMPARED:
        cells = {(record.metric, record.subject): record for record in records}
        subjects = list(dict.fromkeys(record.subject for record in records))
        shown.add_column("metric")
        for subject in subjects:
            shown.add_column(subject, justify="right")
        for metric, unit in dict.fromkeys((record.metric, record.unit) for record in records):
            row = [cells.get((metric, subject)) for subject in subjects]
            values = ["" if record is None else _value(record) for record in row]
            shown.add_row(f"{metric} ({unit})" if unit else metric, *values)
        return shown
    for column in ("workload", "subject", "metric"):
        shown.add_column(column, overflow="fold")
    for column in ("value", "unit", "better"):
        shown.add_column(column, justify="right" if column == "value" else "left")
    for record in records:
        style = "red" if record.failed else None
        shown.add_row(
            record.workload, record.subject, record.metric, _value(record), record.unit, record.better, style=style
        )
    return shown


def _value(record: Record) -> str:
    return ("none" if record.value is None else f"{record.value:.4g}") + (" ✗" if record.failed else "")


if __name__ == "__main__":
    sys.exit(main())
