"""How long a diagnosis takes: the whole command with a cold and a warm cache, calls in one process, very many rows."""

import sys
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.command import processes
from benchmarks.measure import Record, timed
from lite6jax.arms.description import load_bundled
from lite6jax.arms.factory import write_factory
from lite6jax.diagnosis.diagnose import diagnose as diagnosis_of
from lite6jax.diagnosis.document import read_model
from lite6jax.effects.effect import Effect
from lite6jax.effects.serialization import parse_effect
from lite6jax.recordings import Recording, RecordingSettings, write_recording
from lite6jax.simulation import draw_calibration, draw_sensor_frame, simulate

OURS = "lite6jax"
LITE6 = load_bundled("lite6")
TOOL = np.array([0.02, -0.01, 0.06, 0.0, 0.0, 0.0])
"""m and rad: where the measured point is on the flange, which is not known."""
TRUE = "joint_compliance:joint=2,compliance_rad_per_Nm=2e-5"
"""What the recordings hide: at most 0.3 mrad."""
TARGETS = {"cold": 10.0, "warm": 3.0, "rows": 30.0}
"""Seconds: a whole command on 400 rows with a cold and a warm compilation cache, and 12 000 rows."""


def diagnose(long: int = 12_000, repeats: int = 3) -> Iterator[Record]:
    """Seconds of the whole command, of a call in this process, and of very many rows, each over its target."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recording = hidden(folder, known=True, samples=400)
        file = write_recording(recording, folder / "recording.csv")
        ours = [sys.executable, "-m", "lite6jax.cli", "diagnose", str(file)]
        caches = [folder / f"cache{i}" for i in range(repeats)]
        for cache, used in (("cold", caches), ("warm", caches[:1] * repeats)):
            seconds, wrong = processes(ours, used, lambda path: wrong_findings(read_model(path).physics.effects))
            yield from _against("400 rows", f"lite6jax diagnose, {cache} cache", "wall time", seconds, cache, wrong)
        for call in ("first call, with compilation", "second call"):
            taken, wrong = _diagnosed(recording)
            yield Record("400 rows", OURS, call, taken, "s", "lower", wrong)
        for known in (True, False):
            taken, wrong = _diagnosed(hidden(folder, known, long))
            work = f"{long} rows, chain {'known' if known else 'unknown'}"
            yield from _against(work, OURS, "first call, with compilation", taken, "rows", wrong)


def hidden(folder: Path, known: bool, samples: int) -> Recording:
    """A static recording of positions with `TRUE` in it, frame and tool unknown; the chain is as `known`."""
    seed = 7
    kinematics = draw_calibration(LITE6, seed)
    declared = str(write_factory(kinematics, folder / "factory.yaml", overwrite=True)) if known else None
    return simulate(
        LITE6,
        settings=RecordingSettings(factory_calibration=declared),
        kinematics=kinematics,
        seed=seed,
        T_sensor_base=draw_sensor_frame(seed),
        tool=TOOL,
        tool_known=False,
        effects=[TRUE],
        samples=samples,
    )


def _diagnosed(recording: Recording) -> tuple[float, str]:
    seconds, found = timed(partial(diagnosis_of, recording))
    return seconds, wrong_findings(tuple(finding.effect for finding in found.findings))


def _against(work: str, subject: str, metric: str, seconds: float | None, target: str, wrong: str) -> Iterator[Record]:
    most = TARGETS[target]
    yield Record(work, subject, metric, seconds, "s", "lower", wrong)
    share = None if seconds is None else seconds / most
    yield Record(work, subject, f"of the {most:g} s it may take", share, "×", "lower", wrong)


def wrong_findings(found: tuple[Effect, ...]) -> str:
    """Why what was found is not `TRUE`, and nothing else; empty where it is."""
    true = parse_effect(TRUE)[0]
    return "" if found == (true,) else f"found {', '.join(each.label for each in found) or 'nothing'}, not {true.label}"
