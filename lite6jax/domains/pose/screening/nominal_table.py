"""Another nominal table of the same model than the declared one."""

from dataclasses import replace
from typing import Any, NamedTuple, final

import numpy as np
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.description import VARIANTS, bundled_arms, load_bundled
from lite6jax.domains.pose.rigid_arm import RigidArm
from lite6jax.domains.pose.screening.options import ScreeningOptions
from lite6jax.domains.pose.screening.projection import estimated, physics_columns
from lite6jax.domains.pose.screening.screened import Detection, Screened, not_there
from lite6jax.model import ArmModel
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault


@final
class OtherTable(NamedTuple):
    """How a nominal table compares with another of the same model.

    Attributes:
        declared: name of the declared table.
        name: of the other; None where there is none, or the chain is the arm's own.
        share: of the way from the declared table to the other at which the data lie, and its standard deviation; None
            where the chain is fitted.
        ratios: residual scales with the declared table and the other, over that of a fitted chain; None where it is
            not fitted.
        decided: whether the data are of the other.
        likelier: whether they are likelier with the other, if no physics is at work.
    """

    declared: str
    name: str | None
    share: tuple[float, float] | None = None
    ratios: tuple[float, float] | None = None
    decided: bool = False
    likelier: bool = False

    def numbers(self) -> dict[str, Any]:
        """Of a fault, as in `DataFault`."""
        numbers: dict[str, Any] = {"declared": self.declared, "table": self.name, "decided": self.decided}
        if self.share is not None and np.isfinite(self.share[1]):
            numbers |= {"share": self.share[0], "share_std": self.share[1]}
        if self.ratios is not None:
            numbers |= {"declared_ratio": self.ratios[0], "table_ratio": self.ratios[1]}
        return numbers


def detect_other_table(state: Screened, options: ScreeningOptions) -> Detection:
    """Whether the data are of another table; where they leave it open, the corrections decide."""
    arm = state.rigid_arm
    compared = compare_tables(arm, options)
    if compared.name is None:
        reason = "own_chain" if arm.exact else "single_table"
        return not_there("nominal_table", reason=reason, declared=compared.declared)
    if compared.decided or compared.name == state.corrections.table:
        return Detection(compared)
    vague = compared.share is not None and np.isinf(compared.share[1])
    numbers = compared.numbers() | {"fitted": not arm.exact}
    reason = "indistinguishable" if vague else "declared_fits"
    return not_there("nominal_table", reason=reason, likelier=compared.likelier, **numbers)


def use_other_table(state: Screened, compared: OtherTable, options: ScreeningOptions) -> Screened:
    """The other table in the sidecar's place, unless the declared chain was asked for."""
    arm = state.rigid_arm
    assert compared.name is not None
    numbers = compared.numbers() | {"used": "none"}
    recording, nominal, factory = arm.recording, arm.arm, state.factory
    if not arm.exact or state.geometry == "declared":
        recording, nominal = with_table(recording, compared.name)
        factory = None
        numbers["used"] = "instead_of_file" if arm.exact else "table"
    fault = DataFault("nominal_table", (), numbers)
    return replace(state.corrected(fault, recording), arm=nominal, factory=factory)


def compare_tables(arm: RigidArm, options: ScreeningOptions) -> OtherTable:
    """Whether the data are of another table of the same model than the one declared.

    Where the chain is declared and is a published table, the share of the way to the other table is estimated beside
    all physics; where that leaves it vague, the other table must halve the residuals. Where the chain is fitted, the
    other table must be likelier than the declared one, and than a fitted chain for its more numbers.

    Args:
        arm: fitted.
        options: the thresholds.
    """
    tables = [load_bundled(name) for name in _family(arm.arm.name)]
    declared = [arm.arm]
    if arm.exact:
        declared = [t for t in tables if np.abs(t.links - arm.links).max() < options.published_tolerance]
    others = [table for table in tables if declared and table.name != declared[0].name]
    if not others:
        return OtherTable(arm.arm.name, None)
    other, name = others[0], declared[0].name
    if arm.exact:
        share, std = _share(arm, other, options)
        rival = _with_table(arm, other).fitted(options.most_fitted)
        clear = std < options.share_std or rival.scale < options.table_ratio * arm.scale
        there = abs(share - 1) < options.share_tolerance + 4 * std and share > options.share_sigmas * std
        return OtherTable(
            name, other.name, (share, std), decided=bool(clear and there), likelier=bool(rival.scale < arm.scale)
        )
    ours, theirs = (_with_table(arm, table).fitted(options.most_fitted) for table in (arm.arm, other))
    more = len(arm.unknown) - len(theirs.unknown)
    fitted = arm.log_likelihood(arm.scale) - 0.5 * more * np.log(arm.rows * arm.samples)
    required = max(fitted, ours.log_likelihood(arm.scale) + options.trusted_log_likelihood)
    ratios = (ours.scale / arm.scale, theirs.scale / arm.scale)
    return OtherTable(name, other.name, ratios=ratios, decided=bool(theirs.log_likelihood(arm.scale) > required))


def with_table(recording: Recording, name: str) -> tuple[Recording, Arm]:
    """The recording with another bundled arm named and no factory calibration, which was not that arm's; the arm."""
    settings = replace(recording.settings, factory_calibration=None, factory_uncertainty=None)
    if not settings.arm_is_file:
        settings = replace(settings, arm=name)
    return replace(recording, settings=settings), load_bundled(name)


def _share(arm: RigidArm, other: Arm, options: ScreeningOptions) -> tuple[float, float]:
    """Of the way from the arm's chain to another table at which the data lie, and its standard deviation."""
    between = np.zeros((len(arm.links) + 1, 6))
    for k, (link, there) in enumerate(zip(arm.links, other.links, strict=True)):
        T = there @ np.linalg.inv(link)
        between[k] = np.concatenate([T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_rotvec()])
    column = np.einsum("k,krs->rs", between.ravel(), arm.twists)[None]
    share, std = estimated(arm, physics_columns(arm, skip=("links",)), column, options)
    return float(share[0]), float(std[0])


def _family(name: str) -> list[str]:
    """The bundled tables of a model."""
    model = name.split("_")[0]
    return [other for other in bundled_arms() if other == model or (other in VARIANTS and other.startswith(model))]


def _with_table(arm: RigidArm, table: Arm) -> RigidArm:
    """With a chain that is not fitted, the sensor's frame and the tool as far as they are free, and its own numbers."""
    free_frame = arm.recording.settings.pose_frame != "base"
    kept = [
        k
        for k, (name, _, _) in enumerate(arm.unknown)
        if name in ("tool", "reading") or (name == "base" and free_frame)
    ]
    unknown = tuple(arm.unknown[k] for k in kept)
    own = np.array([name == "reading" for name, _, _ in unknown], bool)  # of a sensor's numbers the prior stays
    precision, offset = (np.where(own, each[kept], 0.0) for each in (arm.precision, arm.offset))
    T = arm.T_sensor_base if free_frame else np.eye(4)  # a known one was displaced for the first link
    rows = np.array([frames.row_from_transform(link) for link in table.links])
    start = ArmModel(rows.ravel(), T, arm.T_flange_tool)  # type: ignore[arg-type]
    return replace(arm, start=start, unknown=unknown, precision=precision, offset=offset)
