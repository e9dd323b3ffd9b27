"""`summary()` and a notebook's table of each kind of result: a title, sentences and rows, worded in one function each.

To add a kind, let its class inherit `lite6jax.summary.Summarised` and register a function with `described` here.
"""

from functools import singledispatch
from html import escape
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.diagnosis.combined import CombinedDiagnosis
from lite6jax.diagnosis.document import to_document
from lite6jax.diagnosis.result import Diagnosis
from lite6jax.diagnosis.torque_document import to_torque_document
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.fitting.solution import Errors, FleetSolution, Result, Solution
from lite6jax.identifiability.discrimination import DiscriminationPlan
from lite6jax.identifiability.identify import Identification
from lite6jax.identifiability.planning import Plan
from lite6jax.recordings import Recording
from lite6jax.report import shared, statements, torque_statements, worth
from lite6jax.report.cells import each_with_unit, joint_units, number
from lite6jax.report.data_faults import fault_name
from lite6jax.report.quality import quality_statement

MOST_NOTES = 4
_MOST_FINDINGS = 4


class Description(NamedTuple):
    """What a person reads of a result.

    Attributes:
        title: a few words.
        sentences: whole ones, with units.
        rows: of the table: quantity with its unit, and value.
        notes: what was assumed, a sentence each.
    """

    title: str
    sentences: tuple[str, ...]
    rows: tuple[tuple[str, str], ...]
    notes: tuple[str, ...] = ()


@singledispatch
def described(result: object) -> Description:
    """The description of a result.

    Raises:
        TypeError: a class for which no function is registered here.
    """
    raise TypeError(f"{type(result).__name__} has no description in lite6jax.report.summaries; register one")


def summary(result: object) -> str:
    """The sentences of a result as one text."""
    return " ".join(described(result).sentences)


def html(result: object) -> str:
    """The table of a result with its notes, without styles, scripts or links."""
    title, _, rows, notes = described(result)
    lines = [f"<table><caption>{escape(title)}</caption><tbody>"]
    lines += [f"<tr><th scope=row>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows]
    lines.append("</tbody></table>")
    if notes:
        shown = [*notes[:MOST_NOTES], *([f"{len(notes) - MOST_NOTES} more notes"] if len(notes) > MOST_NOTES else [])]
        lines.append(f"<ul>{''.join(f'<li>{escape(note)}</li>' for note in shown)}</ul>")
    return "".join(lines)


@described.register
def _recording(recording: Recording) -> Description:
    settings = recording.settings
    poses = {0: "no poses", 3: "positions", 6: "positions and orientations"}[recording.numbers_per_sample]
    by = "" if settings.pose_source == "unknown" else f" by {settings.pose_source.replace('_', ' ')}"
    runs = 1 + int(np.count_nonzero(np.diff(recording.run)))
    scales, units = joint_units(recording.sliding, recording.dof)
    span = scales * np.ptp(recording.joint_position, axis=0)
    least, most = (f"{span[joint]:.0f} {units[joint]}" for joint in (np.argmin(span), np.argmax(span)))
    sentences = [
        f"{recording.source} has {_counted(recording.samples, 'sample')} of {recording.dof} joints in "
        f"{_counted(runs, 'run')} ({recording.motion}), with {poses}{by}.",
        f"The joints move over ranges of {least} to {most}.",
    ]
    rows = [
        ("samples", str(recording.samples)),
        ("joints", str(recording.dof)),
        ("runs", str(runs)),
        ("motion", recording.motion),
        ("measured", f"{poses}{by}"),
        (f"range of the joints ({', '.join(dict.fromkeys(units))})", ", ".join(f"{value:.0f}" for value in span)),
    ]
    if recording.position is not None:
        extent = np.ptp(recording.position, axis=0)
        sentences.append(f"The measured points lie within {' × '.join(f'{x:.3f}' for x in extent)} m.")
        rows.append(("extent of the positions (m)", " × ".join(f"{x:.3f}" for x in extent)))
    if settings.position_noise_m is not None:
        rows.append(("declared position noise (mm)", f"{1e3 * settings.position_noise_m:.3g}"))
    if recording.notes:
        sentences.append(f"{_counted(len(recording.notes), 'note')} {_be(len(recording.notes))} in `notes`.")
    return Description(f"Recording of {settings.arm or 'an arm'}", tuple(sentences), tuple(rows), recording.notes)


@described.register
def _solution(solution: Solution) -> Description:
    moved, held = int(solution.free.sum()), len(solution.held)
    data = "calibration" if solution.noise is None else "recording"
    on = "fresh samples" if solution.noise is None else "held-out blocks"
    before, after = solution.nominal_errors, solution.checked
    sentences = [
        f"The fit of the {data} {solution.result.message}.",
        f"It took {_counted(solution.steps, 'step')} and estimated {_counted(moved, 'parameter')} of a "
        f"{solution.arm.name}.",
        f"The error on {on} is {_errors(after)}; that of the nominal geometry is {_errors(before)}.",
    ]
    bad = quality_statement(solution.quality.to_dict())
    if bad is not None:
        sentences.append(bad)
    if held:
        names = ", ".join(each.name for each in solution.held[:6]) + (", …" if held > 6 else "")
        sentences.append(f"{_counted(held, 'parameter')} {_be(held)} held, because the data do not determine: {names}.")
    unsure = np.flatnonzero(solution.free & ~solution.determined)
    if unsure.size:
        names = ", ".join(solution.form.names[k] for k in unsure[:6]) + (", …" if unsure.size > 6 else "")
        sentences.append(f"The data do not determine, and their prior about nominal decides: {names}.")
    rows = [
        ("arm", solution.arm.name),
        ("result", solution.result.message),
        ("quality", solution.quality.verdict.replace("_", " ")),
        ("parameters estimated", str(moved)),
        ("parameters held", str(held)),
        ("position error, nominal geometry (mm RMS)", _millimetres(before.position_rms)),
        (f"position error, fitted (mm RMS, {on})", _millimetres(after.position_rms)),
    ]
    for name, errors in (("nominal geometry", before), ("fitted", after)):
        if errors.orientation is not None:
            rows.append((f"orientation error, {name} (deg RMS)", _degrees(_rms(errors.orientation))))
    if solution.noise is not None:
        found = _millimetres(solution.noise.position)
        told = solution.noise.declared and solution.noise.declared[0]
        declared = "" if told is None else f"; declared {_millimetres(told)}"
        sentences.append(
            f"The residuals have a standard deviation of {found} mm per axis{declared and declared + ' mm'}."
        )
        rows.append(("residual standard deviation per axis (mm)", f"{found}{declared}"))
    return Description(f"Fit of a {data}, {solution.arm.name}", tuple(sentences), tuple(rows), solution.notes)


@described.register
def _fleet(fleet: FleetSolution) -> Description:
    arms = len(fleet.result)
    converged = fleet.result == Result.CONVERGED
    good = int(converged.sum())
    sentences = [
        f"{good} of {_counted(arms, 'fit')} converged, each of {_counted(fleet.parameters.shape[1], 'parameter')}."
    ]
    rows = [("arms", str(arms)), ("converged", str(good)), ("parameters per arm", str(fleet.parameters.shape[1]))]
    if good:
        position, turned = fleet.position_rms[converged], fleet.orientation_rms[converged]
        sentences.append(
            f"Of these the position error of the fitted data is {_millimetres(float(np.median(position)))} mm RMS in "
            f"the median and {_millimetres(float(position.max()))} mm at most."
        )
        rows += [
            ("position error (mm RMS, median of the arms)", _millimetres(float(np.median(position)))),
            ("position error (mm RMS, largest of the arms)", _millimetres(float(position.max()))),
            ("orientation error (deg RMS, median of the arms)", _degrees(float(np.median(turned)))),
        ]
    for code in sorted(set(fleet.result[~converged].tolist())):
        count = int((fleet.result == code).sum())
        sentences.append(f"For {_counted(count, 'arm')} the fit {Result(code).message}.")
        rows.append((Result(code).name.lower().replace("_", " "), str(count)))
    return Description("Fits of a fleet", tuple(sentences), tuple(rows))


@described.register
def _identification(found: Identification) -> Description:
    d, accuracy = found.determination, found.accuracy
    sentences = [
        f"{_counted(d.samples, 'pose')} of a {found.experiment.arm.name} determine{'s' * (d.samples == 1)} {d.rank} of "
        f"{_counted(d.size, 'unknown parameter')}."
    ]
    if found.missed:
        sentences.append(f"Other poses within the joint limits determine {found.possible.rank}.")
    rows = [
        ("poses", str(d.samples)),
        ("unknown parameters", str(d.size)),
        ("determined by these poses", str(d.rank)),
        ("determined by any poses within the limits", str(found.possible.rank)),
    ]
    position = f"±{_millimetres(accuracy.position_rms)}" if accuracy.position_determined else "undetermined"
    orientation = f"±{_degrees(accuracy.orientation_rms)}" if accuracy.orientation_determined else "undetermined"
    rows.append(("predicted position over the workspace (mm, one standard deviation)", position))
    rows.append(("predicted orientation over the workspace (deg, one standard deviation)", orientation))
    if accuracy.position_determined:
        sentences.append(
            f"The fitted model predicts positions over the workspace with a standard deviation of {position[1:]} mm."
        )
    else:
        sentences.append("Positions over the workspace depend on combinations that these poses do not determine.")
    if weak := d.weak():
        sentences.append(f"No more precise than the assembly tolerance {_be(len(weak))}: {', '.join(weak)}.")
    if found.observability is not None:
        rows.append(("condition number", f"{found.observability.condition:.3g}"))
        rows.append(("observability index O1", f"{found.observability.O1:.3g}"))
    return Description(f"Identifiability, {found.experiment.arm.name}", tuple(sentences), tuple(rows), found.notes)


@described.register
def _plan(plan: Plan) -> Description:
    reached = float(plan.accuracy[-1])
    sentences = [
        f"{_counted(plan.count, 'pose')} of {_counted(plan.candidates, 'candidate')} for a "
        f"{plan.experiment.arm.name} {_be(plan.count)} chosen by the criterion {plan.criterion}."
    ]
    rows = [("poses", str(plan.count)), ("candidates", str(plan.candidates)), ("criterion", plan.criterion)]
    if np.isfinite(reached):
        random = float(np.median(plan.random_accuracy[:, plan.count - 1]))
        beside = f"{_millimetres(random)} mm" if np.isfinite(random) else "no finite accuracy"
        sentences.append(
            f"A fit to them predicts positions over the workspace with a standard deviation of "
            f"{_millimetres(reached)} mm; as many random poses reach {beside} in the median."
        )
        rows.append(("predicted position over the workspace (mm)", f"±{_millimetres(reached)}"))
        rows.append(("the same of as many random poses (mm)", beside.removesuffix(" mm")))
    else:
        sentences.append("Positions over the workspace depend on combinations that these poses do not determine.")
    if plan.worth is not None:
        sentences.append(f"They are as accurate as {plan.worth} random poses.")
        rows.append(("random poses of the same accuracy", str(plan.worth)))
    if plan.needed is not None:
        sentences.append(f"{_counted(plan.needed, 'pose')} {_be(plan.needed)} needed for the accuracy given.")
        rows.append(("poses for the accuracy given", str(plan.needed)))
    return Description(f"Poses to record, {plan.experiment.arm.name}", tuple(sentences), tuple(rows))


@described.register
def _discrimination(plan: DiscriminationPlan) -> Description:
    one, other = plan.rivals
    reached, random = float(plan.distance[-1]), float(np.nanmedian(plan.random_distance))
    sentences = (
        f"{_counted(plan.count, 'pose')} of {_counted(plan.candidates, 'candidate')} {_be(plan.count)} chosen to "
        f"discriminate between {one} and {other}.",
        f"Their readings differ by {reached:.1f} standard deviations, those at as many random poses by {random:.1f}.",
    )
    rows = (
        ("poses", str(plan.count)),
        ("candidates", str(plan.candidates)),
        ("rivals", f"{one}; {other}"),
        ("distance (standard deviations)", f"{reached:.1f}"),
        ("distance at random poses (standard deviations, median)", f"{random:.1f}"),
    )
    return Description(f"Poses that discriminate, {plan.experiment.arm.name}", sentences, rows)


@described.register
def _diagnosis(found: Diagnosis) -> Description:
    document = to_document(found)
    findings, verdict = statements.findings_of(document), statements.verdict_statement(document)
    shown, hidden = findings[:_MOST_FINDINGS], len(findings) - _MOST_FINDINGS
    before, after = (_millimetres(document[stage]["heldout_position_rms_m"]) for stage in ("before", "after"))
    noise = _millimetres(found.estimated_noise)
    sentences = [worth.headline(document), verdict, *statements.cautions(document)]
    sentences += [finding["statement"] for finding in shown]
    if hidden > 0:
        sentences.append(f"{_counted(hidden, 'more finding')} {_be(hidden)} in `findings`.")
    error = f"{before} mm RMS with the model of the arm alone"
    sentences.append(
        f"The held-out position error is {after} mm RMS with these effects and {error}."
        if findings
        else f"The held-out position error is {error}."
    )
    faults = [fault_name(entry["fault"]).lower() for entry in document["data_faults"]]
    if faults:
        sentences.append(f"The data have {_counted(len(faults), 'fault')}: {', '.join(faults)}.")
    rows = [
        ("verdict", found.verdict.replace("_", " ")),
        ("samples", str(document["samples"])),
        ("held-out position error before (mm RMS)", before),
        ("held-out position error after (mm RMS)", after),
        ("noise per axis of position, estimated (mm)", noise),
        *((finding["title"], statements.sizes(finding)) for finding in findings),
        ("data faults", ", ".join(faults) or "none"),
    ]
    notes = (*statements.assumptions(document), *statements.what_to_record(document))
    return Description(f"Diagnosis of a {found.problem.arm.name}", tuple(sentences), tuple(rows), notes)


@described.register
def _torque_diagnosis(found: TorqueDiagnosis) -> Description:
    document = to_torque_document(found)
    findings = torque_statements.findings_of(document)
    shown, hidden = findings[:_MOST_FINDINGS], len(findings) - _MOST_FINDINGS
    sentences = [worth.headline(document), torque_statements.verdict_statement(document)]
    sentences += [*torque_statements.cautions(document), *(finding["statement"] for finding in shown)]
    if hidden > 0:
        sentences.append(f"{_counted(hidden, 'more finding')} {_be(hidden)} in `findings`.")
    faults = [fault_name(entry["fault"]).lower() for entry in document["data_faults"]]
    if faults:
        sentences.append(f"The data have {_counted(len(faults), 'fault')}: {', '.join(faults)}.")
    units, common = torque_statements.units(document), torque_statements.common_unit(document)
    stages = [
        (stage, each_with_unit(document[stage]["heldout_torque_rms_by_joint_Nm"], units).removesuffix(f" {common}"))
        for stage in ("before", "after")
    ]
    rows = [
        ("verdict", found.verdict.replace("_", " ")),
        ("samples", str(document["samples"])),
        *(
            (f"held-out torque error {stage}, of each joint ({f'{common} RMS'.strip()})", errors)
            for stage, errors in stages
        ),
        *((finding["title"], ", ".join(map(str, torque_statements.sizes(finding)))) for finding in findings),
        ("data faults", ", ".join(faults) or "none"),
    ]
    notes = (
        torque_statements.filter_statement(document),
        torque_statements.inertial_statement(document),
        *torque_statements.what_to_record(document),
    )
    return Description(
        f"Diagnosis of the torques of a {document['model']['arm']}", tuple(sentences), tuple(rows), notes
    )


@described.register
def _combined(found: CombinedDiagnosis) -> Description:
    document = found.to_dict()
    poses = described(found.poses)
    title = f"Diagnosis of the poses and torques of a {found.poses.problem.arm.name}"
    if found.torques is None:
        return Description(title, (*poses.sentences, shared.refusal(document)), poses.rows, poses.notes)
    torques = described(found.torques)
    both = tuple(shared.statement(entry) for entry in document["shared"])
    rows = (*((f"poses: {name}", value) for name, value in poses.rows),
            *((f"torques: {name}", value) for name, value in torques.rows))  # fmt: skip
    return Description(title, (*poses.sentences, *torques.sentences, *both), rows, (*poses.notes, *torques.notes))


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'s' * (count != 1)}"


def _be(count: int) -> str:
    return "is" if count == 1 else "are"


def _millimetres(metres: float) -> str:
    return number(1e3 * metres)


def _degrees(radians: float) -> str:
    return number(float(np.rad2deg(radians)), 3)


def _rms(values: NDArray[np.floating]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _errors(errors: Errors) -> str:
    parts = [f"{_millimetres(errors.position_rms)} mm RMS"]
    if errors.orientation is not None:
        parts.append(f"{_degrees(_rms(errors.orientation))} deg RMS")
    return " and ".join(parts)
