"""A recording on its way through the screening: corrected so far, with the faults found and those ruled out."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import final

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.calibration.problem import Geometry
from lite6jax.domains.faults import Screened
from lite6jax.domains.pose.rigid_arm import RigidArm
from lite6jax.estimation.prior import PRIOR, Prior
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault


@final
@dataclass(frozen=True)
class Corrections:
    """Which of the faults that resemble physics are corrected.

    Attributes:
        jumps: frame jumps at most; None for as many as are corrected at most.
        beside_physics: whether a jump is estimated jointly with columns of all physics, or without any.
        table: the nominal table to be used where the data leave it open.
        known_jumps: row of the file and frame ("base" or "tool") of each jump, where these have been decided; then
            none is searched for, and only the size of these is estimated.
        settling: whether joint positions are corrected where the joints were read before the arm had settled.
        constant: whether distances have a constant that is fitted; None where the screening decides.
    """

    jumps: int | None = None
    beside_physics: bool = True
    table: str | None = None
    known_jumps: tuple[tuple[int, str], ...] | None = None
    settling: bool = True
    constant: bool | None = None


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class ScreenedPoses(Screened[Recording]):
    """A recording of poses without the faults that were found.

    Attributes:
        arm: the nominal arm; None until it has been read from the sidecar.
        geometry: what is known of it, as in `fit`.
        corrections: which of the faults that resemble physics are corrected.
        prior: the probabilities of explanations before any data: what a correction must gain is its cost.
        rigid: the rigid arm with this recording, from the first screen on that needs it.
        factory: the arm's calibration where it is not the sidecar's.
        transforms: what was done to the columns and poses, each applicable to other rows of the same recording.
    """

    arm: Arm | None
    geometry: Geometry
    corrections: Corrections
    prior: Prior = PRIOR
    rigid: RigidArm | None = None
    factory: FactoryCalibration | None = None
    transforms: tuple[Callable[[Recording], Recording], ...] = ()

    @property
    def recording(self) -> Recording:
        """Corrected so far."""
        return self.data

    def transferred(self, recording: Recording) -> Recording:
        """Other rows of the same recording, corrected as these were, but for faults of single rows."""
        for transform in self.transforms:
            recording = transform(recording)
        return replace(recording, settings=self.recording.settings)

    def transformed(self, transform: Callable[[Recording], Recording]) -> "ScreenedPoses":
        """With one more transform of `transferred`."""
        return replace(self, transforms=(*self.transforms, transform))

    @property
    def rigid_arm(self) -> RigidArm:
        """The rigid arm, for screens that need it."""
        assert self.rigid is not None
        return self.rigid

    @property
    def likelier_table(self) -> str | None:
        """Another nominal table that fits better than the declared one, while physics may be the reason."""
        tables = (fault for fault in self.ruled_out if fault.code == "nominal_table")
        return next((fault.numbers["table"] for fault in tables if fault.numbers.get("likelier")), None)

    def corrected(
        self, fault: DataFault, recording: Recording | None = None, rigid: RigidArm | None = None
    ) -> "ScreenedPoses":
        """With a fault found and corrected; a rigid arm brings its recording."""
        rigid = rigid or self.rigid
        if recording is None:
            recording = self.recording if rigid is None else rigid.recording
        elif rigid is not None:
            rigid = rigid.with_poses(recording)
        return replace(self.with_faults([fault], recording), rigid=rigid)
