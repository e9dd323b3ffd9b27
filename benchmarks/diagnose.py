"""The diagnosis: what it finds where nothing is missing, how long it takes, and beside refitting every candidate."""

import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import product
from math import ceil
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from benchmarks.command import processes
from benchmarks.measure import Record, timed
from benchmarks.one_by_one import Readings, refit_each
from lite6jax.arms.bundled import load_bundled
from lite6jax.arms.factory import write_factory
from lite6jax.diagnosis.diagnose import diagnose as diagnosis_of
from lite6jax.diagnosis.document import read_model
from lite6jax.diagnosis.explanation import Case, explain
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.result import Finding
from lite6jax.domains.pose.problem import PoseProblem, pose_problem
from lite6jax.effects.effect import Effect
from lite6jax.effects.serialization import parse_effect
from lite6jax.estimation.least_squares import fit, relinearise
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Term, Terms
from lite6jax.recordings import FactoryUncertainty, Recording, RecordingSettings, write_recording
from lite6jax.recordings.fault import DataFault
from lite6jax.report.data_faults import fault_statement
from lite6jax.search.state import SelectedTerm
from lite6jax.simulation import UndeclaredNoise, draw_calibration, draw_sensor_frame, perturb, simulate

OURS = "lite6jax"
LITE6 = load_bundled("lite6")
ONE_IN = 100
"""Of so many recordings with nothing missing one may show something."""
ROWS = 300
UNCERTAINTY = 5e-5
"""m and rad: one standard deviation of a calibration that is known but for that."""
TOOL = np.array([0.02, -0.01, 0.06, 0.0, 0.0, 0.0])
"""m and rad: where the measured point is on the flange where that is not known."""

Geometry = Literal["known", "uncertain", "unknown"]
NOISES: dict[str, tuple[UndeclaredNoise, UndeclaredNoise]] = {
    "as declared": (UndeclaredNoise(), UndeclaredNoise()),
    "wrong by a factor of 2": (UndeclaredNoise(factor=2.0), UndeclaredNoise(factor=0.5)),
    "correlated by 0.9": (UndeclaredNoise(correlation=0.9), UndeclaredNoise(correlation=0.9)),
    "growing with reach": (UndeclaredNoise(growth_per_m=2.0), UndeclaredNoise(growth_per_m=2.0)),
    "in the joints": (UndeclaredNoise(joint_noise=5e-5), UndeclaredNoise(joint_noise=5e-5)),
    "5 % outliers": (UndeclaredNoise(outlier_share=0.05, outlier_size=2e-3), UndeclaredNoise(outlier_share=0.05)),
}
"""What is true of the noise and the sidecar does not say, for every other round."""
MOTIONS = ("static", "trajectory")
GEOMETRIES: tuple[Geometry, ...] = ("known", "uncertain", "unknown")
SENSORS = ("tracker", "tracker_6d")

TRUE = "joint_compliance:joint=2,compliance_rad_per_Nm=2e-5"
"""What the recordings that are timed hide: at most 0.3 mrad."""
TARGETS = {"cold": 10.0, "warm": 3.0, "rows": 30.0}
"""Seconds: a whole command on 400 rows with a cold and a warm compilation cache, and 12 000 rows."""
SAME = 1.0
"""Standard deviations between what two losses, least squares and Student's t, make of the same effect."""
NAIVE = "SciPy, each candidate refitted"


class Clean(NamedTuple):
    """A recording in which nothing is missing.

    Attributes:
        seed: of the arm, the motion, the set-up and the noise.
        noise: a key of `NOISES`.
        motion: static or trajectory.
        geometry: what the sidecar says of the chain.
        sensor: positions or poses.
        mounted: whether the sensor's frame and the tool are unknown.
    """

    seed: int
    noise: str
    motion: Literal["static", "trajectory"]
    geometry: Geometry
    sensor: str
    mounted: bool

    def __str__(self) -> str:
        where = "frame and tool unknown" if self.mounted else "frame and tool known"
        return f"seed {self.seed}: noise {self.noise}, {self.motion}, chain {self.geometry}, {self.sensor}, {where}"

    def recording(self, folder: Path) -> Recording:
        """Simulated; its calibration is written into the folder."""
        undeclared = NOISES[self.noise][self.seed // _KINDS % 2]
        simulated = simulation_of(folder, self.geometry, self.seed, self.mounted)
        return simulated(motion=self.motion, samples=ROWS, sensor=self.sensor, undeclared=undeclared)


_KINDS = len(NOISES) * len(MOTIONS) * len(GEOMETRIES) * len(SENSORS)


def clean_recordings(count: int) -> Iterator[Clean]:
    """Every kind once a round, in an order drawn for the round; of every other round frame and tool are unknown."""
    kinds = list(product(NOISES, MOTIONS, GEOMETRIES, SENSORS))
    for seed in range(count):
        lap, place = divmod(seed, _KINDS)
        noise, motion, geometry, sensor = kinds[np.random.default_rng(lap).permutation(_KINDS)[place]]
        yield Clean(seed, noise, motion, geometry, sensor, lap % 2 == 1)  # type: ignore[arg-type]


def simulation_of(folder: Path, geometry: Geometry, seed: int, mounted: bool) -> Callable[..., Recording]:
    """`simulate` for an arm of its own, its sidecar saying of the chain what `geometry` says."""
    kinematics, declared, uncertainty = draw_calibration(LITE6, seed), None, None
    if geometry != "unknown":
        declared = str(folder / f"factory{seed}.yaml")
        written = kinematics
        if geometry == "uncertain":
            uncertainty = FactoryUncertainty(UNCERTAINTY, UNCERTAINTY)
            written = perturb(kinematics, UNCERTAINTY, UNCERTAINTY, seed)
        write_factory(written, declared, overwrite=True)
    declaration = RecordingSettings(factory_calibration=declared, factory_uncertainty=uncertainty)
    mount = {"T_sensor_base": draw_sensor_frame(seed), "tool": TOOL, "tool_known": False} if mounted else {}
    return partial(simulate, LITE6, settings=declaration, kinematics=kinematics, seed=seed, **mount)


def diagnose(recordings: int = 300, long: int = 12_000) -> Iterator[Record]:
    """False alarms, seconds against what they may be, and the ratio to refitting every candidate."""
    with tempfile.TemporaryDirectory() as folder:
        yield from false_alarms(recordings, Path(folder))
        yield from speed(Path(folder), long)
        for geometry in ("known", "unknown"):
            yield from raced(Path(folder), geometry)


def false_alarms(recordings: int, folder: Path) -> Iterator[Record]:
    """How many recordings in which nothing is missing show something, and which; without held-out rows, to be fast."""
    work = f"{recordings} recordings, nothing missing"
    found, faulty, seconds = Counter[str](), 0, []
    for clean in clean_recordings(recordings):
        recording = clean.recording(folder)
        taken, (terms, faults) = timed(partial(searched, recording))
        seconds.append(taken)
        found[clean.noise] += bool(terms)
        faulty += bool(faults)
        for tested in terms:
            yield Record("false alarm", str(clean), _named(tested.term), tested.p_value, "p", "higher")
        for fault in faults:
            yield Record("false alarm", str(clean), f"{fault.code}: {fault_statement(fault)}", None, "", "higher")
    most, total = ceil(recordings / ONE_IN), found.total()
    wrong = f"{total} of {recordings} show something, more than {most}" if total > most else ""
    yield Record(work, OURS, "with a finding", float(total), "", "lower", wrong)
    for noise in NOISES:
        yield Record(work, OURS, f"— noise {noise}", float(found[noise]), "", "lower")
    wrong = f"{faulty} of {recordings} have a fault, more than {most}" if faulty > most else ""
    yield Record(work, OURS, "with a fault of the data, other than outliers", float(faulty), "", "lower", wrong)
    yield Record(work, OURS, "examined and searched, median", float(np.median(seconds)), "s", "lower")


def searched(recording: Recording) -> tuple[tuple[SelectedTerm, ...], tuple[DataFault, ...]]:
    """What screening and search of a recording find: effects, and faults of the data."""
    explanation = explain(Case(recording, None, "declared", Options()))
    return explanation.selection.state.tested, explanation.screened.found


def hidden(folder: Path, geometry: Geometry, samples: int) -> Recording:
    """A static recording of positions with `TRUE` in it, the sensor's frame and the tool unknown."""
    simulated = simulation_of(folder, geometry, 7, mounted=True)
    return simulated(effects=[TRUE], samples=samples)


def speed(folder: Path, long: int = 12_000, repeats: int = 3) -> Iterator[Record]:
    """Seconds of the whole command, of a call in this process, and of very many rows, each over its target."""
    recording = hidden(folder, "known", 400)
    file = write_recording(recording, folder / "recording.csv")
    ours = [sys.executable, "-m", "lite6jax.cli", "diagnose", str(file)]
    caches = [folder / f"cache{i}" for i in range(repeats)]
    for cache, used in (("cold", caches), ("warm", caches[:1] * repeats)):
        seconds, wrong = processes(ours, used, wrong_document)
        yield from _against("400 rows", f"lite6jax diagnose, {cache} cache", "wall time", seconds, cache, wrong)

    first, _ = timed(partial(diagnosis_of, recording))
    yield Record("400 rows", OURS, "first call, with compilation", first, "s", "lower")
    second, found = timed(partial(diagnosis_of, recording))
    yield Record("400 rows", OURS, "second call", second, "s", "lower", wrong_findings(found.findings))
    for geometry in ("known", "unknown"):
        rows = hidden(folder, geometry, long)
        seconds, found = timed(partial(diagnosis_of, rows))
        work, wrong = f"{long} rows, chain {geometry}", wrong_findings(found.findings)
        yield from _against(work, OURS, "first call, with compilation", seconds, "rows", wrong)


def _against(work: str, subject: str, metric: str, seconds: float | None, target: str, wrong: str) -> Iterator[Record]:
    most = TARGETS[target]
    yield Record(work, subject, metric, seconds, "s", "lower", wrong)
    share = None if seconds is None else seconds / most
    yield Record(work, subject, f"of the {most:g} s it may take", share, "×", "lower", wrong)


def wrong_document(path: Path) -> str:
    """Why a diagnosis' JSON file does not say `TRUE`, and nothing else; empty where it does."""
    return _wrong(read_model(path).physics.effects)


def wrong_findings(findings: Sequence[Finding]) -> str:
    """Why what was found is not `TRUE`; empty where it is."""
    return _wrong(tuple(finding.effect for finding in findings))


def _wrong(found: tuple[Effect, ...]) -> str:
    true = parse_effect(TRUE)[0]
    return "" if found == (true,) else f"found {' and '.join(map(_named, found)) or 'nothing'}, not {_named(true)}"


def _named(effect: Term) -> str:
    order = getattr(effect, "order", None)
    return effect.label if order is None else f"{effect.label}, order {order:g}"


class Best(NamedTuple):
    """The candidate that explains the most for its numbers, what it is fitted to be and one standard deviation."""

    effect: Effect
    value: np.ndarray
    std: np.ndarray


def raced(folder: Path, geometry: Geometry, repeats: int = 3) -> Iterator[Record]:
    """One score of all candidates and a refit of the best, against a refit of each: both shall put `TRUE` first."""
    recording = hidden(folder, geometry, 400)
    true, _ = parse_effect(TRUE)
    problem = pose_problem(recording)
    candidates = problem.candidates
    readings = readings_of(problem, geometry)
    first, _ = timed(partial(scored, recording))
    runs = [timed(partial(scored, recording)) for _ in range(repeats)]
    seconds, best = float(np.median([taken for taken, _ in runs])), runs[-1][1]
    taken, (theirs, value) = timed(partial(refitted, readings, candidates))

    wrong = "" if best.effect == true else f"puts {_named(best.effect)} first"
    rival_wrong = "" if theirs == true else f"puts {_named(theirs)} first"
    if not wrong and not rival_wrong and (np.abs(best.value - value) > SAME * best.std).any():
        rival_wrong = f"{value} and {best.value} differ by more than {SAME:g} of {best.std}"
    work = f"{len(candidates)} candidates, chain {geometry}"
    yield Record(work, OURS, "first call, with compilation", first, "s", "lower", wrong)
    yield Record(work, OURS, "all scored, the best refitted", seconds, "s", "lower", wrong)
    yield Record(work, NAIVE, "all refitted", taken, "s", "lower", rival_wrong)
    yield Record(work, OURS, f"faster than {NAIVE}", taken / seconds, "×", "higher", wrong or rival_wrong)


def scored(recording: Recording) -> Best:
    """Of the named candidates, from the recording on: problem, nuisance, scores, refit."""
    options = Options().engine
    problem = relinearise(pose_problem(recording), options)
    alone = fit(problem, Terms(), options)
    test = score_test(problem, alone, options)
    scores = test.score(problem.candidates)
    cost = 0.5 * np.log(test.freedom)
    worth = [-np.inf if score.confounded else score.gain - cost * score.size for score in scores]
    k = int(np.argmax(worth))
    best = problem.candidates[k]
    fitted = fit(problem, Terms((best,)), options, scores[k].values, alone.nuisance)
    return Best(best, fitted.values, np.sqrt(np.diagonal(fitted.covariance)))


def refitted(readings: Readings, candidates: tuple[Effect, ...]) -> tuple[Effect, np.ndarray]:
    """The same by `one_by_one`, from the readings on: the first, and what it is fitted to be."""
    refits = refit_each(readings, candidates)
    cost = 0.5 * np.log(readings.position.size)
    k = int(np.argmax([each.gain - cost * effect.size for each, effect in zip(refits, candidates, strict=True)]))
    return candidates[k], refits[k].values


def readings_of(problem: PoseProblem, geometry: Geometry) -> Readings:
    """A static recording of positions for `one_by_one`, which starts where the library does."""
    recording, arm, start = problem.recording, problem.arm, problem.start
    assert recording.position is not None
    assert recording.time is not None
    assert arm.mass is not None
    assert arm.center_of_mass is not None
    return Readings(
        recording.joint_position, np.asarray(recording.direction_of_motion), recording.time, recording.position,
        problem.noise[0], np.asarray(start.geometry).reshape(-1, 6), np.asarray(start.T_sensor_base),
        np.asarray(start.T_flange_tool), geometry == "known", arm.mass, arm.center_of_mass,
    )  # fmt: skip
