"""Commands for a connected arm: reading its calibration and recording it. They never move it."""

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Annotated, Any

from tyro.conf import arg

from lite6jax.cli import command
from lite6jax.deferred import import_lazily
from lite6jax.errors import InputError
from lite6jax.interruption import list_signals

with import_lazily():
    from lite6jax import recordings
    from lite6jax.arms import factory, files
    from lite6jax.controller import connection, recorder, station
    from lite6jax.report import live, screen

PATIENCE_S = 10.0
"""The time after the first Ctrl-C in which another does not interrupt; the deadlines of all requests are shorter."""

Address = Annotated[
    str, arg(metavar="ADDRESS", help="The control box, such as 192.168.1.185; of an emulator also 127.0.0.1:1502.")
]


@dataclass(frozen=True)
class Read:
    """Read an arm's factory calibration from its controller. One request that changes nothing; the arm does not move.

    For example:

        lite6jax read --ip 192.168.1.185 --out arm.yaml
    """

    ip: Address
    out: command.OutFile = None
    """Write the calibration here (YAML of the vendor's form, which `lite6jax fit` reads)."""
    arm: command.ArmName = None
    """The expected nominal arm; by default a Lite 6."""
    timeout: Annotated[float, arg(metavar="S")] = 5.0
    """The time limit of the whole exchange."""
    json: command.Json = False
    force: command.Force = False

    def run(self) -> int:
        """Reads, writes and prints the calibration."""
        if self.out and self.out.suffix.lower() not in (".yaml", ".yml"):
            raise InputError(f"{self.out}: the output is YAML; let the name end in .yaml")
        command.check_outputs([self.out], [self.arm], self.force)
        if not 0 < self.timeout < 3600:
            raise InputError(f"--timeout {self.timeout:g}: give seconds, more than zero and less than an hour")
        arm, written = None if self.arm is None else files.read_arm(self.arm), []
        read = station.read_calibration(connection.parse_address(self.ip), arm, self.timeout)
        if self.out:
            written.append(factory.write_factory(read.calibration.kinematics, self.out, overwrite=self.force))
        return command.present(self.json, read, live.calibration_report(read), written)


@dataclass(frozen=True)
class Record:
    """Record a live arm at 250 Hz, or what its controller computes for given joints. It never moves the arm.

    For example:

        lite6jax record --ip 192.168.1.185 --out run.parquet --seconds 60
        lite6jax record --ip 192.168.1.185 --poses poses.csv --out fk.csv
    """

    ip: Address
    out: Annotated[Path, arg(metavar="FILE")]
    """The recording (.parquet, .csv). Its sidecar .yaml and the arm's calibration are written beside it. Its
    rows can be read whatever ends the process: until a .parquet is complete they are in an .arrows of its stem."""
    seconds: Annotated[float | None, arg(metavar="S")] = None
    """The duration by the controller's clock; by default until Ctrl-C."""
    poses: Annotated[Path | None, arg(metavar="FILE")] = None
    """Record instead the forward kinematics of the controller at the joints of this recording (.csv, .parquet)."""
    arm: command.ArmName = None
    """The nominal arm; by default a Lite 6."""
    force: command.Force = False

    def run(self) -> int:
        """Records and prints the result."""
        recorder.check_targets(self.out, self.force)
        outputs = [self.out, self.out.with_suffix(".yaml"), station.factory_path(self.out)]
        command.check_outputs(outputs, [self.poses, self.arm], self.force)
        if self.poses is not None and self.seconds is not None:
            raise InputError("--seconds and --poses: a list of joints has its own end; leave one out")
        if self.seconds is not None and not 0 < self.seconds < float("inf"):
            raise InputError(f"--seconds {self.seconds:g}: give more than zero")
        address = connection.parse_address(self.ip)
        arm = files.read_arm(self.arm or "lite6")
        limits = arm.joint_limits
        poses = recordings.read_recording(self.poses, arm=arm, joint_limits=limits) if self.poses else None
        with _stop_on_interrupt() as stop:
            given = station.read_station(address, arm, self.arm or "lite6")
            options: dict[str, Any] = {"overwrite": self.force, "stop": stop}
            if poses is not None:
                with screen.progress(poses.samples, "requesting") as advance:
                    found = recorder.record_poses(address, self.out, given, poses, advance=advance, **options)
            else:
                with live.recording_progress() as show:
                    found = recorder.record(address, self.out, given, seconds=self.seconds, show=show, **options)
        screen.show(live.recorded_report(found))
        screen.written(found.written)
        if found.refusal:
            raise InputError(found.refusal)
        return command.NOT_REACHED if found.short else command.DONE


@contextmanager
def _stop_on_interrupt() -> Iterator[threading.Event]:
    """An event that Ctrl-C or a termination signal sets; repeated Ctrl-C interrupts only after `PATIENCE_S`."""
    stop = threading.Event()
    times: list[float] = []

    def handle(number: int, frame: FrameType | None) -> None:
        times.append(time.monotonic())
        stop.set()
        if times[-1] - times[0] > PATIENCE_S:
            raise KeyboardInterrupt

    # handlers can be set in the main thread only
    wanted = list_signals() if threading.current_thread() is threading.main_thread() else []
    before = {number: signal.signal(number, handle) for number in wanted}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
