"""Commands on calibrations and recordings without effects: check one, fit one, compare arms, fit a folder."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, final

from tyro.conf import Positional, arg

from lite6jax.cli.command import (
    BAD_FIT,
    DONE,
    NOT_REACHED,
    ArmName,
    AssumeDegrees,
    AssumeMillimetres,
    Folder,
    Force,
    Json,
    OutFile,
    Processes,
    Scheduler,
    check_figures,
    check_outputs,
    check_processes,
    present,
    save_figures,
)
from lite6jax.errors import InputError

if TYPE_CHECKING:
    from lite6jax.arms.arm import Arm
    from lite6jax.arms.factory import FactoryCalibration
    from lite6jax.fitting.solution import Solution
    from lite6jax.recordings import Recording


@final
@dataclass(frozen=True)
class Check:
    """Rule out the easy causes of a mismatch first: nominal table, tool offset, smooth or jumping error.

    For example:

        lite6jax check arm.yaml run7.csv
    """

    files: Annotated[Positional[tuple[Path, ...]], arg(metavar="FILE…")]
    """Calibrations (.yaml, .json, .conf) and recordings (.csv, .parquet)."""
    arm: ArmName = None
    """The nominal arm; recognised, or from the sidecar, where not given."""
    assume_degrees: AssumeDegrees = False
    assume_millimetres: AssumeMillimetres = False
    json: Json = False
    """Print a JSON object for each file, a line each, instead of the report."""

    def run(self) -> int:
        """Reads, checks, prints."""
        if not self.files:
            raise InputError("check needs a file or more; name them")
        from lite6jax.domains.pose.check import check_calibration, check_recording
        from lite6jax.fitting.source import load_nominal, read_source
        from lite6jax.recordings import Recording
        from lite6jax.report import data_faults, screen

        nominal = load_nominal(self.arm)
        for path in self.files:
            source = read_source(
                path, nominal, assume_degrees=self.assume_degrees, assume_millimetres=self.assume_millimetres
            )
            found = check_recording(source, nominal) if isinstance(source, Recording) else check_calibration(source)
            if self.json:
                from lite6jax.report import documents

                print(documents.line({"file": str(path), **documents.document(found)}))
            else:
                screen.show(data_faults.check_report(path, found))
        return DONE


@dataclass(frozen=True)
class Fit:
    """Fit one arm: from its factory calibration, or from a recording of measured poses.

    For example:

        lite6jax fit arm.yaml --out model.json
        lite6jax fit run7.csv --figures figures
        lite6jax fit --ip 192.168.1.185 --save-calibration arm.yaml
    """

    source: Annotated[Positional[Path | None], arg(metavar="FILE")] = None
    """A calibration (.yaml, .json) or a recording (.csv, .parquet, .mcap, .bag, or the folder of a rosbag2 or of a
    LeRobot data set), with its sidecar .yaml beside it; `lite6jax init` writes one."""
    ip: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """In place of a file: read the calibration of the arm at this address, fit it, and compare it with the controller's
    own forward kinematics. The arm does not move."""
    save_calibration: OutFile = None
    """With --ip: write the calibration that was read here (YAML of the vendor's form, which `fit` reads again)."""
    no_sdk: bool = False
    """With --ip: read and fit only."""
    fk_samples: int = 1000
    """With --ip: joint positions at which to ask the controller."""
    arm: ArmName = None
    """The nominal arm: a bundled name, or a description or URDF. Recognised, or from the sidecar, where not given."""
    out: OutFile = None
    """Write the effective table (JSON, mm and deg) here."""
    figures: Folder = None
    """Draw the error against each joint into this folder (PNG and SVG)."""
    force: Force = False
    geometry: Literal["declared", "exact", "prior", "free"] = "declared"
    """Of a recording: what its sidecar says; the factory calibration exactly, or near it; or fitted freely."""
    loss: Literal["student_t", "least_squares"] = "student_t"
    """Of a recording: student_t is robust to outliers."""
    solver: Literal["gauss_newton", "levenberg_marquardt"] = "gauss_newton"
    """gauss_newton is the fast one, levenberg_marquardt that of optimistix; they agree."""
    samples: int = 300
    """Of a calibration: joint positions drawn inside the limits."""
    seed: int = 0
    """Of those."""
    assume_degrees: AssumeDegrees = False
    assume_millimetres: AssumeMillimetres = False
    json: Json = False

    def run(self) -> int:
        """Reads, fits, writes, prints."""
        if (self.source is None) == (self.ip is None):
            raise InputError("fit needs a FILE, or an arm with --ip ADDRESS; give one of the two")
        if self.fk_samples < 1:
            raise InputError(f"--fk-samples {self.fk_samples}: give 1 or more, or --no-sdk to ask for none")
        if self.save_calibration and self.ip is None:
            raise InputError("--save-calibration: is of what an arm's controller says; add --ip ADDRESS")
        outputs = [(self.out, ".json"), (self.save_calibration, ".yaml")]
        check_outputs(outputs, [self.source, self.arm], self.force)
        from lite6jax.fitting.source import load_nominal
        from lite6jax.recordings import Recording

        nominal = load_nominal(self.arm)
        source, written = self._read(nominal), []
        recorded, verified = isinstance(source, Recording), self.ip is not None and not self.no_sdk
        if self.save_calibration and not isinstance(source, Recording):  # at once: no failure below costs what was read
            from lite6jax.arms.factory import write_factory

            written.append(write_factory(source.kinematics, self.save_calibration, overwrite=self.force))
        title = self.source.name if self.source else str(self.ip)
        stem = self.source.stem if self.source else title.replace(":", "_")
        kinds = {"error_by_joint": True, "error_distribution": recorded, "controller": verified}
        names = [f"{stem}_{kind}" for kind, is_drawn in kinds.items() if is_drawn]
        check_figures(self.figures, names, self.force)
        solution, verification, refusal = self._fit(source, nominal), None, None
        if verified and not isinstance(source, Recording):
            from lite6jax.controller.exchange import parse_address
            from lite6jax.controller.verification import verify
            from lite6jax.report import screen

            try:
                with screen.progress(self.fk_samples, "asking the controller") as advance:
                    verification = verify(source, parse_address(str(self.ip)), self.fk_samples, self.seed, advance)
            except InputError as error:  # the fit is good all the same: it is shown and written first
                refusal = error
        if self.out:
            from lite6jax.fitting.solution import write_solution

            written.append(write_solution(solution, self.out, self.force))

        def draw():
            from lite6jax.report import figures

            yield figures.error_by_joint(solution, title)
            if solution.recording:
                yield figures.error_distribution(solution, solution.recording, title)
            if verification:
                yield figures.verification_figure(verification, title)

        def report():
            from lite6jax.report import fits

            if isinstance(source, Recording):
                yield from fits.recording_read(source, solution)
            else:
                yield from fits.calibration_read(source)
            yield from fits.solution_report(solution, solution.recording)
            if verification:
                from lite6jax.report import live

                yield from live.verification_report(verification, title)

        def document(documents):
            agrees = {"controller_agrees": bool(verification.passed)} if verification else {}
            return documents.document(solution) | agrees

        written += save_figures(self.figures, names, draw, self.force)
        present(self.json, document, report(), written)
        if refusal:
            raise refusal
        if solution.result.name != "CONVERGED" or (verification is not None and not verification.passed):
            return NOT_REACHED
        return BAD_FIT if solution.quality.verdict == "bad" else DONE

    def _read(self, nominal: "Arm | None") -> "FactoryCalibration | Recording":
        if self.source is None:
            from lite6jax.controller.calibration import read_calibration
            from lite6jax.controller.exchange import parse_address

            return read_calibration(parse_address(str(self.ip)), nominal).calibration
        from lite6jax.fitting.source import read_source

        return read_source(
            self.source, nominal, assume_degrees=self.assume_degrees, assume_millimetres=self.assume_millimetres
        )

    def _fit(self, source: "FactoryCalibration | Recording", nominal: "Arm | None") -> "Solution":
        from lite6jax.recordings import Recording

        if isinstance(source, Recording):
            from lite6jax.domains.pose.fit import fit_recording

            return fit_recording(source, nominal, geometry=self.geometry, loss=self.loss, solver=self.solver)
        from lite6jax.fitting.fit import fit_calibration

        return fit_calibration(source, solver=self.solver, samples=self.samples, seed=self.seed)


@dataclass(frozen=True)
class Compare:
    """Compare calibrations of arms of one type: the manufacturing tolerance made visible.

    For example:

        lite6jax compare station1.yaml station2.yaml --figures figures
    """

    files: Annotated[Positional[tuple[Path, ...]], arg(metavar="FILE…")]
    """Two calibrations or more (.yaml, .json)."""
    arm: ArmName = None
    """The nominal arm of all of them; recognised where not given."""
    figures: Folder = None
    """Draw the differences into this folder (PNG and SVG)."""
    json: Json = False
    force: Force = False

    def run(self) -> int:
        """Reads, compares, draws, prints."""
        from lite6jax.arms.factory import read_factory
        from lite6jax.fitting.fleet import compare
        from lite6jax.fitting.source import load_nominal

        nominal, names = load_nominal(self.arm), ("compare_parameters", "compare_distances")
        check_figures(self.figures, names, self.force)
        found = compare([read_factory(path, nominal) for path in self.files])

        def draw():
            from lite6jax.report import figures

            return figures.parameter_differences(found), figures.distance_between(found)

        written = save_figures(self.figures, names, draw, self.force)
        from lite6jax.report import fits, screen

        return present(self.json, found, fits.comparison_report(found, screen.console().width), written)


@dataclass(frozen=True)
class Fleet:
    """Fit every calibration and recording of a folder; a bad file becomes a row that says why. A run that was ended
    goes on where it stopped.

    For example:

        lite6jax fleet calibrations --out fleet.parquet
        lite6jax fleet s3://bucket/calibrations --out fleet.parquet --scheduler tcp://10.0.0.5:8786
    """

    folder: Annotated[Positional[Path], arg(metavar="DIR")]
    """The folder, or a URL that fsspec reads; its subfolders are not read."""
    out: Annotated[Path, arg(metavar="FILE")]
    """Write a row a file here (Parquet; SI units in the column names)."""
    arm: ArmName = None
    """The nominal arm of all of them; recognised file by file where not given."""
    processes: Processes = None
    """Processes of this machine, each with one thread; one a core where not given."""
    scheduler: Scheduler = None
    json: Json = False
    force: Force = False

    def run(self) -> int:
        """Fits, writes, prints."""
        check_outputs([(self.out, ".parquet")], [], self.force)
        check_processes(self.processes, self.scheduler)
        nominal = None
        if self.arm is not None:
            from lite6jax.fitting.source import load_nominal

            nominal = load_nominal(self.arm)
        from lite6jax.folders.fleet import fit_folder, read_rows
        from lite6jax.report import screen

        with screen.progress_of_many("fitting") as advance:
            run = fit_folder(
                self.folder,
                self.out,
                nominal,
                scheduler=self.scheduler,
                processes=self.processes,
                progress=advance,
                overwrite=self.force,
            )
        from lite6jax.report import fleets

        return present(
            self.json,
            lambda documents: documents.of_folder(list(read_rows(run.path))),
            fleets.folder_report(read_rows(run.path, parameters=False), run.kept),
            [run.path],
        )
