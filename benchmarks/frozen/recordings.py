"""Which recordings are frozen, where each comes from, and the commands that diagnose it.

A recording is a file of `../shared`, or is drawn again from a seed. None of them is stored.
"""

import hashlib
import shlex
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import yaml

from benchmarks.campaigns.campaign import write_files
from benchmarks.campaigns.rounds import Kind, Trial, first_made
from benchmarks.concealed.plain_physics import Hidden
from benchmarks.concealed.plans import READERS
from benchmarks.concealed.trials import draw, draw_reading
from benchmarks.fleet_diagnosis import HALF, Shared, write_fleet
from benchmarks.measure import ROOT
from benchmarks.torque_trials.trials import draw as draw_torques
from benchmarks.tracking_trials.plans import Plan
from benchmarks.tracking_trials.trials import make_trial

SHARED = ROOT.parent / "shared"
SEED = 67
"""Of all trials and fleets that are drawn."""
DOCUMENT = "frozen.json"
"""What the last command writes, in the folder in which it runs."""
FLEET = "frozen"
"""The folder that the diagnosis of a fleet writes."""
_DIAGNOSE = ("--quick", "--processes", "1", "--force", "--out")
"""Two held-out blocks: all parts of a diagnosis run, in 60 % of the time. One process, so that sums have one order."""


@dataclass(frozen=True)
class Frozen:
    """A recording, and how it is diagnosed."""

    name: str  # `kind/recording`
    prepare: Callable[[Path], Sequence[Sequence[str]]]  # writes its files into a folder; the commands to run there
    source: Path | None = None  # what must exist, a file or folder of `../shared`; None where all is drawn
    real: bool = False  # measured on a real arm: only the numbers of its findings are stored
    quick: bool = False  # whether it is among the few that `--quick` compares

    @property
    def kind(self) -> str:
        """The first part of the name."""
        return self.name.partition("/")[0]


def list_frozen() -> list[Frozen]:
    """All of them, in an order in which every kind comes early."""
    return [*_in_folders(), *_touched(), *_ur10(), *_cases(), *_trials(), *_fleets()]


def digest_folder(folder: Path) -> str:
    """The SHA-256 of all files of a folder with their names: another recording is no difference of the tree."""
    digest = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        digest.update(f"{path.relative_to(folder).as_posix()}\0".encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


# ------------------------------------------------------------------ files of ../shared

_QUICK = {
    *("concealed/o01_null_factory", "concealed/o02_compliance_j2", "concealed/o08_bump_j3_unnamed"),
    *("frontier/b3_40poses_comp_free", "frontier/q2_flank_narrow_then_far", "sensors/s05_distance_harmonic_j2"),
    *("sensors/s06_height_compliance_j2", "dynamics/t02_viscous_j2", "touch/panda_1_front", "cases/o05"),
    *("cases/T08", "trials/0", "readings/contact", "torque_trials/0"),
    "tracking/delay_friction",
}
_FOLDERS = {
    "concealed": "concealed/open",
    "frontier": "concealed/frontier",
    "frontier2": "concealed/frontier2",
    "sensors": "sensors/open",
    "dynamics": "dynamics/open",
}
"""Kinds of simulated recordings with a folder each, in which `recording.csv` stands."""
_TOUCHED = (
    *("panda_1_front", "panda_1_right", "panda_2_front_center", "panda_2_back_left", "panda_2_mid_high"),
    *("panda_4_front", "panda_4_very_front", "kuka_14_front", "panda_1_front panda_1_back_high"),
)
"""Recordings of touches; two names are two files of one arm."""
_EVERY = 5  # the rows of UR10 B that are taken
_REAL_CASES = ("o01",)  # cases whose recordings are real


def _in_folders() -> Iterator[Frozen]:
    for kind, place in _FOLDERS.items():
        for folder in sorted(path for path in (SHARED / place).glob("*") if path.is_dir()):
            name = f"{kind}/{folder.name}"
            yield Frozen(name, partial(_copy_given, folder), folder, quick=name in _QUICK)


def _copy_given(source: Path, folder: Path) -> Sequence[Sequence[str]]:
    for path in source.iterdir():
        if path.stem.partition("_")[0] not in ("truth", "unseen"):
            shutil.copy(path, folder)
    return [_diagnose("recording.csv")]


def _diagnose(*files: str) -> list[str]:
    return ["diagnose", *files, *_DIAGNOSE, DOCUMENT]


def _touched() -> Iterator[Frozen]:
    source = SHARED / "real" / "touch"
    for names in _TOUCHED:
        name = f"touch/{names.replace(' ', '+')}"
        yield Frozen(name, partial(_copy_touched, source, names.split()), source, real=True, quick=name in _QUICK)


def _copy_touched(source: Path, names: Sequence[str], folder: Path) -> Sequence[Sequence[str]]:
    for name in names:
        settings = source / f"{name}.yaml"
        shutil.copy(settings, folder)
        shutil.copy(source / f"{name}.csv", folder)
        shutil.copy(source / yaml.safe_load(settings.read_text())["recording"]["arm"], folder)
    return [_diagnose(*(f"{name}.csv" for name in names))]


def _ur10() -> Iterator[Frozen]:
    source = SHARED / "real" / "ur10"
    yield Frozen("ur10/series_b", partial(_shorten_ur10, source), source, real=True)


def _shorten_ur10(source: Path, folder: Path) -> Sequence[Sequence[str]]:
    lines = (source / "ur10_series_b.csv").read_text().splitlines(keepends=True)
    head = next(place for place, line in enumerate(lines) if not line.startswith("#"))
    (folder / "recording.csv").write_text("".join([*lines[: head + 1], *lines[head + 1 :: _EVERY]]))
    shutil.copy(source / "ur10_series_b.yaml", folder / "recording.yaml")
    shutil.copy(source / "ur10.yaml", folder)
    return [_diagnose("recording.csv")]


def _cases() -> Iterator[Frozen]:
    """Cases of `cases/` that end in a diagnosis: what `init` asks and writes is a part of them."""
    for listed in sorted((SHARED / "cases").glob("*/cases.yaml")):
        for title, case in yaml.safe_load(listed.read_text()).items():
            words = [shlex.split(step["run"])[1:] for step in case["steps"]]
            commands = [command for command in words if command[0] in ("init", "diagnose")]
            if not commands or commands[-1][0] != "diagnose":
                continue
            short = title.partition("_")[0]
            folders = (path for path in listed.parent.iterdir() if path.is_dir())
            source = next(path for path in sorted(folders) if path.name.partition("_")[0] == short)
            also = [listed.parent / extra for extra in case.get("also", ())]
            prepare = partial(_copy_case, source, also, commands)
            name = f"cases/{short}"
            yield Frozen(name, prepare, source, real=short in _REAL_CASES, quick=name in _QUICK)


def _copy_case(
    source: Path, also: Sequence[Path], commands: Sequence[Sequence[str]], folder: Path
) -> Sequence[Sequence[str]]:
    shutil.copytree(source, folder, dirs_exist_ok=True)
    for extra in also:
        shutil.copy(extra, folder)
    *before, last = commands
    asked = ("--quick", "--out", "d.json")
    return [*before, [*(word for word in last if word not in asked), *_DIAGNOSE, DOCUMENT]]


# ------------------------------------------------------------------ drawn by the generators of the trials

_TRIALS, _TORQUE_TRIALS = 12, 6
"""So many of each, the first of the seed: clean ones, singles, mixtures, what is outside and at the edge, faults."""
_ARMS, _ROWS = 5, 120
_FLEETS: dict[str, tuple[Shared, ...]] = {
    "clean": (),
    "compliance": (Shared(Hidden("joint_compliance", "joint2", (1.0,)), 2 * HALF),),
}
"""Fleets by name, and what all of their arms have."""
_FOLLOWING: dict[str, tuple[Kind, str, tuple[str, ...], tuple[float, ...]]] = {
    "clean": ("clean", "declared", (), ()),
    "delay_friction": ("mixture", "declared", ("command_delay", "coulomb_friction"), (20.0, 20.0)),
    "unnamed_torque": ("outside", "declared", ("cable_drag",), (20.0,)),
    "unknown_servo": ("single", "unknown", ("command_delay",), (20.0,)),
}
"""Logs of commands by name: kind, whether the servos are declared, and effects with their sizes in thresholds."""
_LOG_ROWS = 200
"""Of each of two runs: a diagnosis of three joints takes seconds."""


def _trials() -> Iterator[Frozen]:
    for index in range(_TRIALS):
        yield _trial(f"trials/{index}", partial(draw, SEED, index))
    for sensor in READERS:
        yield _trial(f"readings/{sensor}", partial(draw_reading, sensor, SEED, 0))
    for index in range(_TORQUE_TRIALS):
        yield _trial(f"torque_trials/{index}", partial(draw_torques, SEED, index))
    for index, name in enumerate(_FOLLOWING):
        yield _trial(f"tracking/{name}", partial(_draw_log, index, name))


def _draw_log(index: int, name: str) -> Trial:
    """A short log of commands of a small arm."""
    kind, servo, effects, sizes = _FOLLOWING[name]
    plan = Plan(
        seed=SEED,
        index=index,
        kind=kind,
        engine="plain",
        arm="serial3",
        servo=servo,
        noise="white",
        sigma=1e-4,
        quantum=0.0,
        rate=100.0,
        samples=_LOG_ROWS,
        motions=("multisine", "trapezoids"),
        unseen="chirp",
        effects=effects,
        sizes=sizes,
    )
    return first_made(lambda rng: make_trial(plan, rng), SEED, 40, index)


def _trial(name: str, drawn: Callable[[], Trial]) -> Frozen:
    return Frozen(name, partial(_write_trial, drawn), quick=name in _QUICK)


def _write_trial(drawn: Callable[[], Trial], folder: Path) -> Sequence[Sequence[str]]:
    files = {name: text for name, text in drawn().files.items() if name != "unseen.csv"}
    write_files(files, folder)
    return [_diagnose("recording.csv")]


def _fleets() -> Iterator[Frozen]:
    for name, hidden in _FLEETS.items():
        yield Frozen(f"fleets/{name}", partial(_write_fleet, hidden))


def _write_fleet(hidden: tuple[Shared, ...], folder: Path) -> Sequence[Sequence[str]]:
    write_fleet(folder / "arms", SEED, _ARMS, _ROWS, hidden)
    return [["diagnose", "--fleet", "arms", *_DIAGNOSE, FLEET]]
