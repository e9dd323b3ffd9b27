"""Motions from files for a diagnosed arm: what they do not declare is that of the recording that was diagnosed."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from lite6jax.recordings import (
    ArmJoints,
    Recording,
    RecordingSettings,
    read_recording,
    read_settings,
    sidecar_path,
)
from lite6jax.storage import exists


def read_motion(path: str | Path, model: Any) -> Recording:
    """A motion to predict; what its own sidecar does not declare is taken from the diagnosed recording.

    Args:
        path: of the motion.
        model: of poses or of torques: its `dof`, `sliding`, `motion` and `reference_temperature`.

    Raises:
        InputError: as `read_recording`.
    """
    sidecar = sidecar_path(path)
    settings = (
        read_settings(sidecar)
        if exists(sidecar)
        else RecordingSettings(reference_temperature_degC=model.reference_temperature)
    )
    recording = read_recording(path, arm=ArmJoints(model.dof, model.sliding))
    if settings.motion is None and recording.motion != model.motion:
        settings = replace(settings, motion=model.motion)
    return declare_anew(recording, settings)


def declare_anew(recording: Recording, settings: RecordingSettings) -> Recording:
    """With other settings; notes on the file stay, except those on what was not declared."""
    undeclared = ("there is no sidecar", *recording.made_anew().notes)
    kept = tuple(note for note in recording.notes if not note.startswith(undeclared))
    anew = recording.made_anew(settings=settings)
    return replace(anew, notes=(*kept, *anew.notes))
