"""The command `frozen`: writes the documents of all recordings, or says where those of the tree differ from them."""

import argparse
import contextlib
import io
import json
import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.frozen.comparison import list_differences, store
from benchmarks.frozen.recordings import DOCUMENT, FLEET, Frozen, digest_folder, list_frozen
from benchmarks.measure import DONE, MISSED, ROOT, UNUSABLE, run_command
from lite6jax.storage import write_atomically

STORED = ROOT / "benchmarks" / "records" / "frozen"
"""A file of each kind, `KIND.jsonl`: a line for each recording."""
_SHOWN = 12  # differences of a recording that are printed, if not all are asked for
_ANSWERED = (0, 3)  # exit codes of a command that wrote its document

Entries = dict[str, dict[str, Any]]


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code: 0, 1 where a recording differs, 2 for arguments that cannot be used."""
    known = list_frozen()
    parser = argparse.ArgumentParser(prog="python -m benchmarks frozen", description=__doc__)
    add = parser.add_argument
    add("--write", action="store_true", help="store the documents of this tree in place of the earlier ones")
    add("--only", action="append", metavar="NAME", help="only recordings whose name contains this; give it again")
    kinds = list(dict.fromkeys(frozen.kind for frozen in known))
    add("--kind", choices=kinds, action="append", help="only recordings of this kind; give it again for one more")
    add("--quick", action="store_true", help="only a few of most kinds, in about two minutes")
    add("--missing", action="store_true", help="with --write: only recordings of which nothing is stored")
    add("--all", action="store_true", help=f"print all differences of a recording, not the first {_SHOWN}")
    add("--stored", type=Path, default=STORED, metavar="DIR", help="where the documents are; in the repository")
    options = parser.parse_args(arguments)
    if options.missing and not options.write:
        parser.error("--missing: add --write")
    wanted = [frozen for frozen in known if _is_wanted(frozen, options)]
    if not wanted:
        print("benchmarks: no recording has such a name; leave --only or --kind out")
        return UNUSABLE
    return run_command(partial(_write if options.write else _compare, wanted, options))


def _is_wanted(frozen: Frozen, options: argparse.Namespace) -> bool:
    named = not options.only or any(part in frozen.name for part in options.only)
    of_kind = not options.kind or frozen.kind in options.kind
    return named and of_kind and (frozen.quick or not options.quick)


# ------------------------------------------------------------------ writing and comparing


def _write(wanted: Sequence[Frozen], options: argparse.Namespace) -> int:
    written = 0
    for frozen in wanted:
        entries = read_entries(options.stored, frozen.kind)
        if options.missing and frozen.name in entries:
            continue
        if frozen.source is not None and not frozen.source.exists():
            _say("skipped", frozen.name, f"{frozen.source} is not here")
            continue
        entry, seconds = diagnose_frozen(frozen)
        write_entries(options.stored, frozen.kind, entries | {frozen.name: entry})
        _say("written", frozen.name, f"{seconds:.1f} s")
        written += 1
    print(f"{written} documents written below {options.stored}")
    return DONE


def _compare(wanted: Sequence[Frozen], options: argparse.Namespace) -> int:
    same = 0
    compared = 0
    stored = {kind: read_entries(options.stored, kind) for kind in {frozen.kind for frozen in wanted}}
    for frozen in wanted:
        before = stored[frozen.kind].get(frozen.name)
        if before is None:
            _say("skipped", frozen.name, "nothing is stored of it")
            continue
        if frozen.source is not None and not frozen.source.exists():
            _say("skipped", frozen.name, f"{frozen.source} is not here")
            continue
        after, seconds = diagnose_frozen(frozen)
        if after["recording"] != before["recording"]:
            _say("skipped", frozen.name, "its files are not those of the stored document")
            continue
        compared += 1
        lines = list_differences(before["document"], after["document"])
        if not lines:
            same += 1
            _say("same", frozen.name, f"{seconds:.1f} s")
            continue
        _say("differs", frozen.name, f"{seconds:.1f} s")
        shown = lines if options.all else lines[:_SHOWN]
        more = len(lines) - len(shown)
        for line in [*shown, *([f"… and {more} more"] if more else [])]:
            print(f"          {line}", flush=True)
    print(f"{same} of {compared} the same")
    return DONE if same == compared else MISSED


def _say(state: str, name: str, words: str) -> None:
    print(f"{state:9} {name:44} {words}", flush=True)


# ------------------------------------------------------------------ one recording


def diagnose_frozen(frozen: Frozen) -> tuple[dict[str, Any], float]:
    """What is stored of a recording, and the processor seconds of its commands.

    The entry has `recording`, the SHA-256 of its files, and `document`, which of a refused recording is the command
    that refused it.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        commands = frozen.prepare(folder)
        digest = digest_folder(folder)
        start = time.process_time()
        document = _run(commands, folder)
        seconds = time.process_time() - start
    return {"recording": digest, "document": store(document, frozen.real)}, seconds


def _run(commands: Sequence[Sequence[str]], folder: Path) -> dict[str, Any]:
    """The document that the last command writes; all commands run in this process, which compiles a shape once."""
    from lite6jax.cli import program  # here: what only writes or compares documents needs no command

    for command in commands:
        with _quiet(folder):
            code = program.main(list(command))
        if code not in _ANSWERED:
            return {"refused": command[0]}
    fleet = folder / FLEET / "fleet.json"
    written = fleet if fleet.exists() else folder / DOCUMENT
    return json.loads(written.read_text())


@contextlib.contextmanager
def _quiet(folder: Path) -> Iterator[None]:
    """Within, this process works in a folder and prints nothing."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            yield
    finally:
        os.chdir(before)


# ------------------------------------------------------------------ files


def read_entries(stored: Path, kind: str) -> Entries:
    """The entries of a kind by name of recording; none where there is no file."""
    path = stored / f"{kind}.jsonl"
    if not path.exists():
        return {}
    lines = map(json.loads, path.read_text().splitlines())
    return {line.pop("name"): line for line in lines}


def write_entries(stored: Path, kind: str, entries: Entries) -> Path:
    """Writes a line for each recording, by name: what changes is then the line of that recording."""
    stored.mkdir(parents=True, exist_ok=True)
    lines = [
        json.dumps({"name": name, **entries[name]}, ensure_ascii=False, separators=(",", ":"))
        for name in sorted(entries)
    ]
    return write_atomically(stored / f"{kind}.jsonl", "\n".join(lines) + "\n", overwrite=True)
