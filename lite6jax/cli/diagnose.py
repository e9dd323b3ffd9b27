"""The command `diagnose`: what an arm has beyond its model, found in a recording; of a folder see `diagnose_folder`."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, arg

from lite6jax.cli.arguments import (
    ArmName,
    Folder,
    OutFile,
    Processes,
    Scheduler,
    check_out,
    check_processes,
    refuse_inputs,
)
from lite6jax.cli.exit_codes import BAD_FIT, DONE
from lite6jax.cli.inputs import inputs
from lite6jax.errors import InputError
from lite6jax.storage import write_atomically

if TYPE_CHECKING:
    from lite6jax.diagnosis.result import Diagnosis
    from lite6jax.diagnosis.torque_result import TorqueDiagnosis
    from lite6jax.recordings import Recording
    from lite6jax.report.ranking import Files

Domain = Literal["poses", "torques", "both"]


@dataclass(frozen=True)
class Diagnose:
    """Find which effects a recording shows beyond the model of the arm: their sites, names, numbers and significance.

    For example:

        lite6jax diagnose run7.csv
        lite6jax diagnose run7.csv --out diagnosis.json --report report.html
        lite6jax diagnose run7.csv --reference gazebo.csv --out diagnosis.json
        lite6jax diagnose recordings --out results
        lite6jax diagnose --fleet recordings --out results
    """

    source: Annotated[Positional[Path], arg(metavar="FILE")]
    """A recording of measured poses, or of motor torques or currents (.csv, .parquet, .mcap, .bag, or the folder of a
    rosbag2 or of a LeRobot data set), with its sidecar .yaml beside it; `lite6jax init` writes one. Or a folder of
    recordings, or a URL that fsspec reads: each recording is diagnosed."""
    out: OutFile = None
    """Write findings and model here (JSON), for predict, compensate and report. Nothing is written without. Of a folder
    of recordings: a folder, for a document of each and the table summary.parquet."""
    reference: Annotated[Path | None, arg(metavar="OTHER")] = None
    """Compare with this recording instead of the model: another simulator at the same joint positions, or the same arm
    earlier. The report first states whether the model reproduces it, and the differences if not. Of torques in another
    motion, what each recording shows is compared."""
    arm: ArmName = None
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
    json: bool = False
    """Print the JSON document instead of the report."""
    report: OutFile = None
    """Write a self-contained page with the findings and their figures here (.html)."""
    figures: Folder = None
    """Draw the figures into this folder (PNG and SVG)."""
    force: bool = False
    """Replace files that exist."""
    assume_degrees: bool = False
    """Take joint columns that say rad as degrees."""
    assume_millimetres: bool = False
    """Take position columns that say m as millimetres."""
    fleet: bool = False
    """Of a folder of recordings of many arms of one type: also pool them, to find what the type shares and no recording
    shows alone, and which arms differ. Writes fleet.json beside the table."""
    over: Literal["date"] | None = None
    """With --fleet: the recordings are of one arm, and its effects may drift with the dates of their sidecars."""
    processes: Processes = None
    """So many processes of this machine, each with one thread; one a core where not given. Of one recording they work
    on the held-out blocks, and are five at most; with --effects threads of one do."""
    scheduler: Scheduler = None
    """Of a folder: the Dask cluster of the scheduler at this address (tcp://HOST:8786), in place of processes here."""

    def run(self) -> int:
        """Reads, searches, writes, prints."""
        if self.poses and self.torques:
            raise InputError("--poses and --torques: give one of them, or none to diagnose both")
        from lite6jax.cli.diagnose_folder import diagnose_recorded_fleet, diagnose_recordings, is_folder

        if self.over is not None and not self.fleet:
            raise InputError("--over: is of recordings that are pooled; add --fleet")
        if is_folder(self.source):
            return diagnose_recorded_fleet(self) if self.fleet else diagnose_recordings(self)
        if self.fleet:
            raise InputError(f"--fleet: is for a folder of recordings; {self.source} is one file")
        if self.scheduler is not None:
            raise InputError(f"--scheduler: is for a folder of recordings; {self.source} is one file")
        check_processes(self.processes, None)
        if self.out:
            check_out(self.out, ".json", self.force)
        if self.report:
            check_out(self.report, ".html", self.force)
        refuse_inputs([self.out, self.report], [self.source, self.reference, self.arm, self.effects])
        self._check_figures("poses")
        from lite6jax.diagnosis.fold_processes import fold_processes

        # other processes cannot import classes that this one reads from a file
        with nullcontext() if self.effects else fold_processes(self.processes):
            return self._diagnosed_file()

    def _diagnosed_file(self) -> int:
        """Diagnoses one file: reads it, searches, and writes and prints the result."""
        from lite6jax.diagnosis.document import document_text, write_document
        from lite6jax.report import screen
        from lite6jax.report.ranking import Files
        from lite6jax.report.sections import diagnosis_report

        recording, domain, search = self._search(both=True)
        if domain != "poses":
            self._check_figures(domain)
        with screen.stages() as entered:
            found: Any = search(progress=entered)
        document = self._document(found, domain)
        poses = found.poses if domain == "both" else found
        files = Files(self.source, self.out, self.effects)
        written = [write_document(document, self.out, self.force)] if self.out else []
        if self.report or self.figures:
            against = None if poses.against is None else poses.against.file
            if domain == "both" and self.reference:
                against = str(self.reference)
            sides = str(self.source) if against is None else f"{self.source} against {against}"
            written += self._draw(found, domain, document, sides, files)
        if self.json:
            print(document_text(document))
        else:
            screen.show(diagnosis_report(document, str(self.source), files, self.details))
            screen.show(screen.notes(recording.notes))
            screen.written(written)
        return BAD_FIT if domain != "torques" and poses.quality.verdict == "bad" else DONE

    def _draw(self, found: Any, domain: "Domain", document: Any, sides: str, files: "Files") -> list[Path]:
        """Writes the figures and the page where there are places for them.

        Args:
            found: the diagnosis.
            domain: of what it is.
            document: as in the JSON file, with statements.
            sides: what was diagnosed, and against what.
            files: for commands to copy.
        """
        from lite6jax.report import canvas, diagnosis_figures, pages, screen

        written, drawn, most = [], {}, len(_figures_of(domain))
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

    def _check_figures(self, domain: "Domain") -> None:
        """Refuses figures that cannot be written where they are asked for, before a long computation."""
        if self.figures:
            from lite6jax.report import canvas

            names = [f"{self.source.stem}_{name}" for name in _figures_of(domain)]
            canvas.check_names(self.figures, names, self.force)

    def diagnosed(self) -> "tuple[Diagnosis | TorqueDiagnosis, dict[str, Any]]":
        """The diagnosis of the recording's poses, or with `torques`, or where it has no poses, of its torques.

        Returns:
            the diagnosis and its document; nothing is written or printed.

        Raises:
            InputError: the recording has neither, or as `diagnose` and `diagnose_torques`.
        """
        _, domain, search = self._search(both=False)
        found = search()
        return found, self._document(found, domain)

    def _search(self, both: bool) -> "tuple[Recording, Domain, Callable[..., Any]]":
        """Reads what is to be diagnosed.

        Args:
            both: whether poses and torques of one recording are diagnosed together.

        Returns:
            the recording, what of it is diagnosed, and the search, which takes `progress`.
        """
        from lite6jax.diagnosis import diagnose, torque_diagnosis
        from lite6jax.diagnosis.options import QUICK
        from lite6jax.effects.user_effects import by_domain, load_effects
        from lite6jax.fitting.source import arm_of, load_nominal, load_recording

        assumed = {"assume_degrees": self.assume_degrees, "assume_millimetres": self.assume_millimetres}
        arm = load_nominal(self.arm)
        recording = load_recording(self.source, arm, **assumed)
        effects = load_effects(self.effects) if self.effects else ()
        kinematic, dynamic = by_domain(effects)
        domain: Domain = "poses"
        if self.torques or (recording.position is None and recording.has_torques):
            domain = "torques"
        elif both and recording.has_torques and recording.position is not None and not self.poses:
            domain = "both"
        if domain != "torques":
            arm = arm or arm_of(recording)
        other = load_recording(self.reference, arm, **assumed) if self.reference else None
        given: dict[str, Any] = {"options": QUICK if self.quick else None}
        if domain == "torques":
            given["effects"] = dynamic
            if other is None:
                return recording, domain, partial(torque_diagnosis.diagnose_torques, recording, arm, **given)
            return recording, domain, partial(torque_diagnosis.diagnose_torques_against, recording, other, arm, **given)
        given |= {"geometry": self.geometry, "effects": kinematic}
        if domain == "both":
            from lite6jax.diagnosis import combined

            given |= {"effects": effects, "reference": other}
            return recording, domain, partial(combined.diagnose_combined, recording, arm, **given)
        if other is None:
            return recording, domain, partial(diagnose.diagnose, recording, arm, **given)
        return recording, domain, partial(diagnose.diagnose_against, recording, other, arm, **given)

    def _document(self, found: "Any", domain: "Domain") -> dict[str, Any]:
        """The document of what was found, with the files that were read and with sentences."""
        from lite6jax.report.statements import with_statements

        document = found.to_dict() if domain == "both" else found.document()
        document |= {"inputs": inputs(self.source, self.arm, self.reference, self.effects)}
        if domain != "both" and found.against is not None:
            document["against"] = found.against.to_dict()
        return with_statements(document)


def _figures_of(domain: "Domain") -> list[str]:
    """The names of the figures of a diagnosis of poses, of torques or of both."""
    from lite6jax.report.diagnosis_figures import NAMES, PREFIX, TORQUE_NAMES

    if domain == "torques":
        return [*TORQUE_NAMES]
    return [*NAMES, *(PREFIX + name for name in TORQUE_NAMES)] if domain == "both" else [*NAMES]
