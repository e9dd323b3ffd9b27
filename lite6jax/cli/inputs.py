"""The files that a diagnosis was made from, with their checksums, for its document."""

from collections.abc import Iterator
from pathlib import Path

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
