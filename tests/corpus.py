"""Diagnosed recordings that tests share: each is made and diagnosed when first asked for, once in each process."""

import contextlib
import io
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from diagnosis.recorded import Made, static_motion

from lite6jax import cli
from lite6jax.diagnosis.diagnose import Diagnosis, diagnose_poses
from lite6jax.recordings import Recording, write_recording

COMPLIANCE = "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5"


@dataclass(frozen=True)
class Diagnosed:
    """A recording, its file, and what was found in it."""

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


class Corpus(dict[str, Diagnosed]):
    """Recordings by name: "clean", and "compliance" with three positions that are off by 20 mm an axis."""

    def __init__(self, folder: Path):
        self._folder = folder

    def __missing__(self, name: str) -> Diagnosed:
        folder = self._folder / name
        folder.mkdir()
        effects = {"clean": (), "compliance": (COMPLIANCE,)}[name]
        recording = Made(folder, effects, seed=1).recording(static_motion(1, 200))
        if name == "compliance":
            position = recording.position.copy()
            position[[3, 50, 99]] += 0.02
            recording = replace(recording, position=position)
        self[name] = Diagnosed(recording, write_recording(recording, folder / "run7.csv"))
        return self[name]
