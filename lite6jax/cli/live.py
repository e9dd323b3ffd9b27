"""Commands for an arm with a controller: reading its calibration, recording it, and emulating controllers on loopback.

They never move a real arm.
"""

import math
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import UseAppendAction, arg

from lite6jax import suffixes
from lite6jax.cli import command
from lite6jax.deferred import import_lazily
from lite6jax.errors import InputError
from lite6jax.interruption import list_signals

with import_lazily():
    from lite6jax import emulator, recordings, simulation
    from lite6jax.arms import factory, files
    from lite6jax.controller import connection, recorder, station
    from lite6jax.effects import catalogue, composition, dynamic, serialization
    from lite6jax.report import connected, screen
    from lite6jax.report.sentences import commands as sentences

if TYPE_CHECKING:
    from rich.console import RenderableType

    from lite6jax.arms.arm import Arm
    from lite6jax.domains.tracking.predict import DiagnosedServos

PATIENCE_S = 10.0
"""The time after the first Ctrl-C in which another does not interrupt; the deadlines of all requests are shorter."""

Address = Annotated[
    str, arg(metavar="ADDRESS", help="The control box, such as 192.168.1.185; of an emulator also 127.0.0.1:1502.")
]


@dataclass(frozen=True)
class ReadCommand:
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
        if self.out and self.out.suffix.lower() not in suffixes.YAML:
            raise InputError(f"{self.out}: the output is YAML; let the name end in .yaml")
        command.check_outputs([self.out], [self.arm], self.force)
        if not 0 < self.timeout < 3600:
            raise InputError(f"--timeout {self.timeout:g}: give seconds, more than zero and less than an hour")
        arm = None if self.arm is None else files.read_arm(self.arm)
        written = []
        read = station.read_calibration(connection.parse_address(self.ip), arm, self.timeout)
        if self.out:
            written.append(factory.write_factory(read.calibration.kinematics, self.out, overwrite=self.force))
        return command.present(self.json, read, connected.calibration_report(read), written)


@dataclass(frozen=True)
class RecordCommand:
    """Record a live arm at 250 Hz, or what its controller computes for given joints. It never moves the arm.

    For example:

        lite6jax record --ip 192.168.1.185 --out run.parquet --seconds 60
        lite6jax record --ip 192.168.1.185 --poses poses.csv --out fk.csv
    """

    ip: Address
    out: Annotated[Path, arg(metavar="FILE")]
    """The recording (.parquet, .csv). Its sidecar .yaml and the arm's calibration are written beside it. Its
    rows can be read whatever ends the process: until run.parquet is complete they are in run.growing.csv."""
    seconds: Annotated[float | None, arg(metavar="S")] = None
    """The duration by the controller's clock; by default until Ctrl-C."""
    poses: Annotated[Path | None, arg(metavar="FILE")] = None
    """Record instead the forward kinematics of the controller at the joints of this recording (.csv, .parquet)."""
    arm: command.ArmName = None
    """The nominal arm; by default a Lite 6."""
    force: command.Force = False

    def run(self) -> int:
        """Records and prints the result."""
        live = self.poses is None
        recorder.check_targets(self.out, self.force, live=live)
        command.check_outputs(recorder.list_targets(self.out, live=live), [self.poses, self.arm], self.force)
        if self.poses is not None and self.seconds is not None:
            raise InputError("--seconds and --poses: a list of joints has its own end; leave one out")
        if self.seconds is not None and not 0 < self.seconds < float("inf"):
            raise InputError(f"--seconds {self.seconds:g}: give more than zero")
        address = connection.parse_address(self.ip)
        arm = files.read_arm(self.arm or "lite6")
        limits = arm.joint_limits
        poses = None
        if self.poses:
            poses = recordings.read_recording(self.poses, arm=arm, joint_limits=limits)
        with _stop_on_interrupt() as stop:
            arm_station = station.read_station(address, arm, self.arm or "lite6")
            options: dict[str, Any] = {"overwrite": self.force, "stop": stop}
            if poses is not None:
                with screen.progress(poses.samples, "requesting") as advance:
                    recorded = recorder.record_poses(address, self.out, arm_station, poses, advance=advance, **options)
            else:
                with connected.recording_progress() as show:
                    recorded = recorder.record(
                        address, self.out, arm_station, seconds=self.seconds, show=show, **options
                    )
        screen.show(connected.recorded_report(recorded))
        screen.written(recorded.written)
        if recorded.refusal:
            raise InputError(recorded.refusal)
        return command.NOT_REACHED if recorded.short else command.DONE


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
    handled_signals = []
    if threading.current_thread() is threading.main_thread():
        handled_signals = list_signals()
    before = {number: signal.signal(number, handle) for number in handled_signals}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


# ------------------------------------------------------------------ emulated controllers

_MOST_ARMS = 32
_REFRESH_S = 0.25


@dataclass(frozen=True)
class EmulateCommand:
    """Run an emulated UFACTORY controller on this machine until Ctrl-C. xarm-python-sdk and the commands read, verify
    and record it like an arm.

    For example:

        lite6jax emulate --motion sines
        lite6jax emulate --factory arm.yaml --effect joint_compliance:joint=2,compliance_rad_per_Nm=9e-5
        lite6jax emulate --arms 3 --fault latency:0.2 --fault lose
        lite6jax emulate --motion poses --tracking --effect command_delay:joint=2,delay_s=0.02
    """

    factory: Annotated[tuple[Path, ...], arg(metavar="FILE…")] = ()
    """The calibration, or one for each arm; by default drawn with deviations of 0.8 mm and 0.15 deg per parameter."""
    arm: command.ArmName = None
    """The arm: a bundled one or a description; by default lite6, or the arm of the calibration."""
    arms: Annotated[int | None, arg(metavar="N")] = None
    """The number of controllers, on this address and the next ones."""
    address: Annotated[str, arg(metavar="127.x.y.z")] = "127.0.0.1"
    """The address, on loopback only. The report ports are 30000 to 30003."""
    control_port: Annotated[int, arg(metavar="PORT")] = 502
    """502, as on an arm, requires privileges; another one must be set in the SDK."""
    effect: command.EffectTexts = ()
    """A hidden effect with its parameters, such as joint_backlash:joint=4,gap_rad=1e-3 in the pose on port 30000, or
    viscous_friction:joint=2,viscous_Nm_s_per_rad=3 in the torques of the motors; repeatable. The controller's
    kinematics contain none."""
    effects: Annotated[Path | None, arg(metavar="FILE.py")] = None
    """A file of your own effects for --effect. It is executed."""
    tracking: bool = False
    """Let the joints follow the commands as servos do. Effects are then those on how servos follow, as of `simulate
    --tracking`; without it the joints are where they were commanded 8 ms before."""
    motion: Annotated[str, arg(metavar="rest|sines|poses|FILE")] = "rest"
    """Rest; a smooth motion; from pose to pose; or the motion in a recording."""
    torque_noise: Annotated[tuple[float, ...], arg(metavar="NM…")] = ()
    """The noise of the torques, one sigma: one number for all joints, or one per joint. Without it they are constant at
    rest, as those that a controller computes from a model."""
    fault: Annotated[tuple[str, ...], UseAppendAction, arg(metavar="NAME[:VALUE]")] = ()
    """A fault; repeatable. --faults lists them."""
    faults: bool = False
    """List the faults and exit."""
    tool_offset: Annotated[
        tuple[float, float, float, float, float, float], arg(metavar="X Y Z ROLL PITCH YAW")
    ] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # fmt: skip
    """The tool offset in the controller, mm and degrees."""
    payload: Annotated[float, arg(metavar="KG")] = 0.0
    """The payload at the flange."""
    payload_at: command.Triple = (0.0, 0.0, 0.0)
    """The centre of mass of the payload, mm in the flange's frame."""
    warm_up: Annotated[float, arg(metavar="K")] = 12.0
    """The final temperature rise from 25 °C, with a time constant of 20 min."""
    speed: Annotated[float, arg(metavar="FACTOR")] = 1.0
    """The speed of the clock relative to real time."""
    duration: command.Duration = None
    seed: int = 0
    """The seed of drawn calibrations and motions."""

    def run(self) -> int:
        """Serves until Ctrl-C."""
        from rich.table import Table

        if self.faults:
            table = Table.grid(padding=(0, 2))
            for name, words in emulator.describe_faults():
                table.add_row(name, words)
            screen.show([table])
            return command.DONE
        faults = emulator.parse_faults(self.fault)
        command.check_duration(self.duration)
        controllers = self._controllers(faults)
        with ExitStack() as stack:
            for controller in controllers:
                stack.enter_context(controller)
            screen.show(self._page(controllers))
            screen.console().file.flush()  # another program may wait for these lines
            for _ in command.repeat(self.duration, _REFRESH_S):
                pass
        return command.DONE

    def _controllers(self, faults: "emulator.Faults") -> "list[emulator.Controller]":
        import ipaddress

        import numpy as np

        count = self.arms if self.arms is not None else max(1, len(self.factory))
        if not 1 <= count <= _MOST_ARMS:
            raise InputError(f"--arms {count}: give 1 to {_MOST_ARMS}")
        if len(self.factory) not in (0, count):
            raise InputError(f"--factory: {len(self.factory)} files for {count} arms; give one for each, or none")
        try:
            first = ipaddress.IPv4Address("127.0.0.1" if self.address == "localhost" else self.address)
            addresses = [str(first + i) for i in range(count)]
        except ValueError as error:
            raise InputError(f"--address {self.address!r}: is not an address; write it like 127.0.0.1") from error
        if self.payload < 0 or not math.isfinite(self.payload):
            raise InputError(f"--payload {self.payload}: give kg, 0 or more")
        return [
            emulator.Controller(
                body,
                path=emulator.read_path(self.motion, body.arm, self.seed + i),
                faults=faults,
                tool=[*self.tool_offset[:3], *np.deg2rad(self.tool_offset[3:])],
                payload=[self.payload, *self.payload_at],
                address=address,
                control_port=self.control_port,
                speed=self.speed,
            )
            for i, address in enumerate(addresses)
            for body in [self._body(i)]
        ]

    def _body(self, index: int) -> "emulator.EmulatedArm":
        import numpy as np

        nominal = None if self.arm is None else files.read_arm(self.arm)
        if self.factory:
            read = factory.read_factory(self.factory[index], nominal)
            arm = read.arm
            kinematics = read.kinematics
        else:
            arm = nominal or files.read_arm("lite6")
            kinematics = simulation.draw_calibration(arm, self.seed + index)
        noise = np.array(self.torque_noise * arm.dof if len(self.torque_noise) == 1 else self.torque_noise, float)
        if self.tracking:
            servos = self._servos(replace(arm, kinematics=kinematics, dh=None))
            return emulator.EmulatedArm(arm, kinematics, warm_up=self.warm_up, torque_noise=noise, servos=servos)
        kinds = {**catalogue.TORQUE_EFFECTS, **catalogue.kinds_of(command.load_own_effects(self.effects))}
        for text in self.effect:
            name = text.partition(":")[0]
            if name in catalogue.TRACKING_EFFECTS and name not in kinds:
                raise InputError(f"{name}: is of servos; add --tracking")
        hidden = [serialization.parse_effect(text, kinds) for text in self.effect]
        of_torques = dynamic.TorqueEffect
        torque_effects = tuple((effect, values) for effect, values in hidden if isinstance(effect, of_torques))
        parsed = [(effect, values) for effect, values in hidden if not isinstance(effect, of_torques)]
        physics = composition.Physics(tuple(effect for effect, _ in parsed))
        values = physics.join([values for _, values in parsed])
        return emulator.EmulatedArm(arm, kinematics, physics, values, self.warm_up, torque_effects, noise)

    def _servos(self, arm: "Arm") -> "DiagnosedServos":
        """The arm as made with its servos, payload and effects on how it follows."""
        if self.effects is not None:
            raise InputError("--effects: is of poses, and --tracking of commands; keep one")
        settings = recordings.RecordingSettings(
            arm=arm.name, servo=simulation.usual_servo(arm), payload_com_m=command.metres(self.payload_at)
        )
        return simulation.servos_with_effects(arm, self.effect, settings, self.payload)

    def _page(self, controllers: "Sequence[emulator.Controller]") -> "Iterator[RenderableType]":
        """The addresses, the motion, the hidden effects and faults, and how to connect."""
        from rich.text import Text

        first = controllers[0]
        for controller in controllers:
            yield from command.say("emulated", one=controller)
        calibration = ", ".join(map(str, self.factory)) or "as drawn"
        yield from map(screen.unbroken, sentences.emulated_motion(calibration, self.motion, self.speed))
        physics = first.body.physics
        of_torques = first.body.torque_effects
        if physics.effects:
            yield Text("Hidden effects, in the pose on port 30000 and not in the controller's kinematics")
            yield from command.list_effects(zip(physics.effects, physics.reported(first.body.values), strict=True))
        if of_torques:
            yield Text("Hidden effects, in the torques")
            yield from command.list_effects((effect, effect.reported(values)) for effect, values in of_torques)
        if first.body.servos is not None:
            yield screen.unbroken(sentences.emulated_servos(first.body.servos.servo))
        if first.body.followed:
            yield Text("Hidden effects, in how the joints follow their commands")
            yield from command.list_effects((effect, effect.reported(values)) for effect, values in first.body.followed)
        yield from sentences.emulated_faults(first.body.torque_noise.tolist(), self.fault)
        ip = first.address if first.control_port == 502 else f"{first.address}:{first.control_port}"
        arm_name = first.body.arm.name if self.arm is None else self.arm
        arm_option = "" if arm_name == "lite6" else f" --arm {arm_name}"  # the default of the commands
        yield screen.unbroken(f"Try: lite6jax read --ip {ip}{arm_option}")
        yield screen.unbroken(f'Or:  from xarm.wrapper import XArmAPI; arm = XArmAPI("{first.address}")')
        if first.control_port != 502:
            yield screen.unbroken(
                "     and before it: from xarm.core.config.x_config import XCONF\n"
                f"     XCONF.SocketConf.TCP_CONTROL_PORT = {first.control_port}"
            )
        yield Text("Stop with Ctrl-C.")
