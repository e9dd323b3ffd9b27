"""`python -m benchmarks rivals`: the diagnosis beside what others would do, on real series.

Each rival sees the rows outside a contiguous fold and predicts the fold from its joints, payload, temperature and time;
the errors of all folds together are its score, all rows counted. Every one starts from the same fitted geometry, and
corrects it: a displacement and a turn of the tool in the base's axes.
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

from benchmarks.concealed.chain import rotation_from_vector
from benchmarks.measure import DONE, Record, ended, timed, write_records
from benchmarks.residual import (
    Array,
    Fitted,
    Geometry,
    Rival,
    gaussian_process,
    geometry_alone,
    neural_network,
    ridge,
    rotations,
    stepwise,
)
from lite6jax.calibration.compiled import keep_compiled_code
from lite6jax.diagnosis.diagnose import diagnose
from lite6jax.diagnosis.document import read_model, write_document
from lite6jax.domains.pose.registration import register, register_model
from lite6jax.errors import InputError
from lite6jax.recordings import Recording, read_recording, sidecar_path
from lite6jax.storage import check_writable

OURS = "lite6jax"
FOLDS = 5
REAL = "LITE6JAX_REAL"
"""The variable that names the folder of real series."""
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
    return ended(partial(_compare, options, Path(real)))


def _compare(options: argparse.Namespace, real: Path) -> int:
    console, records = Console(highlight=False), []
    if options.json:
        check_writable(options.json, overwrite=True)
    paths = sorted(path for path in real.glob("*.csv") if sidecar_path(path).exists())
    if not paths:
        raise InputError(f"{real}: holds no recording (.csv with .yaml beside it); put the real series there")
    with console.status("…") as status:
        for title, outcomes in series(paths, options.every, not options.rivals_only, status.update):
            console.print(table(title, outcomes))
            records += [record for outcome in outcomes for record in outcome.records(title)]
    if options.json:
        write_records(options.json, records)
    return DONE


def series(
    paths: Sequence[Path], every: int, ours: bool, progress: Callable[[str], object]
) -> Iterator[tuple[str, list["Outcome"]]]:
    """A title and the outcomes: each series by itself, and from each to the next."""
    recordings = [read_recording(path) for path in paths]
    recordings = [each.select(np.arange(0, each.samples, every)) for each in recordings]
    for path, recording, after, other in zip(
        paths, recordings, [*paths[1:], None], [*recordings[1:], None], strict=True
    ):

        def said(who: str, where: str = path.name) -> object:
            return progress(f"{where}: {who}")

        outcomes = list(compare(recording, progress=said))
        elsewhere = [] if other is None else list(transfer(recording, other, progress=said))
        if ours:
            said(OURS)
            seconds, found = timed(partial(diagnose, recording))
            names = tuple(finding.effect.label for finding in found.findings)
            outcomes.append(Outcome(OURS, found.after, found.fit.terms.size, names, seconds))
            if other is not None:
                with tempfile.TemporaryDirectory() as folder:
                    model = read_model(write_document(found.to_dict(), Path(folder) / "d.json"))
                elsewhere.append(replace(outcomes[-1], errors=register_model(model, other)[1].distance))
        yield f"{path.name}, {recording.samples} rows, held-out fifths", outcomes
        if after is not None:
            yield f"from {path.name} to {after.name}, frame and tool registered anew", elsewhere


def rivals(free: bool) -> dict[str, Rival]:
    """By name."""
    return {
        "geometry alone": geometry_alone,
        "geometry and Gaussian process": gaussian_process,
        "geometry and neural network": neural_network,
        "ridge, orders 1–60": partial(ridge, free),
        "stepwise, BIC": partial(stepwise, free),
    }


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one of them makes of a recording.

    Attributes:
        subject: which.
        errors: `(sample,)` m, each row predicted by a fit of the other folds.
        parameters: of the fit of all rows, over the geometry's.
        names: of the fit of all rows.
        seconds: of all fits, the geometry's included.
    """

    subject: str
    errors: Array
    parameters: int
    names: tuple[str, ...]
    seconds: float

    def figures(self) -> dict[str, float]:
        """mm, of the errors that are there."""
        e = 1e3 * self.errors
        return {
            "RMS": float(np.sqrt(np.nanmean(e**2))),
            "p95": float(np.nanpercentile(e, 95)),
            "largest": float(np.nanmax(e)),
        }

    def told(self) -> str:
        """The names, those of one kind together."""
        kinds: dict[str, list[str]] = {}
        for name in self.names:
            kinds.setdefault(name.split(":")[0], []).append(name.split(":")[1].removeprefix("joint"))
        told = [f"{kind} {', '.join(sites)}" for kind, sites in kinds.items()]
        return "; ".join(told[:_NAMED]) + ("; …" if len(told) > _NAMED else "") or "none"

    def records(self, work: str) -> Iterator[Record]:
        """For the JSON."""
        for name, value in self.figures().items():
            yield Record(work, self.subject, f"error, {name}", value, "mm", "lower")
        yield Record(work, self.subject, "numbers", float(self.parameters), "", "lower")
        yield Record(work, self.subject, f"names: {self.told()}", float(len(self.names)), "", "higher")
        yield Record(work, self.subject, "time", self.seconds, "s", "lower")


def compare(recording: Recording, folds: int = FOLDS, progress: Callable[[str], object] = str) -> Iterator[Outcome]:
    """All rivals on one recording, by contiguous folds, and on all of it for their names."""
    held = recording.contiguous_folds(folds)
    geometries = [timed(partial(Geometry.of, recording.select(~fold))) for fold in held]
    whole = timed(partial(Geometry.of, recording))
    for name in rivals(whole[1].free):
        progress(name)
        errors, seconds = np.zeros(recording.samples), sum(s for s, _ in (*geometries, whole))
        for fold, (_, geometry) in zip(held, geometries, strict=True):
            taken, fitted = timed(partial(_fitted, geometry, name, recording.select(~fold)))
            view = geometry.view(recording.select(fold))
            assert view.missed is not None
            errors[fold] = np.linalg.norm(fitted.correct(view).shift - view.missed, axis=1)
            seconds += taken
        taken, fitted = timed(partial(_fitted, whole[1], name, recording))
        yield Outcome(name, errors, fitted.parameters, fitted.names, seconds + taken)


def _fitted(geometry: Geometry, name: str, recording: Recording) -> Fitted:
    view = geometry.view(recording)
    with threadpool_limits(1):  # small matrices: more threads would wait for each other
        return rivals(geometry.free)[name](view.rows(np.flatnonzero(view.usable)))


def transfer(recording: Recording, other: Recording, progress: Callable[[str], object] = str) -> Iterator[Outcome]:
    """Fitted to one recording, errors on another of the same arm, its sensor frame and tool registered anew."""
    taken, geometry = timed(partial(Geometry.of, recording))
    for name in rivals(geometry.free):
        progress(name)
        seconds, fitted = timed(partial(_fitted, geometry, name, recording))
        view = geometry.view(other)
        shift, turn = fitted.correct(view)
        tool = np.tile(np.eye(4), (len(shift), 1, 1))
        tool[:, :3, :3], tool[:, :3, 3] = rotation_from_vector(turn) @ view.tool[0], view.tool[1] + shift
        assert other.position is not None
        R = None if other.quaternion is None else rotations(other.quaternion)
        found = register(tool @ np.linalg.inv(geometry.after), other.position, R, view.noise)
        yield Outcome(name, found.distance, fitted.parameters, fitted.names, taken + seconds)


def table(title: str, outcomes: Sequence[Outcome]) -> Table:
    """A row each."""
    shown = Table(title=title, title_justify="left")
    for column in ("", "RMS mm", "p95 mm", "max mm", "numbers", "s", "names"):
        shown.add_column(column, justify="left" if column in ("", "names") else "right")
    for outcome in outcomes:
        figures = (f"{value:.4f}" for value in outcome.figures().values())
        shown.add_row(outcome.subject, *figures, str(outcome.parameters), f"{outcome.seconds:.0f}", outcome.told())
    return shown
