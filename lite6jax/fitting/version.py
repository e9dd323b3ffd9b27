"""What results depend on besides their input: the package's source and the libraries that compute."""

import hashlib
import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_PACKAGE = Path(__file__).parents[1]
_LIBRARIES = ("jax", "jaxlib", "numpy", "scipy", "pyarrow", "optimistix")


@cache
def source_digest() -> str:
    """The SHA-256 of the package's source and its arms, as hexadecimal digits."""
    digest = hashlib.sha256()
    for path in sorted(path for kind in ("*.py", "*.yaml") for path in _PACKAGE.rglob(kind)):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def versions() -> tuple[str, ...]:
    """The source's digest, and the versions of Python and the libraries."""
    return (source_digest(), sys.version, *map(_version, _LIBRARIES))


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return "none"
