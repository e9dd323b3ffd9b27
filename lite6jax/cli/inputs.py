"""The files that a diagnosis was made from, with their checksums: for its document, and found again by it."""

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lite6jax.errors import InputError, InputWarning, command_line
from lite6jax.storage import exists


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
    from lite6jax.recordings.checksums import table_checksum
    from lite6jax.recordings.sidecar import list_sidecar_files

    files = []
    for role, file in (("", recording), ("reference ", reference)):
        if file is not None:
            files += [(f"{role}recording", file), *((role + part, path) for part, path in list_sidecar_files(file))]
    files += [("arm", Path(arm.partition("#")[0]))] if arm else []
    files += [("effects", effects)] if effects else []
    files = [(role, file) for role, file in dict.fromkeys(files) if file.is_file()]
    return [{"role": role, "file": file.name, "sha256": table_checksum(file)} for role, file in files]


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
    from lite6jax.recordings.checksums import table_checksum

    named = _recordings(document)
    found = find_recording(document, diagnosis)
    if found is None:
        which = f"the recording {named[0]['file']} that it names is not beside it" if named else "it names no recording"
        raise InputError(f"{diagnosis}: {which}; give one: {command_line('view', diagnosis, 'RECORDING')}")
    if table_checksum(found) != named[0]["sha256"]:
        said = f"{found}: is not as it was when {diagnosis.name} was made from it (their SHA-256 differ)"
        warnings.warn(said, InputWarning, stacklevel=2)
    return found


def find_nominal(document: Mapping[str, Any], diagnosis: Path) -> str | None:
    """The file of the nominal arm, with base and tip, that the sidecar of the diagnosed recording names.

    None where the sidecar is not beside the diagnosis or here, names a bundled arm, or the file is not as it was.
    """
    from lite6jax.recordings import read_settings, sidecar_path
    from lite6jax.recordings.checksums import table_checksum

    sums = {entry["sha256"] for entry in document.get("inputs", ()) if entry["role"] == "arm"}
    recording = find_recording(document, diagnosis)
    sidecar = None if recording is None else sidecar_path(recording)
    if sidecar is None or not sums or not exists(sidecar):
        return None
    settings = read_settings(sidecar)
    reference = str(settings.arm_reference(sidecar.parent)) if settings.arm_is_file else ""
    file = Path(reference.partition("#")[0])
    return reference if reference and file.is_file() and table_checksum(file) in sums else None


def _recordings(document: Mapping[str, Any]) -> list[Mapping[str, str]]:
    return [entry for entry in document.get("inputs", ()) if entry["role"] == "recording"]


@contextmanager
def refuse_damage(diagnosis: Path) -> Iterator[None]:
    """Within, what a document lacks is an error of the input."""
    from lite6jax.diagnosis.document import DAMAGED

    try:
        yield
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise InputError(f"{diagnosis}: is damaged (it lacks {error}); {DAMAGED}") from error
