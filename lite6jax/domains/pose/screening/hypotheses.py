"""What is wrong where poses miss the arm grossly: columns, zeros, signs, units, poses, the frame, or the tool.

A hypothesis is a tuple of changes, each a fault and what undoes it. All are compared on the nominal arm by the median
error of the poses, with frame and tool in closed form where they are free; the best are fitted, and one is taken only
where its log-likelihood exceeds that of the recording as it is declared, and of every other of the same kind.

With the arm fitted, another nominal table of the same model is one more hypothesis.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, combinations
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.description import bundled_arms, bundled_of, load_bundled
from lite6jax.calibration.problem import TOLERANCE
from lite6jax.calibration.start import frames_from_poses, measured_rotations
from lite6jax.domains.pose.kinematics import unit_quaternions
from lite6jax.domains.pose.readings import median_distance
from lite6jax.domains.pose.rigid_arm import RigidArm, rigid_arm
from lite6jax.domains.pose.screening.options import ScreeningOptions
from lite6jax.domains.pose.screening.projection import estimated, physics_columns
from lite6jax.domains.pose.screening.screened import Screened
from lite6jax.model import LEVER, ArmModel
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault
from lite6jax.recordings.motion import with_joints
from lite6jax.recordings.sequence import spread_rows

Array = NDArray[np.floating]
Hypothesis = tuple["Change", ...]

DECLARED = ("declared_frame", "declared_tool")
POSES = ("inverted_poses", "mirrored_sensor", "orientation_convention")
JOINTS = ("swapped_joints", "joint_unit", "mirrored_joint", "coupled_joint", "joint_turns")
CODES = (*DECLARED, *POSES, *JOINTS)
"""The faults, in the order in which their changes are made. Of two that fit alike the earlier kind is preferred: a
declaration is wrong more often than poses, and poses more often than joints."""
_NUMBERS = {
    "coupled_joint": "factor",
    "joint_turns": "added_rad",
    "mirrored_sensor": "axes",
    "orientation_convention": "convention",
}
"""What the value of a change is called."""
_SCALAR_LAST = [3, 0, 1, 2]


@final
@dataclass(frozen=True)
class Change:
    """One fault, and what undoes it.

    Attributes:
        code: of `CODES`.
        joints: concerned, from 0: those swapped, or the joint and the one that it is coupled to.
        value: of a unit the factor of the column; of a coupling the factor of the other joint; of a zero what is
            added, rad; of a mirrored sensor the axis that is reversed or the two that are exchanged; of orientations
            the convention.
    """

    code: str
    joints: tuple[int, ...] = ()
    value: float | str = 1.0

    @property
    def numbers(self) -> dict[str, Any]:
        """Of the fault, as in `DataFault`."""
        joints = [joint + 1 for joint in self.joints]
        if self.code == "swapped_joints":
            return {"joints": joints}
        found: dict[str, Any] = {"joint": joints[0]} if joints else {}
        if self.code == "joint_unit":
            found["unit"] = "deg" if float(self.value) < 1 else "rad"
        if self.code == "coupled_joint":
            found["added_joint"] = joints[1]
        name = _NUMBERS.get(self.code)
        return found if name is None else found | {name: self.value}

    def undone(self, recording: Recording) -> Recording:
        """The recording without the fault."""
        if self.code in DECLARED:
            free = {"pose_frame": "unknown"} if self.code == "declared_frame" else {"tool": "unknown"}
            return replace(recording, settings=replace(recording.settings, **free))
        return self._poses(recording) if self.code in POSES else self._joints(recording)

    def _poses(self, recording: Recording) -> Recording:
        position, quaternion = recording.position, recording.quaternion
        assert position is not None
        convention = str(self.value)
        if convention.endswith("scalar_last") and quaternion is not None:
            quaternion = quaternion[:, _SCALAR_LAST]
        R = measured_rotations(replace(recording, quaternion=quaternion))
        if self.code == "mirrored_sensor":
            M = _reflection(convention)
            position, R = position @ M, None if R is None else M @ R @ M
        elif R is not None and (self.code == "inverted_poses" or convention.startswith("inverted")):
            R = np.swapaxes(R, 1, 2)
            position = -np.einsum("sij,sj->si", R, position) if self.code == "inverted_poses" else position
        return replace(recording, position=position, quaternion=None if R is None else unit_quaternions(R))

    def _joints(self, recording: Recording) -> Recording:
        """What is recorded of each joint, changed as its position is."""
        A, b = np.eye(recording.dof), np.zeros(recording.dof)
        i, j = (*self.joints, *self.joints)[:2]
        if self.code == "swapped_joints":
            A[[i, j]] = A[[j, i]]
        elif self.code == "mirrored_joint":
            A[i, i] = -1.0
        elif self.code == "joint_unit":
            A[i, i] = self.value
        elif self.code == "coupled_joint":
            A[i, j] = self.value
        else:
            b[i] = self.value
        effort = np.sign(A) if self.code != "coupled_joint" else np.linalg.inv(A).T  # power stays the same
        return with_joints(recording, A, b, effort)


def undo(hypothesis: Hypothesis, recording: Recording) -> Recording:
    """The recording without the faults of a hypothesis."""
    for change in hypothesis:
        recording = change.undone(recording)
    return recording


def correct_mismatch(state: Screened) -> Screened:
    """The recording as the best hypothesis has it, where it misses the arm grossly as it is declared.

    It stays as it is where several hypotheses fit alike, or none does, or another bundled arm does.
    """
    arm, options = state.rigid_arm, state.options
    limit = max(options.suspect_reach * arm.arm.reach, options.suspect_noise * arm.noise[0])
    few = arm.select(spread_rows(arm.samples, options.column_rows))
    error = _median_error(few)
    if touches_one_point(arm.recording, arm.noise[0]):
        return _rule_out(state, error, limit, one_point=True)
    if error <= limit:
        return _rule_out(state, error, limit)
    allowed = min(error / options.column_gain, options.corrected_reach * arm.arm.reach)
    near = _search(few, options, allowed)
    other, left = _nearest_arm(few)
    unfitted = [_median_error(_free_frames(few, undo(h, few.recording))) for h in near]
    if left <= min([allowed, error / options.clearly_nearer, *unfitted]):
        numbers = {"declared": arm.arm.name, "arm": other, "median_error_m": error, "corrected_error_m": left}
        return state.corrected(DataFault("other_arm", (), numbers))
    fits = [(h, _rigid(state, undo(h, arm.recording)).fitted(options.most_fitted)) for h in near]
    errors = [_median_error(fit) for _, fit in fits]
    least = min(errors, default=np.inf)
    # a chain that is not known may be further from its table than the limit, and fit the recording as it is
    recorded = arm.fitted(options.most_fitted)
    fitted_error = _median_error(recorded)
    if least > allowed:
        best = {"best_alternative_m": least} if fits else {}
        if fitted_error <= options.corrected_reach * arm.arm.reach:
            return _rule_out(state, error, limit, fitted_error_m=fitted_error, **best)
        numbers = {"median_error_m": error, "fitted_error_m": fitted_error, "best_alternative_m": None} | best
        return state.corrected(DataFault("unexplained", (), numbers))
    equal_below = max(options.equal_ratio * least, least + options.equal_noise * arm.noise[0])
    equal = [fit for fit, left in zip(fits, errors, strict=True) if left <= equal_below]
    equal.sort(key=lambda one: (_outside_limits(state, one[0]), _simplicity(one[0])))
    chosen, corrected = equal[0]
    scale = min(corrected.scale, recorded.scale)
    more = 0.5 * np.log(arm.rows * arm.samples) * (len(corrected.unknown) - len(recorded.unknown))
    if corrected.log_likelihood(scale) - recorded.log_likelihood(scale) < options.trusted_log_likelihood + more:
        return _rule_out(state, error, limit, fitted_error_m=fitted_error)
    distinct, rivals = [chosen], []
    for hypothesis, fit in equal[1:]:
        if any(_whole_turns_apart(hypothesis, other) for other in distinct):
            continue
        distinct.append(hypothesis)
        alike = _simplicity(hypothesis)[:2] == _simplicity(chosen)[:2]
        alike &= _outside_limits(state, hypothesis) == _outside_limits(state, chosen)
        if alike and corrected.log_likelihood(scale) - fit.log_likelihood(scale) < options.trusted_log_likelihood:
            rivals.append(hypothesis)
    others = [chosen, *rivals] if rivals else distinct[1:]
    alternatives = [[{"fault": change.code, **change.numbers} for change in one] for one in others]
    numbers = {"median_error_m": error, "corrected_error_m": least, "alternatives": alternatives}
    if rivals:
        return state.corrected(DataFault("undecided", (), numbers))
    rigid = _rigid(state, undo(chosen, arm.recording))
    for change in chosen:
        own = change.numbers | (numbers if change is chosen[-1] else {})
        if change.code == "declared_frame":
            turned = Rotation.from_matrix(rigid.T_sensor_base[:3, :3]).as_rotvec()
            own |= {"translation_m": rigid.T_sensor_base[:3, 3].tolist(), "rotation_rad": turned.tolist()}
        if change.code == "declared_tool":
            tool = np.linalg.inv(arm.arm.T_joint_flange) @ rigid.T_flange_tool
            own["translation_m"] = tool[:3, 3].tolist()
        state = state.corrected(DataFault(change.code, (), own), rigid=rigid)
    return state.transformed(partial(undo, chosen))


def _rule_out(state: Screened, error: float, limit: float, **numbers: Any) -> Screened:
    """Every hypothesis that the settings and the number of joints leave; the screen of turns speaks of turns."""
    settings = state.rigid_arm.recording.settings
    missing = {"joint_turns"}
    missing |= {"orientation_convention", "inverted_poses"} if state.rigid_arm.rows == 3 else set()
    missing |= {"declared_frame"} if settings.pose_frame != "base" else set()
    missing |= {"declared_tool"} if settings.tool == "unknown" else set()
    missing |= {"swapped_joints", "coupled_joint"} if state.rigid_arm.recording.dof == 1 else set()
    codes = (code for code in CODES if code not in missing)
    return state.rule_out(*codes, median_error_m=error, suspected_above_m=limit, **numbers)


def touches_one_point(recording: Recording, noise: float) -> bool:
    """Whether the measured positions `(sample, 3)` m are one point, which says nothing of scale or axes."""
    assert recording.position is not None
    return median_distance(recording.position) <= 3 * noise


def single_changes(recording: Recording) -> Iterator[Hypothesis]:
    """Every simple hypothesis: each fault alone, and reversed signs of any set of joints."""
    dof, settings = recording.dof, recording.settings
    turning = [i for i in range(dof) if i not in recording.sliding]
    if settings.pose_frame == "base":
        yield (Change("declared_frame"),)
    if settings.tool != "unknown":
        yield (Change("declared_tool"),)
    axes = ("x", "y", "z", "xy", "yz", "xz") if settings.pose_frame == "base" else ("z",)
    yield from ((Change("mirrored_sensor", (), axis),) for axis in axes)
    if recording.quaternion is not None:
        yield (Change("inverted_poses"),)
        for convention in ("inverted", "scalar_last", "inverted_scalar_last"):
            yield (Change("orientation_convention", (), convention),)
    for pair in combinations(range(dof), 2):
        yield (Change("swapped_joints", pair),)
    most = dof if dof <= 8 else 2  # of more joints there are too many sets
    for joints in chain.from_iterable(combinations(range(dof), count) for count in range(1, most + 1)):
        yield tuple(Change("mirrored_joint", (i,)) for i in joints)
    for i in turning:
        yield from ((Change("joint_unit", (i,), factor),) for factor in (np.pi / 180, 180 / np.pi))
    for i in _with_zeros(recording):
        for quarters in (2, -2, 1, -1):
            zero = Change("joint_turns", (i,), quarters * np.pi / 2)
            yield (zero,)
            yield (Change("mirrored_joint", (i,)), zero)
    for i in turning:
        for j in {i - 1, i + 1} & set(turning):
            yield from ((Change("coupled_joint", (i, j), sign),) for sign in (1.0, -1.0))


def _search(few: RigidArm, options: ScreeningOptions, allowed: float) -> list[Hypothesis]:
    """Hypotheses worth a fit: the best by error, of few changes first, more only where fewer do not suffice."""
    simple = list(single_changes(few.recording))
    beam: list[Hypothesis] = [()]
    best: dict[Hypothesis, float] = {}
    for changes in range(options.most_changes):
        rows = few if not changes else few.select(spread_rows(few.samples, options.pair_rows))
        tried = {_joined(h, more) for h in beam for more in simple if _compatible(h, more)}
        scored = {h: _median_error(_free_frames(rows, undo(h, rows.recording))) for h in tried}
        beam = sorted(scored, key=lambda h: (scored[h], _simplicity(h)))[: options.pairs_first]
        if not beam:
            break
        missed = scored[beam[0]] > options.unfitted_ratio * allowed
        for h in [*([()] if not changes else []), *beam[: options.zeros_first]] if missed else ():
            zeros = _zeros(rows, h)
            if zeros:
                refined = _joined(tuple(c for c in h if c.code != "joint_turns"), zeros)
                scored[refined] = _median_error(_free_frames(rows, undo(refined, rows.recording)))
        least = min(scored.values())
        stuck = bool(best) and least > options.worth_another * min(best.values())
        best |= scored
        if least <= options.unfitted_ratio * allowed or stuck:
            break
    least = min(best.values(), default=np.inf)
    worth = max(options.unfitted_ratio * allowed, options.fitted_ratio * least)
    ranked = sorted((h for h in best if best[h] <= worth), key=lambda h: (best[h], _simplicity(h)))
    return ranked[: options.pairs_first]


def _zeros(few: RigidArm, hypothesis: Hypothesis) -> Hypothesis:
    """Zeros of joints that are off by more than a calibration corrects, of a fit of all of them."""
    arm = _free_frames(few, undo(hypothesis, few.recording))
    settings, dof = arm.recording.settings, arm.recording.dof
    free_frame, free_tool = settings.pose_frame != "base", settings.tool == "unknown"
    zeros = _with_zeros(arm.recording)
    unknown = [("base", 0, k) for k in range(6)] * free_frame + [("tool", 0, k) for k in range(arm.rows)] * free_tool
    unknown += [("link", i, 5) if i < dof - 1 else ("tool", 0, 5) for i in zeros]
    own = [k for k, (name, _, _) in enumerate(arm.unknown) if name == "reading"]
    precision = np.r_[np.zeros(len(unknown) - len(zeros)), np.ones(len(zeros)), arm.precision[own]]
    offset, last = np.r_[np.zeros(len(unknown)), arm.offset[own]], len(unknown)
    unknown += [arm.unknown[k] for k in own]
    numbers = {"precision": precision, "offset": offset, "informative": precision > 0}
    fit = replace(arm, unknown=tuple(unknown), **numbers).fitted(few.samples)
    off = fit.offset[last - len(zeros) : last]
    total = {i: float(value) for i, value in zip(zeros, off, strict=True)}
    for change in (c for c in hypothesis if c.code == "joint_turns"):
        total[change.joints[0]] = total.get(change.joints[0], 0.0) + float(change.value)
    changes = []
    for i, value in total.items():
        quarters = np.round(value / (np.pi / 2)) * np.pi / 2
        value = float(quarters if abs(value - quarters) < TOLERANCE["rad"] else value)
        changes += [Change("joint_turns", (i,), value)] if value else []
    return tuple(changes)


def _nearest_arm(few: RigidArm) -> tuple[str | None, float]:
    """The other bundled arm whose nominal kinematics agree best, and its median error in m."""
    declared_tool = np.linalg.inv(few.arm.T_joint_flange) @ few.T_flange_tool
    errors = []
    for one in bundled_of(few.recording.dof):
        if one.sliding == few.recording.sliding and one.name != few.arm.name:
            tool = one.T_joint_flange @ declared_tool
            start = few.start._replace(geometry=one.kinematics.ravel(), T_flange_tool=tool)  # type: ignore[arg-type]
            errors.append((_median_error(_free_frames(replace(few, arm=one, start=start), few.recording)), one.name))
    error, name = min(errors, default=(np.inf, None))
    return name, error


def _with_zeros(recording: Recording) -> list[int]:
    """The joints whose zeros the poses show: a free frame and a free tool take up those of the first and the last."""
    first, last = recording.settings.pose_frame != "base", recording.settings.tool == "unknown"
    return [i for i in range(int(first), recording.dof - int(last)) if i not in recording.sliding]


def _rigid(state: Screened, recording: Recording) -> RigidArm:
    return rigid_arm(recording, state.rigid_arm.arm, state.geometry, state.factory)


def _free_frames(arm: RigidArm, recording: Recording) -> RigidArm:
    """The arm with another recording of as many rows, and frames in closed form as its settings leave them free."""
    flange = frames.chain(arm.links, recording.joint_position, recording.sliding) @ arm.arm.T_joint_flange
    assert recording.position is not None
    known_tool = np.linalg.inv(arm.arm.T_joint_flange) @ arm.T_flange_tool
    T_frame, T_tool = frames_from_poses(
        flange,
        recording.position,
        measured_rotations(recording),
        arm.T_sensor_base if recording.settings.pose_frame == "base" else None,
        None if recording.settings.tool == "unknown" else known_tool,
    )
    tool = arm.arm.T_joint_flange @ T_tool
    start = arm.start._replace(T_sensor_base=T_frame, T_flange_tool=tool)  # type: ignore[arg-type]
    return replace(arm.with_poses(recording), start=start)


def _median_error(arm: RigidArm) -> float:
    return float(np.median(np.hypot(arm.distance, LEVER * arm.turn)))


def _joined(hypothesis: Hypothesis, more: Hypothesis) -> Hypothesis:
    """Both, in the order in which changes are made; each once."""
    return tuple(sorted({*hypothesis, *more}, key=lambda c: (CODES.index(c.code), c.joints)))


def _compatible(hypothesis: Hypothesis, more: Hypothesis) -> bool:
    """Whether no change of one repeats or takes back one of the other."""
    made = {(c.code, frozenset(c.joints)) for c in hypothesis}
    poses = {c.code for c in hypothesis if c.code in POSES}
    return not any((c.code, frozenset(c.joints)) in made or (c.code in POSES and poses) for c in more)


def _simplicity(hypothesis: Hypothesis) -> tuple[int, int, tuple[int, ...]]:
    """The fewer the changes and the earlier their kind in `CODES`, the less."""
    kinds = [0 if c.code in DECLARED else 1 if c.code in POSES else 2 for c in hypothesis]
    return len(hypothesis), max(kinds, default=0), tuple(CODES.index(c.code) for c in hypothesis)


def _outside_limits(state: Screened, hypothesis: Hypothesis) -> int:
    """How many joint positions a hypothesis puts outside the limits."""
    arm, slack = state.rigid_arm, state.options.limit_slack_rad
    q, (low, high) = undo(hypothesis, arm.recording).joint_position, arm.arm.joint_limits.T
    return int(np.sum((q < low - slack) | (q > high + slack)))


def _whole_turns_apart(a: Hypothesis, b: Hypothesis) -> bool:
    """Whether two hypotheses differ by whole turns of joints, or by no more than a calibration corrects."""
    rest_a, rest_b = (tuple(c for c in h if c.code != "joint_turns") for h in (a, b))
    zeros_a, zeros_b = ({c.joints[0]: float(c.value) for c in h if c.code == "joint_turns"} for h in (a, b))
    apart = [(zeros_a.get(i, 0.0) - zeros_b.get(i, 0.0)) / (2 * np.pi) for i in {*zeros_a, *zeros_b}]
    return rest_a == rest_b and bool(np.allclose(apart, np.round(apart), atol=TOLERANCE["rad"] / (2 * np.pi)))


def _reflection(axes: str) -> Array:
    """`(3, 3)`: one axis reversed, or two exchanged."""
    M, places = np.eye(3), ["xyz".index(axis) for axis in axes]
    M[places] = M[places[::-1]] if len(places) > 1 else -M[places]
    return M


# ------------------------------------------------------------------ another nominal table


def tables_of_model(name: str) -> list[Arm]:
    """The bundled tables of the model that an arm's name begins with: two of a lite6."""
    model = name.split("_")[0]
    return [load_bundled(other) for other in bundled_arms() if other.split("_")[0] == model]


def use_other_table(state: Screened) -> Screened:
    """Another table of the same model in the place of the one declared, where the data are of that one.

    Where they leave it open, the corrections decide. A declared chain that was asked for stays. Where it is a published
    table, the share of the way to the other table is estimated beside all physics; where that leaves it vague, the
    other table must halve the residuals. Where the chain is fitted, the other table must be likelier than the declared
    one, and than a fitted chain for its more numbers.
    """
    arm, options = state.rigid_arm, state.options
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
        # of the way from the declared table to the other at which the data lie
        between = np.zeros((len(arm.links) + 1, 6))
        T = other.links @ np.linalg.inv(arm.links)
        between[:-1, :3], between[:-1, 3:] = T[:, :3, 3], Rotation.from_matrix(T[:, :3, :3]).as_rotvec()
        column = np.einsum("k,krs->rs", between.ravel(), arm.twists)[None]
        share, std = (float(n[0]) for n in estimated(arm, physics_columns(arm, skip=("links",)), column, options))
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


def _with_table(arm: RigidArm, table: Arm) -> RigidArm:
    """With a chain that is not fitted, the sensor's frame and the tool as far as they are free, and its own numbers."""
    free_frame = arm.recording.settings.pose_frame != "base"
    kept = [name in ("tool", "reading") or (name == "base" and free_frame) for name, _, _ in arm.unknown]
    T = arm.T_sensor_base if free_frame else np.eye(4)  # a known one was displaced for the first link
    rows = np.array([frames.row_from_transform(link) for link in table.links])
    start = ArmModel(rows.ravel(), T, arm.T_flange_tool)  # type: ignore[arg-type]
    return replace(arm.keeping(kept), start=start)
