"""What commands share: kinds of arguments, exit codes, checks before long work."""

import signal
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from lite6jax.errors import InputError
from lite6jax.storage import check_writable

DONE, NOT_CONVERGED, BAD_INPUT, BAD_FIT, INTERRUPTED = 0, 1, 2, 3, 128 + signal.SIGINT

ArmName = Annotated[str | None, arg(metavar="ARM")]
OutFile = Annotated[Path | None, arg(metavar="FILE")]
Folder = Annotated[Path | None, arg(metavar="DIR")]


def check_out(path: Path, suffix: str, overwrite: bool) -> None:
    """Refuses a file name of another type than the one written, or a file that exists already.

    Raises:
        InputError: as said, or the place cannot be written to.
    """
    if path.suffix.lower() != suffix:
        raise InputError(f"{path}: what is written here is {suffix[1:]}; let the name end in {suffix}")
    check_writable(path, overwrite)


def check_seed(seed: int) -> None:
    """Refuses a negative seed, which NumPy's generators do not take.

    Raises:
        InputError: as said.
    """
    if seed < 0:
        raise InputError(f"--seed {seed}: give 0 or more")


def stem(source: str) -> str:
    """The name of an arm, or of its file without folder, suffix and tip: figures are named after it."""
    return Path(source.partition("#")[0]).stem
