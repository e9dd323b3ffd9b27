"""The files that a diagnosis was made from, with their checksums: for its document, and found again by it."""

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from lite6jax.errors import InputError, InputWarning, command_line
from lite6jax.storage import exists


def inputs(
    recording: Path, arm: str | None = None, reference: Path | None = None, effects: Path | None = None
) -> list[dict[str, str]]:
    """Each file by its role, name and SHA-256: the recording, its sidecar, and the files that either names.

    Args:
        recording: as given.
        arm: a bundled name, or a file with or without a tip.
        reference: another recording.
        effects: of effects of the user's own.
    """
    from lite6jax.recordings.checksums import table_checksum

    files = [*_of_recording(recording, ""), *(_of_recording(reference, "reference ") if reference else ())]
    files += [("arm", Path(arm.partition("#")[0]))] if arm else []
    files += [("effects", effects)] if effects else []
    named = {(role, file) for role, file in files if file.is_file()}
    ordered = [pair for pair in dict.fromkeys(files) if pair in named]
    return [{"role": role, "file": file.name, "sha256": table_checksum(file)} for role, file in ordered]


def found_recording(document: Mapping[str, Any], diagnosis: Path) -> Path | None:
    """The recording that was diagnosed, where it is beside the diagnosis or here."""
    places = [
        place for entry in _recordings(document) for place in (diagnosis.with_name(entry["file"]), Path(entry["file"]))
    ]
    return next((place for place in places if place.is_file()), None)


def diagnosed_recording(document: Mapping[str, Any], diagnosis: Path) -> Path:
    """The recording that was diagnosed.

    Raises:
        InputError: it is not there, or the document does not say which it was.

    Warns:
        InputWarning: the file is another one than was diagnosed.
    """
    from lite6jax.recordings.checksums import table_checksum

    named = _recordings(document)
    found = found_recording(document, diagnosis)
    if found is None:
        which = f"the recording {named[0]['file']} that it names is not beside it" if named else "it names no recording"
        raise InputError(f"{diagnosis}: {which}; give one: {command_line('view', diagnosis, 'RECORDING')}")
    if table_checksum(found) != named[0]["sha256"]:
        warnings.warn(
            f"{found}: is not as it was when {diagnosis.name} was made from it (their SHA-256 differ)",
            InputWarning,
            stacklevel=2,
        )
    return found


def diagnosed_nominal(document: Mapping[str, Any], diagnosis: Path) -> str | None:
    """The file of the nominal arm, with base and tip, that the sidecar of the diagnosed recording names.

    None where the sidecar is not beside the diagnosis or here, names a bundled arm, or the file is not as it was.
    """
    from lite6jax.recordings import read_settings, sidecar_path
    from lite6jax.recordings.checksums import table_checksum

    sums = {entry["sha256"] for entry in document.get("inputs", ()) if entry["role"] == "arm"}
    recording = found_recording(document, diagnosis)
    sidecar = None if recording is None else sidecar_path(recording)
    if sidecar is None or not sums or not exists(sidecar):
        return None
    settings = read_settings(sidecar)
    reference = str(settings.arm_reference(sidecar.parent)) if settings.arm_is_file else ""
    file = Path(reference.partition("#")[0])
    return reference if reference and file.is_file() and table_checksum(file) in sums else None


def _recordings(document: Mapping[str, Any]) -> list[Mapping[str, str]]:
    return [entry for entry in document.get("inputs", ()) if entry["role"] == "recording"]


def _of_recording(file: Path, role: str) -> Iterator[tuple[str, Path]]:
    from lite6jax.recordings import read_settings, sidecar_path

    sidecar = sidecar_path(file)
    yield f"{role}recording", file
    if not exists(sidecar):
        return
    yield f"{role}settings", sidecar
    settings = read_settings(sidecar)
    if settings.arm_is_file:
        yield f"{role}arm", Path(str(settings.arm_reference(file.parent)).partition("#")[0])
    calibration = settings.factory_path(file.parent)
    if calibration is not None:
        yield f"{role}calibration", calibration
