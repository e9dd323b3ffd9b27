"""Concealed fleets by the command: effects that no recording shows, odd arms, and false alarms where none is.

Every kind of fleet is drawn several times. Effects go round through the catalogue, and a fleet counts as found where an
effect of the right name, site and order is in its document.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.campaigns.shares import Share, share
from benchmarks.concealed.fleets import Shared, write_fleet
from benchmarks.concealed.plain_physics import Hidden
from benchmarks.measure import ROOT, Record

HALF = 0.5
"""Thresholds of one recording, of an effect that all arms have."""
_ODD = 4.0
"""Thresholds of an effect that one arm has and the others have not."""
_MIDDLE = {1: 0.0, 2: 0.0, 3: 1.8, 4: 0.0, 5: 0.0}
"""rad, in the middle of what each joint does."""
_WIDTH = 0.4
"""rad, of a bump over the position of a joint."""


def fleet_diagnosis(
    fleets: int = 6, clean: int = 20, arms: int = 30, fewer: int = 12, rows: int = 200, seed: int = 11
) -> Iterator[Record]:
    """Shares of so many fleets of each kind and of clean ones, with 95 % intervals; `fewer` arms are in some."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for kind, count in (("half", arms), ("outside", arms), ("odd", fewer)):
            answers = []
            for number in range(fleets):
                hidden = _hidden(kind, number, count, seed)
                place = folder / f"{kind}{number}"
                answers.append((hidden, _answer(place, seed + number, count, rows, (hidden,))))
            yield from _judged(kind, f"{count} recordings", answers)
        documents = [_answer(folder / f"clean{i}", seed + 1000 + i, fewer, rows, ()) for i in range(clean)]
        work = f"{fewer} clean arms"
        alarms = share(bool(document["effects"]) for document in documents)
        yield _record(work, "fleets with an effect", alarms, "lower")
        said = share(
            bool(member["outlier_in"]) for document in documents for member in document["recordings"] if member["used"]
        )
        yield _record(work, "arms said to differ", said, "lower")


def _hidden(kind: str, number: int, arms: int, seed: int) -> Shared:
    """What a fleet has."""
    rng = np.random.default_rng([seed, 3, number])
    order = float(rng.integers(20, 121))
    effects = (
        Hidden("joint_compliance", "joint2", (1.0,)),
        Hidden("joint_harmonic", f"joint{rng.integers(1, 6)}", (1.0, 0.0, order), {"order": order}),
        Hidden("joint_backlash", f"joint{rng.integers(1, 6)}", (1.0,)),
        Hidden("joint_compliance", "joint3", (1.0,)),
        Hidden("joint_coupling", "joint3", (1.0,), {"source_joint": 2}),
        Hidden("joint_harmonic", f"joint{rng.integers(1, 6)}", (1.0, 0.0, order), {"order": order}),
    )
    effect = effects[number % len(effects)]
    if kind == "outside":
        joint = int(rng.integers(1, 6))
        fixed = {"joint": float(joint), "centre": _MIDDLE[joint] + float(rng.uniform(-0.5, 0.5))}
        return Shared(Hidden("joint_bump", f"joint{joint}", (1.0,), {**fixed, "width": _WIDTH}), HALF)
    if kind == "half":
        return Shared(effect, HALF)
    return Shared(effect, 0.0, odd=((int(rng.integers(arms)), _ODD),))


def _answer(folder: Path, seed: int, arms: int, rows: int, hidden: tuple[Shared, ...]) -> dict[str, Any]:
    """The document that the command writes."""
    write_fleet(folder, seed, arms, rows, hidden)
    out = folder.with_name(f"{folder.name}_out")
    given = ["diagnose", "--fleet", str(folder), "--out", str(out), "--quick"]
    done = subprocess.run([sys.executable, "-m", "lite6jax.cli", *given], cwd=ROOT, capture_output=True)
    if done.returncode:
        raise RuntimeError(done.stderr.decode())
    document: dict[str, Any] = json.loads((out / "fleet.json").read_text())
    return document


def _judged(kind: str, work: str, answers: list[tuple[Shared, dict[str, Any]]]) -> Iterator[Record]:
    names = {
        "half": "half-threshold effect in all",
        "outside": "half-threshold bump in all",
        "odd": "effect in one arm",
    }
    subject = f"{names[kind]}, {work}"
    found = [_found(hidden, document) for hidden, document in answers]
    if kind == "outside":
        there = [
            [one["effect"] for one in document["effects"] if one["site"] == hidden.effect.site]
            for hidden, document in answers
        ]
        yield _record(subject, "without a name at its site", share(one == ["unnamed"] for one in there), "higher")
        wrong = share(any(one["effect"] != "unnamed" for one in document["effects"]) for _, document in answers)
        yield _record(subject, "with a name, which is wrong", wrong, "lower")
        return
    yield _record(subject, "found and named", share(one is not None for one in found), "higher")
    if kind == "half":
        silent = share(
            not any(_is(hidden, label) for label in _labels(member))
            for hidden, document in answers
            for member in document["recordings"]
        )
        yield _record(subject, "recordings that do not show it alone", silent, "higher")
    if kind == "odd":
        right = share(_outliers(document) == [f"arm{hidden.odd[0][0] + 1:02d}.csv"] for hidden, document in answers)
        yield _record(subject, "that arm named, and no other", right, "higher")
    further = share(
        len(document["effects"]) > (one is not None) for one, (_, document) in zip(found, answers, strict=True)
    )
    yield _record(subject, "with another effect too", further, "lower")


def _found(hidden: Shared, document: Mapping[str, Any]) -> dict[str, Any] | None:
    effect = hidden.effect
    for one in document["effects"]:
        if (one["effect"], one["site"]) != (effect.name, effect.site):
            continue
        if all(abs(one.get(name, value) - value) < 0.5 for name, value in effect.fixed.items()):
            return dict(one)
    return None


def _is(hidden: Shared, label: str) -> bool:
    return label == f"{hidden.effect.name}:{hidden.effect.site}"


def _labels(member: Mapping[str, Any]) -> list[str]:
    return [one["label"] for one in member["found_alone"]]


def _outliers(document: Mapping[str, Any]) -> list[str]:
    return [member["file"] for member in document["recordings"] if member["outlier_in"]]


def _record(work: str, metric: str, found: Share, better: Any) -> Record:
    said = f"{metric}, of {found.of} ({100 * found.low:.0f} to {100 * found.high:.0f} %)"
    return Record("fleet diagnosis", work, said, 100 * found.value, "%", better)
