"""The command that shows a diagnosis in the browser."""

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, final

from tyro.conf import Positional, arg

from lite6jax.cli.exit_codes import DONE
from lite6jax.cli.inputs import diagnosed_recording
from lite6jax.errors import InputError

if TYPE_CHECKING:
    from lite6jax.report.viewer import Scene

REFRESH_S = 1 / 30


@final
@dataclass(frozen=True)
class View:
    """Show a diagnosis in the browser until Ctrl-C: the arm in motion, measured against predicted poses, the errors as
    arrows, and the places of what was found. Of torques, the joints are coloured by their errors.

    For example:

        lite6jax view diagnosis.json
        lite6jax view diagnosis.json run9.csv --port 8123
    """

    diagnosis: Annotated[Positional[Path], arg(metavar="DIAGNOSIS")]
    """What `diagnose` wrote (.json)."""
    recording: Annotated[Positional[Path | None], arg(metavar="RECORDING")] = None
    """A recording in the same set-up; where not given the one that was diagnosed, beside the diagnosis or here."""
    torques: bool = False
    """Of a diagnosis of poses and torques, show the torques."""
    effects: Annotated[Path | None, arg(metavar="FILE.py")] = None
    """Effects of your own that the model has. Runs the file."""
    host: Annotated[str, arg(metavar="ADDRESS")] = "127.0.0.1"
    """The address on which to listen. With another than this one, others in the network see the arm too."""
    port: Annotated[int | None, arg(metavar="PORT")] = None
    """The port; 8080, or the next one that is free, where not given."""
    duration: Annotated[float | None, arg(metavar="S")] = None
    """The duration; by default until Ctrl-C."""

    def run(self) -> int:
        """Reads, serves until Ctrl-C."""
        if self.duration is not None and not 0 < self.duration < math.inf:
            raise InputError(f"--duration {self.duration}: give seconds above 0")
        if self.port is not None and not 0 <= self.port < 1 << 16:
            raise InputError(f"--port {self.port}: is not a port; give 1 to 65535")
        from rich.text import Text

        from lite6jax.report import screen, viewer

        scene, file = self._scene()
        end = math.inf if self.duration is None else time.monotonic() + self.duration
        with viewer.served(scene, self.host, self.port) as shown:
            screen.show([Text(f"{scene.arm.name}, {scene.samples} rows of {file}"), Text(scene.headline)])
            screen.show(map(Text, scene.remarks))
            screen.show([Text(f"Open {shown.url} in a browser. Stop with Ctrl-C.", no_wrap=True, overflow="ignore")])
            screen.console().file.flush()  # another program may wait for these lines
            while time.monotonic() < end:
                time.sleep(REFRESH_S)
                shown.play(REFRESH_S)
        return DONE

    def _scene(self) -> "tuple[Scene, Path]":
        from lite6jax.diagnosis.document import (
            DAMAGED,
            is_of_torques,
            parsed_document,
            read_model,
            read_torque_model,
            torques_of,
        )
        from lite6jax.domains.pose.files import read_motion
        from lite6jax.effects.user_effects import load_effects
        from lite6jax.recordings import read_recording
        from lite6jax.report import viewer

        document: Any = parsed_document(self.diagnosis)
        effects = load_effects(self.effects) if self.effects else ()
        motors = read_torque_model(self.diagnosis, effects) if self.torques or is_of_torques(document) else None
        arm = read_model(self.diagnosis, effects) if motors is None else None
        file = self.recording or diagnosed_recording(document, self.diagnosis)
        try:
            if arm is not None:
                return viewer.pose_scene(document, arm, read_motion(file, arm)), file
            assert motors is not None
            recording = read_recording(file, arm=motors.arm)
            return viewer.torque_scene(torques_of(document) or {}, motors, recording), file
        except InputError:
            raise
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            raise InputError(f"{self.diagnosis}: is damaged (it lacks {error}); {DAMAGED}") from error
