"""The command that emulates: controllers on loopback, for those who have no arm at hand."""

import math
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import UseAppendAction, arg

from lite6jax.cli.arguments import DONE, ArmName
from lite6jax.errors import InputError

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

    from lite6jax.emulator import Body, Controller, Faults

MOST_ARMS = 32
REFRESH_S = 0.25


@dataclass(frozen=True)
class Emulate:
    """Run an emulated UFACTORY controller on this machine: what xarm-python-sdk and the commands read, verify and
    record as if it were an arm, until Ctrl-C.

    For example:

        lite6jax emulate --motion sines
        lite6jax emulate --factory arm.yaml --effect joint_compliance:joint=2,compliance_rad_per_Nm=9e-5
        lite6jax emulate --arms 3 --fault latency:0.2 --fault fragments
    """

    factory: Annotated[tuple[Path, ...], arg(metavar="FILE…")] = ()
    """The calibration it holds, or one for each arm; drawn where not given, 0.8 mm and 0.15 deg off in each number."""
    arm: ArmName = None
    """Which arm: a bundled one or a description; lite6, or the one a calibration is of, where not given."""
    arms: Annotated[int | None, arg(metavar="N")] = None
    """So many controllers, on this address and the next ones."""
    address: Annotated[str, arg(metavar="127.x.y.z")] = "127.0.0.1"
    """Of loopback, nothing else. The report ports are 30000 to 30003."""
    control_port: Annotated[int, arg(metavar="PORT")] = 502
    """502, as on an arm, needs the right to it; another one has to be told to the SDK."""
    effect: Annotated[tuple[str, ...], UseAppendAction, arg(metavar="NAME:KEY=VALUE,…")] = ()
    """Hidden physics with its numbers, such as joint_backlash:joint=4,gap_rad=1e-3; may be given more than once. The
    pose on port 30000 shows it, the controller's own kinematics does not."""
    effects: Annotated[Path | None, arg(metavar="FILE.py")] = None
    """Effects of your own that --effect may name. Runs the file."""
    motion: Annotated[str, arg(metavar="rest|sines|poses|FILE")] = "rest"
    """Rest until told to move; a smooth motion; from pose to pose; or the motion in a recording."""
    fault: Annotated[tuple[str, ...], UseAppendAction, arg(metavar="NAME[:VALUE]")] = ()
    """What is wrong with it; may be given more than once. --faults lists them."""
    faults: bool = False
    """List the faults there are, and end."""
    tool_offset: Annotated[
        tuple[float, float, float, float, float, float], arg(metavar="X Y Z ROLL PITCH YAW")
    ] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # fmt: skip
    """That is set in the controller, mm and degrees."""
    payload: Annotated[float, arg(metavar="KG")] = 0.0
    """At the flange."""
    payload_at: Annotated[tuple[float, float, float], arg(metavar="X Y Z")] = (0.0, 0.0, 0.0)
    """Its centre of mass, mm in the flange's frame."""
    warm_up: Annotated[float, arg(metavar="K")] = 12.0
    """By which it warms up from 25 °C, with a time constant of 20 min."""
    speed: Annotated[float, arg(metavar="FACTOR")] = 1.0
    """How much faster than real time its clock runs."""
    duration: Annotated[float | None, arg(metavar="S")] = None
    """End by itself after so long."""
    seed: int = 0
    """Of calibrations and motions that are drawn."""

    def run(self) -> int:
        """Serves until Ctrl-C."""
        from rich.live import Live
        from rich.table import Table

        from lite6jax.emulator import describe_faults, parse_faults
        from lite6jax.report import screen

        if self.faults:
            table = Table.grid(padding=(0, 2))
            for name, words in describe_faults():
                table.add_row(name, words)
            screen.show([table])
            return DONE
        faults = parse_faults(self.fault)
        if self.duration is not None and not 0 < self.duration < math.inf:
            raise InputError(f"--duration {self.duration}: give seconds above 0")
        controllers = self._controllers(faults)
        end = math.inf if self.duration is None else time.monotonic() + self.duration
        terminal = screen.console()
        with ExitStack() as stack:
            for controller in controllers:
                stack.enter_context(controller)
            screen.show(self._page(controllers))
            if terminal.is_terminal:
                live = stack.enter_context(Live(console=terminal, auto_refresh=False, transient=True))
                while (left := end - time.monotonic()) > 0:
                    live.update(_standing(controllers), refresh=True)
                    time.sleep(min(REFRESH_S, left))
            else:
                terminal.file.flush()  # whoever started it may wait for these lines
                while (left := end - time.monotonic()) > 0:
                    for controller in controllers:
                        controller.look()
                    time.sleep(min(REFRESH_S, left))
        return DONE

    def _controllers(self, faults: "Faults") -> "list[Controller]":
        import ipaddress

        import numpy as np

        from lite6jax.emulator import Controller, read_path

        count = self.arms if self.arms is not None else max(1, len(self.factory))
        if not 1 <= count <= MOST_ARMS:
            raise InputError(f"--arms {count}: give 1 to {MOST_ARMS}")
        if len(self.factory) not in (0, count):
            raise InputError(f"--factory: {len(self.factory)} files for {count} arms; give one for each, or none")
        try:
            first = ipaddress.IPv4Address("127.0.0.1" if self.address == "localhost" else self.address)
            addresses = [str(first + i) for i in range(count)]
        except ValueError as error:
            raise InputError(f"--address {self.address!r}: is none; write it like 127.0.0.1") from error
        if self.payload < 0 or not math.isfinite(self.payload):
            raise InputError(f"--payload {self.payload}: give kg, 0 or more")
        controllers = []
        for i, address in enumerate(addresses):
            body = self._body(i)
            controllers.append(
                Controller(
                    body,
                    path=read_path(self.motion, body.arm, self.seed + i),
                    faults=faults,
                    tool=[*self.tool_offset[:3], *np.deg2rad(self.tool_offset[3:])],
                    payload=[self.payload, *self.payload_at],
                    address=address,
                    control_port=self.control_port,
                    speed=self.speed,
                )
            )
        return controllers

    def _body(self, index: int) -> "Body":
        from lite6jax.arms.factory import read_factory
        from lite6jax.arms.files import read_arm
        from lite6jax.effects.catalogue import kinds_of
        from lite6jax.effects.composition import Physics
        from lite6jax.effects.serialization import parse_effect
        from lite6jax.effects.user_effects import load_effects
        from lite6jax.emulator import Body
        from lite6jax.simulation import draw_calibration

        own = () if self.effects is None else load_effects(self.effects)
        parsed = [parse_effect(text, kinds_of(own)) for text in self.effect]
        physics = Physics(tuple(effect for effect, _ in parsed))
        nominal = None if self.arm is None else read_arm(self.arm)
        if self.factory:
            factory = read_factory(self.factory[index], nominal)
            arm, kinematics = factory.arm, factory.kinematics
        else:
            arm = nominal or read_arm("lite6")
            kinematics = draw_calibration(arm, self.seed + index)
        return Body(arm, kinematics, physics, physics.join([values for _, values in parsed]), self.warm_up)

    def _page(self, controllers: "Sequence[Controller]") -> "Iterator[RenderableType]":
        """What listens where, and what is hidden in it."""
        from rich.text import Text

        first = controllers[0]
        for controller in controllers:
            name, port = controller.body.arm.name, controller.control_port
            yield Text(f"An emulated {name} at {controller.address}: control port {port}, reports on 30000 to 30003.")
        drawn = "as drawn" if not self.factory else ", ".join(map(str, self.factory))
        clock = "" if self.speed == 1 else f" Its clock runs {self.speed:g} times as fast."
        yield Text(f"Calibration: {drawn}.", no_wrap=True, overflow="ignore")
        yield Text(f"Motion: {self.motion}.{clock}", no_wrap=True, overflow="ignore")
        physics, values = first.body.physics, first.body.values
        if physics.effects:
            yield Text("Hidden physics, in the pose on port 30000 and unknown to the controller's own kinematics")
            for effect, parameters in zip(physics.effects, physics.reported(values), strict=True):
                numbers = ", ".join(f"{key} = {estimate.value:.6g}" for key, estimate in parameters.items())
                yield Text(f"  {effect.name} at {effect.site}: {numbers}")
        if self.fault:
            yield Text(f"Faults: {', '.join(self.fault)}.")
        ip = first.address if first.control_port == 502 else f"{first.address}:{first.control_port}"
        named = first.body.arm.name if self.arm is None else self.arm
        other = "" if named == "lite6" else f" --arm {named}"  # which is what the commands expect
        yield Text(f"Try: lite6jax read --ip {ip}{other}", no_wrap=True, overflow="ignore")
        yield Text(
            f'Or:  from xarm.wrapper import XArmAPI; arm = XArmAPI("{first.address}")', no_wrap=True, overflow="ignore"
        )
        if first.control_port != 502:
            yield Text(
                "     and before it: from xarm.core.config.x_config import XCONF\n"
                f"     XCONF.SocketConf.TCP_CONTROL_PORT = {first.control_port}",
                no_wrap=True,
                overflow="ignore",
            )
        yield Text("Ctrl-C ends it.")


def _standing(controllers: "Sequence[Controller]") -> "Table":
    """A row a controller: its clock, its state, its joints, who is connected, what was asked."""
    from rich.table import Table

    states = {1: "moves", 2: "ready", 3: "paused", 4: "stopped", 5: "reset"}
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for title in ("address", "clock", "state", "joints (deg)", "connected", "requests"):
        table.add_column(title, no_wrap=title in ("address", "clock", "state"))
    for controller in controllers:
        seen = controller.look()
        connected = ", ".join(
            f"{port}" + (f" x{count}" if count > 1 else "") for port, count in seen.connections.items() if count
        )
        error = f", error {seen.error}" if seen.error else ""
        joints = " ".join(f"{math.degrees(angle):.1f}" for angle in seen.joints)
        table.add_row(
            controller.address, f"{seen.time:.0f} s", states.get(seen.state, str(seen.state)) + error, joints,
            connected or "nobody", str(sum(seen.asked.values())),
        )  # fmt: skip
    return table
