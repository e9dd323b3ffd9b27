"""Commands on calibrations and recordings without effects: check one, fit one, compare arms, fit a folder."""

from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Annotated, Literal, final

from tyro.conf import Positional, arg

from lite6jax.cli import command
from lite6jax.deferred import import_lazily
from lite6jax.errors import InputError

with import_lazily():
    from lite6jax import recordings
    from lite6jax.arms import factory
    from lite6jax.calibration import fit, solution
    from lite6jax.calibration import fleet as comparing
    from lite6jax.calibration import source as sources
    from lite6jax.controller import connection, sdk, station
    from lite6jax.domains.pose import check as pose_check
    from lite6jax.domains.pose import fit as pose_fit
    from lite6jax.fleet import folder
    from lite6jax.report import connected, documents, faults, figures, fits, listings, screen


@final
@dataclass(frozen=True)
class CheckCommand:
    """Rule out the easy causes of a mismatch first: nominal table, tool offset, smooth or jumping error.

    For example:

        lite6jax check arm.yaml run7.csv
    """

    files: Annotated[Positional[tuple[Path, ...]], arg(metavar="FILE…")]
    """Calibrations (.yaml, .json, .conf) and recordings (.csv, .parquet)."""
    arm: command.ArmName = None
    """The nominal arm; recognised, or from the sidecar, where not given."""
    assume_degrees: command.AssumeDegrees = False
    assume_millimetres: command.AssumeMillimetres = False
    json: command.Json = False
    """Print a JSON object for each file, a line each, instead of the report."""

    def run(self) -> int:
        """Reads, checks, prints."""
        if not self.files:
            raise InputError("check needs a file or more; name them")
        nominal = sources.load_nominal(self.arm)
        for path in self.files:
            source = sources.read_source(path, nominal, **command.assumptions(self))
            if isinstance(source, recordings.Recording):
                checked = pose_check.check_recording(source, nominal)
            else:
                checked = pose_check.check_calibration(source)
            if self.json:
                print(documents.line({"file": str(path), **documents.document(checked)}))
            else:
                screen.show(faults.check_report(path, checked))
        return command.DONE


@dataclass(frozen=True)
class FitCommand:
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
    save_calibration: command.OutFile = None
    """With --ip: write the calibration that was read here (YAML of the vendor's form, which `fit` reads again)."""
    no_sdk: bool = False
    """With --ip: read and fit only."""
    fk_samples: int = 1000
    """With --ip: joint positions at which to ask the controller."""
    arm: command.ArmName = None
    """The nominal arm: a bundled name, or a description or URDF. Recognised, or from the sidecar, where not given."""
    out: command.OutFile = None
    """Write the effective table (JSON, mm and deg) here."""
    figures: command.Folder = None
    """Draw the error against each joint into this folder (PNG and SVG)."""
    force: command.Force = False
    geometry: command.Geometry = "declared"
    """Of a recording: what its sidecar says; the factory calibration exactly, or near it; or fitted freely."""
    loss: Literal["student_t", "least_squares"] = "student_t"
    """Of a recording: student_t is robust to outliers."""
    solver: Literal["gauss_newton", "levenberg_marquardt"] = "gauss_newton"
    """gauss_newton is the fast one, levenberg_marquardt that of optimistix; they agree."""
    samples: int = 300
    """Of a calibration: joint positions drawn inside the limits."""
    seed: int = 0
    """Of those."""
    assume_degrees: command.AssumeDegrees = False
    assume_millimetres: command.AssumeMillimetres = False
    json: command.Json = False

    def run(self) -> int:
        """Reads, fits, writes, prints."""
        if (self.source is None) == (self.ip is None):
            raise InputError("fit needs a FILE, or an arm with --ip ADDRESS; give one of the two")
        if self.fk_samples < 1:
            raise InputError(f"--fk-samples {self.fk_samples}: give 1 or more, or --no-sdk to ask for none")
        if self.save_calibration and self.ip is None:
            raise InputError("--save-calibration: is of what an arm's controller says; add --ip ADDRESS")
        outputs = [self.out, self.save_calibration]
        command.check_outputs(outputs, [self.source, self.arm], self.force, [".json", ".yaml"])
        nominal = sources.load_nominal(self.arm)
        title = self.source.name if self.source else str(self.ip)
        stem = self.source.stem if self.source else title.replace(":", "_")
        written: list[Path] = []
        if self.source is None:
            source = station.read_calibration(connection.parse_address(title), nominal).calibration
        else:
            source = sources.read_source(self.source, nominal, **command.assumptions(self))
        if self.save_calibration and isinstance(source, factory.FactoryCalibration):
            # at once: no failure below costs what was read
            written.append(factory.write_factory(source.kinematics, self.save_calibration, overwrite=self.force))
        verified = self.ip is not None and not self.no_sdk
        verification = None
        refusal = None
        names = [f"{stem}_{kind}" for kind in ("error_by_joint", *(["controller"] if verified else []))]
        command.check_figures(self.figures, names, self.force)
        if isinstance(source, recordings.Recording):
            fitted = pose_fit.fit_recording(source, nominal, geometry=self.geometry, loss=self.loss, solver=self.solver)
            report = [fits.recording_read(source, fitted)]
        else:
            fitted = fit.fit_calibration(source, solver=self.solver, samples=self.samples, seed=self.seed)
            report = [fits.calibration_read(source)]
            if verified:
                try:
                    with screen.progress(self.fk_samples, "asking the controller") as advance:
                        address = connection.parse_address(title)
                        verification = sdk.verify(source, address, self.fk_samples, self.seed, advance)
                except InputError as error:  # the fit is good all the same: it is shown and written first
                    refusal = error
        report.append(fits.solution_report(fitted, fitted.recording))
        agrees = {}
        if verification:
            report.append(connected.verification_report(verification, title))
            agrees = {"controller_agrees": bool(verification.passed)}

        def draw():
            yield figures.error_by_joint(fitted, title)
            if verification:
                yield figures.verification_figure(verification, title)

        written += [solution.write_solution(fitted, self.out, self.force)] if self.out else []
        written += command.save_figures(self.figures, names, draw, self.force)
        command.present(self.json, lambda: documents.document(fitted) | agrees, chain(*report), written)
        if refusal:
            raise refusal
        if fitted.result.name != "CONVERGED" or (verification is not None and not verification.passed):
            return command.NOT_REACHED
        if fitted.quality.verdict == "bad":
            return command.BAD_FIT
        return command.DONE


@dataclass(frozen=True)
class CompareCommand:
    """Compare calibrations of arms of one type: the manufacturing tolerance made visible.

    For example:

        lite6jax compare station1.yaml station2.yaml --figures figures
    """

    files: Annotated[Positional[tuple[Path, ...]], arg(metavar="FILE…")]
    """Two calibrations or more (.yaml, .json)."""
    arm: command.ArmName = None
    """The nominal arm of all of them; recognised where not given."""
    figures: command.Folder = None
    """Draw the differences into this folder (PNG and SVG)."""
    json: command.Json = False
    force: command.Force = False

    def run(self) -> int:
        """Reads, compares, draws, prints."""
        nominal = sources.load_nominal(self.arm)
        names = ("compare_parameters", "compare_distances")
        command.check_figures(self.figures, names, self.force)
        comparison = comparing.compare([factory.read_factory(path, nominal) for path in self.files])
        written = command.save_figures(self.figures, names, lambda: comparison.plot().values(), self.force)
        return command.present(
            self.json, comparison, fits.comparison_report(comparison, screen.console().width), written
        )


@dataclass(frozen=True)
class FleetCommand:
    """Fit every calibration and recording of a folder; a bad file becomes a row that says why.

    For example:

        lite6jax fleet calibrations --out fleet.parquet
        lite6jax fleet s3://bucket/calibrations --out fleet.parquet --scheduler tcp://10.0.0.5:8786
    """

    folder: Annotated[Positional[Path], arg(metavar="DIR")]
    """The folder, or a URL that fsspec reads; its subfolders are not read."""
    out: Annotated[Path, arg(metavar="FILE")]
    """Write a row a file here (Parquet; SI units in the column names)."""
    arm: command.ArmName = None
    """The nominal arm of all of them; recognised file by file where not given."""
    processes: command.Processes = None
    """Processes of this machine, each with one thread; one a core where not given."""
    scheduler: command.Scheduler = None
    json: command.Json = False
    force: command.Force = False

    def run(self) -> int:
        """Fits, writes, prints."""
        command.check_outputs([self.out], [], self.force, [".parquet"])
        command.check_processes(self.processes, self.scheduler)
        nominal = None if self.arm is None else sources.load_nominal(self.arm)
        with screen.progress(None, "fitting") as advance:
            table = folder.fit_folder(
                self.folder,
                self.out,
                nominal,
                scheduler=self.scheduler,
                processes=self.processes,
                progress=advance,
                overwrite=self.force,
            )
        return command.present(
            self.json,
            lambda: documents.of_folder(folder.read_rows(table)),
            listings.folder_report(folder.read_rows(table, parameters=False)),
            [table],
        )
