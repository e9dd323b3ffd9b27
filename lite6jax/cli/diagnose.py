"""The command `diagnose`, of a recording, of each in a folder or of all, and commands on the diagnosis that it writes:
show it again or in the browser, predict, and compensate its errors.
"""

import contextlib
import io
import json
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, final

from tyro.conf import Positional, UseAppendAction, arg

from lite6jax import interruption
from lite6jax.cli import command
from lite6jax.deferred import import_lazily
from lite6jax.errors import InputError, InputWarning, command_line, name_options
from lite6jax.fleet.place import StorageFolder, attempt, list_recordings, restore_url
from lite6jax.storage import exists, file_sha256, write_atomically

with import_lazily():
    from lite6jax import recordings, threads, workers
    from lite6jax.arms import simulator as simulators
    from lite6jax.calibration import source
    from lite6jax.diagnosis import diagnose, fold_processes, servo_export
    from lite6jax.diagnosis import document as diagnosis_file
    from lite6jax.diagnosis import options as diagnosis_options
    from lite6jax.domains import predict
    from lite6jax.domains.pose import compensate, registration
    from lite6jax.domains.pose import predict as pose_predict
    from lite6jax.domains.tracking import predict as tracking_predict
    from lite6jax.domains.tracking import simulator as tracking_simulator
    from lite6jax.estimation import options as engine_options
    from lite6jax.fleet import diagnoses, folder, reduction
    from lite6jax.recordings import files as recording_files
    from lite6jax.report import (
        compensations,
        diagnosis_figures,
        documents,
        figures,
        listings,
        pages,
        ranking,
        screen,
        sections,
        statements,
        viewer,
    )

if TYPE_CHECKING:
    import pyarrow as pa

    from lite6jax.arms.files import Conversion

    Found = diagnose.Diagnosis | diagnose.TorqueDiagnosis | diagnose.TrackingDiagnosis

_MOST_FOR_FOLDS = 4
"""Most other processes: five folds are held out, and this process works on at least one."""
_IMPORTS_FOR_FOLDS = ("lite6jax.diagnosis.heldout",)
"""Modules that other processes import as they start, which takes most of a second."""


@contextlib.contextmanager
def share_folds(count: int | None = None) -> Iterator[None]:
    """Has the folds of the diagnoses within worked on by so many processes, of which this is one.

    The others import what they need while this one reads. All of them compute with one thread from here on.

    Args:
        count: how many, at most five. Where not given, one a core of a command, and none beside a program that imports
            the library.
    """
    if count is None and not interruption.is_command_line():
        yield
        return
    further_processes = min(count or threads.available(), 1 + _MOST_FOR_FOLDS) - 1
    threads.limit(1)
    if not further_processes:
        yield
        return
    with (
        workers.Processes(further_processes, _IMPORTS_FOR_FOLDS) as processes,
        fold_processes.folds_shared_with(processes),
    ):
        yield


@dataclass(frozen=True)
class DiagnoseCommand:
    """Find which effects a recording shows beyond the model of the arm: their sites, names, numbers and significance.

    For example:

        lite6jax diagnose run7.csv
        lite6jax diagnose run7.csv --out diagnosis.json --report report.html
        lite6jax diagnose run7.csv --reference gazebo.csv --out diagnosis.json
        lite6jax diagnose touched_left.csv touched_right.csv --out diagnosis.json
        lite6jax diagnose tracker_in_front.csv tracker_beside.csv --out diagnosis.json
        lite6jax diagnose log.csv --simulator model.xml --corrected corrected.xml
        lite6jax diagnose recordings --out results
        lite6jax diagnose --fleet recordings --out results
    """

    source: Annotated[Positional[Path], arg(metavar="FILE")]
    """A recording of measured poses, of motor torques or currents, or of commands beside measured joints: .csv,
    .parquet, .mcap, .bag, or the folder of a rosbag2 or of a LeRobot data set. Its sidecar .yaml stands beside it;
    `lite6jax init` writes one. Or a folder of recordings, or a URL that fsspec reads: each recording is diagnosed."""
    more: Annotated[Positional[tuple[Path, ...]], arg(metavar="FILE…")] = ()
    """Further recordings of the same arm with the same tool, touched at other places or measured from other ones:
    geometry and effects are shared, and each file has points, planes, anchors or a sensor's frame of its own."""
    out: command.OutFile = None
    """Write findings and model here (JSON), for predict, compensate and report. Nothing is written without. Of a folder
    of recordings: a folder, for a document of each and the table summary.parquet."""
    reference: Annotated[Path | None, arg(metavar="OTHER")] = None
    """Compare with this recording instead of the model: another simulator at the same joint positions, or the same arm
    earlier. The report first states whether the model reproduces it, and the differences if not. Of torques in another
    motion, what each recording shows is compared."""
    simulator: Annotated[str | None, arg(metavar="MODEL.xml")] = None
    """Of commands, compare with this simulator: an MJCF with position actuators, whose arm and servos are then the
    nominal ones. MODEL.xml#TIP or MODEL.xml#BASE:TIP names a chain of several."""
    corrected: command.OutFile = None
    """Of commands, write the arm with its servos and what was found here, as `convert` does of the document. It is an
    MJCF (.xml), a URDF (.urdf), a description (.yaml) or a rollout in NumPy (.py)."""
    arm: command.ArmName = None
    """The nominal arm; from the sidecar where not given."""
    geometry: command.Geometry = "declared"
    """Of poses, what is known of its geometry: as the sidecar declares; exactly the factory calibration; near it;
    nothing."""
    effects: Annotated[Path | None, arg(metavar="FILE.py")] = None
    """Effects of your own, tested for like the catalogue's. Runs the file."""
    torques: bool = False
    """Of a recording that has poses or commands beside torques, diagnose the torques only."""
    poses: bool = False
    """Of such a recording, diagnose the poses only."""
    tracking: bool = False
    """Of a recording that has commands beside poses or torques, diagnose how the joints follow their commands."""
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
        domains = {"--poses": self.poses, "--torques": self.torques, "--tracking": self.tracking}
        domain_options = [option for option, is_chosen in domains.items() if is_chosen]
        if len(domain_options) > 1:
            raise InputError(
                f"{' and '.join(domain_options)}: give one of them, or none to diagnose all that was recorded"
            )
        if self.simulator is not None:
            of_arm = {"poses": self.poses, "torques": self.torques, "arm": self.arm, "reference": self.reference}
            for option, value in of_arm.items():
                if value:
                    raise InputError(f"--{option}: does not go with --simulator, the nominal arm of commands; keep one")
        if _is_folder(self.source):
            if self.more:
                raise InputError(f"{self.source}: is a folder; name a folder, or files of one arm")
            return self._diagnose_folder()
        for option, value in (("fleet", self.fleet), ("scheduler", self.scheduler)):
            if value:
                raise InputError(f"--{option}: is for a folder of recordings; {self.source} is one file")
        command.check_processes(self.processes, None)
        read = [self.source, *self.more, self.reference, self.arm, self.simulator, self.effects]
        command.check_outputs([self.out, self.report, self.corrected], read, self.force, (".json", ".html"))
        if self.corrected is not None:
            servo_export.servo_form(self.corrected)
        recording, result = self.search()
        document = self.document(result)
        written = self.write(result, document)
        corrections = self._write_corrected(result)
        written += [conversion.path for conversion in corrections]
        files = ranking.Files(self.source, self.out, self.effects)
        report = sections.diagnosis_report(document, str(self.source), files, self.details)
        bad = isinstance(result, diagnose.Diagnosis) and result.quality.verdict == "bad"
        code = command.BAD_FIT if bad else command.DONE
        notes = [*recording.notes, *self._of_other_domains(recording)]
        conversions = chain.from_iterable(map(listings.conversion_report, corrections))
        return _present(self.json, document, chain(report, conversions, screen.notes(notes)), written, code)

    def _write_corrected(self, found: "Found") -> "list[Conversion]":
        """Writes the arm with its servos and what was found, where there is a place for it."""
        if self.corrected is None:
            return []
        models = [part.model for part in found.parts if isinstance(part, diagnose.TrackingDiagnosis)]
        source_name = str(self.source)
        return [
            servo_export.convert_servos(model, self.corrected, None, self.force, None, source_name) for model in models
        ]

    def _of_other_domains(self, recording: "recordings.Recording") -> list[str]:
        """That commands stand beside what was diagnosed, and the command that diagnoses them."""
        asked = self._domain(recording)
        if recording.commanded_position is None or asked == "tracking" or self.fleet:
            return []
        diagnosed = diagnose.domains_of(recording, asked)
        if "tracking" in diagnosed:
            return []
        ask = command_line("diagnose", self.source, *self.more, "--tracking")
        read = " and ".join(diagnosed)
        return [
            f"the {read} are diagnosed, and not the commands beside them; `{ask}` asks why the joints do not follow"
        ]

    def search(self) -> "tuple[recordings.Recording, Found]":
        """The recording and its diagnosis."""
        # other processes cannot import classes that this one reads from a file
        with contextlib.nullcontext() if self.effects else share_folds(self.processes):
            recording, search = self._prepare()
            diagnosed = diagnose.domains_of(recording, self._domain(recording))
            if self.corrected is not None and "tracking" not in diagnosed:
                raise InputError(
                    f"--corrected: holds what a diagnosis of commands found, and this one is of "
                    f"{' and '.join(diagnosed)}; write --out diagnosis.json, and convert that"
                )
            if self.figures is not None:
                names = diagnosis_figures.figure_names(diagnosed)
                command.check_figures(self.figures, [f"{self.source.stem}_{name}" for name in names], self.force)
            with screen.stages() as follow:
                return recording, search(progress=follow)

    def _domain(self, recording: "recordings.Recording") -> str | None:
        """What is diagnosed of a recording, None for all: of a fleet poses, or of what has none the torques."""
        if self.torques:
            return "torques"
        if self.tracking or self.simulator:
            return "tracking"
        if self.poses or (self.fleet and recording.numbers_per_sample):
            return "poses"
        return None

    def _prepare(self) -> "tuple[recordings.Recording, Callable[..., Found]]":
        """The recording, and the search, which takes `progress`.

        Of a recording that has both, poses and torques are diagnosed together, but of a fleet the poses.
        """
        assumed = command.assumptions(self)
        arm = source.load_nominal(self.arm)
        simulated = None
        about_chain: contextlib.AbstractContextManager[None] = contextlib.nullcontext()
        if self.simulator is not None:
            simulated = simulators.read_simulator(self.simulator)
            arm = simulated.arm
            about_chain = tracking_simulator.naming_the_chain(simulated)
        with about_chain:
            recording = source.load_recording(self.source, arm, **assumed)
            further = [source.load_recording(file, arm, **assumed) for file in self.more]
        if further:
            recording = recordings.join_recordings([recording, *further])
        effects = command.load_own_effects(self.effects)
        if recording.numbers_per_sample and not (self.torques or self.tracking or self.simulator):
            arm = arm or source.arm_of(recording)
        arguments: dict[str, Any] = {
            "domain": self._domain(recording),
            "reference": source.load_recording(self.reference, arm, **assumed) if self.reference else None,
            "geometry": self.geometry,
            "effects": effects,
            "options": diagnosis_options.QUICK if self.quick else None,
        }
        if simulated is not None:
            return recording, partial(diagnose.diagnose, recording, simulator=simulated, **arguments)
        return recording, partial(diagnose.diagnose, recording, arm, **arguments)

    def document(self, found: Any) -> dict[str, Any]:
        """The document of what was found, with the files that were read and with sentences."""
        inputs = command.list_inputs(self.source, self.arm, self.reference, self.effects)
        if self.simulator is not None:
            file = Path(self.simulator.partition("#")[0])
            inputs.append({"role": "simulator", "file": file.name, "sha256": file_sha256(file)})
        for file in self.more:
            inputs += [input_entry for input_entry in command.list_inputs(file) if input_entry not in inputs]
        return statements.with_statements(found.to_dict() | {"inputs": inputs})

    def write(self, found: "Found", document: Any) -> list[Path]:
        """Writes the document, the figures and the page where there are places for them."""
        written = []
        if self.out:
            written = [diagnosis_file.write_document(document, self.out, self.force)]
        if not (self.report or self.figures):
            return written
        drawn = {}
        figure_count = len(diagnosis_figures.figure_names([part.domain for part in found.parts]))
        with screen.progress(2 * figure_count + 1, "drawing") as advance:
            for figure_name, figure in diagnosis_figures.drawings(found, self.source.name, document):
                drawn[figure_name] = figure
                advance(1)
            if self.figures:
                figures_by_file = {f"{self.source.stem}_{figure_name}": figure for figure_name, figure in drawn.items()}
                written += figures.save(figures_by_file, self.figures, self.force)
            advance(figure_count)
            if self.report:
                sides = str(self.source)
                if self.reference and any(part.against for part in found.parts):
                    sides += f" against {self.reference.name}"
                files = ranking.Files(self.source, self.out, self.effects)
                html = pages.diagnosis_page(found, document, sides, drawn, files)
                written.append(write_atomically(self.report, html, self.force))
        return written

    # ------------------------------------------------------------------ of a folder

    def _diagnose_folder(self) -> int:
        """Diagnoses every recording, writes documents and table, and with --fleet pools them into fleet.json."""
        reason = "--fleet pools many"
        if not self.fleet:
            reason = f"{self.source} is a folder"
        of_one_recording = {
            "reference": self.reference,
            "simulator": self.simulator,
            "corrected": self.corrected,
            "report": self.report,
            "figures": self.figures,
        }
        for option, value in of_one_recording.items():
            if value is not None:
                raise InputError(f"--{option}: is of one recording, and {reason}; leave it out")
        if self.out is None:
            raise InputError(f"{self.source}: is a folder; add --out DIR for the documents of its recordings")
        if self.out.suffix.lower() == ".json":
            raise InputError(
                f"{self.source}: is a folder; name a file in it, or a folder with --out for the documents of all"
            )
        command.check_processes(self.processes, self.scheduler)
        pooled = self.out / diagnoses.POOLED
        if self.fleet:
            diagnoses.check_pooled(self.out, list_recordings(StorageFolder.of(self.source)), self.force)
        with screen.progress(None, "diagnosing") as advance:
            table = diagnoses.diagnose_folder(
                self.source,
                self.out,
                diagnose_names,
                (self,),
                scheduler=self.scheduler,
                processes=self.processes,
                progress=advance,
                overwrite=self.force,
            )
        if not self.fleet:
            rows = list(folder.read_rows(table))
            return command.present(
                self.json, lambda: documents.of_diagnoses(rows), listings.diagnoses_report(rows), [table]
            )
        rounds: list[int] = []
        arguments = str(self.source), self.out, engine_options.DEFAULTS, self.scheduler, self.processes
        with screen.repeated(lambda: f"pooling the recordings: {rounds[-1] if rounds else 0} effects so far"):
            document = diagnoses.pool_folder(*arguments, rounds.append).to_dict()
        write_atomically(pooled, diagnosis_file.document_text(document), overwrite=self.force)
        return _present(self.json, document, listings.population_report(document), [table, pooled])

    def diagnose(self) -> tuple[str, bytes | None]:
        """The document of the recording, as `run` writes it, and with `fleet` the reduced recording.

        A recording of a fleet is one of poses, or with `torques`, or where it has no poses, of torques.
        """
        result = self._prepare()[1]()
        text = diagnosis_file.document_text(self.document(result))
        if not self.fleet:
            return text, None
        if isinstance(result, diagnose.TrackingDiagnosis):
            raise InputError(f"{self.source}: has commands and neither poses nor torques, which --fleet pools")
        return text, reduction.reduced(result).to_bytes()


def _present(as_json: bool, document: Any, report: Any, written: list[Path], code: int = command.DONE) -> int:
    """As `command.present`, with the document as its file has it."""
    return command.present(as_json, lambda: diagnosis_file.document_text(document), report, written, code)


def _is_folder(source: Path) -> bool:
    """Tells whether a source is a folder of recordings or a URL, and not a recording that is a folder."""
    if restore_url(source) is not None:
        return True
    return os.path.isdir(source) and recordings.recording_file(source) is None


def diagnose_names(names: Sequence[str], place: StorageFolder, asked: DiagnoseCommand) -> "pa.Table":
    """The rows of some recordings of a folder, with their documents and of a fleet with their reduced recordings.

    `asked` is the command as it was given, but for its source.
    """
    rows = []
    for name in names:
        with place.local_folder([name]) as local_folder, contextlib.redirect_stdout(io.StringIO()):
            outputs, message = attempt(local_folder / name, replace(asked, source=local_folder / name).diagnose)
            message = place.show(message, local_folder)
        if outputs is None:
            rows.append(diagnoses.make_refusal(name, message))
        else:
            rows.append(diagnoses.make_row(name, json.loads(outputs[0]), *outputs, message))
    return workers.concatenate(rows)


# ------------------------------------------------------------------ what was written

_REFRESH_S = 1 / 30

DiagnosisFile = Annotated[Positional[Path], arg(metavar="DIAGNOSIS", help="What `diagnose` wrote (.json).")]


@final
@dataclass(frozen=True)
class ReportCommand:
    """Show a diagnosis again from its file, or write its certificate: accuracy before and after, findings, checksums.

    For example:

        lite6jax report diagnosis.json
        lite6jax report results/fleet.json
        lite6jax report diagnosis.json --certificate certificate.pdf
    """

    diagnosis: DiagnosisFile
    """What `diagnose` wrote (.json), of one recording or of a fleet."""
    certificate: command.OutFile = None
    """Write one A4 page here (.pdf), of one recording; date and instrument are those of its sidecar."""
    details: bool = False
    """Print also what was ruled out and what was not tested."""
    json: command.Json = False
    force: command.Force = False

    def run(self) -> int:
        """Reads, writes, prints."""
        command.check_outputs([self.certificate], [self.diagnosis], self.force, [".pdf"])
        document = diagnosis_file.parse_document(self.diagnosis)
        written = []
        of_fleet = listings.is_of_fleet(document)
        if self.certificate and of_fleet:
            raise InputError(f"--certificate: is of one recording, and {self.diagnosis} is of a fleet; leave it out")
        if not of_fleet:
            diagnosis_file.check_document(document, self.diagnosis)
        with command.refuse_damage(self.diagnosis):
            if of_fleet:
                page = list(listings.population_report(document))
            else:
                stated_document = statements.with_statements(document)
                recording = command.find_recording(document, self.diagnosis)
                files = None
                if recording is not None:
                    files = ranking.Files(recording, self.diagnosis)
                page = list(sections.diagnosis_report(stated_document, str(self.diagnosis), files, self.details))
                if self.certificate:
                    itself = {"role": "diagnosis", "file": self.diagnosis.name, "sha256": file_sha256(self.diagnosis)}
                    stated_document["inputs"] = [*stated_document.get("inputs", ()), itself]
                    written.append(pages.write_certificate(stated_document, self.certificate, self.force))
        return _present(self.json, document, page, written)


@final
@dataclass(frozen=True)
class ViewCommand:
    """Show a diagnosis in the browser until Ctrl-C: the arm in motion, measured against predicted poses, the errors as
    arrows, and the places of what was found. Of torques, the joints are coloured by their errors.

    For example:

        lite6jax view diagnosis.json
        lite6jax view diagnosis.json run9.csv --port 8123
    """

    diagnosis: DiagnosisFile
    recording: Annotated[Positional[Path | None], arg(metavar="RECORDING")] = None
    """A recording in the same set-up; where not given the one that was diagnosed, beside the diagnosis or here."""
    torques: bool = False
    """Of a diagnosis of poses and torques, show the torques."""
    effects: command.OwnEffects = None
    host: Annotated[str, arg(metavar="ADDRESS")] = "127.0.0.1"
    """The address on which to listen. With another than this one, others in the network see the arm too."""
    port: Annotated[int | None, arg(metavar="PORT")] = None
    """The port; 8080, or the next one that is free, where not given."""
    duration: command.Duration = None

    def run(self) -> int:
        """Reads, serves until Ctrl-C."""
        command.check_duration(self.duration)
        if self.port is not None and not 0 <= self.port < 1 << 16:
            raise InputError(f"--port {self.port}: is not a port; give 1 to 65535")
        from rich.text import Text

        document = diagnosis_file.parse_document(self.diagnosis)
        effects = command.load_own_effects(self.effects)
        domain = "torques" if self.torques else None
        model = diagnosis_file.model_from_document(document, effects, str(self.diagnosis), domain)
        file = self.recording or command.require_recording(document, self.diagnosis)
        with command.refuse_damage(self.diagnosis):
            if isinstance(model, pose_predict.DiagnosedArm):
                scene = viewer.pose_scene(document, model, recordings.read_motion(file, model))
            else:
                measured = recordings.read_recording(file, arm=model.arm)
                scene = viewer.joint_scene(diagnosis_file.find_part(document, "torques") or document, model, measured)
        with viewer.served(scene, self.host, self.port) as shown:
            screen.show([Text(f"{scene.arm.name}, {scene.samples} rows of {file}"), Text(scene.headline)])
            screen.show(map(Text, scene.remarks))
            screen.show([screen.unbroken(f"Open {shown.url} in a browser. Stop with Ctrl-C.")])
            screen.console().file.flush()  # another program may wait for these lines
            for _ in command.repeat(self.duration, _REFRESH_S):
                shown.play(_REFRESH_S)
        return command.DONE


@dataclass(frozen=True)
class PredictCommand:
    """Predict what the sensor of a diagnosed recording would measure in another motion of the same arm.

    Of a diagnosis of commands these are q1_rad …, the joints that follow the commands of a motion (time_s, cmd1_rad …),
    rolled out from rest at its first command. Of one of torques these are tau1_Nm …, the torques of the motors, and
    tau1_std_Nm …, which contain the sensor's noise as well. Of one of poses and torques both are written, if the motion
    is a trajectory.

    Beside each pose stand its standard deviations, x_std_m … and where orientation was recorded rx_std_rad … about the
    axes of the tool. They contain what the diagnosis left uncertain, and not the sensor's noise. Where `outside` is 1
    the recording does not support the row: it is beyond the recorded range, or in a gap of it. Beside joints that
    follow commands, columns as `outside_speed_joint2` say what is beyond: speed, load, reversals or a driver.

    For example:

        lite6jax predict diagnosis.json motion.csv --out predicted.csv
        lite6jax predict diagnosis.json run9.csv --register --out predicted.csv
    """

    diagnosis: DiagnosisFile
    motion: Annotated[Positional[Path], arg(metavar="FILE")]
    """Joint positions, and the other quantities on which the model's effects depend (.csv, .parquet); or commands."""
    out: Annotated[Path, arg(metavar="FILE")]
    """Write the poses, torques or joints here (.csv), one row per sample."""
    register: bool = False
    """First fit sensor frame and tool to the poses in the file, for another set-up of the same arm."""
    effects: command.OwnEffects = None
    json: command.Json = False
    force: command.Force = False

    def run(self) -> int:
        """Reads, predicts, writes."""
        command.check_outputs([self.out], [self.diagnosis, self.motion, self.effects], self.force, [".csv"])
        import pyarrow as pa

        document = diagnosis_file.parse_document(self.diagnosis)
        effects = command.load_own_effects(self.effects)
        model = diagnosis_file.model_from_document(document, effects, str(self.diagnosis))
        recording = model.read_motion(self.motion)
        torque_notes: list[str] = []
        registered = None
        of_poses = isinstance(model, pose_predict.DiagnosedArm)
        if self.register:
            if not isinstance(model, pose_predict.DiagnosedArm):
                domain = diagnosis_file.domain_of(document)
                raise InputError(f"--register: a diagnosis of {domain} has no sensor frame")
            model, registered = registration.register_model(model, recording)
        if said := compensations.corrected_columns(document):
            warnings.warn(f"{self.motion}: {said}", InputWarning, stacklevel=1)
        prediction = predict.predicted(model, recording)
        columns = prediction.columns()
        if of_poses and diagnosis_file.find_part(document, "torques") is not None:
            columns, torque_notes = self._add_torques(document, columns, recording, effects)
        table = pa.table(columns)
        path = write_atomically(self.out, lambda target: recording_files.write_table(table, target), self.force)
        if self.json:
            return command.present(True, documents.prediction_document(prediction, registered), (), [path])
        if model.reference is not None:
            screen.show([statements.model_statement(model.reference.file, model.reference.basis)])
        if registered is not None:
            screen.show(compensations.registration_report(registered))
        elif of_poses and (said_frame := compensations.frame_of_stations(document)):
            print(said_frame)
        screen.show(screen.notes(recording.notes))
        if empty := int(prediction.empty.sum()):
            why = "there is a gap of its times"
            if of_poses:
                why = "the clock offset reaches beyond the ends"
            print(f"{empty} rows are empty: there, {why} of the motion.")
        if prediction.outside is None:
            print(f"{self.diagnosis}: {compensations.NO_BARS}", file=sys.stderr)
        elif isinstance(prediction, tracking_predict.TrackedMotion):
            print(compensations.rolled_sentence(prediction))
        else:
            print(compensations.outside_sentence(int(prediction.outside.sum()), len(prediction.outside), "row"))
        for line in torque_notes:
            print(line)
        screen.written([path])
        return command.DONE

    def _add_torques(
        self, document: Any, poses: dict[str, Any], recording: "recordings.Recording", effects: Sequence[Any]
    ) -> tuple[dict[str, Any], list[str]]:
        """The columns of poses with those of torques beside them, and what is to be said of these.

        A row is outside where it is of poses or of torques. Torques of a motion that has none are left out.
        """
        model = diagnosis_file.model_from_document(document, effects, str(self.diagnosis), "torques")
        try:
            torque_prediction = predict.predicted(model, recording)
        except InputError as error:
            return poses, [f"Torques are not predicted: {name_options(str(error))}."]
        columns = poses | torque_prediction.columns()
        if torque_prediction.outside is None:
            return columns, []
        columns["outside"] = (
            torque_prediction.outside | (poses["outside"] > 0 if "outside" in poses else False)
        ).astype(int)
        count = int(torque_prediction.outside.sum())
        rows = len(torque_prediction.outside)
        none_outside = "Of the torques no row is outside what was recorded."
        return columns, [
            f"Of the torques: {count} of {rows} rows are outside what was recorded." if count else none_outside
        ]


@dataclass(frozen=True)
class CompensateCommand:
    """Compute the joint positions at which a diagnosed arm reaches given poses, or commands that its joints follow to
    where they are wanted.

    Of a diagnosis of commands FILE has time_s and cmd1_rad …, commands as they would be given, and run where a motion
    begins anew. The output has the commands with which encoders show the joints where these wanted them: ahead of delay
    and lag, with what sag and friction take. `outside` is 1 in rows where a joint is faster, carries more, or reverses
    sooner than in what was recorded; columns as `outside_load_joint2` say what. The errors before and after
    are predicted.

    The targets are a table with x_m y_m z_m or x_mm y_mm z_mm (X, Y, Z are recognised; --column says what else a column
    is); with qw qx qy qz where orientation matters; with q1_rad … where the joints are to stay near given ones (such as
    those of the nominal inverse kinematics); and with the quantities on which the model's effects depend (payload_kg,
    temp1_degC …, time_s). Each row of the output has the joint positions, whether
    the target is reached, the error, and the reason. Exit code 0 if every target is reached, 1 if not.

    For example:

        lite6jax compensate diagnosis.json targets.csv --out joints.csv
        lite6jax compensate diagnosis.json targets.csv --frame base --approach 1 --out joints.csv
        lite6jax compensate diagnosis.json targets.csv --column A=yaw_deg --column B=pitch_deg --column C=roll_deg
            --out joints.csv
        lite6jax compensate diagnosis.json commands.csv --out corrected.csv
    """

    diagnosis: DiagnosisFile
    targets: Annotated[Positional[Path], arg(metavar="FILE")]
    """Poses to reach, of the point that was measured (.csv, .parquet); or commands."""
    out: Annotated[Path, arg(metavar="FILE")]
    """Write the joint positions, or the commands, here (.csv), one row per target."""
    frame: Literal["sensor", "base"] = "sensor"
    """The frame of the targets: that of the diagnosed recording's sensor, or the arm's base."""
    approach: Annotated[tuple[int, ...], arg(metavar="-1|0|1")] = ()
    """The direction from which the joints approach every target, one number for all or one for each, for backlash; by
    default each row is approached from the one before."""
    column: Annotated[tuple[str, ...], UseAppendAction, arg(metavar="COLUMN=MEANING")] = ()
    """What a column of the targets is, such as X=x_mm or foo=ignore. May be repeated."""
    effects: command.OwnEffects = None
    json: command.Json = False
    force: command.Force = False

    def run(self) -> int:
        """Reads, solves, writes, prints."""
        sidecar = recordings.sidecar_path(self.out)
        declared = exists(recordings.sidecar_path(self.targets))
        outputs = [self.out, *([sidecar] if declared else [])]
        read = [self.diagnosis, self.targets, self.effects]
        command.check_outputs(outputs, read, self.force, [".csv"])
        if not declared and exists(sidecar):
            raise InputError(
                f"{sidecar}: would be read as the settings of {self.out.name}, but belongs to another file; choose "
                "another name for the joint positions, or remove it"
            )
        import pyarrow as pa

        document = diagnosis_file.parse_document(self.diagnosis)
        effects = command.load_own_effects(self.effects)
        if diagnosis_file.is_of_tracking(document):
            return self._correct(document, effects)
        model = diagnosis_file.read_model(self.diagnosis, effects, domain="poses")
        approach = self.approach * (model.dof if len(self.approach) == 1 else 1)
        if approach and (len(approach) != model.dof or not set(approach) <= {-1, 0, 1}):
            raise InputError(
                f"--approach {' '.join(map(str, self.approach))}: give -1, 0 or 1, once or for each of the "
                f"{model.dof} joints"
            )
        targets = compensate.read_pose_targets(self.targets, model, command.parse_pairs("--column", self.column))
        compensation = compensate.compensate(model, targets, frame=self.frame, approach=approach or None)
        table = compensations.compensation_columns(compensation)
        columns = pa.table({name: pa.array(values) for name, values in table.items()})
        if declared:  # so that `predict` reads the joint positions under the same settings
            settings = targets.recording.settings.moved(self.targets.parent, self.out.parent)
            written = [recording_files.write_with_settings(columns, settings, self.out, self.force), sidecar]
        else:
            written = [
                write_atomically(self.out, lambda target: recording_files.write_table(columns, target), self.force)
            ]
        if said := compensations.corrected_columns(document, written=True):
            warnings.warn(f"{self.targets}: {said}", InputWarning, stacklevel=1)
        if beyond := compensations.outside_warning(compensation, model):
            warnings.warn(f"{self.targets}: {beyond}", InputWarning, stacklevel=1)
        origin = []
        if model.reference is not None:
            origin.append(statements.model_statement(model.reference.file, model.reference.basis))
        page = compensations.compensation_report(compensation, model, str(self.targets), self.frame)
        code = command.DONE if compensation.reached.all() else command.NOT_REACHED
        return command.present(self.json, compensation, chain(origin, page), written, code)

    def _correct(self, document: Any, effects: Sequence[Any]) -> int:
        """As `run`, of commands."""
        import pyarrow as pa

        pose_options = {
            "--frame": self.frame != "sensor",
            "--approach": bool(self.approach),
            "--column": bool(self.column),
        }
        for option, used in pose_options.items():
            if used:
                raise InputError(f"{option}: is of poses, and {self.diagnosis} is of commands; leave it out")
        model = diagnosis_file.model_from_document(document, effects, str(self.diagnosis))
        assert isinstance(model, tracking_predict.DiagnosedServos)
        motion = recording_files.read_commands(self.targets, model)
        corrected = tracking_predict.commands_to_follow(model, motion)
        columns = pa.table(corrected.columns())
        path = write_atomically(self.out, lambda target: recording_files.write_table(columns, target), self.force)
        page = chain(compensations.corrected_report(corrected, str(self.targets)), screen.notes(motion.notes))
        return command.present(self.json, corrected, page, [path])
