"""The command of a kind of trials: runs them, or one of them, and says what came of it."""

import argparse
import json
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import yaml
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from benchmarks.campaigns.campaign import Campaign, open_truth, truth_text, write_files
from benchmarks.campaigns.judgement import Row
from benchmarks.campaigns.report import draw_detection, markdown, sections, tables
from benchmarks.measure import DONE, MISSED, run_command
from lite6jax.errors import InputError
from lite6jax.storage import check_writable


def main(campaign: Campaign, arguments: Sequence[str] | None = None) -> int:
    """The exit code: 0, 1 where a goal is missed, 2 for arguments that cannot be used, 130 where interrupted."""
    parser = argparse.ArgumentParser(
        prog=f"python -m benchmarks {campaign.name}",
        description="Recordings of simulated arms whose hidden physics is drawn by a generator that shares no code "
        "with the library, sealed before the diagnosis begins and opened after it; and what the diagnosis is worth.",
    )
    add = parser.add_argument
    counts = f"how many; if not given {campaign.count}, and fewer of a sensor or a noise that is chosen"
    add("--trials", type=at_least(1), metavar="N", help=counts)
    add("--seed", type=at_least(0), default=0, metavar="S", help="of the campaign; 0 if not given")
    kinds = "only trials of this kind; give it again for one more"
    add("--kind", choices=list(campaign.rounds.shares), action="append", help=kinds)
    if campaign.sensors:
        sensors = "only recordings of this sensor, which measures no poses: clean ones and single effects"
        add("--sensor", choices=list(campaign.sensors), help=sensors)
    if campaign.noises:
        noises = "only healthy arms with this noise, which is hard to tell from physics"
        add("--noise", choices=list(campaign.noises), help=noises)
    sealed = "draw what is outside the catalogue from the families that are put aside, and from no other: to be looked "
    add("--sealed", action="store_true", help=f"{sealed}at once, when the development is over")
    add("--trial", type=at_least(0), metavar="I", help="only trial I of the seed, and all that happened in it")
    add("--out", type=Path, metavar="FILE.parquet", help="keep the results here; goes on where it stopped")
    add("--compare", type=Path, metavar="BEFORE.parquet", help="say what differs from earlier results")
    add("--figure", type=Path, metavar="FILE.png", help="draw what is found by the size of the effect")
    add("--export", type=Path, metavar="DIR", help="diagnose nothing; write the files here, truth and all")
    add("--markdown", action="store_true", help="print the tables as Markdown")
    add("--processes", type=at_least(1), metavar="P", help="that work at a time; one a core if not given")
    cluster = "of a Dask cluster that works in place of processes, as tcp://HOST:8786"
    add("--scheduler", metavar="ADDRESS", help=cluster)
    options = parser.parse_args(arguments)
    sensor = getattr(options, "sensor", None)
    noise = getattr(options, "noise", None)
    if sensor and noise:
        parser.error("--noise: is of sensors that measure poses; leave --sensor out")
    campaign = campaign.sensors.get(sensor or "", campaign)
    campaign = campaign.noises.get(noise or "", campaign)
    if not set(options.kind or ()) <= set(campaign.rounds.shares):
        chosen = "--sensor" if sensor else "--noise"
        parser.error(f"--kind: with this {chosen} only {' and '.join(campaign.rounds.shares)}")
    options.trials = options.trials or campaign.count
    if options.trial is not None and (options.kind or options.out or options.figure or options.compare):
        parser.error("--trial: runs one and keeps nothing; leave --kind, --out, --figure and --compare out")
    if options.out and options.out.suffix != ".parquet":
        parser.error(f"--out: {options.out} is to be a Parquet file; end its name in .parquet")
    kept = f"; what was done is kept beside {options.out}, the same command goes on" if options.out else ""
    work = _exported if options.export else _many if options.trial is None else _one
    return run_command(
        partial(work, campaign, options, Console(highlight=False)), (InputError, ValueError, OSError), kept
    )


def _many(campaign: Campaign, options: argparse.Namespace, console: Console) -> int:
    if options.out:
        check_writable(options.out, overwrite=True)
    wanted = campaign.rounds.indices(options.seed, options.trials, *(options.kind or ()))
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    shown = Console(stderr=True)
    with (
        tempfile.TemporaryDirectory() as folder,
        Progress(*columns, console=shown, transient=True, disable=not shown.is_terminal) as bar,
    ):
        out = options.out or Path(folder) / f"{campaign.name}.parquet"
        task = bar.add_task("")

        def advance(what: str, done: int, total: int) -> None:
            bar.update(task, description=what, completed=done, total=total)

        rows = campaign.run(
            options.seed, wanted, out, options.processes, console.print, advance, options.sealed, options.scheduler
        )
    if options.compare:
        for line in differences(campaign.read_rows(options.compare), rows):
            console.print(line, soft_wrap=True)
    if options.figure:
        console.print(f"Wrote {draw_detection(rows, options.figure)}", soft_wrap=True)
    if options.markdown:
        print(markdown(sections(campaign, rows)))
    else:
        for table in tables(sections(campaign, rows)):
            console.print(table)
    return MISSED if any(goal.met is False for goal in campaign.goals(rows)) else DONE


def _one(campaign: Campaign, options: argparse.Namespace, console: Console) -> int:
    """Runs a trial and prints what was hidden and what was said."""
    seed, index = options.seed, options.trial
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "trial.parquet")

        def sealed(_: str) -> None:
            digest = out.with_suffix(".sha256").read_text().split()[0]
            console.print(f"Trial {index} of seed {seed}: truth sealed, SHA-256 {digest}.", soft_wrap=True)

        # by a process, as the trials of a run are: the truth is then the same to the last bit
        (row,) = campaign.run(seed, [index], out, 1, sealed, lambda *counts: None, options.sealed, options.scheduler)
        truth = open_truth(out.with_suffix(".trials"), index, row["sha256"])
        # but for what the motion to be predicted really was: hundreds of numbers
        truth = {key: value for key, value in truth.items() if not key.startswith("unseen_")}
        plain = json.loads(json.dumps({"truth": truth, "diagnosis": row}, default=float))
        console.print(yaml.safe_dump(plain, sort_keys=False, allow_unicode=True, default_flow_style=None), markup=False)
    return DONE


def _exported(campaign: Campaign, options: argparse.Namespace, console: Console) -> int:
    """Writes each trial with its open truth into a folder of its own: to look for what went wrong."""
    wanted = campaign.rounds.indices(options.seed, options.trials, *(options.kind or ()))
    for index in wanted if options.trial is None else [options.trial]:
        trial = campaign.draw(options.seed, index, options.sealed)
        case = options.export / f"{options.seed}_{index:05d}_{trial.truth['kind']}"
        write_files(trial.files | trial.beside | {"truth.json": truth_text(trial.truth)}, case)
        console.print(f"Wrote {case}", soft_wrap=True)
    return DONE


def differences(before: Sequence[Row], after: Sequence[Row]) -> Iterator[str]:
    """A line for each trial whose findings or data faults differ, and how many agree; of the same truths alone."""
    earlier = {(row["seed"], row["index"], row["sha256"]): row for row in before}
    pairs = [(earlier[key], row) for row in after if (key := (row["seed"], row["index"], row["sha256"])) in earlier]
    agreeing = 0
    for old, new in pairs:
        said = _said(old), _said(new)
        if said[0] == said[1]:
            agreeing += 1
        else:
            yield f"trial {new['index']} ({new['kind']}): before {said[0]}, now {said[1]}"
    yield f"{agreeing} of {len(pairs)} trials have the same findings and data faults."


def _said(row: Row) -> tuple[list[str], list[str]]:
    orders = ("" if f["order"] is None else f" of order {f['order']:.1f}" for f in row["findings"])
    findings = [f"{f['effect']}:{f['site']}{order}" for f, order in zip(row["findings"], orders, strict=True)]
    return sorted(findings), sorted(set(row["faults"]))


def at_least(least: int) -> Callable[[str], int]:
    """What an argument is read by that is a whole number from the least on."""

    def whole(text: str) -> int:
        value = int(text)
        if value < least:
            raise ValueError
        return value

    whole.__name__ = f"whole number from {least}"
    return whole
