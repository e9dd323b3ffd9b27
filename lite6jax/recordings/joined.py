"""Several recordings of one arm as one: touches at several places, each with points, planes or anchors of its own."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from lite6jax.errors import InputError
from lite6jax.recordings.readings import Readings
from lite6jax.recordings.recording import Recording
from lite6jax.recordings.settings import OF_READINGS, RecordingSettings

_ARRAYS = (
    *("joint_position", "time", "joint_velocity", "joint_acceleration", "joint_torque", "motor_current"),
    *("joint_temperature", "commanded_position", "ambient_temperature", "payload", "row"),
)
_OWN = ("contact_distances", "contact_points", "planes", "anchor_m")
"""Keys of which each file has its own; of all others they have the same."""


def join_recordings(recordings: Sequence[Recording]) -> Recording:
    """One recording of touches of one kind, distances or heights, with the tool, the arm and its effects shared.

    Each file is a run of its own. Points, planes and anchors get the name of their file before their own.

    Raises:
        InputError: poses, touches of several kinds, files that disagree on the arm, the tool or a noise, heights.
    """
    first = recordings[0]
    kinds = {recording.touches.kind if recording.touches else "poses" for recording in recordings}
    if len(kinds) > 1 or kinds & {"poses", "axis"}:
        raise InputError(
            f"{', '.join(one.source for one in recordings)}: hold {' and '.join(sorted(kinds))}; several files of one "
            "arm are diagnosed together where all are touches of points, touches of planes, or distances"
        )
    for one in recordings[1:]:
        for key in (field.name for field in fields(RecordingSettings) if field.name not in _OWN):
            if getattr(one.settings, key) != getattr(first.settings, key):
                raise InputError(
                    f"{one.source}: its sidecar says {key}: {getattr(one.settings, key)}, and that of {first.source} "
                    f"{getattr(first.settings, key)}; let them agree"
                )
        if one.dof != first.dof:
            raise InputError(
                f"{one.source}: has {one.dof} joints, and {first.source} {first.dof}; name files of one arm"
            )
    stems = [Path(one.source).stem for one in recordings]
    if len({*stems}) < len(stems):
        raise InputError(f"{first.source}: two files are called {stems[0]}; give each a name of its own")
    arrays: dict[str, Any] = {}
    for name in _ARRAYS:
        each = [getattr(one, name) for one in recordings]
        if name == "joint_velocity" and first.velocity_differentiated:
            continue
        if all(array is not None for array in each):
            arrays[name] = np.concatenate(each)
    arrays["run"] = np.concatenate([one.run + 1_000_000 * k for k, one in enumerate(recordings)])
    return Recording.assembled(
        **arrays,
        settings=replace(first.settings, **_own_settings(recordings, stems)),
        source=first.source,
        notes=tuple(dict.fromkeys(note for one in recordings for note in one.notes)),
        sliding=first.sliding,
        readings=_joined([one.touches for one in recordings if one.touches is not None], stems),
    )


def _joined(readings: Sequence[Readings], stems: Sequence[str]) -> Readings:
    names = tuple(f"{stem}/{name}" for one, stem in zip(readings, stems, strict=True) for name in one.names)
    before = np.cumsum([0, *(len(one.names) for one in readings)])
    group = np.concatenate([one.group + start for one, start in zip(readings, before, strict=False)])
    value, pixels = (np.concatenate([getattr(one, key) for one in readings]) for key in ("value", "pixels"))
    return Readings(readings[0].kind, group, names, value, pixels)


def _own_settings(recordings: Sequence[Recording], stems: Sequence[str]) -> dict[str, Any]:
    """What each file says of its own points, planes and anchors, under their new names."""
    found: dict[str, Any] = {"contact_distances": (), "contact_points": {}, "planes": {}, "anchor_m": {}}
    for one, stem in zip(recordings, stems, strict=True):
        own = one.settings
        found["contact_distances"] += tuple(
            replace(each, between=tuple(f"{stem}/{name}" for name in each.between)) for each in own.contact_distances
        )
        for key in ("contact_points", "planes", "anchor_m"):
            given = getattr(own, key)
            if key == "anchor_m" and isinstance(given, tuple) and one.touches is not None:
                given = dict.fromkeys(one.touches.names, given)
            if isinstance(given, Mapping):
                found[key] |= {f"{stem}/{name}": value for name, value in given.items()}
    defaults = {field.name: field.default for field in fields(RecordingSettings) if field.name in OF_READINGS}
    return {key: value or defaults[key] for key, value in found.items()}
