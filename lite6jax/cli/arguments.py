"""What commands share: kinds of arguments, checks before long work."""

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import arg

from lite6jax.errors import InputError
from lite6jax.storage import check_writable

ArmName = Annotated[str | None, arg(metavar="ARM")]
OutFile = Annotated[Path | None, arg(metavar="FILE")]
Folder = Annotated[Path | None, arg(metavar="DIR")]
Processes = Annotated[int | None, arg(metavar="N")]
Scheduler = Annotated[str | None, arg(metavar="ADDRESS")]


def check_out(path: Path, suffix: str, overwrite: bool) -> None:
    """Refuses a file name of another type than the one written, or a file that exists already.

    Raises:
        InputError: as said, or the place cannot be written to.
    """
    if path.suffix.lower() != suffix:
        raise InputError(f"{path}: what is written here is {suffix[1:]}; let the name end in {suffix}")
    check_writable(path, overwrite)


def refuse_inputs(outputs: Iterable[Path | None], inputs: Iterable[str | Path | None]) -> None:
    """Refuses to replace a file that the command reads, which --force does not ask for.

    Args:
        outputs: what will be written.
        inputs: files or names of bundled arms, as given; of a recording the sidecar and the files that it names too.

    Raises:
        InputError: as said, or a sidecar cannot be read.
    """
    read = [file for source in inputs if source is not None for file in _files_read(source) if os.path.exists(file)]
    for path in outputs:
        if path is not None and os.path.exists(path) and any(os.path.samefile(path, file) for file in read):
            raise InputError(f"{path}: is read by this command and would be replaced; choose another name to write to")


def _files_read(source: str | Path) -> Iterator[Path]:
    from lite6jax.recordings import read_settings, recording_file, sidecar_path

    yield Path(source)
    yield Path(str(source).partition("#")[0])
    file = recording_file(source)
    if file is None:
        return
    settings = read_settings(sidecar_path(file))
    yield sidecar_path(file)
    if settings.arm_is_file:
        yield Path(settings.arm_reference(file.parent))
    if settings.factory_calibration:
        yield file.parent / settings.factory_calibration


def check_seed(seed: int) -> None:
    """Refuses a negative seed, which NumPy's generators do not take.

    Raises:
        InputError: as said.
    """
    if seed < 0:
        raise InputError(f"--seed {seed}: give 0 or more")


def check_processes(processes: int | None, scheduler: str | None) -> None:
    """Refuses no processes, and processes of this machine beside a cluster.

    Raises:
        InputError: as said.
    """
    if processes is not None and processes < 1:
        raise InputError(f"--processes {processes}: give 1 or more")
    if processes is not None and scheduler is not None:
        raise InputError("--processes and --scheduler: give one of them; a cluster has workers of its own")


def arm_reference(arm: str, file: Path) -> str:
    """How a sidecar names an arm: a bundled one by its name, a file by its path relative to the sidecar.

    Args:
        arm: as it was given.
        file: the sidecar, or what stands in the same folder.
    """
    from lite6jax.arms.bundled import bundled_arms

    if arm in bundled_arms():
        return arm
    return Path(os.path.relpath(Path(arm).resolve(), file.resolve().parent)).as_posix()


def stem(source: str) -> str:
    """The name of an arm, or of its file without folder, suffix and tip: figures are named after it."""
    return Path(source.partition("#")[0]).stem


def pairs(option: str, given: tuple[str, ...], parsed: bool = False) -> dict[str, Any]:
    """`name=value` by name; with `parsed`, values as YAML has them.

    Raises:
        InputError: no such pair, by the option.
    """
    import yaml

    found: dict[str, Any] = {}
    for pair in given:
        name, mark, value = pair.rpartition("=") if not parsed else pair.partition("=")
        if not mark or not name or not value or len(pair) > 1000:
            raise InputError(f"{option} {pair[:60]}: write it as {'KEY=VALUE' if parsed else 'COLUMN=MEANING'}")
        try:
            found[name] = yaml.safe_load(value) if parsed else value
        except yaml.YAMLError as error:
            raise InputError(f"{option} {pair[:60]}: its value is not valid YAML; write KEY=VALUE") from error
    return found
