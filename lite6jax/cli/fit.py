"""Commands that fit: one arm, two or more to compare, a folder of them."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from lite6jax.cli.arguments import ArmName, Folder, OutFile, check_out, refuse_inputs
from lite6jax.cli.exit_codes import BAD_FIT, DONE, NOT_REACHED
from lite6jax.errors import InputError

if TYPE_CHECKING:
    from lite6jax.arms.arm import Arm
    from lite6jax.arms.factory import FactoryCalibration
    from lite6jax.controller.verification import Verification
    from lite6jax.recordings import Recording


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
    force: bool = False
    """Replace files that exist."""
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
    assume_degrees: bool = False
    """Take joint columns that say rad as degrees."""
    assume_millimetres: bool = False
    """Take position columns that say m as millimetres."""
    json: bool = False
    """Print JSON instead of the report."""

    def run(self) -> int:
        """Reads, fits, prints, writes."""
        if (self.source is None) == (self.ip is None):
            raise InputError("fit needs a FILE, or an arm with --ip ADDRESS; give one of the two")
        if self.fk_samples < 1:
            raise InputError(f"--fk-samples {self.fk_samples}: give 1 or more, or --no-sdk to ask for none")
        if self.save_calibration and self.ip is None:
            raise InputError("--save-calibration: is of what an arm's controller says; add --ip ADDRESS")
        for path, suffix in ((self.out, ".json"), (self.save_calibration, ".yaml")):
            if path:
                check_out(path, suffix, self.force)
        refuse_inputs([self.out, self.save_calibration], [self.source, self.arm])
        from lite6jax.fitting.source import load_nominal
        from lite6jax.recordings import Recording

        nominal = load_nominal(self.arm)
        stem = self.source.stem if self.source else str(self.ip).replace(":", "_")
        title = self.source.name if self.source else str(self.ip)
        names = [f"{stem}_error_by_joint", f"{stem}_error_distribution", f"{stem}_controller"]
        source, written = self._read(nominal), []
        if self.save_calibration and not isinstance(source, Recording):  # at once: no failure below costs what was read
            from lite6jax.arms.factory import write_factory

            written.append(write_factory(source.kinematics, self.save_calibration, overwrite=self.force))
        recording = source if isinstance(source, Recording) else None
        verified = self.ip is not None and not self.no_sdk
        if self.figures:
            from lite6jax.report import canvas

            kept = (True, recording is not None, verified)
            canvas.check_names(self.figures, [n for n, keep in zip(names, kept, strict=True) if keep], self.force)
        if isinstance(source, Recording):
            from lite6jax.domains.pose.fit import fit_recording

            solution = fit_recording(source, nominal, geometry=self.geometry, loss=self.loss, solver=self.solver)
        else:
            from lite6jax.fitting.fit import fit_calibration

            solution = fit_calibration(source, solver=self.solver, samples=self.samples, seed=self.seed)
        recording = solution.recording
        verification, refusal = None, None
        if verified and not isinstance(source, Recording):
            try:
                verification = self._verify(source)
            except InputError as error:  # the fit is good all the same: it is shown and written first
                refusal = error

        from lite6jax.report import fits, screen

        # before anything is printed: a reader who leaves early, like `head`, must not cost the files
        if self.out:
            from lite6jax.fitting.solution import write_solution

            written.append(write_solution(solution, self.out, self.force))
        if self.figures:
            from lite6jax.report import canvas, figures

            drawn = {names[0]: figures.error_by_joint(solution, title)}
            if recording:
                drawn[names[1]] = figures.error_distribution(solution, recording, title)
            if verification:
                drawn[names[2]] = figures.verification_figure(verification, title)
            written += canvas.save(drawn, self.figures, self.force)
        if self.json:
            from lite6jax.report import documents

            document = documents.document(solution)
            if verification:
                document["controller_agrees"] = bool(verification.passed)
            print(documents.text(document, written))
        else:
            if isinstance(source, Recording):
                screen.show(fits.recording_read(source, solution))
            else:
                screen.show(fits.calibration_read(source))
            screen.show(fits.solution_report(solution, recording))
            if verification:
                from lite6jax.report import live

                screen.show(live.verification_report(verification, str(self.ip)))
            screen.written(written)
        if refusal:
            raise refusal
        passed = verification is None or verification.passed
        if solution.result.name != "CONVERGED" or not passed:
            return NOT_REACHED
        return BAD_FIT if solution.quality.verdict == "bad" else DONE

    def _read(self, nominal: "Arm | None") -> "FactoryCalibration | Recording":
        if self.source is None:
            from lite6jax.controller.calibration import read_calibration
            from lite6jax.controller.connection import parse_address

            return read_calibration(parse_address(str(self.ip)), nominal).calibration
        from lite6jax.fitting.source import read_source

        return read_source(
            self.source, nominal, assume_degrees=self.assume_degrees, assume_millimetres=self.assume_millimetres
        )

    def _verify(self, calibration: "FactoryCalibration") -> "Verification":
        from lite6jax.controller.connection import parse_address
        from lite6jax.controller.verification import verify
        from lite6jax.report import screen

        with screen.progress(self.fk_samples, "asking the controller") as advance:
            return verify(calibration, parse_address(str(self.ip)), self.fk_samples, self.seed, advance)


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
    json: bool = False
    """Print JSON instead of the report."""
    force: bool = False
    """Replace files that exist."""

    def run(self) -> int:
        """Reads, compares, prints, draws."""
        from lite6jax.arms.factory import read_factory
        from lite6jax.fitting.fleet import compare
        from lite6jax.fitting.source import load_nominal

        nominal = load_nominal(self.arm)
        names = ("compare_parameters", "compare_distances")
        if self.figures:
            from lite6jax.report import canvas

            canvas.check_names(self.figures, names, self.force)
        comparison = compare([read_factory(path, nominal) for path in self.files])

        from lite6jax.report import fits, screen

        written = []
        if self.figures:
            from lite6jax.report import canvas, figures

            drawn = (figures.parameter_differences(comparison), figures.distance_between(comparison))
            written = canvas.save(dict(zip(names, drawn, strict=True)), self.figures, self.force)
        if self.json:
            from lite6jax.report import documents

            print(documents.text(documents.document(comparison), written))
            return DONE
        screen.show(fits.comparison_report(comparison, screen.console().width))
        screen.written(written)
        return DONE
