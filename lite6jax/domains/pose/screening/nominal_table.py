"""Another nominal table of the same model than the declared one."""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.description import bundled_arms, load_bundled
from lite6jax.domains.pose.rigid_arm import RigidArm
from lite6jax.domains.pose.screening.options import ScreeningOptions
from lite6jax.domains.pose.screening.projection import estimated, physics_columns
from lite6jax.domains.pose.screening.screened import Screened
from lite6jax.model import ArmModel
from lite6jax.recordings.fault import DataFault


def tables_of_model(name: str) -> list[Arm]:
    """The bundled tables of the model that an arm's name begins with: two of a lite6."""
    model = name.split("_")[0]
    return [load_bundled(other) for other in bundled_arms() if other.split("_")[0] == model]


def use_other_table(state: Screened, options: ScreeningOptions) -> Screened:
    """Another table of the same model in the place of the one declared, where the data are of that one.

    Where they leave it open, the corrections decide. A declared chain that was asked for stays. Where it is a published
    table, the share of the way to the other table is estimated beside all physics; where that leaves it vague, the
    other table must halve the residuals. Where the chain is fitted, the other table must be likelier than the declared
    one, and than a fitted chain for its more numbers.

    Args:
        state: with a fitted arm.
        options: the thresholds.
    """
    arm = state.rigid_arm
    tables = tables_of_model(arm.arm.name)
    declared = [arm.arm]
    if arm.exact:
        declared = [t for t in tables if np.abs(t.links - arm.links).max() < options.published_tolerance]
    others = [table for table in tables if declared and table.name != declared[0].name]
    if not others:
        reason = "own_chain" if arm.exact else "single_table"
        return state.rule_out("nominal_table", reason=reason, declared=arm.arm.name)
    other, vague = others[0], False
    numbers: dict[str, Any] = {"declared": declared[0].name, "table": other.name}
    theirs = _with_table(arm, other).fitted(options.most_fitted)
    if arm.exact:
        share, std = _share(arm, other, options)
        clear = std < options.share_std or theirs.scale < options.table_ratio * arm.scale
        there = abs(share - 1) < options.share_tolerance + 4 * std and share > options.share_sigmas * std
        decided, likelier, vague = bool(clear and there), bool(theirs.scale < arm.scale), bool(np.isinf(std))
        numbers |= {"decided": decided} | ({"share": share, "share_std": std} if np.isfinite(std) else {})
    else:
        ours = _with_table(arm, arm.arm).fitted(options.most_fitted)
        more = len(arm.unknown) - len(theirs.unknown)
        fitted = arm.log_likelihood(arm.scale) - 0.5 * more * np.log(arm.rows * arm.samples)
        required = max(fitted, ours.log_likelihood(arm.scale) + options.trusted_log_likelihood)
        decided, likelier = bool(theirs.log_likelihood(arm.scale) > required), False
        ratios = {"declared_ratio": ours.scale / arm.scale, "table_ratio": theirs.scale / arm.scale}
        numbers |= {"decided": decided} | ratios
    if not decided and other.name != state.corrections.table:
        reason = "indistinguishable" if vague else "declared_fits"
        return state.rule_out("nominal_table", reason=reason, likelier=likelier, **numbers, fitted=not arm.exact)
    recording, nominal, factory, used = arm.recording, arm.arm, state.factory, "none"
    if not arm.exact or state.geometry == "declared":
        # its factory calibration was not that arm's
        settings = replace(recording.settings, factory_calibration=None, factory_uncertainty=None)
        settings = settings if settings.arm_is_file else replace(settings, arm=other.name)
        recording, nominal, factory = replace(recording, settings=settings), other, None
        used = "instead_of_file" if arm.exact else "table"
    fault = DataFault("nominal_table", (), numbers | {"used": used})
    return replace(state.corrected(fault, recording), arm=nominal, factory=factory)


def _share(arm: RigidArm, other: Arm, options: ScreeningOptions) -> tuple[float, float]:
    """Of the way from the arm's chain to another table at which the data lie, and its standard deviation."""
    between = np.zeros((len(arm.links) + 1, 6))
    for k, (link, there) in enumerate(zip(arm.links, other.links, strict=True)):
        T = there @ np.linalg.inv(link)
        between[k] = np.concatenate([T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_rotvec()])
    column = np.einsum("k,krs->rs", between.ravel(), arm.twists)[None]
    share, std = estimated(arm, physics_columns(arm, skip=("links",)), column, options)
    return float(share[0]), float(std[0])


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
