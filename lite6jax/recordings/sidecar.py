"""The sidecar, the YAML file beside a recording: its settings and names of columns, read and written."""

import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from lite6jax.errors import InputError
from lite6jax.recordings.columns import IGNORED
from lite6jax.recordings.settings import (
    OF_READINGS,
    RecordingSettings,
    form_of,
    parse_setting,
    reject_unknown,
    shown,
)
from lite6jax.storage import exists, read_yaml, write_atomically


class Sidecar(NamedTuple):
    """What stands beside a recording.

    Attributes:
        settings: of the arm, the sensor and the motion.
        columns: of columns with names of their own, the names in `columns.py`, or `ignore`.
    """

    settings: RecordingSettings
    columns: Mapping[str, str]


def sidecar_path(recording: str | Path) -> Path:
    """Where the sidecar of a recording stands: the same stem, `.yaml`; of a folder, beside it."""
    path = Path(recording)
    if not os.path.isdir(path):
        return path.with_suffix(".yaml")
    named = path if path.name not in ("", "..") else Path(os.path.abspath(path))  # such as the folder one is in
    return named.parent / f"{named.name}.yaml"


def read_settings(path: str | Path) -> RecordingSettings:
    """The settings in a sidecar; the defaults where the file does not exist.

    Raises:
        InputError: as `read_sidecar`.
    """
    return read_sidecar(path).settings


def list_sidecar_files(recording: str | Path) -> Iterator[tuple[str, Path]]:
    """What a recording is read with besides its own file: its sidecar, and the arm and the calibration that it names.

    Yields:
        the role, `settings`, `arm` or `calibration`, and the path; nothing where there is no sidecar.

    Raises:
        InputError: as `read_sidecar`, after the sidecar itself was named.
    """
    sidecar = sidecar_path(recording)
    if not exists(sidecar):
        return
    yield "settings", sidecar
    settings = read_settings(sidecar)
    if settings.arm_is_file:
        yield "arm", Path(str(settings.arm_reference(sidecar.parent)).partition("#")[0])
    if (calibration := settings.factory_path(sidecar.parent)) is not None:
        yield "calibration", calibration


def read_sidecar(path: str | Path) -> Sidecar:
    """What a sidecar says; the defaults where the file does not exist.

    Raises:
        InputError: not YAML, tags, alias bombs, an unknown key (with the nearest accepted one) or an unusable value.
    """
    path = Path(path)
    if not exists(path):
        if exists(path.with_suffix(".yml")):
            raise InputError(f"{path.with_suffix('.yml')}: a sidecar ends in .yaml; rename it to {path.name}")
        return Sidecar(RecordingSettings(), {})
    content = read_yaml(path)
    if not isinstance(content, dict) or not {"recording", "columns"} & set(content):
        raise InputError(f"{path}: is not a sidecar; its one top key must be `recording:`, with the settings below it")
    reject_unknown(f"{path}: ", content, ["recording", "columns", "account"])
    columns = _columns(content.get("columns"), path)
    settings = content.get("recording")
    if settings is None:
        return Sidecar(RecordingSettings(), columns)
    if not isinstance(settings, dict):
        raise InputError(f"{path}: recording: {shown(settings)} is not a mapping; write `key: value` lines below it")
    reject_unknown(f"{path}: recording.", settings, [field.name for field in fields(RecordingSettings)])
    for key, value in settings.items():
        if value is None:
            raise InputError(f"{path}: recording.{key}: has no value; give {form_of(key)}, or leave the key out")
    try:
        declared = RecordingSettings(**{key: parse_setting(key, value) for key, value in settings.items()})
    except InputError as error:
        raise InputError(f"{path}: recording.{error}") from error
    return Sidecar(declared, columns)


def _columns(given: Any, path: Path) -> dict[str, str]:
    if given is None:
        return {}
    if not isinstance(given, dict):
        raise InputError(f"{path}: columns: {shown(given)} is not a mapping; write lines `name in the table: q1_rad`")
    for name, meaning in given.items():
        if not isinstance(meaning, str):
            raise InputError(
                f"{path}: columns.{str(name)[:60]}: {shown(meaning)} is no name of a column; write one such as q1_rad,"
                f" or {IGNORED}"
            )
    return {str(name): meaning.strip() for name, meaning in given.items()}


def write_settings(
    settings: RecordingSettings,
    path: str | Path,
    overwrite: bool = False,
    account: Mapping[str, Any] | None = None,
) -> Path:
    """Writes a sidecar that `read_settings` reads back exactly; every declared key is written, defaults too,
    but for those of readings that are no poses.

    Args:
        settings: what it declares.
        path: the file.
        overwrite: whether it may be replaced.
        account: what the recording of an arm says about itself: plain numbers and phrases, which nothing reads back.

    Raises:
        InputError: the file exists and `overwrite` is false, or it cannot be written.
    """
    defaults = {field.name: field.default for field in fields(settings)}
    declared = {
        key: _plain(value)
        for key, value in asdict(settings).items()
        if value is not None and not (key in OF_READINGS and getattr(settings, key) == defaults[key])
    }
    content = {"recording": declared} | ({} if account is None else {"account": dict(account)})
    return write_atomically(
        path,
        yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True),
        overwrite,
    )


def _plain(value: Any) -> Any:
    """With lists for tuples, at any depth, as YAML has them."""
    if isinstance(value, Mapping):
        return {key: _plain(part) for key, part in value.items()}
    return [_plain(part) for part in value] if isinstance(value, list | tuple) else value
