"""Whole commands as the shell sees them: a fit beside the seed's script, a folder of factory files, a diagnosis.

And a recording: ten minutes at 250 Hz, in real time and as fast as it goes; what is lost, what doubled, what it costs.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np
import yaml

from benchmarks import seed_way
from benchmarks.fits import chain_error, simulated_arms
from benchmarks.measure import OURS, ROOT, Record, disagreement, time_call
from lite6jax.arms.description import load_bundled
from lite6jax.arms.factory import write_factory
from lite6jax.controller.connection import Address
from lite6jax.controller.recorder import LiveRecording, record
from lite6jax.controller.station import read_station
from lite6jax.diagnosis.diagnose import diagnose_poses
from lite6jax.diagnosis.document import read_model
from lite6jax.effects.effect import Effect
from lite6jax.effects.serialization import parse_effect
from lite6jax.emulator import Controller, EmulatedArm, draw_sines
from lite6jax.recordings import Recording, RecordingSettings, read_recording, write_recording
from lite6jax.simulation import draw_calibration, draw_sensor_frame, simulate

RATE_HZ, PERIOD_US = 250, 4000
HOST, PORT = "127.0.0.99", 15099
SPEED = 200.0
COMMAND = [sys.executable, "-m", "lite6jax.cli"]
EXACT = 1e-13  # m, and of a rotation's entries: the 1e-10 mm to which a fit reproduces a calibration
LITE6 = load_bundled("lite6")
TRUE = "joint_compliance:joint=2,compliance_rad_per_Nm=2e-5"
"""What the recordings of a diagnosis hide: at most 0.3 mrad."""
TARGETS = {"cold": 10.0, "warm": 3.0, "rows": 30.0}
"""Seconds: a whole command on 400 rows with a cold and a warm compilation cache, and 12 000 rows."""


def run_processes(arguments: list[str], caches: list[Path], check: Callable[[Path], str]) -> tuple[float | None, str]:
    """Median seconds of one process for each cache folder, and why an answer is wrong.

    Args:
        arguments: to which `--out FILE` is added.
        caches: where the compiled code of each is kept.
        check: of the file that it wrote; empty where the answer is right.
    """
    seconds, wrong = [], ""
    for cache in caches:
        cache.mkdir(exist_ok=True)
        out = cache / f"{len(list(cache.iterdir()))}.json"
        # the user's cache folder, below which the compiled code is kept
        environment = {**os.environ, "XDG_CACHE_HOME": str(cache)}
        environment.pop("JAX_COMPILATION_CACHE_DIR", None)
        call = partial(subprocess.run, [*arguments, "--out", str(out)], cwd=ROOT, env=environment)
        taken, run = time_call(partial(call, capture_output=True, text=True))
        if run.returncode:
            return None, (run.stderr.strip().splitlines() or [f"exit code {run.returncode}"])[-1]
        seconds.append(taken)
        wrong = wrong or check(out)
    return median(seconds), wrong


def _share(seconds: float | None, of: float | None) -> float | None:
    return None if seconds is None or of is None else seconds / of


def command(repeats: int = 3) -> Iterator[Record]:
    """Median wall seconds of each process: start, imports, fit, table, check on 1000 fresh samples."""
    kinematics = simulated_arms(1, seed=4)[0]
    with tempfile.TemporaryDirectory() as folder:
        calibration = write_factory(kinematics, Path(folder, "lite6_calibration.yaml"))
        caches = [Path(folder, f"cache{i}") for i in range(repeats)]
        check = partial(wrong_table, kinematics=kinematics)
        base, wrong = run_processes([sys.executable, seed_way.__file__, str(calibration)], caches, check)
        yield Record("command", "seed's way", "wall time", base, "s", wrong)
        for cache, used in (("cold", caches), ("warm", caches[:1] * repeats)):
            seconds, wrong = run_processes([*COMMAND, "fit", str(calibration)], used, check)
            subject = f"lite6jax fit, {cache} cache"
            yield Record("command", subject, "wall time", seconds, "s", wrong)
            yield Record("command", subject, "of the seed's way", _share(seconds, base), "×", wrong)


def wrong_table(path: Path, kinematics: np.ndarray) -> str:
    """Why a JSON table of the seed's form is not the chain `(6, 6)`; empty where it is."""
    table = json.loads(path.read_text())
    degree = np.pi / 180
    base = [table["base"][key] for key in ("x", "y", "roll", "pitch")] * np.array([1e-3, 1e-3, degree, degree])
    rows = [[row[key] for key in ("theta_off", "d", "a", "alpha")] for row in table["dh"]]
    dh = np.array(rows) * [degree, 1e-3, 1e-3, degree]
    parameters = np.concatenate([base, np.delete(dh.ravel(), seed_way.D2), [np.deg2rad(table["beta_joint2"])]])
    fresh = seed_way.sample_joints(1000, np.random.default_rng(5))
    return disagreement(np.array(chain_error(kinematics[None], parameters[None], fresh)), 0.0, EXACT, "flange poses")


def folders(files: int = 3000, repeats: int = 3) -> Iterator[Record]:
    """Least wall seconds of `fleet` on a folder of factory files, with one process and with two.

    Both are to write the same bytes. Beside it, PyYAML's C loader parses the files on one core.
    """
    work = f"{files} factory files"
    with tempfile.TemporaryDirectory() as name:
        arms = Path(name, "arms")
        arms.mkdir()
        for i, kinematics in enumerate(simulated_arms(files, seed=6)):
            write_factory(kinematics, arms / f"arm{i:06d}.yaml")

        def loaded() -> None:
            for path in sorted(arms.iterdir()):
                yaml.load(path.read_bytes(), Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))

        def fleet(out: Path, processes: int) -> float:
            given = ["fleet", str(arms), "--out", str(out), "--force", "--processes", str(processes)]
            return time_call(partial(subprocess.run, [*COMMAND, *given], cwd=ROOT, capture_output=True, check=True))[0]

        loader = min(time_call(loaded)[0] for _ in range(repeats))
        yield Record(work, "PyYAML's C loader", "wall time", loader, "s")
        fleet(Path(name, "warm.parquet"), 2)
        taken, tables = [], []
        for processes in (1, 2):
            out = Path(name, f"{processes}.parquet")
            taken.append(min(fleet(out, processes) for _ in range(repeats)))
            tables.append(out.read_bytes())
        wrong = "" if tables[0] == tables[1] else "two processes write other bytes than one"
        for processes, seconds in enumerate(taken, 1):
            yield Record(work, f"fleet, processes {processes}", "wall time", seconds, "s", wrong)
        yield Record(work, "fleet, processes 2", "of the C loader's time", taken[1] / loader, "×")
        yield Record(work, "fleet, processes 2", "faster than one", taken[0] / taken[1], "×")
        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**10
        yield Record(work, "fleet", "largest process", peak, "MiB")


def diagnose(long: int = 12_000, repeats: int = 3) -> Iterator[Record]:
    """Seconds of the whole command, of a call in this process, and of very many rows, each over its target."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recording = hidden(folder, known=True, samples=400)
        file = write_recording(recording, folder / "recording.csv")
        caches = [folder / f"cache{i}" for i in range(repeats)]

        def check(path: Path) -> str:
            return wrong_findings(read_model(path, domain="poses").physics.effects)

        for cache, used in (("cold", caches), ("warm", caches[:1] * repeats)):
            seconds, wrong = run_processes([*COMMAND, "diagnose", str(file)], used, check)
            yield from _against("400 rows", f"lite6jax diagnose, {cache} cache", seconds, cache, wrong)
        for known in (True, False):
            seconds, found = time_call(partial(diagnose_poses, hidden(folder, known, long)))
            work = f"{long} rows, chain {'known' if known else 'unknown'}"
            wrong = wrong_findings(tuple(finding.effect for finding in found.findings))
            yield from _against(work, OURS, seconds, "rows", wrong)


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
        tool=np.array([0.02, -0.01, 0.06, 0.0, 0.0, 0.0]),
        tool_known=False,
        effects=[TRUE],
        samples=samples,
    )


def _against(work: str, subject: str, seconds: float | None, target: str, wrong: str) -> Iterator[Record]:
    most = TARGETS[target]
    yield Record(work, subject, "wall time", seconds, "s", wrong)
    yield Record(work, subject, f"of the {most:g} s it may take", _share(seconds, most), "×", wrong)


def wrong_findings(found: tuple[Effect, ...]) -> str:
    """Why what was found is not `TRUE`, and nothing else; empty where it is."""
    true = parse_effect(TRUE)[0]
    return "" if found == (true,) else f"found {', '.join(each.label for each in found) or 'nothing'}, not {true.label}"


# ------------------------------------------------------------------ a recording as long as a motion


def soak(seconds: float = 600.0) -> Iterator[Record]:
    """An emulated arm in a process of its own, recorded here; every row is looked at afterwards."""
    for kind, serve in (("real time", _in_real_time), ("compressed in time", _compressed)):
        with tempfile.TemporaryDirectory() as folder, serve() as address:
            out = Path(folder, "run.parquet")
            station = read_station(address, load_bundled("lite6"), "lite6")
            before = time.process_time()
            wall, done = time_call(lambda out=out, to=address, of=station: record(to, out, of, seconds=seconds))
            busy = time.process_time() - before
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10  # reading the file back takes more
            rows = round(seconds * RATE_HZ)
            yield Record("soak", kind, "rows", float(done.rows), "", wrong_rows(done, out, rows))
            yield Record("soak", kind, "reports lost", float(done.missing))
            yield Record("soak", kind, "reports doubled", float(done.repeated))
            yield Record("soak", kind, "wall time", wall, "s")
            if serve is _in_real_time:  # compressed, the emulator shares the process
                yield Record("soak", kind, "processor time a second recorded", 1e3 * busy / seconds, "ms")
            else:
                yield Record("soak", kind, "rows a second", done.rows / wall, "1/s")
            yield Record("soak", kind, "bytes a row", out.stat().st_size / max(done.rows, 1))
            yield Record("soak", kind, "peak memory of the process", peak, "MiB")


def wrong_rows(done: LiveRecording, out: Path, rows: int) -> str:
    """Why a recording is not every report once, in order, in one run; empty where it is."""
    if done.unwritten or done.runs != 1:
        return f"{done.unwritten} rows unwritten, {done.runs} runs"
    clock = np.rint(1e6 * np.asarray(read_recording(out).time)).astype(np.int64)
    if len(clock) != rows:
        return f"{len(clock)} rows, not {rows}"
    steps = np.diff(clock)
    off = int((steps != PERIOD_US).sum())
    return f"{off} steps are not {PERIOD_US} µs, from {steps.min()} to {steps.max()}" if off else ""


@contextmanager
def _in_real_time() -> Iterator[Address]:
    program = f"from lite6jax.cli import main; main(['emulate', '--address', '{HOST}', '--control-port', '{PORT}',"
    program += " '--motion', 'sines'])"
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    address = Address(HOST, PORT)
    try:
        for _ in range(300):
            time.sleep(0.2)
            try:
                read_station(address, load_bundled("lite6"), "lite6")
                break
            except ValueError:
                continue
        yield address
    finally:
        process.terminate()
        process.wait()


@contextmanager
def _compressed() -> Iterator[Address]:
    arm = load_bundled("lite6")
    path = draw_sines(arm)
    with Controller(EmulatedArm(arm, arm.kinematics), path=path, address=HOST, control_port=PORT, speed=SPEED):
        yield Address(HOST, PORT)
