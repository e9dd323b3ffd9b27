"""The diagnosis of a recording relative to a reference recording: what has changed, or what a simulator lacks."""

from collections.abc import Callable, Sequence

from lite6jax.arms.arm import Arm
from lite6jax.diagnosis.diagnose import diagnose
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.result import Diagnosis
from lite6jax.domains.pose.reference import ReferenceComparison, compare
from lite6jax.effects.effect import Effect
from lite6jax.fitting.problem import Geometry
from lite6jax.progress import Stage
from lite6jax.recordings import Recording


def diagnose_against(
    recording: Recording,
    reference: Recording,
    arm: Arm | None = None,
    *,
    geometry: Geometry = "declared",
    effects: Sequence[Effect] = (),
    options: Options | None = None,
    progress: Callable[[Stage], object] | None = None,
) -> tuple[Diagnosis, ReferenceComparison]:
    """Compares a recording with a reference, and diagnoses what the recording has beyond it.

    Args:
        recording: measured poses.
        reference: poses at the same joint positions.
        arm: the nominal arm; from the recording's settings where not given.
        geometry: of the recording, as in `fit`.
        effects: a user's own, as in `diagnose`.
        options: thresholds, as in `diagnose`.
        progress: as in `diagnose`.

    Raises:
        InputError: as `compare` and `diagnose`.
    """
    comparison = compare(recording, reference, arm, geometry)
    found = diagnose(
        comparison.recording,
        arm,
        geometry=comparison.geometry,
        effects=effects,
        factory=comparison.factory,
        options=options,
        progress=progress,
    )
    return found, comparison
