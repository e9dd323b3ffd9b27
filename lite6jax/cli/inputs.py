"""The files that a diagnosis was made from, with their checksums: for its document, and found again by it."""

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lite6jax.deferred import import_lazily
from lite6jax.errors import InputError, InputWarning, command_line
from lite6jax.storage import exists

with import_lazily():
    from lite6jax.diagnosis import document as diagnosis_file
    from lite6jax.recordings import checksums, sidecar


def list_inputs(
    recording: Path, arm: str | None = None, reference: Path | None = None, effects: Path | None = None
) -> list[dict[str, str]]:
    """Each file by its role, name and SHA-256: the recording, its sidecar, and the files that either names.

    Args:
        recording: as given.
        arm: a bundled name, or a file with or without a tip.
        reference: another recording.
        effects: of effects of the user's own.
    """
    files = []
    for role, file in (("", recording), ("reference ", reference)):
        if file is not None:
            parts = [("recording", file), *sidecar.list_sidecar_files(file)]
            files += [(f"{role}{part}", path) for part, path in parts]
    files += [("arm", Path(arm.partition("#")[0]))] if arm else []
    files += [("effects", effects)] if effects else []
    files = [(role, file) for role, file in dict.fromkeys(files) if file.is_file()]
    return [{"role": role, "file": file.name, "sha256": checksums.table_checksum(file)} for role, file in files]


def find_recording(document: Mapping[str, Any], diagnosis: Path) -> Path | None:
    """The recording that was diagnosed, where it is beside the diagnosis or here."""
    named = [entry["file"] for entry in _recordings(document)]
    places = [place for file in named for place in (diagnosis.with_name(file), Path(file))]
    return next((place for place in places if place.is_file()), None)


def require_recording(document: Mapping[str, Any], diagnosis: Path) -> Path:
    """The recording that was diagnosed.

    Raises:
        InputError: it is not there, or the document does not say which it was.

    Warns:
        InputWarning: the file is another one than was diagnosed.
    """
    named = _recordings(document)
    found = find_recording(document, diagnosis)
    if found is None:
        which = f"the recording {named[0]['file']} that it names is not beside it" if named else "it names no recording"
        raise InputError(f"{diagnosis}: {which}; give one: {command_line('view', diagnosis, 'RECORDING')}")
    if checksums.table_checksum(found) != named[0]["sha256"]:
        said = f"{found}: is not as it was when {diagnosis.name} was made from it (their SHA-256 differ)"
        warnings.warn(said, InputWarning, stacklevel=2)
    return found


def find_nominal(document: Mapping[str, Any], diagnosis: Path) -> str | None:
    """The file of the nominal arm, with base and tip, that the sidecar of the diagnosed recording names.

    None where the sidecar is not beside the diagnosis or here, names a bundled arm, or the file is not as it was.
    """
    sums = {entry["sha256"] for entry in document.get("inputs", ()) if entry["role"] == "arm"}
    recording = find_recording(document, diagnosis)
    declared = None if recording is None else sidecar.sidecar_path(recording)
    if declared is None or not sums or not exists(declared):
        return None
    settings = sidecar.read_settings(declared)
    reference = str(settings.arm_reference(declared.parent)) if settings.arm_is_file else ""
    file = Path(reference.partition("#")[0])
    return reference if reference and file.is_file() and checksums.table_checksum(file) in sums else None


def _recordings(document: Mapping[str, Any]) -> list[Mapping[str, str]]:
    return [entry for entry in document.get("inputs", ()) if entry["role"] == "recording"]


@contextmanager
def refuse_damage(diagnosis: Path) -> Iterator[None]:
    """Within, what a document lacks is an error of the input."""
    try:
        yield
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise InputError(f"{diagnosis}: is damaged (it lacks {error}); {diagnosis_file.DAMAGED}") from error
