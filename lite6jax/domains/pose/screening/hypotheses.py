"""What is wrong where poses miss the arm grossly: columns, zeros, signs, units, poses, the frame, or the tool.

A hypothesis is a tuple of changes, each a fault and what undoes it. All are compared on the nominal arm by the median
error of the poses, with frame and tool in closed form where they are free; the best are fitted, and one is taken only
where its log-likelihood exceeds that of the recording as it is declared, and of every other of the same kind.

With the arm fitted, another nominal table of the same model is one more hypothesis.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, final

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.description import bundled_arms, bundled_of, load_bundled
from lite6jax.calibration.problem import TOLERANCE
from lite6jax.calibration.start import measured_rotations
from lite6jax.domains.faults import (
    DECLARED,
    LIMIT_SLACK_RAD,
    Hypothesis,
    SuspectedFault,
    distinct,
    joined,
    listed,
    places,
    rounded_to_quarters,
    search,
    simplest,
)
from lite6jax.domains.pose.rigid_arm import RigidArm, rigid_arm, with_joints_of_touches
from lite6jax.domains.pose.screening.changes import (
    CODES,
    added,
    differ_by_turns,
    is_estimated,
    simplicity,
    single_changes,
    undo,
    with_zeros,
)
from lite6jax.domains.pose.screening.deviation import Deviation
from lite6jax.domains.pose.screening.projection import estimated, physics_columns
from lite6jax.domains.pose.screening.screened import ScreenedPoses
from lite6jax.domains.pose.screening.thresholds import MOST_FITTED, PUBLISHED_TOLERANCE, SUSPECT_REACH
from lite6jax.estimation.prior import Prior
from lite6jax.model import LEVER, ArmModel
from lite6jax.recordings import Recording
from lite6jax.recordings.alignment import frames_from_poses, median_distance
from lite6jax.recordings.fault import DataFault
from lite6jax.recordings.sequence import spread_rows

_SUSPECT_NOISE = 10.0
"""The suspect median error in standard deviations of the sensor; noise alone is below four."""
_COLUMN_GAIN = 5.0
"""Ratio by which a correction must reduce the median error, set beside large physics."""
_CORRECTED_REACH = 0.05
"""Share of the reach that a corrected error may be, as a clock offset in a fast motion leaves it."""
_EQUAL_RATIO = 1.5
"""Ratio of errors up to which corrections are alike; those of wrong columns differ more."""
_EQUAL_NOISE = 0.1
"""The same as a difference, in standard deviations: below the scatter of a median."""
_COLUMN_ROWS = 200
"""Rows on which single changes are compared; their median error is known to a tenth."""
_MANY = 600
"""Hypotheses at once, from which they are compared on fewer rows: of single changes there are some hundred."""
_PAIR_ROWS = 60
"""Rows on which so many are compared."""
_PAIRS_FIRST = 8
"""Best hypotheses that are joined with more changes, or fitted; bounds the time."""
_ZEROS_FIRST = 3
"""Best hypotheses beside which zeros of any angle are fitted; each takes a fit."""
_UNFITTED_RATIO = 2.0
"""Ratio to the allowed error up to which a hypothesis is fitted; closed forms are rough."""
_FITTED_RATIO = 3.0
"""Ratio to the least error up to which a hypothesis is fitted; a fit reorders few."""
_CLEARLY_NEARER = 20.0
"""Ratio of errors by which another arm must agree better; arms differ by some cm."""
_MOST_CHANGES = 3
"""Faults that a hypothesis joins, a set of signs counted as one; bounds the time."""
_WORTH_ANOTHER = 0.7
"""Ratio by which another change must reduce the error; a right one halves it."""
_BEYOND_GRANTED = 8.0
"""Times what factories grant, from which a fitted arm is not the declared one; real arms are below five."""
_LEAST_GROSS = 3.0
"""Times what factories grant, from which a zero, a frame or a tool is a fault; chains of one's own are below."""
_LEAST_SCALE = 1.005
"""Ratio from which a sensor's scale is sought as a fault; physics is below."""
_LARGEST_SCALE = 1100.0
"""Ratio up to which a sensor's scale is sought: millimetres that are read as metres."""
_SHARE_STD = 0.1
"""Standard deviation from which the share of the way to another table is vague: a tenth of the way."""
_SHARE_TOLERANCE = 0.1
"""The share's distance from 1, beside 4 deviations, as arms differ from tables."""
_SHARE_SIGMAS = 6.0
"""Deviations of the share from 0; tables differ hardly more than physics moves an arm."""
_TABLE_RATIO = 0.5
"""Ratio of residuals that decides where the share is vague; physics rarely halves them."""


def correct_mismatch(state: ScreenedPoses) -> ScreenedPoses:
    """The recording as the best hypothesis has it, where it misses the arm grossly as it is declared.

    It stays as it is where several hypotheses fit alike, or none does, or another bundled arm does.
    """
    arm = state.rigid_arm
    limit = max(SUSPECT_REACH * arm.arm.reach, _SUSPECT_NOISE * arm.noise[0])
    thinned = arm.select(spread_rows(arm.samples, _COLUMN_ROWS))
    error = median_error(thinned)
    touches = arm.recording.touches is not None
    if not touches and touches_one_point(arm.recording, arm.noise[0]):
        return _rule_out(state, error, limit, one_point=True)
    if error <= limit:
        return _rule_out(state, error, limit)
    allowed = min(error / _COLUMN_GAIN, _CORRECTED_REACH * arm.arm.reach)
    near = _search(thinned, allowed)
    nearest_name, nearest_error = (None, np.inf) if touches else _nearest_arm(thinned)
    unfitted = [median_error(_free_frames(thinned, undo(h, thinned.recording))) for h in near]
    if nearest_error <= min([allowed, error / _CLEARLY_NEARER, *unfitted]):
        numbers = {
            "declared": arm.arm.name,
            "arm": nearest_name,
            "median_error_m": error,
            "corrected_error_m": nearest_error,
        }
        return state.corrected(DataFault("other_arm", (), numbers))
    fits = {h: _rigid(state, undo(h, arm.recording)).fitted(MOST_FITTED) for h in near}
    errors = {h: median_error(fit) for h, fit in fits.items()}
    smallest = min(errors.values(), default=np.inf)
    # a chain that is not known may be further from its table than the limit, and fit the recording as it is
    recorded = arm.fitted(MOST_FITTED)
    fitted_error = median_error(recorded)
    if smallest > allowed:
        alternative = {"best_alternative_m": smallest} if fits else {}
        if fitted_error <= _CORRECTED_REACH * arm.arm.reach:
            return _rule_out(state, error, limit, fitted_error_m=fitted_error, **alternative)
        numbers = {"median_error_m": error, "fitted_error_m": fitted_error, "best_alternative_m": None} | alternative
        return state.corrected(DataFault("unexplained", (), numbers))
    equal_below = max(_EQUAL_RATIO * smallest, smallest + _EQUAL_NOISE * arm.noise[0])
    order = {h: (_outside_limits(state, h), *simplicity(h)) for h in near if errors[h] <= equal_below}
    equal = sorted(order, key=lambda h: order[h])
    chosen = equal[0]
    corrected = fits[chosen]
    scale = min(corrected.scale, recorded.scale)
    required = state.prior.cost("data_fault")
    gain = _deviation(state, corrected).log_likelihood(scale) - _deviation(state, recorded).log_likelihood(scale)
    if gain < required:
        return _rule_out(state, error, limit, fitted_error_m=fitted_error)
    others = [h for h in distinct(equal, differ_by_turns) if h != chosen and not places(h) > places(chosen)]
    tied = simplest(equal, lambda h: order[h][:3])
    likelihood = corrected.log_likelihood(scale)
    rivals = [h for h in others if h in tied and likelihood - fits[h].log_likelihood(scale) < required]
    alternatives = [chosen, *rivals] if rivals else others
    numbers = {
        "median_error_m": error,
        "corrected_error_m": smallest,
        "alternatives": listed([change.data_fault for change in hypothesis] for hypothesis in alternatives),
    }
    if rivals:
        return state.corrected(DataFault("undecided", (), numbers))
    refined = _refined(state, chosen, corrected)
    if not refined:  # a scale that is none: the chain is what misses
        return _rule_out(state, error, limit, fitted_error_m=fitted_error)
    return correct(state, refined, _rigid(state, undo(refined, arm.recording)), numbers)


def _refined(state: ScreenedPoses, hypothesis: Hypothesis, fitted: RigidArm) -> Hypothesis:
    """A hypothesis with its scale and its zeros, but for quarter turns, as all rows have them beside its prior."""
    of_values = [change for change in hypothesis if is_estimated(change)]
    deviation = _deviation(state, fitted)
    weighed = deviation.weighed(of_values)
    for change in of_values:
        hypothesis = added(hypothesis, deviation.valued(change, weighed))
    return tuple(change for change in hypothesis if change.code != "sensor_scale" or _is_gross_scale(change))


def correct(state: ScreenedPoses, hypothesis: Hypothesis, rigid: RigidArm, numbers: dict[str, Any]) -> ScreenedPoses:
    """The recording without the faults of a hypothesis.

    Args:
        state: before.
        hypothesis: what is wrong.
        rigid: the arm with the recording without it.
        numbers: of the mismatch, which go with the last fault.
    """
    board = state.recording.settings.board
    for change in hypothesis:
        fault_numbers = {**change.data_fault.numbers, **(numbers if change is hypothesis[-1] else {})}
        if change.code == "declared_frame":
            turned = Rotation.from_matrix(rigid.T_sensor_base[:3, :3]).as_rotvec()
            fault_numbers |= {"translation_m": rigid.T_sensor_base[:3, 3].tolist(), "rotation_rad": turned.tolist()}
        if change.code == "declared_tool":
            tool = np.linalg.inv(rigid.arm.T_joint_flange) @ rigid.T_flange_tool
            fault_numbers["translation_m"] = tool[:3, 3].tolist()
        if change.code == "sensor_scale" and board is not None:
            fault_numbers |= {"declared_m": board.square_m, "square_m": board.square_m / change.size}
        state = state.corrected(DataFault(change.code, (), fault_numbers), rigid=rigid)
    return state.transformed(partial(undo, hypothesis))


def _rule_out(state: ScreenedPoses, error: float, limit: float, **numbers: Any) -> ScreenedPoses:
    """Every hypothesis that the recording may have; the screen of turns speaks of turns."""
    recording = state.rigid_arm.recording
    tested = {change.code for hypothesis in single_changes(recording) for change in hypothesis} - {"joint_turns"}
    if recording.touches is None:
        tested.add("sensor_scale")
    codes = (code for code in CODES if code in tested)
    return state.rule_out(*codes, median_error_m=error, suspected_above_m=limit, **numbers)


def touches_one_point(recording: Recording, noise: float) -> bool:
    """Tells whether the measured positions `(sample, 3)` m are one point, which says nothing of scale or axes."""
    assert recording.position is not None
    return median_distance(recording.position) <= 3 * noise


@final
class _MedianErrors:
    """Hypotheses by the median error of the nominal arm, with frame and tool in closed form where they are free.

    Attributes:
        allowed: m, an error that explains the poses.
    """

    def __init__(self, thinned: RigidArm, allowed: float) -> None:
        self.allowed = allowed
        self._touched = thinned.recording.touches is not None
        self._fewer = thinned.select(spread_rows(thinned.samples, _PAIR_ROWS))
        self._rows = self._fewer if self._touched else thinned  # of touches each takes a fit of its places
        self.most_changes = 1 if self._touched else _MOST_CHANGES
        self._simple = list(single_changes(thinned.recording))
        if not self._touched:
            self._simple += _scales(self._fewer)

    def simple(self, changes: int) -> Sequence[Hypothesis]:
        """All."""
        return self._simple

    def costs(self, hypotheses: Sequence[Hypothesis]) -> dict[Hypothesis, float]:
        """The median error of each, m."""
        rows = self._fewer if len(hypotheses) > _MANY else self._rows
        return {h: median_error(_free_frames(rows, undo(h, rows.recording))) for h in hypotheses}

    def refined(self, costs: Mapping[Hypothesis, float], origins: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The best with zeros of any angle, where they leave much, or where a zero does what a frame or a tool does."""
        best = self.nearest(costs)
        missed = costs[best[0]] > _UNFITTED_RATIO * self.allowed
        if not missed and not any(change.code in DECLARED for change in best[0]):
            return []
        refined = []
        for h in [*(h for h in origins if not h), *best[:_ZEROS_FIRST]]:
            zeros = _zeros(self._rows, h)
            if zeros:
                refined.append(joined(tuple(c for c in h if c.code != "joint_turns"), zeros))
        return refined

    def nearest(self, costs: Mapping[Hypothesis, float]) -> list[Hypothesis]:
        """The best, but for those with zeros of any angle, which reduce some error of any arm."""
        apart = [h for h in costs if not any(c.code == "joint_turns" and is_estimated(c) for c in h)]
        return sorted(apart, key=lambda h: (costs[h], simplicity(h)))[:_PAIRS_FIRST]

    def suffices(self, nearest: Hypothesis, cost: float, before: float) -> bool:
        """Tells whether it explains the poses, or one more change hardly helped."""
        return cost <= _UNFITTED_RATIO * self.allowed or (before < np.inf and cost > _WORTH_ANOTHER * before)


def _search(thinned: RigidArm, allowed: float) -> list[Hypothesis]:
    """Hypotheses worth a fit, the best by error."""
    errors = search(_MedianErrors(thinned, allowed), {})
    smallest = min(errors.values(), default=np.inf)
    limit = max(_UNFITTED_RATIO * allowed, _FITTED_RATIO * smallest)
    # a number of any size reduces some error of any arm: `explain_deviation` judges what explains a part of it
    near = (h for h in errors if errors[h] <= (_UNFITTED_RATIO * allowed if any(map(is_estimated, h)) else limit))
    ranked = sorted(near, key=lambda h: (errors[h], simplicity(h)))
    return ranked[:_PAIRS_FIRST]


def _scales(thinned: RigidArm) -> list[Hypothesis]:
    """The scale of the sensor at which the nominal arm misses the poses least, where it is grossly wrong."""

    def error(log_scale: float) -> float:
        change = SuspectedFault("sensor_scale", (), float(np.exp(log_scale)))
        return median_error(_free_frames(thinned, undo((change,), thinned.recording)))

    bound = float(np.log(_LARGEST_SCALE))
    nearest: Any = minimize_scalar(error, bounds=(-bound, bound), method="bounded")
    log_scale = float(nearest.x)
    grossly = abs(log_scale) > np.log(_LEAST_SCALE)
    if grossly:
        return [(SuspectedFault("sensor_scale", (), float(np.exp(log_scale))),)]
    return []


def _zeros(thinned: RigidArm, hypothesis: Hypothesis) -> Hypothesis:
    """Zeros of joints that are off by more than a calibration corrects, of a fit of all of them."""
    arm = _free_frames(thinned, undo(hypothesis, thinned.recording))
    settings = arm.recording.settings
    dof = arm.recording.dof
    free_frame = settings.pose_frame != "base"
    free_tool = settings.tool == "unknown"
    if thinned.recording.touches is not None:
        free_frame = thinned.form.frame
    zeros = with_zeros(arm.recording)
    axes = range(max(arm.rows, 3))
    unknown = [("base", 0, k) for k in range(6)] * free_frame + [("tool", 0, k) for k in axes] * free_tool
    unknown += [("link", i, 5) if i < dof - 1 else ("tool", 0, 5) for i in zeros]
    reading_places = [k for k, (name, _, _) in enumerate(arm.unknown) if name == "reading"]
    precision = np.r_[np.zeros(len(unknown) - len(zeros)), np.ones(len(zeros)), arm.precision[reading_places]]
    offset = np.r_[np.zeros(len(unknown)), arm.offset[reading_places]]
    last = len(unknown)
    unknown += [arm.unknown[k] for k in reading_places]
    numbers = {"precision": precision, "offset": offset, "informative": precision > 0}
    fit = replace(arm, unknown=tuple(unknown), **numbers).fitted(thinned.samples)
    off = fit.offset[last - len(zeros) : last]
    total = {i: float(value) for i, value in zip(zeros, off, strict=True)}
    for change in (c for c in hypothesis if c.code == "joint_turns"):
        total[change.joints[0]] = total.get(change.joints[0], 0.0) + change.size
    changes = []
    for i, value in total.items():
        value = 0.0 if abs(value) < TOLERANCE["rad"] else rounded_to_quarters(value, TOLERANCE["rad"])
        changes += [SuspectedFault("joint_turns", (i,), value)] if value else []
    return tuple(changes)


def _nearest_arm(thinned: RigidArm) -> tuple[str | None, float]:
    """The other bundled arm whose nominal kinematics agree best, and its median error in m."""
    declared_tool = np.linalg.inv(thinned.arm.T_joint_flange) @ thinned.T_flange_tool
    errors = []
    for candidate in bundled_of(thinned.recording.dof):
        if candidate.sliding == thinned.recording.sliding and candidate.name != thinned.arm.name:
            tool = candidate.T_joint_flange @ declared_tool
            start = thinned.start._replace(geometry=candidate.kinematics.ravel(), T_flange_tool=tool)  # type: ignore[arg-type]
            errors.append(
                (
                    median_error(_free_frames(replace(thinned, arm=candidate, start=start), thinned.recording)),
                    candidate.name,
                )
            )
    error, name = min(errors, default=(np.inf, None))
    return name, error


def _deviation(state: ScreenedPoses, fitted: RigidArm) -> Deviation:
    return Deviation(fitted, _rigid(state, fitted.recording))


def _rigid(state: ScreenedPoses, recording: Recording) -> RigidArm:
    return rigid_arm(recording, state.rigid_arm.arm, state.geometry, state.factory)


def _free_frames(arm: RigidArm, recording: Recording) -> RigidArm:
    """The arm with another recording of as many rows, and frames in closed form as its settings leave them free."""
    if recording.touches is not None:
        return with_joints_of_touches(arm, recording)
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


def median_error(arm: RigidArm) -> float:
    return float(np.median(np.hypot(arm.distance, LEVER * arm.turn)))


def _outside_limits(state: ScreenedPoses, hypothesis: Hypothesis) -> int:
    """How many joint positions a hypothesis puts outside the limits."""
    arm = state.rigid_arm
    slack = LIMIT_SLACK_RAD
    q = undo(hypothesis, arm.recording).joint_position
    low, high = arm.arm.joint_limits.T
    return int(np.sum((q < low - slack) | (q > high + slack)))


# ------------------------------------------------------------------ what a fitted arm takes up


def explain_deviation(state: ScreenedPoses) -> ScreenedPoses:
    """The recording without the gross errors that its fitted arm takes up, one after the other, the likeliest first."""
    fitted = state.rigid_arm
    if all(name != "link" for name, _, _ in fitted.unknown):
        return state.rule_out("arm_deviation", reason="known")
    start = rigid_arm(fitted.recording, fitted.arm, state.geometry, state.factory)
    error = median_error(start)
    made: Hypothesis = ()
    alternatives: list[Hypothesis] = []
    for _ in range(fitted.recording.dof + 1):
        explained = _likeliest(Deviation(fitted, start), state.prior)
        if explained is None:
            break
        change, rivals = explained
        more = added(made, change)
        begun = rigid_arm(undo(more, state.recording), fitted.arm, state.geometry, state.factory)
        again = begun.fitted(MOST_FITTED)
        if again.scale > _EQUAL_RATIO * fitted.scale:  # the fit had taken up something else
            break
        alternatives += rivals
        made = more
        start = begun
        fitted = again
    if made:
        numbers: dict[str, Any] = {"median_error_m": error, "corrected_error_m": median_error(start)}
        numbers["alternatives"] = listed([c.data_fault for c in hypothesis] for hypothesis in alternatives)
        state = correct(state, made, fitted, numbers)
    numbers = Deviation(fitted, start).summary()
    if numbers["factor"] < _BEYOND_GRANTED:
        return state.rule_out("arm_deviation", reason="granted", **numbers)
    return state.corrected(DataFault("arm_deviation", (), numbers))


def _likeliest(deviation: Deviation, prior: Prior) -> tuple[SuspectedFault, list[Hypothesis]] | None:
    """The fault that explains the deviation best, and those that do as well; None where the arm's own prior does."""
    recording = deviation.arm.recording
    changes = [SuspectedFault("joint_turns", (joint,)) for joint in with_zeros(recording)]
    if recording.touches is None:
        changes.append(SuspectedFault("sensor_scale"))
        changes += [SuspectedFault("declared_frame")] * (not deviation.arm.form.frame)
        changes += [SuspectedFault("declared_tool")] * (not deviation.arm.form.tool)
    none = deviation.weighed(())
    weighed = {change: deviation.weighed((change,)) for change in changes}
    likeliest = max(weighed, key=lambda change: weighed[change].evidence)
    required = prior.cost("data_fault") + float(np.log(len(changes)))
    if weighed[likeliest].evidence - none.evidence < required:
        return None
    fits = {change: deviation.weighed((change,), [weighed[likeliest].factor]).fit for change in changes}
    comparable = [change for change in changes if fits[likeliest] - fits[change] < prior.cost("data_fault")]
    comparable.sort(key=lambda change: simplicity((change,)))
    valued = [deviation.valued(change, weighed[change]) for change in comparable]
    if valued[0].code == "sensor_scale":
        is_gross = _is_gross_scale(valued[0])
    else:  # by its displacement over what factories grant
        is_gross = deviation.share(comparable[0], weighed[comparable[0]]) > _LEAST_GROSS
    if not is_gross:  # a chain and a sensor do as much by themselves
        return None
    return valued[0], [(change,) for change in valued[1:]]


def _is_gross_scale(change: SuspectedFault) -> bool:
    return abs(np.log(change.size)) > np.log(_LEAST_SCALE)


# ------------------------------------------------------------------ another nominal table


def tables_of_model(name: str) -> list[Arm]:
    """The bundled tables of the model that an arm's name begins with: two of a lite6."""
    model = name.split("_")[0]
    return [load_bundled(table) for table in bundled_arms() if table.split("_")[0] == model]


def use_other_table(state: ScreenedPoses) -> ScreenedPoses:
    """Another table of the same model in the place of the one declared, where the data are of that one.

    Where they leave it open, the corrections decide. A declared chain that was asked for stays. Where it is a published
    table, the share of the way to the other table is estimated beside all physics; where that leaves it vague, the
    other table must halve the residuals. Where the chain is fitted, the other table must be likelier than the declared
    one, and than a fitted chain for its more numbers.
    """
    arm = state.rigid_arm
    tables = tables_of_model(arm.arm.name)
    declared = [arm.arm]
    if arm.exact:
        declared = [t for t in tables if np.abs(t.links - arm.links).max() < PUBLISHED_TOLERANCE]
    alternatives = [table for table in tables if declared and table.name != declared[0].name]
    if not alternatives:
        reason = "own_chain" if arm.exact else "single_table"
        return state.rule_out("nominal_table", reason=reason, declared=arm.arm.name)
    alternative = alternatives[0]
    vague = False
    numbers: dict[str, Any] = {"declared": declared[0].name, "table": alternative.name}
    theirs = _with_table(arm, alternative).fitted(MOST_FITTED)
    if arm.exact:
        # of the way from the declared table to the other at which the data lie
        between = np.zeros((len(arm.links) + 1, 6))
        T = alternative.links @ np.linalg.inv(arm.links)
        between[:-1, :3], between[:-1, 3:] = T[:, :3, 3], Rotation.from_matrix(T[:, :3, :3]).as_rotvec()
        column = np.einsum("k,krs->rs", between.ravel(), arm.twists)[None]
        share, std = (float(n[0]) for n in estimated(arm, physics_columns(arm, skip=("links",)), column))
        clear = std < _SHARE_STD or theirs.scale < _TABLE_RATIO * arm.scale
        at_alternative = abs(share - 1) < _SHARE_TOLERANCE + 4 * std and share > _SHARE_SIGMAS * std
        decided = bool(clear and at_alternative)
        likelier = bool(theirs.scale < arm.scale)
        vague = bool(np.isinf(std))
        numbers |= {"decided": decided} | ({"share": share, "share_std": std} if np.isfinite(std) else {})
    else:
        ours = _with_table(arm, arm.arm).fitted(MOST_FITTED)
        more = len(arm.unknown) - len(theirs.unknown)
        fitted = arm.log_likelihood(arm.scale) - 0.5 * more * np.log(arm.rows * arm.samples)
        required = max(fitted, ours.log_likelihood(arm.scale) + state.prior.cost("nominal_table"))
        decided = bool(theirs.log_likelihood(arm.scale) > required)
        likelier = False
        ratios = {"declared_ratio": ours.scale / arm.scale, "table_ratio": theirs.scale / arm.scale}
        numbers |= {"decided": decided} | ratios
    if not decided and alternative.name != state.corrections.table:
        reason = "indistinguishable" if vague else "declared_fits"
        return state.rule_out("nominal_table", reason=reason, likelier=likelier, **numbers, fitted=not arm.exact)
    recording = arm.recording
    nominal = arm.arm
    factory = state.factory
    used = "none"
    if not arm.exact or state.geometry == "declared":
        # its factory calibration was not that arm's
        settings = replace(recording.settings, factory_calibration=None, factory_uncertainty=None)
        if not settings.arm_is_file:
            settings = replace(settings, arm=alternative.name)
        recording = replace(recording, settings=settings)
        nominal = alternative
        factory = None
        used = "instead_of_file" if arm.exact else "table"
    fault = DataFault("nominal_table", (), numbers | {"used": used})
    return replace(state.corrected(fault, recording), arm=nominal, factory=factory)


def _with_table(arm: RigidArm, table: Arm) -> RigidArm:
    """With a chain that is not fitted, the sensor's frame and the tool as far as they are free, and its own numbers."""
    free_frame = arm.recording.settings.pose_frame != "base"
    mask = [name in ("tool", "reading") or (name == "base" and free_frame) for name, _, _ in arm.unknown]
    T = arm.T_sensor_base if free_frame else np.eye(4)  # a known one was displaced for the first link
    rows = np.array([frames.row_from_transform(link) for link in table.links])
    start = ArmModel(rows.ravel(), T, arm.T_flange_tool)  # type: ignore[arg-type]
    return replace(arm.keeping(mask), start=start)
