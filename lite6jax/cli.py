"""The commands: arguments in, sentences, tables and files out; the numbers come from the library."""

import gc
import inspect
import operator
import os
import signal
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from importlib.metadata import PackageNotFoundError, version
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.conf import FlagCreatePairsOff, OmitArgPrefixes, Positional, arg, subcommand

from lite6jax.errors import InputError
from lite6jax.storage import check_writable

# What computes or draws is imported by the command that needs it: help and mistakes answer at once.
DONE, NOT_CONVERGED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 128 + signal.SIGINT
DEMO = Path(__file__).parent / "demo" / "lite6_simulated.yaml"

ArmName = Annotated[str | None, arg(metavar="ARM")]
OutFile = Annotated[Path | None, arg(metavar="FILE")]
Folder = Annotated[Path | None, arg(metavar="DIR")]


@dataclass(frozen=True)
class Fit:
    """Fit one arm: from its factory calibration, or from a recording of measured poses.

    For example:

        lite6jax fit arm.yaml --out model.json
        lite6jax fit run7.csv --figures figures
    """

    source: Annotated[Positional[Path], arg(metavar="FILE")]
    """A calibration (.yaml, .json) or a recording (.csv, .parquet, with its sidecar .yaml beside it)."""
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
    """Of a recording: student_t is blind to wild samples."""
    solver: Literal["gauss_newton", "levenberg_marquardt"] = "gauss_newton"
    """The fast one, or optimistix'; they agree."""
    samples: int = 300
    """Of a calibration: joint positions drawn inside the limits."""
    seed: int = 0
    """Of those."""
    assume_degrees: bool = False
    """Take joint columns that say rad as degrees."""
    assume_millimetres: bool = False
    """Take position columns that say m as millimetres."""

    def run(self) -> int:
        """Reads, fits, prints, writes."""
        if self.out:
            _check_out(self.out, ".json", self.force)
        from lite6jax.fitting.fit import fit_calibration, fit_recording, load_nominal, read_source
        from lite6jax.recordings import Recording

        nominal = load_nominal(self.arm)
        source = read_source(
            self.source, nominal, assume_degrees=self.assume_degrees, assume_millimetres=self.assume_millimetres
        )
        recording = source if isinstance(source, Recording) else None
        names = [f"{self.source.stem}_error_by_joint", f"{self.source.stem}_error_distribution"]
        if self.figures:
            from lite6jax.report import figures

            figures.check_names(self.figures, names if recording else names[:1], self.force)
        if isinstance(source, Recording):
            solution = fit_recording(source, nominal, geometry=self.geometry, loss=self.loss, solver=self.solver)
        else:
            solution = fit_calibration(source, solver=self.solver, samples=self.samples, seed=self.seed)

        from lite6jax.report import screen, tables

        written = []  # before anything is printed: a reader who leaves early, like `head`, must not cost the files
        if self.out:
            from lite6jax.fitting.model_table import write_solution

            written.append(write_solution(solution, self.out, self.force))
        if self.figures:
            from lite6jax.report import figures

            drawn = {names[0]: figures.error_by_joint(solution, self.source.name)}
            if recording:
                drawn[names[1]] = figures.error_distribution(solution, recording, self.source.name)
            written += figures.save(drawn, self.figures, self.force)
        if isinstance(source, Recording):
            screen.show(tables.recording_read(source, solution))
        else:
            screen.show(tables.calibration_read(source))
        screen.show(tables.solution_report(solution, recording))
        screen.written(written)
        return DONE if solution.result.name == "CONVERGED" else NOT_CONVERGED


@dataclass(frozen=True)
class Demo:
    """Fit a bundled calibration of a simulated Lite 6, to see what the program does.

    For example:

        lite6jax demo --figures figures
    """

    out: OutFile = None
    """Write the effective table (JSON, mm and deg) here."""
    figures: Folder = None
    """Draw the error against each joint into this folder (PNG and SVG)."""
    force: bool = False
    """Replace files that exist."""

    def run(self) -> int:
        """As `fit` on the bundled file."""
        print("The calibration below is simulated, of the size that real ones have: no arm was measured.")
        print(f"lite6jax fit {DEMO}\n", flush=True)
        return Fit(DEMO, out=self.out, figures=self.figures, force=self.force).run()


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
    force: bool = False
    """Replace files that exist."""

    def run(self) -> int:
        """Reads, compares, prints, draws."""
        from lite6jax.arms.factory import read_factory
        from lite6jax.fitting.compare import compare
        from lite6jax.fitting.fit import load_nominal

        nominal = load_nominal(self.arm)
        names = ("compare_parameters", "compare_distances")
        if self.figures:
            from lite6jax.report import figures

            figures.check_names(self.figures, names, self.force)
        comparison = compare([read_factory(path, nominal) for path in self.files])

        from lite6jax.report import screen, tables

        written = []
        if self.figures:
            from lite6jax.report import figures

            drawn = (figures.parameter_differences(comparison), figures.distance_between(comparison))
            written = figures.save(dict(zip(names, drawn, strict=True)), self.figures, self.force)
        screen.show(tables.comparison_report(comparison, screen.console().width))
        screen.written(written)
        return DONE


@dataclass(frozen=True)
class Fleet:
    """Fit every calibration and recording of a folder; a bad file becomes a row that says why.

    For example:

        lite6jax fleet calibrations --out fleet.parquet
    """

    folder: Annotated[Positional[Path], arg(metavar="DIR")]
    """The folder; its subfolders are not read."""
    out: Annotated[Path, arg(metavar="FILE")]
    """Write a row a file here (Parquet; SI units in the column names)."""
    arm: ArmName = None
    """The nominal arm of all of them; recognised file by file where not given."""
    force: bool = False
    """Replace the file if it exists."""

    def run(self) -> int:
        """Fits, writes, prints."""
        _check_out(self.out, ".parquet", self.force)
        from lite6jax.fitting.fit import load_nominal
        from lite6jax.fitting.folder import fit_folder, folder_files, write_rows
        from lite6jax.report import screen, tables

        nominal = load_nominal(self.arm)
        files = folder_files(self.folder, self.out)
        with screen.progress(len(files), "fitting") as advance:
            rows = fit_folder(files, nominal, advance)
        path = write_rows(rows, self.out, self.force)
        screen.show(tables.folder_report(rows))
        screen.written([path])
        return DONE


@dataclass(frozen=True)
class Convert:
    """Write one arm's file in another form; what the new form cannot hold is said, or refused.

    For example:

        lite6jax convert arm.yaml arm.urdf
        lite6jax convert model.json arm.yaml --to ur
    """

    source: Annotated[Positional[str], arg(metavar="FILE|ARM")]
    """A calibration (.yaml, .json), a description, a URDF (robot.urdf#tip), or a bundled arm's name."""
    target: Annotated[Positional[Path], arg(metavar="FILE")]
    """The file to write."""
    to: Annotated[Literal["vendor", "ur", "table", "urdf", "description"] | None, arg(metavar="FORM")] = None
    """vendor or ur (.yaml), table (.json), urdf, or description (.yaml). By the suffix where not given: a calibration
    becomes vendor .yaml, all else a description."""
    arm: ArmName = None
    """The nominal arm of a calibration; recognised where not given."""
    force: bool = False
    """Replace the file if it exists."""

    def run(self) -> int:
        """Converts and reads back."""
        check_writable(self.target, self.force)
        from lite6jax.arms.forms import convert_file
        from lite6jax.fitting.fit import load_nominal
        from lite6jax.report import screen, tables

        done = convert_file(self.source, self.target, self.to, load_nominal(self.arm), self.force)
        screen.written([done.path])
        screen.show(tables.conversion_report(done))
        return DONE


@dataclass(frozen=True)
class Check:
    """Rule out the easy causes of a mismatch first: nominal table, tool offset, smooth or jumping error.

    For example:

        lite6jax check arm.yaml run7.csv
    """

    files: Annotated[Positional[tuple[Path, ...]], arg(metavar="FILE…")]
    """Calibrations (.yaml, .json) and recordings (.csv, .parquet)."""
    arm: ArmName = None
    """The nominal arm; recognised, or from the sidecar, where not given."""
    assume_degrees: bool = False
    """Take joint columns that say rad as degrees."""
    assume_millimetres: bool = False
    """Take position columns that say m as millimetres."""

    def run(self) -> int:
        """Reads, asks, prints."""
        if not self.files:
            raise InputError("check needs a file or more; name them")
        from lite6jax.fitting.check import check_calibration, check_recording
        from lite6jax.fitting.fit import load_nominal, read_source
        from lite6jax.recordings import Recording
        from lite6jax.report import screen, tables

        nominal = load_nominal(self.arm)
        for path in self.files:
            source = read_source(
                path, nominal, assume_degrees=self.assume_degrees, assume_millimetres=self.assume_millimetres
            )
            found = check_recording(source, nominal) if isinstance(source, Recording) else check_calibration(source)
            screen.show(tables.findings_report(path, found))
        return DONE


Command = Fit | Compare | Fleet | Convert | Check | Demo
DESCRIPTION = """Fit a UFACTORY Lite 6, or any serial arm, to its calibration or to measured poses.

Exit codes: 0 done, 1 the fit did not converge, 2 the input cannot be used, 130 interrupted."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command.

    Args:
        arguments: the command line without the program's name; the process's own where not given.

    Returns:
        the exit code: 0 done, 1 the fit did not converge, 2 the input cannot be used, 130 interrupted.
    """
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without × or ° shows a question mark
    try:
        if arguments == ["--version"]:
            print(f"lite6jax {_version()}")
            return DONE
        command: Command = tyro.cli(
            _subcommands(), prog="lite6jax", description=DESCRIPTION, args=arguments,
            config=(FlagCreatePairsOff, OmitArgPrefixes),
        )  # fmt: skip
        from lite6jax.fitting.compiled import keep_compiled_code

        keep_compiled_code()
        gc.set_threshold(200_000)  # tracing makes objects that stay; to look them through again and again takes a tenth
        code = command.run()
        sys.stdout.flush()
    except SystemExit as stop:  # tyro has printed help or what is wrong with the arguments
        return int(stop.code or 0)
    except InputError as error:
        print(f"error: {_one_line(error)}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("interrupted: nothing is left half-written", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader (head, less) has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return 128 + getattr(signal, "SIGPIPE", 13)
    return code


def _subcommands() -> Any:
    named = {"fit": Fit, "compare": Compare, "fleet": Fleet, "convert": Convert, "check": Check, "demo": Demo}
    options = []
    for name, command in named.items():
        text = inspect.getdoc(command)  # as it stands: tyro would join the lines of the examples
        options.append(Annotated[command, subcommand(name, description=text)])
    return reduce(operator.or_, options)


def _check_out(path: Path, suffix: str, overwrite: bool) -> None:
    if path.suffix.lower() != suffix:
        raise InputError(f"{path}: what is written here is {suffix[1:]}; let the name end in {suffix}")
    check_writable(path, overwrite)


def _one_line(error: InputError) -> str:
    """The message with what would break the line, or steer the terminal, spelled out."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in str(error))


def _version() -> str:
    try:
        return version("lite6jax")
    except PackageNotFoundError:
        return "(not installed)"


if __name__ == "__main__":
    sys.exit(main())
