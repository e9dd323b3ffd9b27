"""Commands for a connected arm: reading its calibration and recording it. They never move it."""

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Annotated

from tyro.conf import arg

from lite6jax.cli.arguments import ArmName, OutFile, refuse_inputs
from lite6jax.cli.exit_codes import DONE, NOT_REACHED
from lite6jax.errors import InputError
from lite6jax.storage import check_writable

PATIENCE_S = 10.0
"""The time after the first Ctrl-C in which another does not interrupt; the deadlines of all requests are shorter."""

IP = Annotated[str, arg(metavar="ADDRESS")]


@dataclass(frozen=True)
class Read:
    """Read an arm's factory calibration from its controller. One request that changes nothing; the arm does not move.

    For example:

        lite6jax read --ip 192.168.1.185 --out arm.yaml
    """

    ip: IP
    """The control box, such as 192.168.1.185; of an emulator also 127.0.0.1:1502."""
    out: OutFile = None
    """Write the calibration here (YAML of the vendor's form, which `lite6jax fit` reads)."""
    arm: ArmName = None
    """The expected nominal arm; by default a Lite 6."""
    timeout: Annotated[float, arg(metavar="S")] = 5.0
    """The time limit of the whole exchange."""
    json: bool = False
    """Print JSON instead of the report."""
    force: bool = False
    """Replace the file if it exists."""

    def run(self) -> int:
        """Reads, writes and prints the calibration."""
        if self.out:
            if self.out.suffix.lower() not in (".yaml", ".yml"):
                raise InputError(f"{self.out}: the output is YAML; let the name end in .yaml")
            check_writable(self.out, self.force)
            refuse_inputs([self.out], [self.arm])
        if not 0 < self.timeout < 3600:
            raise InputError(f"--timeout {self.timeout:g}: give seconds, more than zero and less than an hour")
        from lite6jax.arms.factory import write_factory
        from lite6jax.arms.files import read_arm
        from lite6jax.controller.calibration import read_calibration
        from lite6jax.controller.connection import parse_address

        arm = None if self.arm is None else read_arm(self.arm)
        read = read_calibration(parse_address(self.ip), arm, self.timeout)
        written = []  # before anything is printed, because printing fails if the pipe is closed
        if self.out:
            written.append(write_factory(read.calibration.kinematics, self.out, overwrite=self.force))
        if self.json:
            from lite6jax.report import documents

            print(documents.text(documents.document(read), written))
            return DONE
        from lite6jax.report import live, screen

        screen.show(live.calibration_report(read))
        screen.written(written)
        return DONE


@dataclass(frozen=True)
class Record:
    """Record a live arm at 250 Hz, or what its controller computes for given joints. It never moves the arm.

    For example:

        lite6jax record --ip 192.168.1.185 --out run.parquet --seconds 60
        lite6jax record --ip 192.168.1.185 --poses poses.csv --out fk.csv
    """

    ip: IP
    """The control box, such as 192.168.1.185; of an emulator also 127.0.0.1:1502."""
    out: Annotated[Path, arg(metavar="FILE")]
    """The recording (.parquet, .csv). Its sidecar .yaml and the arm's calibration are written beside it. Its
    rows can be read whatever ends the process: until a .parquet is complete they are in an .arrows of its stem."""
    seconds: Annotated[float | None, arg(metavar="S")] = None
    """The duration by the controller's clock; by default until Ctrl-C."""
    poses: Annotated[Path | None, arg(metavar="FILE")] = None
    """Record instead the forward kinematics of the controller at the joints of this recording (.csv, .parquet)."""
    arm: ArmName = None
    """The nominal arm; by default a Lite 6."""
    force: bool = False
    """Replace files that exist."""

    def run(self) -> int:
        """Records and prints the result."""
        from lite6jax.controller.recorder import check_targets, record, record_poses
        from lite6jax.controller.station import factory_path, read_station

        check_targets(self.out, self.force)
        outputs = [self.out, self.out.with_suffix(".yaml"), factory_path(self.out)]
        refuse_inputs(outputs, [self.poses, self.arm])
        if self.poses is not None and self.seconds is not None:
            raise InputError("--seconds and --poses: a list of joints has its own end; leave one out")
        if self.seconds is not None and not 0 < self.seconds < float("inf"):
            raise InputError(f"--seconds {self.seconds:g}: give more than zero")
        from lite6jax.arms.files import read_arm
        from lite6jax.controller.connection import parse_address
        from lite6jax.recordings import read_recording
        from lite6jax.report import live, screen

        address = parse_address(self.ip)
        arm = read_arm(self.arm or "lite6")
        poses = None
        if self.poses is not None:
            poses = read_recording(self.poses, arm=arm, joint_limits=arm.joint_limits)
        with _stop_on_interrupt() as stop:
            station = read_station(address, arm, self.arm or "lite6")
            if poses is not None:
                with screen.progress(poses.samples, "requesting") as advance:
                    recorded = record_poses(
                        address, self.out, station, poses, overwrite=self.force, stop=stop, advance=advance
                    )
            else:
                with live.recording_progress() as show:
                    recorded = record(
                        address, self.out, station, seconds=self.seconds, overwrite=self.force, stop=stop, show=show
                    )
        screen.show(live.recorded_report(recorded))
        screen.written(recorded.written)
        if recorded.refusal:
            raise InputError(recorded.refusal)
        return NOT_REACHED if recorded.short else DONE


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

    wanted = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    wanted = [number for number in wanted if signal.getsignal(number) != signal.SIG_IGN]  # as set by nohup
    if threading.current_thread() is not threading.main_thread():  # handlers can be set only there
        wanted = []
    before = {number: signal.signal(number, handle) for number in wanted}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
