"""The command `diagnose`: what an arm has beyond its model, found in a recording, in each of a folder, or in all."""

import contextlib
import io
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, arg

from lite6jax.cli import command
from lite6jax.deferred import import_lazily
from lite6jax.errors import InputError
from lite6jax.fleet.place import Place, attempt, list_recordings, restore_url
from lite6jax.storage import write_atomically

with import_lazily():
    from lite6jax import recordings, workers
    from lite6jax.calibration import source
    from lite6jax.diagnosis import combined, diagnose, fold_processes, torque_diagnosis
    from lite6jax.diagnosis import document as diagnosis_file
    from lite6jax.diagnosis import options as diagnosis_options
    from lite6jax.effects import user_effects
    from lite6jax.fleet import diagnoses, reduction, terms
    from lite6jax.report import (
        canvas,
        diagnosis_figures,
        documents,
        fleets,
        pages,
        ranking,
        screen,
        sections,
        statements,
    )

if TYPE_CHECKING:
    import pyarrow as pa

Domain = Literal["poses", "torques", "both"]


@dataclass(frozen=True)
class Diagnose:
    """Find which effects a recording shows beyond the model of the arm: their sites, names, numbers and significance.

    For example:

        lite6jax diagnose run7.csv
        lite6jax diagnose run7.csv --out diagnosis.json --report report.html
        lite6jax diagnose run7.csv --reference gazebo.csv --out diagnosis.json
        lite6jax diagnose touched_left.csv touched_right.csv --out diagnosis.json
        lite6jax diagnose recordings --out results
        lite6jax diagnose --fleet recordings --out results
    """

    source: Annotated[Positional[Path], arg(metavar="FILE")]
    """A recording of measured poses, or of motor torques or currents (.csv, .parquet, .mcap, .bag, or the folder of a
    rosbag2 or of a LeRobot data set), with its sidecar .yaml beside it; `lite6jax init` writes one. Or a folder of
    recordings, or a URL that fsspec reads: each recording is diagnosed."""
    more: Annotated[Positional[tuple[Path, ...]], arg(metavar="FILE…")] = ()
    """Further recordings of the same arm with the same tool, touched at other places: geometry and effects are shared,
    and each file has points, planes or anchors of its own."""
    out: command.OutFile = None
    """Write findings and model here (JSON), for predict, compensate and report. Nothing is written without. Of a folder
    of recordings: a folder, for a document of each and the table summary.parquet."""
    reference: Annotated[Path | None, arg(metavar="OTHER")] = None
    """Compare with this recording instead of the model: another simulator at the same joint positions, or the same arm
    earlier. The report first states whether the model reproduces it, and the differences if not. Of torques in another
    motion, what each recording shows is compared."""
    arm: command.ArmName = None
    """The nominal arm; from the sidecar where not given."""
    geometry: Literal["declared", "exact", "prior", "free"] = "declared"
    """What is known of its geometry: as the sidecar declares; exactly the factory calibration; near it; nothing."""
    effects: Annotated[Path | None, arg(metavar="FILE.py")] = None
    """Effects of your own, tested for like the catalogue's. Runs the file."""
    torques: bool = False
    """Of a recording that has poses and torques, diagnose the torques only."""
    poses: bool = False
    """Of such a recording, diagnose the poses only."""
    quick: bool = False
    """Hold out two blocks instead of five, and design no separating poses: in about 60 % of the time. The search of all
    rows is the same; the errors after are rather too large."""
    details: bool = False
    """Print also what was ruled out and what was not tested."""
    json: command.Json = False
    report: command.OutFile = None
    """Write a self-contained page with the findings and their figures here (.html)."""
    figures: command.Folder = None
    """Draw the figures into this folder (PNG and SVG)."""
    force: command.Force = False
    assume_degrees: command.AssumeDegrees = False
    assume_millimetres: command.AssumeMillimetres = False
    fleet: bool = False
    """Of a folder of recordings of many arms of one type: also pool them, to find what the type shares and no recording
    shows alone, and which arms differ. Writes fleet.json beside the table."""
    processes: command.Processes = None
    """So many processes of this machine, each with one thread; one a core where not given. Of one recording they work
    on the held-out blocks, and are five at most; with --effects threads of one do."""
    scheduler: command.Scheduler = None
    """Of a folder: the Dask cluster of the scheduler at this address (tcp://HOST:8786), in place of processes here."""

    def run(self) -> int:
        """Reads, searches, writes, prints."""
        if self.poses and self.torques:
            raise InputError("--poses and --torques: give one of them, or none to diagnose both")
        if _is_folder(self.source):
            if self.more:
                raise InputError(f"{self.source}: is a folder; name a folder, or files of one arm")
            return self._diagnose_folder()
        for option in ("fleet", "scheduler"):
            if getattr(self, option):
                raise InputError(f"--{option}: is for a folder of recordings; {self.source} is one file")
        command.check_processes(self.processes, None)
        read = [self.source, *self.more, self.reference, self.arm, self.effects]
        command.check_outputs([self.out, self.report], read, self.force, (".json", ".html"))
        self._check_figures("poses")
        # other processes cannot import classes that this one reads from a file
        with contextlib.nullcontext() if self.effects else fold_processes.fold_processes(self.processes):
            recording, domain, search = self._prepare(both=True)
            if domain != "poses":
                self._check_figures(domain)
            with screen.stages() as follow:
                found: Any = search(progress=follow)
        document, files = self._document(found), ranking.Files(self.source, self.out, self.effects)
        written = [diagnosis_file.write_document(document, self.out, self.force)] if self.out else []
        if self.report or self.figures:
            written += self._draw(found, domain, document, files)
        if self.json:
            print(diagnosis_file.document_text(document))
        else:
            screen.show(sections.diagnosis_report(document, str(self.source), files, self.details))
            screen.show(screen.notes(recording.notes))
            screen.written(written)
        poses = found.poses if domain == "both" else found
        return command.BAD_FIT if domain != "torques" and poses.quality.verdict == "bad" else command.DONE

    def _prepare(self, both: bool) -> "tuple[recordings.Recording, Domain, Callable[..., Any]]":
        """The recording, what of it is diagnosed, and the search, which takes `progress`.

        Of a recording that has both, poses and torques are diagnosed together where `both` says so.
        """
        assumed = {"assume_degrees": self.assume_degrees, "assume_millimetres": self.assume_millimetres}
        arm = source.load_nominal(self.arm)
        recording = source.load_recording(self.source, arm, **assumed)
        if self.more:
            further = [source.load_recording(file, arm, **assumed) for file in self.more]
            recording = recordings.join_recordings([recording, *further])
        effects = command.load_own_effects(self.effects)
        kinematic, dynamic = user_effects.by_domain(effects)
        domain: Domain = "poses"
        if self.torques or (recording.position is None and recording.has_torques):
            domain = "torques"
        elif both and recording.has_torques and recording.position is not None and not self.poses:
            domain = "both"
        if domain != "torques":
            arm = arm or source.arm_of(recording)
        given: dict[str, Any] = {
            "options": diagnosis_options.QUICK if self.quick else None,
            "reference": source.load_recording(self.reference, arm, **assumed) if self.reference else None,
        }
        if domain != "torques":
            given["geometry"] = self.geometry
        search, own = {
            "poses": (diagnose.diagnose, kinematic),
            "torques": (torque_diagnosis.diagnose_torques, dynamic),
            "both": (combined.diagnose_combined, effects),
        }[domain]
        return recording, domain, partial(search, recording, arm, effects=own, **given)

    def _document(self, found: Any) -> dict[str, Any]:
        """The document of what was found, with the files that were read and with sentences."""
        inputs = command.list_inputs(self.source, self.arm, self.reference, self.effects)
        for file in self.more:
            inputs += [one for one in command.list_inputs(file) if one not in inputs]
        return statements.with_statements(found.to_dict() | {"inputs": inputs})

    def _check_figures(self, domain: Domain) -> None:
        if self.figures:
            names = [f"{self.source.stem}_{name}" for name in diagnosis_figures.NAMES[domain]]
            command.check_figures(self.figures, names, self.force)

    def _draw(self, found: Any, domain: Domain, document: Any, files: "ranking.Files") -> list[Path]:
        """Writes the figures and the page where there are places for them."""
        against = self.reference if domain == "both" else found.against and found.against.file
        sides = f"{self.source} against {against}" if against else str(self.source)
        written, drawn, most = [], {}, len(diagnosis_figures.NAMES[domain])
        with screen.progress(2 * most + 1, "drawing") as advance:
            for each, figure in diagnosis_figures.drawings(found, self.source.name, document):
                drawn[each] = figure
                advance(1)
            if self.figures:
                named = {f"{self.source.stem}_{each}": figure for each, figure in drawn.items()}
                written += canvas.save(named, self.figures, self.force)
            advance(most)
            if self.report:
                html = pages.diagnosis_page(found, document, sides, drawn, files)
                written.append(write_atomically(self.report, html, self.force))
        return written

    # ------------------------------------------------------------------ of a folder

    def _diagnose_folder(self) -> int:
        """Diagnoses every recording, writes documents and table, and with --fleet pools them into fleet.json."""
        many = "--fleet pools many" if self.fleet else f"{self.source} is a folder"
        for option in ("reference", "report", "figures"):
            if getattr(self, option) is not None:
                raise InputError(f"--{option}: is of one recording, and {many}; leave it out")
        if self.out is None:
            raise InputError(f"{self.source}: is a folder; add --out DIR for the documents of its recordings")
        if self.out.suffix.lower() == ".json":
            raise InputError(
                f"{self.source}: is a folder; name a file in it, or a folder with --out for the documents of all"
            )
        command.check_processes(self.processes, self.scheduler)
        if self.fleet:
            return self._diagnose_fleet(self.out)
        table = self._diagnose_each(self.out)
        rows = fleets.read_diagnoses(table)
        report = fleets.diagnoses_report(rows)
        return command.present(self.json, lambda: documents.of_diagnoses(rows), report, [table])

    def _diagnose_each(self, out: Path) -> Path:
        with screen.progress_of_many("diagnosing") as advance:
            return diagnoses.diagnose_folder(
                self.source,
                out,
                diagnose_names,
                (self,),
                scheduler=self.scheduler,
                processes=self.processes,
                progress=advance,
                overwrite=self.force,
            )

    def _diagnose_fleet(self, out: Path) -> int:
        path = out / diagnoses.POOLED
        diagnoses.check_pooled(out, list_recordings(Place.of(self.source)), self.force)
        self._diagnose_each(out)
        effects = [0]
        with screen.repeated(lambda: f"pooling the recordings: {effects[0]} effects so far"):
            document = diagnoses.pool_folder(
                str(self.source),
                out,
                terms.PoolingOptions(),
                self.scheduler,
                self.processes,
                lambda count: effects.__setitem__(0, count),
            ).to_dict()
        write_atomically(path, diagnosis_file.document_text(document), overwrite=self.force)
        if self.json:
            print(diagnosis_file.document_text(document))
        else:
            screen.show(fleets.population_report(document))
            screen.written([out / diagnoses.TABLE, path])
        return command.DONE

    def diagnose(self) -> tuple[str, bytes | None]:
        """The document of the recording, as `run` writes it, and with `fleet` the reduced recording.

        A recording of a fleet is one of poses, or with `torques`, or where it has no poses, of torques.
        """
        _, _, search = self._prepare(both=not self.fleet)
        found = search()
        text = diagnosis_file.document_text(self._document(found))
        if not self.fleet:
            return text, None
        return text, reduction.reduced(found).to_bytes()


def _is_folder(source: Path) -> bool:
    """Whether a source is a folder of recordings or a URL, and not a recording that is a folder."""
    if restore_url(source) is not None or not os.path.isdir(source):
        return restore_url(source) is not None
    return recordings.recording_file(source) is None


def diagnose_names(names: Sequence[str], place: Place, asked: Diagnose) -> "pa.Table":
    """The rows of some recordings of a folder, with their documents and of a fleet with their reduced recordings.

    `asked` is the command as it was given, but for its source.
    """
    rows = []
    for name in names:
        with place.local_folder([name]) as folder, contextlib.redirect_stdout(io.StringIO()):
            found, said = attempt(folder / name, replace(asked, source=folder / name).diagnose)
            said = place.show(said, folder)
        if found is None:
            rows.append(diagnoses.make_refusal(name, said))
        else:
            rows.append(diagnoses.make_row(name, json.loads(found[0]), *found, said))
    return workers.concatenate(rows)
