"""Diagnosed recordings that tests share: each is made and diagnosed when first asked for, once in each process."""

import contextlib
import io
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from diagnosis.recorded import Made, moving_motion, static_motion

from lite6jax import cli
from lite6jax.diagnosis.diagnose import Diagnosis, diagnose_poses
from lite6jax.recordings import Recording, write_recording

COMPLIANCE = "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5"
BACKLASH = "joint_backlash:joint=3,gap_rad=8e-4"
LAG = "joint_lag:joint=1,lag_s=2e-3"
OUTLIERS = (3, 50, 99)
"""Rows of "compliance" whose positions are off by 20 mm an axis."""


def bump(q):
    """rad at joint 4, of no effect in the catalogue."""
    return 6e-4 * (q > 0.5)


@dataclass(frozen=True)
class Diagnosed:
    """A recording and what was found in it.

    Attributes:
        made: the arm.
        motion: of the recording, as the oracle takes it.
        recording: as the sensor read it.
        path: of the recording's file.
    """

    made: Made
    motion: dict[str, np.ndarray]
    recording: Recording
    path: Path

    @cached_property
    def diagnosis(self) -> Diagnosis:
        """From the call."""
        return diagnose_poses(self.recording)

    @cached_property
    def printed(self) -> tuple[Path, str]:
        """The JSON that `lite6jax diagnose` writes, and what it prints."""
        out, said = self.path.with_suffix(".json"), io.StringIO()
        with contextlib.redirect_stdout(said):
            assert cli.main(["diagnose", str(self.path), "--out", str(out)]) == 0
        return out, said.getvalue()


class Corpus:
    """Recordings by name: "clean", "compliance", "moving", "unnamed", "free"."""

    def __init__(self, folder: Path):
        self._folder, self._made = folder, {}

    def __getitem__(self, name: str) -> Diagnosed:
        if name not in self._made:
            self._made[name] = self._make(name)
        return self._made[name]

    def _make(self, name: str) -> Diagnosed:
        folder = self._folder / name
        folder.mkdir()
        made, motion, curve = Made(folder, seed=1), static_motion(1, 200), None
        if name == "compliance":
            made = replace(made, effects=(COMPLIANCE,))
        elif name == "moving":
            made, motion = replace(made, effects=(BACKLASH, LAG)), moving_motion(1, 400)
        elif name == "unnamed":
            curve = (4, bump)
        elif name == "free":
            made = replace(made, effects=(COMPLIANCE,), geometry="free", frame=True, tool=True)
        else:
            assert name == "clean", name
        recording = made.recording(motion, bump=curve)
        if name == "compliance":
            position = recording.position.copy()
            position[list(OUTLIERS)] += 0.02
            recording = replace(recording, position=position)
        return Diagnosed(made, motion, recording, write_recording(recording, folder / "run7.csv"))
