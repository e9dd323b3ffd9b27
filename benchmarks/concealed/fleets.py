"""Concealed fleets: recordings of many arms of one type, or of one arm over time, that share what is hidden in them.

Made of the generator of the concealed trials, which shares no code with the library.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from benchmarks.concealed import chain as chains
from benchmarks.concealed.hiding import beyond_named
from benchmarks.concealed.information import threshold
from benchmarks.concealed.plain_physics import OUTSIDE, Hidden, Setup, poses
from benchmarks.concealed.plans import SENSORS, Plan
from benchmarks.concealed.recorded import PAYLOAD_CENTER, draw_motion, files_of, measure
from benchmarks.concealed.view import Open, View, turned


@dataclass(frozen=True)
class Shared:
    """An effect that arms of a fleet have.

    Attributes:
        effect: with values of size 1; those of a wave are turned to a phase of each arm.
        thresholds: its mean size, in thresholds of one recording.
        spread: the relative standard deviation of its size between arms.
        odd: arms in which it has other sizes, in thresholds.
    """

    effect: Hidden
    thresholds: float
    spread: float = 0.0
    odd: tuple[tuple[int, float], ...] = ()

    def sized(self, arm: int) -> float:
        """The size in one arm in thresholds, but for its spread."""
        return dict(self.odd).get(arm, self.thresholds)


def write_fleet(folder: Path, seed: int, arms: int, rows: int, hidden: Sequence[Shared]) -> None:
    """Writes the recordings of a fleet: `armNN.csv` with sidecar and factory calibration.

    The arms are at rest before a laser tracker whose frame and target are unknown. A threshold is that of the effect in
    the recording of the first arm, so that all arms share a physical size; of one outside the catalogue, that of what
    the nearest named effect of its site leaves of it.
    """
    folder.mkdir()
    sizes: list[float] = []
    for arm in range(arms):
        rng = np.random.default_rng([seed, 2, arm])
        actual = chains.lite6().moved(rng, *chains.MADE)
        plan = Plan(
            seed, arm, "single", "plain", "lite6", "tracker", False, "known", True, "as declared", "", (), (), rows
        )
        sensor = turned(rng.uniform(-np.pi, np.pi, 3), rng.uniform(-2, 2, 3))
        tool = turned(rng.uniform(-0.5, 0.5, 3), np.array([0.02, -0.01, 0.06]) + rng.uniform(-0.02, 0.02, 3))
        setup, noise = Setup(actual, sensor, tool, np.array(PAYLOAD_CENTER)), SENSORS[plan.sensor][:2]
        motion = draw_motion(rng, actual, False, rows, loading=True)
        view = View(setup, Open(True, 3, False), motion, noise)  # type: ignore[arg-type]
        if not sizes:
            span = view.nuisance()
            spans = [beyond_named(view, one.effect, span) if one.effect.name in OUTSIDE else span for one in hidden]
            sizes = [threshold(view, (one.effect,), 0, each).size for one, each in zip(hidden, spans, strict=True)]
        there = []
        for one, size in zip(hidden, sizes, strict=True):
            factor = one.sized(arm) * (1 + one.spread * rng.normal()) * size
            effect = one.effect
            if effect.name == "joint_harmonic":
                phase = rng.uniform(-np.pi, np.pi)
                effect = effect.sized(np.array([np.cos(phase), np.sin(phase), *effect.values[2:]]))
            there.append(effect.scaled(factor))
        seen = poses(setup, tuple(there), motion)
        measured, q, _, _ = measure(plan, rng, setup, motion, seen)
        files = files_of(plan, chains.lite6(), actual, motion, measured, q, noise, motion)
        name = f"arm{arm + 1:02d}"
        said = yaml.safe_load(files["recording.yaml"])
        said["recording"]["factory_calibration"] = f"{name}_factory.yaml"
        (folder / f"{name}.csv").write_text(files["recording.csv"])
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(said, sort_keys=False))
        (folder / f"{name}_factory.yaml").write_text(files["factory.yaml"])
