"""The timeline: the sequence of paths that the joints follow."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.emulator.paths import Brake, Path, Rest

Array = NDArray[np.floating]


class Timeline:
    """A sequence of paths, each valid from its start until that of the next one."""

    KEEP = 5.0
    """s, for which past paths are kept."""

    def __init__(self, position: ArrayLike) -> None:
        """Starts at rest at `(joint,)` rad."""
        self._paths: list[tuple[float, Path]] = [(-np.inf, Rest(np.array(position, float)))]

    @property
    def end(self) -> float:
        """s, the end of the last path; infinite for an endless one."""
        start, path = self._paths[-1]
        return start + path.duration if path.duration else start

    def then(self, path: Path, start: float) -> None:
        """Appends `path` from `start` s on, not before the start of the last one."""
        while len(self._paths) > 1 and self._paths[1][0] < start - self.KEEP:
            del self._paths[0]
        self._paths.append((start, path))

    def stop(self, now: float) -> None:
        """Removes later paths and brakes."""
        position, velocity = (part[0] for part in self.at(np.array([now])))
        self._paths = [entry for entry in self._paths if entry[0] <= now]
        self.then(Brake(position, velocity), now)

    def at(self, time: Array) -> tuple[Array, Array]:
        """Positions and velocities `(sample, joint)` at increasing times `(sample,)` s."""
        cuts = np.searchsorted(time, [start for start, _ in self._paths[1:]], side="left")
        pieces = np.split(time, cuts)
        parts = [
            path.at(piece - start if np.isfinite(start) else piece)
            for (start, path), piece in zip(self._paths, pieces, strict=True)
            if len(piece)
        ]
        if len(parts) == 1:
            return parts[0]
        positions, velocities = zip(*parts, strict=True)
        return np.concatenate(positions), np.concatenate(velocities)
