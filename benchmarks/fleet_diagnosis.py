"""Concealed fleets by the command: effects that no recording shows, odd arms, and false alarms where none is.

Every kind of fleet is drawn several times, by the generator of the concealed trials. Effects go round through the
catalogue, and a fleet counts as found where an effect of the right name, site and order is in its document.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.campaigns.judgement import share
from benchmarks.concealed import chain as chains
from benchmarks.concealed.hiding import beyond_named, detection_threshold
from benchmarks.concealed.plain_physics import OUTSIDE, Hidden, Setup, poses
from benchmarks.concealed.plans import SENSORS, Plan
from benchmarks.concealed.trials import PAYLOAD_CENTER, draw_motion, files_of, measure
from benchmarks.concealed.view import Open, View, transform
from benchmarks.measure import ROOT, Record

HALF = 0.5  # thresholds of one recording, of an effect that all arms have
_ODD = 4.0  # thresholds of an effect that one arm has and the others have not
_MIDDLE = {1: 0.0, 2: 0.0, 3: 1.8, 4: 0.0, 5: 0.0}  # rad, in the middle of what each joint does
_WIDTH = 0.4  # rad, of a bump over the position of a joint

Document = Mapping[str, Any]


@dataclass(frozen=True)
class Shared:
    """An effect that arms of a fleet have."""

    effect: Hidden  # with values of size 1; those of a wave are turned to a phase of each arm
    thresholds: float  # its size, in thresholds of one recording
    odd: int | None = None  # the only arm that has it, from 0; None where all have

    def found_in(self, document: Document) -> bool:
        """Whether a document has it with its name, site and order."""
        return any(
            (one["effect"], one["site"]) == (self.effect.name, self.effect.site)
            and all(abs(one.get(name, value) - value) < 0.5 for name, value in self.effect.fixed.items())
            for one in document["effects"]
        )


def fleet_diagnosis(
    fleets: int = 6, clean: int = 20, arms: int = 30, fewer: int = 12, rows: int = 200, seed: int = 11
) -> Iterator[Record]:
    """Shares of so many fleets of each kind and of clean ones, with 95 % intervals; `fewer` arms are in some."""
    kinds = {
        "half": (arms, "half-threshold effect in all"),
        "outside": (arms, "half-threshold bump in all"),
        "odd": (fewer, "effect in one arm"),
    }
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for kind, (count, words) in kinds.items():
            answers = []
            for number in range(fleets):
                hidden = _hidden(kind, number, count, seed)
                answers.append((hidden, _answer(folder / f"{kind}{number}", seed + number, count, rows, (hidden,))))
            yield from _shares(f"{words}, {count} recordings", _judged(kind, answers))
        documents = [_answer(folder / f"clean{i}", seed + 1000 + i, fewer, rows, ()) for i in range(clean)]
        used = [member for document in documents for member in document["recordings"] if member["used"]]
        alarms = {
            "fleets with an effect": (bool(document["effects"]) for document in documents),
            "arms said to differ": (bool(member["outlier_in"]) for member in used),
        }
        yield from _shares(f"{fewer} clean arms", alarms)


def _shares(work: str, flags: Mapping[str, Iterable[bool]]) -> Iterator[Record]:
    for metric, each in flags.items():
        found = share(each)
        said = f"{metric}, of {found.of} ({100 * found.low:.0f} to {100 * found.high:.0f} %)"
        yield Record("fleet diagnosis", work, said, 100 * found.value, "%")


def _hidden(kind: str, number: int, arms: int, seed: int) -> Shared:
    """What a fleet has."""
    rng = np.random.default_rng([seed, 3, number])
    order = float(rng.integers(20, 121))
    wave = (1.0, 0.0, order), {"order": order}
    effects = (
        Hidden("joint_compliance", "joint2", (1.0,)),
        Hidden("joint_harmonic", f"joint{rng.integers(1, 6)}", *wave),
        Hidden("joint_backlash", f"joint{rng.integers(1, 6)}", (1.0,)),
        Hidden("joint_compliance", "joint3", (1.0,)),
        Hidden("joint_coupling", "joint3", (1.0,), {"source_joint": 2}),
        Hidden("joint_harmonic", f"joint{rng.integers(1, 6)}", *wave),
    )
    effect = effects[number % len(effects)]
    if kind == "outside":
        joint = int(rng.integers(1, 6))
        fixed = {"joint": float(joint), "centre": _MIDDLE[joint] + float(rng.uniform(-0.5, 0.5))}
        return Shared(Hidden("joint_bump", f"joint{joint}", (1.0,), {**fixed, "width": _WIDTH}), HALF)
    return Shared(effect, HALF) if kind == "half" else Shared(effect, _ODD, int(rng.integers(arms)))


def _answer(folder: Path, seed: int, arms: int, rows: int, hidden: tuple[Shared, ...]) -> Document:
    """The document that the command writes."""
    write_fleet(folder, seed, arms, rows, hidden)
    out = folder.with_name(f"{folder.name}_out")
    given = ["diagnose", "--fleet", str(folder), "--out", str(out), "--quick"]
    subprocess.run([sys.executable, "-m", "lite6jax.cli", *given], cwd=ROOT, capture_output=True, check=True)
    document: Document = json.loads((out / "fleet.json").read_text())
    return document


def _judged(kind: str, answers: Sequence[tuple[Shared, Document]]) -> dict[str, Iterable[bool]]:
    """What counts of fleets of a kind, a flag each."""
    if kind == "outside":
        at_site = [
            [one["effect"] for one in document["effects"] if one["site"] == hidden.effect.site]
            for hidden, document in answers
        ]
        named = (any(one["effect"] != "unnamed" for one in document["effects"]) for _, document in answers)
        return {
            "without a name at its site": (names == ["unnamed"] for names in at_site),
            "with a name, which is wrong": named,
        }
    found = [hidden.found_in(document) for hidden, document in answers]
    if kind == "half":
        said = "recordings that do not show it alone"
        flags = [
            all(one["label"] != f"{hidden.effect.name}:{hidden.effect.site}" for one in member["found_alone"])
            for hidden, document in answers
            for member in document["recordings"]
        ]
    else:
        said, files = "that arm named, and no other", [f"arm{(hidden.odd or 0) + 1:02d}.csv" for hidden, _ in answers]
        odd = ([each["file"] for each in document["recordings"] if each["outlier_in"]] for _, document in answers)
        flags = [one == [file] for one, file in zip(odd, files, strict=True)]
    more = [len(document["effects"]) > one for one, (_, document) in zip(found, answers, strict=True)]
    return {"found and named": found, said: flags, "with another effect too": more}


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
        where = ("lite6", "tracker", False, "known", True, "as declared")
        plan = Plan(seed, arm, "single", "plain", *where, "", (), (), rows)
        sensor = transform(rng.uniform(-np.pi, np.pi, 3), rng.uniform(-2, 2, 3))
        tool = transform(rng.uniform(-0.5, 0.5, 3), np.array([0.02, -0.01, 0.06]) + rng.uniform(-0.02, 0.02, 3))
        setup, noise = Setup(actual, sensor, tool, np.array(PAYLOAD_CENTER)), SENSORS[plan.sensor][:2]
        motion = draw_motion(rng, actual, False, rows, loading=True)
        view = View(setup, Open(True, 3, False), motion, noise)  # type: ignore[arg-type]
        if not sizes:
            span = view.nuisance()
            spans = [beyond_named(view, one.effect, span) if one.effect.name in OUTSIDE else span for one in hidden]
            pairs = zip(hidden, spans, strict=True)
            sizes = [detection_threshold(view, (one.effect,), 0, each).size for one, each in pairs]
        there = []
        for one, size in zip(hidden, sizes, strict=True):
            rng.normal()  # nothing depends on it, but seeds mean the fleets that they meant
            effect = one.effect
            if effect.name == "joint_harmonic":
                phase = rng.uniform(-np.pi, np.pi)
                effect = effect.sized(np.array([np.cos(phase), np.sin(phase), *effect.values[2:]]))
            there.append(effect.scaled(size * one.thresholds if one.odd in (None, arm) else 0.0))
        seen = poses(setup, tuple(there), motion)
        files = files_of(plan, chains.lite6(), actual, motion, measure(plan, rng, setup, motion, seen)[1], motion)
        name = f"arm{arm + 1:02d}"
        said = yaml.safe_load(files["recording.yaml"])
        said["recording"]["factory_calibration"] = f"{name}_factory.yaml"
        (folder / f"{name}.csv").write_text(files["recording.csv"])
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(said, sort_keys=False))
        (folder / f"{name}_factory.yaml").write_text(files["factory.yaml"])
