"""`python -m benchmarks rivals`: the diagnosis beside what others would do, on real series.

Each rival sees the rows outside a contiguous fold and predicts the fold from its joints, direction of motion, payload
and temperatures; stepwise regression has time too. The score is the error over all rows of all folds. Every rival
starts from the same fitted geometry and corrects it by a displacement and a turn of the tool in the base's axes.
"""

import argparse
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from benchmarks import residual
from benchmarks.concealed.chain import rotation_from_vector
from benchmarks.measure import DONE, OURS, Record, run_command, time_call, write_records
from benchmarks.residual import Array, Fitted, Geometry, Rival, rotations
from lite6jax.calibration.compiled import keep_compiled_code
from lite6jax.diagnosis.diagnose import diagnose_poses
from lite6jax.diagnosis.document import read_model, write_document
from lite6jax.domains.pose.registration import register, register_model
from lite6jax.errors import InputError
from lite6jax.recordings import Recording, read_recording, sidecar_path
from lite6jax.storage import check_writable

FOLDS = 5
REAL = "LITE6JAX_REAL"  # the variable that names the folder of real series
_NAMED = 8


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code: 0, 2 for arguments that cannot be used, 130 where interrupted."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks rivals",
        description="The geometry alone; over it a Gaussian process, a neural network, ridge regression on Fourier "
        "orders and gravity, stepwise regression; and the diagnosis: by contiguous held-out fifths, and from each "
        "series to the next with sensor frame and tool registered anew.",
    )
    parser.add_argument(
        "--real", type=Path, metavar="DIR", help=f"recordings (.csv with .yaml) of one arm; ${REAL} where not given"
    )
    parser.add_argument("--every", type=int, default=1, metavar="K", help="of a series: every K-th row")
    parser.add_argument("--rivals-only", action="store_true", help="leave the diagnosis out, which takes longest")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the records to this file, over an older one")
    options = parser.parse_args(arguments)
    real = options.real or os.environ.get(REAL)
    if not real:
        parser.error(f"name what to compare on: --real DIR (or the variable {REAL})")
    if options.every < 1:
        parser.error("--every: give 1 or more")
    keep_compiled_code()
    return run_command(partial(_compare, options, Path(real)))


def _compare(options: argparse.Namespace, real: Path) -> int:
    """Each series by itself, and from each to the next."""
    console, records = Console(highlight=False), []
    if options.json:
        check_writable(options.json, overwrite=True)
    paths = sorted(path for path in real.glob("*.csv") if sidecar_path(path).exists())
    if not paths:
        raise InputError(f"{real}: holds no recording (.csv with .yaml beside it); put the real series there")
    recordings = [read_recording(path) for path in paths]
    recordings = [each.select(np.arange(0, each.samples, options.every)) for each in recordings]
    with console.status("…") as status:
        for k, (path, recording) in enumerate(zip(paths, recordings, strict=True)):
            other = recordings[k + 1] if k + 1 < len(paths) else None
            outcomes = {f"{path.name}, {recording.samples} rows, held-out fifths": list(compare(recording))}
            if other is not None:
                title = f"from {path.name} to {paths[k + 1].name}, frame and tool registered anew"
                outcomes[title] = list(transfer(recording, other))
            if not options.rivals_only:
                status.update(f"{path.name}: {OURS}")
                for found, own in zip(outcomes.values(), _diagnosed(recording, other), strict=True):
                    found.append(own)
            for title, found in outcomes.items():
                console.print(table(title, found))
                records += [record for outcome in found for record in outcome.records(title)]
    if options.json:
        write_records(options.json, records)
    return DONE


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one of them makes of a recording."""

    subject: str  # which
    errors: Array  # `(sample,)` m, each row predicted by a fit of the other folds
    parameters: int  # of the fit of all rows, over the geometry's
    names: tuple[str, ...]  # of the fit of all rows
    seconds: float  # of all fits, the geometry's included

    @property
    def figures(self) -> tuple[float, float, float]:
        """mm, RMS, 95th percentile and largest of the errors that are there."""
        e = 1e3 * self.errors
        return float(np.sqrt(np.nanmean(e**2))), float(np.nanpercentile(e, 95)), float(np.nanmax(e))

    @property
    def named(self) -> str:
        """The names, those of one kind together."""
        kinds: dict[str, list[str]] = {}
        for kind, _, site in (name.partition(":") for name in self.names):
            kinds.setdefault(kind, []).append(site.removeprefix("joint"))
        told = [f"{kind} {', '.join(sites)}" for kind, sites in kinds.items()]
        return "; ".join(told[:_NAMED]) + ("; …" if len(told) > _NAMED else "") or "none"

    def records(self, work: str) -> Iterator[Record]:
        """For the JSON."""
        for name, value in zip(("RMS", "p95", "largest"), self.figures, strict=True):
            yield Record(work, self.subject, f"error, {name}", value, "mm")
        yield Record(work, self.subject, "numbers", float(self.parameters))
        yield Record(work, self.subject, f"names: {self.named}", float(len(self.names)))
        yield Record(work, self.subject, "time", self.seconds, "s")


def _diagnosed(recording: Recording, other: Recording | None) -> Iterator[Outcome]:
    """The diagnosis of a recording by its held-out rows, and registered to another one."""
    seconds, found = time_call(partial(diagnose_poses, recording))
    names = tuple(finding.effect.label for finding in found.findings)
    own = Outcome(OURS, found.after, found.fit.terms.size, names, seconds)
    yield own
    if other is not None:
        with tempfile.TemporaryDirectory() as folder:
            model = read_model(write_document(found.to_dict(), Path(folder) / "d.json"), domain="poses")
        yield replace(own, errors=register_model(model, other)[1].distance)


def rivals(free: bool) -> dict[str, Rival]:
    """By name."""
    return {
        "geometry alone": residual.geometry_alone,
        "geometry and Gaussian process": residual.gaussian_process,
        "geometry and neural network": residual.neural_network,
        "ridge, orders 1–60": partial(residual.ridge, free),
        "stepwise, BIC": partial(residual.stepwise, free),
    }


def compare(recording: Recording, folds: int = FOLDS) -> Iterator[Outcome]:
    """All rivals on one recording, by contiguous folds, and on all of it for their names."""
    held = recording.contiguous_folds(folds)
    geometries = [time_call(partial(Geometry.of, recording.select(~fold))) for fold in held]
    whole = time_call(partial(Geometry.of, recording))
    for name, rival in rivals(whole[1].free).items():
        errors, seconds = np.zeros(recording.samples), sum(s for s, _ in (*geometries, whole))
        for fold, (_, geometry) in zip(held, geometries, strict=True):
            taken, fitted = time_call(partial(_fit, geometry, rivals(geometry.free)[name], recording.select(~fold)))
            view = geometry.view(recording.select(fold))
            assert view.missed is not None
            errors[fold] = np.linalg.norm(fitted.correct(view)[:, :3] - view.missed, axis=1)
            seconds += taken
        taken, fitted = time_call(partial(_fit, whole[1], rival, recording))
        yield Outcome(name, errors, fitted.parameters, fitted.names, seconds + taken)


def _fit(geometry: Geometry, rival: Callable[..., Fitted], recording: Recording) -> Fitted:
    with threadpool_limits(1):  # small matrices: more threads would wait for each other
        return rival(geometry.view(recording).usable)


def transfer(recording: Recording, other: Recording) -> Iterator[Outcome]:
    """Fitted to one recording, errors on another of the same arm, its sensor frame and tool registered anew."""
    taken, geometry = time_call(partial(Geometry.of, recording))
    view = geometry.view(other)
    assert other.position is not None
    R = None if other.quaternion is None else rotations(other.quaternion)
    for name, rival in rivals(geometry.free).items():
        seconds, fitted = time_call(partial(_fit, geometry, rival, recording))
        moved = fitted.correct(view)
        tool = np.tile(np.eye(4), (len(moved), 1, 1))
        tool[:, :3, :3] = rotation_from_vector(moved[:, 3:]) @ view.axes[:, -1]
        tool[:, :3, 3] = view.tool + moved[:, :3]
        found = register(tool @ np.linalg.inv(geometry.after), other.position, R, view.noise)
        yield Outcome(name, found.distance, fitted.parameters, fitted.names, taken + seconds)


def table(title: str, outcomes: Sequence[Outcome]) -> Table:
    """A row each."""
    shown = Table(title=title, title_justify="left")
    for column in ("", "RMS mm", "p95 mm", "max mm", "numbers", "s", "names"):
        shown.add_column(column, justify="left" if column in ("", "names") else "right")
    for outcome in outcomes:
        figures = (f"{value:.4f}" for value in outcome.figures)
        shown.add_row(outcome.subject, *figures, str(outcome.parameters), f"{outcome.seconds:.0f}", outcome.named)
    return shown
