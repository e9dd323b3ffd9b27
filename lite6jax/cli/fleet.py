"""The command that fits a folder of arms."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from lite6jax.cli.arguments import ArmName, Processes, Scheduler, check_out, check_processes
from lite6jax.cli.exit_codes import DONE


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
    """In place of processes of this machine: the Dask cluster of the scheduler at this address (tcp://HOST:8786)."""
    json: bool = False
    """Print JSON instead of the report."""
    force: bool = False
    """Replace the file if it exists."""

    def run(self) -> int:
        """Fits, writes, prints."""
        check_out(self.out, ".parquet", self.force)
        check_processes(self.processes, self.scheduler)
        nominal = None
        if self.arm is not None:
            from lite6jax.fitting.source import load_nominal

            nominal = load_nominal(self.arm)
        from lite6jax.folders.fleet import fit_folder
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
        from lite6jax.folders.rows import read_rows

        if self.json:
            from lite6jax.report import documents

            print(documents.text(documents.of_folder(list(read_rows(run.path))), [run.path]))
            return DONE
        from lite6jax.report import fleets

        screen.show(fleets.folder_report(read_rows(run.path, parameters=False), run.kept))
        screen.written([run.path])
        return DONE
