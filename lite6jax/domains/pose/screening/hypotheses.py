"""What is wrong where poses miss the arm grossly: columns, zeros, signs, units, poses, the frame, or the tool.

A hypothesis is a tuple of changes, each a fault and what undoes it. All are compared on the nominal arm by the median
error of the poses, with frame and tool in closed form where they are free; the best are fitted, and one is taken only
where its log-likelihood exceeds that of the recording as it is declared, and of every other of the same kind.

With the arm fitted, another nominal table of the same model is one more hypothesis.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.description import bundled_arms, bundled_of, load_bundled
from lite6jax.calibration.problem import TOLERANCE
from lite6jax.calibration.start import frames_from_poses, measured_rotations
from lite6jax.domains.pose.readings import median_distance
from lite6jax.domains.pose.rigid_arm import RigidArm, rigid_arm, with_joints_of_touches
from lite6jax.domains.pose.screening.changes import (
    CODES,
    DECLARED,
    POSES,
    Hypothesis,
    PoseFault,
    added,
    compatible,
    contains,
    differ_by_turns,
    is_estimated,
    joined,
    listed,
    rounded_to_quarters,
    simplicity,
    single_changes,
    undo,
    with_zeros,
)
from lite6jax.domains.pose.screening.deviation import Deviation
from lite6jax.domains.pose.screening.options import ScreeningOptions
from lite6jax.domains.pose.screening.projection import estimated, physics_columns
from lite6jax.domains.pose.screening.screened import Screened
from lite6jax.model import LEVER, ArmModel
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault
from lite6jax.recordings.sequence import spread_rows

Array = NDArray[np.floating]


def correct_mismatch(state: Screened) -> Screened:
    """The recording as the best hypothesis has it, where it misses the arm grossly as it is declared.

    It stays as it is where several hypotheses fit alike, or none does, or another bundled arm does.
    """
    arm = state.rigid_arm
    options = state.options
    limit = max(options.suspect_reach * arm.arm.reach, options.suspect_noise * arm.noise[0])
    thinned = arm.select(spread_rows(arm.samples, options.column_rows))
    error = median_error(thinned)
    touches = arm.recording.touches is not None
    if not touches and touches_one_point(arm.recording, arm.noise[0]):
        return _rule_out(state, error, limit, one_point=True)
    if error <= limit:
        return _rule_out(state, error, limit)
    allowed = min(error / options.column_gain, options.corrected_reach * arm.arm.reach)
    near = _search(thinned, options, allowed)
    nearest_name, nearest_error = (None, np.inf) if touches else _nearest_arm(thinned)
    unfitted = [median_error(_free_frames(thinned, undo(h, thinned.recording))) for h in near]
    if nearest_error <= min([allowed, error / options.clearly_nearer, *unfitted]):
        numbers = {
            "declared": arm.arm.name,
            "arm": nearest_name,
            "median_error_m": error,
            "corrected_error_m": nearest_error,
        }
        return state.corrected(DataFault("other_arm", (), numbers))
    fits = [(h, _rigid(state, undo(h, arm.recording)).fitted(options.most_fitted)) for h in near]
    errors = [median_error(fit) for _, fit in fits]
    smallest = min(errors, default=np.inf)
    # a chain that is not known may be further from its table than the limit, and fit the recording as it is
    recorded = arm.fitted(options.most_fitted)
    fitted_error = median_error(recorded)
    if smallest > allowed:
        alternative = {"best_alternative_m": smallest} if fits else {}
        if fitted_error <= options.corrected_reach * arm.arm.reach:
            return _rule_out(state, error, limit, fitted_error_m=fitted_error, **alternative)
        numbers = {"median_error_m": error, "fitted_error_m": fitted_error, "best_alternative_m": None} | alternative
        return state.corrected(DataFault("unexplained", (), numbers))
    equal_below = max(options.equal_ratio * smallest, smallest + options.equal_noise * arm.noise[0])
    equal = [fit for fit, fit_error in zip(fits, errors, strict=True) if fit_error <= equal_below]
    equal.sort(key=lambda pair: (_outside_limits(state, pair[0]), simplicity(pair[0])))
    chosen, corrected = equal[0]
    scale = min(corrected.scale, recorded.scale)
    gain = _deviation(state, corrected).log_likelihood(scale) - _deviation(state, recorded).log_likelihood(scale)
    if gain < options.prior.cost("data_fault"):
        return _rule_out(state, error, limit, fitted_error_m=fitted_error)
    distinct = [chosen]
    rivals = []
    for hypothesis, fit in equal[1:]:
        if any(differ_by_turns(hypothesis, accepted) for accepted in distinct) or contains(hypothesis, chosen):
            continue
        distinct.append(hypothesis)
        equally_simple = simplicity(hypothesis)[:2] == simplicity(chosen)[:2]
        equally_simple &= _outside_limits(state, hypothesis) == _outside_limits(state, chosen)
        if equally_simple and corrected.log_likelihood(scale) - fit.log_likelihood(scale) < options.prior.cost(
            "data_fault"
        ):
            rivals.append(hypothesis)
    alternatives = [chosen, *rivals] if rivals else distinct[1:]
    numbers = {"median_error_m": error, "corrected_error_m": smallest, "alternatives": listed(alternatives)}
    if rivals:
        return state.corrected(DataFault("undecided", (), numbers))
    refined = _refined(state, chosen, corrected)
    if not refined:  # a scale that is none: the chain is what misses
        return _rule_out(state, error, limit, fitted_error_m=fitted_error)
    return correct(state, refined, _rigid(state, undo(refined, arm.recording)), numbers)


def _refined(state: Screened, hypothesis: Hypothesis, fitted: RigidArm) -> Hypothesis:
    """A hypothesis with its scale and its zeros, but for quarter turns, as all rows have them beside its prior."""
    of_values = [change for change in hypothesis if is_estimated(change)]
    deviation = _deviation(state, fitted)
    weighed = deviation.weighed(of_values)
    for change in of_values:
        hypothesis = added(hypothesis, deviation.valued(change, weighed))
    return tuple(
        change for change in hypothesis if change.code != "sensor_scale" or _is_gross_scale(change, state.options)
    )


def correct(state: Screened, hypothesis: Hypothesis, rigid: RigidArm, numbers: dict[str, Any]) -> Screened:
    """The recording without the faults of a hypothesis.

    Args:
        state: before.
        hypothesis: what is wrong.
        rigid: the arm with the recording without it.
        numbers: of the mismatch, which go with the last fault.
    """
    board = state.recording.settings.board
    for change in hypothesis:
        fault_numbers = change.numbers | (numbers if change is hypothesis[-1] else {})
        if change.code == "declared_frame":
            turned = Rotation.from_matrix(rigid.T_sensor_base[:3, :3]).as_rotvec()
            fault_numbers |= {"translation_m": rigid.T_sensor_base[:3, 3].tolist(), "rotation_rad": turned.tolist()}
        if change.code == "declared_tool":
            tool = np.linalg.inv(rigid.arm.T_joint_flange) @ rigid.T_flange_tool
            fault_numbers["translation_m"] = tool[:3, 3].tolist()
        if change.code == "sensor_scale" and board is not None:
            fault_numbers |= {"declared_m": board.square_m, "square_m": board.square_m / float(change.value)}
        state = state.corrected(DataFault(change.code, (), fault_numbers), rigid=rigid)
    return state.transformed(partial(undo, hypothesis))


def _rule_out(state: Screened, error: float, limit: float, **numbers: Any) -> Screened:
    """Every hypothesis that the settings and the number of joints leave; the screen of turns speaks of turns."""
    settings = state.rigid_arm.recording.settings
    missing = {"joint_turns"}
    missing |= {"orientation_convention", "inverted_poses"} if state.rigid_arm.rows == 3 else set()
    missing |= {*DECLARED, *POSES} if state.rigid_arm.recording.touches is not None else set()
    missing |= {"declared_frame"} if settings.pose_frame != "base" else set()
    missing |= {"declared_tool"} if settings.tool == "unknown" else set()
    missing |= {"swapped_joints", "coupled_joint"} if state.rigid_arm.recording.dof == 1 else set()
    codes = (code for code in CODES if code not in missing)
    return state.rule_out(*codes, median_error_m=error, suspected_above_m=limit, **numbers)


def touches_one_point(recording: Recording, noise: float) -> bool:
    """Whether the measured positions `(sample, 3)` m are one point, which says nothing of scale or axes."""
    assert recording.position is not None
    return median_distance(recording.position) <= 3 * noise


def _search(thinned: RigidArm, options: ScreeningOptions, allowed: float) -> list[Hypothesis]:
    """Hypotheses worth a fit: the best by error, of few changes first, more only where fewer do not suffice."""
    simple = list(single_changes(thinned.recording))
    touches = thinned.recording.touches is not None
    if touches:  # each hypothesis takes a fit of its places
        thinned = thinned.select(spread_rows(thinned.samples, options.pair_rows))
    else:
        simple += _scales(thinned, options)
    beam: list[Hypothesis] = [()]
    errors: dict[Hypothesis, float] = {}
    for changes in range(1 if touches else options.most_changes):
        rows = thinned if not changes else thinned.select(spread_rows(thinned.samples, options.pair_rows))
        candidates = {joined(h, more) for h in beam for more in simple if compatible(h, more)}
        scored = {h: median_error(_free_frames(rows, undo(h, rows.recording))) for h in candidates}
        beam = sorted(scored, key=lambda h: (scored[h], simplicity(h)))[: options.pairs_first]
        if not beam:
            break
        missed = scored[beam[0]] > options.unfitted_ratio * allowed
        missed |= any(change.code in DECLARED for change in beam[0])  # a zero does what a frame or a tool does
        for h in [*([()] if not changes else []), *beam[: options.zeros_first]] if missed else ():
            zeros = _zeros(rows, h)
            if zeros:
                refined = joined(tuple(c for c in h if c.code != "joint_turns"), zeros)
                scored[refined] = median_error(_free_frames(rows, undo(refined, rows.recording)))
        smallest = min(scored.values())
        stuck = bool(errors) and smallest > options.worth_another * min(errors.values())
        errors |= scored
        if smallest <= options.unfitted_ratio * allowed or stuck:
            break
    smallest = min(errors.values(), default=np.inf)
    limit = max(options.unfitted_ratio * allowed, options.fitted_ratio * smallest)
    # a number of any size reduces some error of any arm: `explain_deviation` judges what explains a part of it
    near = (
        h for h in errors if errors[h] <= (options.unfitted_ratio * allowed if any(map(is_estimated, h)) else limit)
    )
    ranked = sorted(near, key=lambda h: (errors[h], simplicity(h)))
    return ranked[: options.pairs_first]


def _scales(thinned: RigidArm, options: ScreeningOptions) -> list[Hypothesis]:
    """The scale of the sensor at which the nominal arm misses the poses least, where it is grossly wrong."""
    thinned = thinned.select(spread_rows(thinned.samples, options.pair_rows))

    def error(log_scale: float) -> float:
        change = PoseFault("sensor_scale", (), float(np.exp(log_scale)))
        return median_error(_free_frames(thinned, change.undone(thinned.recording)))

    bound = float(np.log(options.largest_scale))
    nearest: Any = minimize_scalar(error, bounds=(-bound, bound), method="bounded")
    log_scale = float(nearest.x)
    grossly = abs(log_scale) > np.log(options.least_scale)
    return [(PoseFault("sensor_scale", (), float(np.exp(log_scale))),)] if grossly else []


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
        total[change.joints[0]] = total.get(change.joints[0], 0.0) + float(change.value)
    changes = []
    for i, value in total.items():
        value = 0.0 if abs(value) < TOLERANCE["rad"] else rounded_to_quarters(value)
        changes += [PoseFault("joint_turns", (i,), value)] if value else []
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


def _deviation(state: Screened, fitted: RigidArm) -> Deviation:
    return Deviation(fitted, _rigid(state, fitted.recording))


def _rigid(state: Screened, recording: Recording) -> RigidArm:
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


def _outside_limits(state: Screened, hypothesis: Hypothesis) -> int:
    """How many joint positions a hypothesis puts outside the limits."""
    arm = state.rigid_arm
    slack = state.options.limit_slack_rad
    q = undo(hypothesis, arm.recording).joint_position
    low, high = arm.arm.joint_limits.T
    return int(np.sum((q < low - slack) | (q > high + slack)))


# ------------------------------------------------------------------ what a fitted arm takes up


def explain_deviation(state: Screened) -> Screened:
    """The recording without the gross errors that its fitted arm takes up, one after the other, the likeliest first."""
    fitted = state.rigid_arm
    options = state.options
    if all(name != "link" for name, _, _ in fitted.unknown):
        return state.rule_out("arm_deviation", reason="known")
    start = rigid_arm(fitted.recording, fitted.arm, state.geometry, state.factory)
    error = median_error(start)
    made: Hypothesis = ()
    alternatives: list[Hypothesis] = []
    for _ in range(fitted.recording.dof + 1):
        explained = _likeliest(Deviation(fitted, start), options)
        if explained is None:
            break
        change, rivals = explained
        more = added(made, change)
        begun = rigid_arm(undo(more, state.recording), fitted.arm, state.geometry, state.factory)
        again = begun.fitted(options.most_fitted)
        if again.scale > options.equal_ratio * fitted.scale:  # the fit had taken up something else
            break
        alternatives += rivals
        made = more
        start = begun
        fitted = again
    if made:
        numbers: dict[str, Any] = {"median_error_m": error, "corrected_error_m": median_error(start)}
        numbers["alternatives"] = listed(alternatives)
        state = correct(state, made, fitted, numbers)
    numbers = Deviation(fitted, start).summary()
    if numbers["factor"] < options.beyond_granted:
        return state.rule_out("arm_deviation", reason="granted", **numbers)
    return state.corrected(DataFault("arm_deviation", (), numbers))


def _likeliest(deviation: Deviation, options: ScreeningOptions) -> tuple[PoseFault, list[Hypothesis]] | None:
    """The fault that explains the deviation best, and those that do as well; None where the arm's own prior does."""
    recording = deviation.arm.recording
    changes = [PoseFault("joint_turns", (joint,)) for joint in with_zeros(recording)]
    if recording.touches is None:
        changes.append(PoseFault("sensor_scale"))
        changes += [PoseFault("declared_frame")] * (not deviation.arm.form.frame)
        changes += [PoseFault("declared_tool")] * (not deviation.arm.form.tool)
    none = deviation.weighed(())
    weighed = {change: deviation.weighed((change,)) for change in changes}
    likeliest = max(weighed, key=lambda change: weighed[change].evidence)
    required = options.prior.cost("data_fault") + float(np.log(len(changes)))
    if weighed[likeliest].evidence - none.evidence < required:
        return None
    fits = {change: deviation.weighed((change,), [weighed[likeliest].factor]).fit for change in changes}
    comparable = [change for change in changes if fits[likeliest] - fits[change] < options.prior.cost("data_fault")]
    comparable.sort(key=lambda change: simplicity((change,)))
    valued = [deviation.valued(change, weighed[change]) for change in comparable]
    if valued[0].code == "sensor_scale":
        is_gross = _is_gross_scale(valued[0], options)
    else:  # by its displacement over what factories grant
        is_gross = deviation.share(comparable[0], weighed[comparable[0]]) > options.least_gross
    if not is_gross:  # a chain and a sensor do as much by themselves
        return None
    return valued[0], [(change,) for change in valued[1:]]


def _is_gross_scale(change: PoseFault, options: ScreeningOptions) -> bool:
    return abs(np.log(float(change.value))) > np.log(options.least_scale)


# ------------------------------------------------------------------ another nominal table


def tables_of_model(name: str) -> list[Arm]:
    """The bundled tables of the model that an arm's name begins with: two of a lite6."""
    model = name.split("_")[0]
    return [load_bundled(table) for table in bundled_arms() if table.split("_")[0] == model]


def use_other_table(state: Screened) -> Screened:
    """Another table of the same model in the place of the one declared, where the data are of that one.

    Where they leave it open, the corrections decide. A declared chain that was asked for stays. Where it is a published
    table, the share of the way to the other table is estimated beside all physics; where that leaves it vague, the
    other table must halve the residuals. Where the chain is fitted, the other table must be likelier than the declared
    one, and than a fitted chain for its more numbers.
    """
    arm = state.rigid_arm
    options = state.options
    tables = tables_of_model(arm.arm.name)
    declared = [arm.arm]
    if arm.exact:
        declared = [t for t in tables if np.abs(t.links - arm.links).max() < options.published_tolerance]
    alternatives = [table for table in tables if declared and table.name != declared[0].name]
    if not alternatives:
        reason = "own_chain" if arm.exact else "single_table"
        return state.rule_out("nominal_table", reason=reason, declared=arm.arm.name)
    alternative = alternatives[0]
    vague = False
    numbers: dict[str, Any] = {"declared": declared[0].name, "table": alternative.name}
    theirs = _with_table(arm, alternative).fitted(options.most_fitted)
    if arm.exact:
        # of the way from the declared table to the other at which the data lie
        between = np.zeros((len(arm.links) + 1, 6))
        T = alternative.links @ np.linalg.inv(arm.links)
        between[:-1, :3], between[:-1, 3:] = T[:, :3, 3], Rotation.from_matrix(T[:, :3, :3]).as_rotvec()
        column = np.einsum("k,krs->rs", between.ravel(), arm.twists)[None]
        share, std = (float(n[0]) for n in estimated(arm, physics_columns(arm, skip=("links",)), column, options))
        clear = std < options.share_std or theirs.scale < options.table_ratio * arm.scale
        at_alternative = abs(share - 1) < options.share_tolerance + 4 * std and share > options.share_sigmas * std
        decided = bool(clear and at_alternative)
        likelier = bool(theirs.scale < arm.scale)
        vague = bool(np.isinf(std))
        numbers |= {"decided": decided} | ({"share": share, "share_std": std} if np.isfinite(std) else {})
    else:
        ours = _with_table(arm, arm.arm).fitted(options.most_fitted)
        more = len(arm.unknown) - len(theirs.unknown)
        fitted = arm.log_likelihood(arm.scale) - 0.5 * more * np.log(arm.rows * arm.samples)
        required = max(fitted, ours.log_likelihood(arm.scale) + options.prior.cost("nominal_table"))
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
        settings = settings if settings.arm_is_file else replace(settings, arm=alternative.name)
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
