"""Commands on what an arm has beyond its model: find it in a recording, predict with it."""

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
from lite6jax.cli.outputs import Drawings, check_figures, present
from lite6jax.errors import InputError
from lite6jax.storage import check_writable, write_atomically

if TYPE_CHECKING:
    from lite6jax.arms.arm import Arm
    from lite6jax.diagnosis.result import Diagnosis
    from lite6jax.diagnosis.torque_result import TorqueDiagnosis
    from lite6jax.recordings import Recording


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
        from lite6jax.cli.diagnose_folder import diagnose_recordings, is_folder

        if self.over is not None and not self.fleet:
            raise InputError("--over: is of recordings that are pooled; add --fleet")
        if is_folder(self.source):
            if self.fleet:
                from lite6jax.cli.diagnose_fleet import diagnose_recorded_fleet

                return diagnose_recorded_fleet(self)
            return diagnose_recordings(self)
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
        if self.figures:
            from lite6jax.report.diagnosis_figures import NAMES

            check_figures(self, NAMES)
        from lite6jax.diagnosis.fold_processes import fold_processes

        # other processes cannot import classes that this one reads from a file
        with nullcontext() if self.effects else fold_processes(self.processes):
            return self._diagnosed_file()

    def _diagnosed_file(self) -> int:
        """Diagnoses one file: reads it, searches, and writes and prints the result."""
        from lite6jax.diagnosis.diagnose import diagnose
        from lite6jax.diagnosis.document import to_document
        from lite6jax.diagnosis.options import QUICK
        from lite6jax.diagnosis.reference_diagnosis import diagnose_against
        from lite6jax.effects.user_effects import by_domain, load_effects
        from lite6jax.fitting.recognition import arm_of
        from lite6jax.fitting.source import load_nominal
        from lite6jax.report import screen
        from lite6jax.report.sections import diagnosis_report
        from lite6jax.report.statements import with_statements

        nominal = load_nominal(self.arm)
        recording = self._read(self.source, nominal)
        effects = load_effects(self.effects) if self.effects else ()
        if self.torques or (recording.position is None and recording.has_torques):
            from lite6jax.cli.diagnose_torques import diagnose_motors

            other = self._read(self.reference, nominal) if self.reference else None
            return diagnose_motors(self, recording, nominal, other, effects)
        arm = nominal or arm_of(recording)
        other = self._read(self.reference, arm) if self.reference else None
        if recording.has_torques and recording.position is not None and not self.poses:
            from lite6jax.cli.diagnose_torques import diagnose_both

            return diagnose_both(self, recording, arm, other, effects)
        effects, _ = by_domain(effects)
        options, seen = QUICK if self.quick else None, None
        with screen.stages() as entered:
            if other is None:
                found = diagnose(
                    recording, arm, geometry=self.geometry, effects=effects, options=options, progress=entered
                )
            else:
                found, seen = diagnose_against(
                    recording, other, arm, geometry=self.geometry, effects=effects, options=options, progress=entered
                )
        document = {**to_document(found), "inputs": inputs(self.source, self.arm, self.reference, self.effects)}
        if seen is not None:
            document["against"] = seen.to_dict()
        document = with_statements(document)

        def drawings() -> Drawings:
            from lite6jax.report import diagnosis_figures, pages

            figures = diagnosis_figures.drawings(found, self.source.name, document)
            return Drawings(figures, len(diagnosis_figures.NAMES), partial(pages.diagnosis_page, found, document))

        present(self, recording, document, diagnosis_report, drawings, None if seen is None else seen.file)
        return BAD_FIT if found.quality.verdict == "bad" else DONE

    def diagnosed(self) -> "tuple[Diagnosis | TorqueDiagnosis, dict[str, Any]]":
        """The diagnosis of the recording's poses, or with `torques`, or where it has no poses, of its torques.

        Returns:
            the diagnosis and its document; nothing is written or printed.

        Raises:
            InputError: the recording has neither, or as `diagnose` and `diagnose_torques`.
        """
        from lite6jax.diagnosis.options import QUICK
        from lite6jax.effects.user_effects import by_domain, load_effects
        from lite6jax.fitting.recognition import arm_of
        from lite6jax.fitting.source import load_nominal

        nominal = load_nominal(self.arm)
        recording = self._read(self.source, nominal)
        kinematic, dynamic = by_domain(load_effects(self.effects) if self.effects else ())
        options, read = QUICK if self.quick else None, inputs(self.source, self.arm, None, self.effects)
        if self.torques or (recording.position is None and recording.has_torques):
            from lite6jax.diagnosis.torque_diagnosis import diagnose_torques
            from lite6jax.diagnosis.torque_document import to_torque_document
            from lite6jax.report import statements

            motors = diagnose_torques(recording, nominal, effects=dynamic, options=options)
            return motors, statements.with_statements({**to_torque_document(motors), "inputs": read})
        from lite6jax.diagnosis.diagnose import diagnose
        from lite6jax.diagnosis.document import to_document
        from lite6jax.report import statements

        found = diagnose(
            recording, nominal or arm_of(recording), geometry=self.geometry, effects=kinematic, options=options
        )
        return found, statements.with_statements({**to_document(found), "inputs": read})

    def _read(self, path: Path, of: "Arm | None") -> "Recording":
        from lite6jax.fitting.source import load_recording

        assumed = {"assume_degrees": self.assume_degrees, "assume_millimetres": self.assume_millimetres}
        return load_recording(path, of, **assumed)


@dataclass(frozen=True)
class Predict:
    """Predict what the sensor of a diagnosed recording would measure in another motion of the same arm.

    Of a diagnosis of torques these are tau1_Nm …, the torques of the motors, and tau1_std_Nm …, which contain the
    sensor's noise as well. Of one of poses and torques both are written, if the motion is a trajectory.

    Beside each pose stand its standard deviations, x_std_m … and where orientation was recorded rx_std_rad … about the
    axes of the tool. They contain what the diagnosis left uncertain, and not the sensor's noise. Where `outside` is 1
    the recording does not support the row: it is beyond the recorded range, or in a gap of it.

    For example:

        lite6jax predict diagnosis.json motion.csv --out predicted.csv
        lite6jax predict diagnosis.json run9.csv --register --out predicted.csv
    """

    diagnosis: Annotated[Positional[Path], arg(metavar="DIAGNOSIS")]
    """What `diagnose` wrote (.json)."""
    motion: Annotated[Positional[Path], arg(metavar="FILE")]
    """Joint positions, and the other quantities on which the model's effects depend (.csv, .parquet)."""
    out: Annotated[Path, arg(metavar="FILE")]
    """Write the poses here (.csv), one row per sample."""
    register: bool = False
    """First fit sensor frame and tool to the poses in the file, for another set-up of the same arm."""
    effects: Annotated[Path | None, arg(metavar="FILE.py")] = None
    """Effects of your own that the model has. Runs the file."""
    json: bool = False
    """Print JSON instead of the report."""
    force: bool = False
    """Replace the file if it exists."""

    def run(self) -> int:
        """Reads, predicts, writes."""
        check_writable(self.out, self.force)
        if self.out.suffix.lower() != ".csv":
            raise InputError(f"{self.out}: what is written here is csv; let the name end in .csv")
        refuse_inputs([self.out], [self.diagnosis, self.motion, self.effects])
        import sys

        import numpy as np
        import pyarrow as pa

        from lite6jax.diagnosis.document import check_sum, model_from_document, parsed_document
        from lite6jax.diagnosis.torque_document import is_of_torques, of_torques
        from lite6jax.domains.pose.files import read_motion
        from lite6jax.domains.pose.predict import predicted, prediction_columns
        from lite6jax.domains.pose.registration import register_model
        from lite6jax.effects.user_effects import load_effects
        from lite6jax.recordings.writing import write_table
        from lite6jax.report import compensation, screen
        from lite6jax.report.reference import origin_statement

        document, effects = parsed_document(self.diagnosis), load_effects(self.effects) if self.effects else ()
        if is_of_torques(document):
            from lite6jax.cli.diagnose_torques import predict_motors

            return predict_motors(self, document, effects)
        model = model_from_document(document, effects, str(self.diagnosis))
        check_sum(document, self.diagnosis)
        recording = read_motion(self.motion, model)
        found = None
        if self.register:
            model, found = register_model(model, recording)
        shown = predicted(model, recording)
        written = prediction_columns(shown, model.orientation)
        said: list[str] = []
        if of_torques(document) is not None:
            from lite6jax.cli.diagnose_torques import torques_beside

            written, said = torques_beside(self, document, written, recording, effects)
        columns = pa.table(written)
        path = write_atomically(self.out, lambda target: write_table(columns, target), self.force)
        if self.json:
            from lite6jax.report import documents

            print(documents.text(documents.of_prediction(shown, found), [path]))
            return DONE
        if model.reference is not None:
            screen.show([origin_statement(model.reference)])
        if found is not None:
            screen.show(compensation.registration_report(found))
        screen.show(screen.notes(recording.notes))
        empty = int(np.isnan(shown.poses[:, 0, 0]).sum())
        if empty:
            print(f"{empty} rows are empty: there, the clock offset reaches beyond the ends of the motion.")
        if shown.outside is None:
            print(f"{self.diagnosis}: {compensation.NO_BARS}", file=sys.stderr)
        else:
            print(compensation.outside_sentence(int(shown.outside.sum()), len(shown.outside), "row"))
        for line in said:
            print(line)
        screen.written([path])
        return DONE
