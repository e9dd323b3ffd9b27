"""Runs the workloads, prints a table of each, writes the JSON, and fails where an answer was wrong."""

import argparse
import importlib.util
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.measure import DONE, MISSED, UNUSABLE, Record, Workload, run_command, write_records
from lite6jax.storage import check_writable

MODULES = (
    ("fits", ("one", "fleet", "samples", "devices", "ceres")),
    ("study", ("study", "models", "regressor")),
    ("commands", ("command", "folders", "diagnose")),
    ("scaling", ("rollouts", "scaling")),
    *((name, (name,)) for name in ("fleet_diagnosis", "compensation")),
    ("commands", ("soak",)),
)
"""Workloads in the order in which they run: functions of this folder's modules."""
WORKLOADS = {name: module for module, names in MODULES for name in names}
BY_NAME = ("devices", "ceres", "fleet_diagnosis", "scaling", "soak")
"""Workloads that take minutes, a device or a compiler, and run only where they are named."""
PACKAGES = {"scipy": "scipy", "pinocchio": "pin", "mujoco": "mujoco", "sklearn": "scikit-learn"}
"""Those of the extra `benchmark`, by the module that is imported."""
OF_WORKLOADS = ("scipy", "pinocchio", "mujoco")  # what the workloads cannot do without
COMMANDS = {
    "concealed": ("concealed.campaign", "mujoco"),
    "torque": ("torque_trials.campaign", "mujoco"),
    "tracking": ("tracking_trials.campaign", "mujoco"),
    "frozen": ("frozen.command", "mujoco"),
    "ladder": ("ladder", "pinocchio"),
    "rivals": ("rivals", "sklearn"),
    "sensitivity": ("sensitivity", "mujoco"),
}
"""Commands with options of their own: the module that has them, and what it cannot do without."""


def main(arguments: Sequence[str] | None = None, known: Mapping[str, Workload] | None = None) -> int:
    """The exit code: 0, 1 where an answer was wrong, 2 where the benchmarks cannot run."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    module, *needed = COMMANDS.get(arguments[0] if arguments else "", ("", *OF_WORKLOADS))
    missing = [PACKAGES[each] for each in needed if importlib.util.find_spec(each) is None]
    if missing:
        print(f"benchmarks: {' and '.join(missing)} missing; pip install 'lite6jax[benchmark]'", file=sys.stderr)
        return UNUSABLE
    if module:
        return importlib.import_module(f"benchmarks.{module}").main(arguments[1:])
    return run_command(partial(_run, arguments, dict(known or {name: partial(_workload, name) for name in WORKLOADS})))


def _workload(name: str, **options: Any) -> Iterator[Record]:
    return getattr(importlib.import_module(f"benchmarks.{WORKLOADS[name]}"), name)(**options)


def _run(arguments: Sequence[str], known: dict[str, Workload]) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description=__doc__,
        epilog=f"{', '.join(COMMANDS)} have options of their own: concealed --help.",
    )
    unnamed = f"one workload; without it all but {', '.join(BY_NAME)}"
    parser.add_argument("name", nargs="?", choices=list(known), help=unnamed)
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the records to this file, over an older one")
    parser.add_argument(
        "--device", choices=("cpu", "gpu"), help="compare this device with the processor: runs `devices` only"
    )
    options = parser.parse_args(arguments)
    if options.device is not None:
        if options.name not in (None, "devices"):
            parser.error("--device: is of `devices`; leave the name out")
        options.name = "devices"
        known["devices"] = partial(known["devices"], device=options.device)
    if options.json:
        check_writable(options.json, overwrite=True)
    console, records = Console(), []
    for name in [options.name] if options.name else [name for name in known if name not in BY_NAME]:
        with console.status(f"{name} …"):
            found = list(known[name]())
        table = Table("workload", "subject", "metric", "value", "unit", title=name, title_justify="left")
        for each in found:
            value = ("none" if each.value is None else f"{each.value:.4g}") + (" ✗" if each.failed else "")
            style = "red" if each.failed else None
            table.add_row(each.workload, each.subject, each.metric, value, each.unit, style=style)
        console.print(table)
        records += found
    if options.json:
        write_records(options.json, records)
    failed = [record for record in records if record.failed]
    for record in failed:
        console.print(f"wrong: {record.workload}, {record.subject}, {record.metric}: {record.failed}", style="red")
    return MISSED if failed else DONE


if __name__ == "__main__":
    sys.exit(main())
