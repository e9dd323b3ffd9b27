"""The summary of each kind of result: a title, sentences and notes, one function each.

To add a kind, let its class inherit `lite6jax.results.PublicResult` and register a function with `describe` here.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from rich.console import RenderableType
from rich.text import Text

from lite6jax.calibration.fleet import Comparison, FleetSolution
from lite6jax.calibration.quality import Result
from lite6jax.calibration.solution import Errors, Solution
from lite6jax.design.identify import Identification, Sensitivity
from lite6jax.design.poses import DiscriminationPlan, Plan
from lite6jax.diagnosis.result import DomainDiagnosis
from lite6jax.domains.pose.compensate import Compensation
from lite6jax.domains.pose.predict import Prediction
from lite6jax.domains.pose.registration import Registration
from lite6jax.domains.torque.predict import TorquePrediction
from lite6jax.recordings import Recording
from lite6jax.report import fits, ranking, statements, study
from lite6jax.report.compensation import outside_sentence, registration_report
from lite6jax.report.faults import fault_name
from lite6jax.report.words import be, counted, each_with_unit, joint_units, number, torque_units
from lite6jax.results import Description, describe

_MOST_FINDINGS = 4


@describe.register
def _recording(recording: Recording) -> Description:
    settings = recording.settings
    poses = fits.what_is_measured(recording)
    by = "" if settings.pose_source == "unknown" else f" by {settings.pose_source.replace('_', ' ')}"
    runs = 1 + int(np.count_nonzero(np.diff(recording.run)))
    scales, units = joint_units(recording.sliding, recording.dof)
    span = scales * np.ptp(recording.joint_position, axis=0)
    least, most = (f"{span[joint]:.0f} {units[joint]}" for joint in (np.argmin(span), np.argmax(span)))
    sentences = [
        f"{recording.source} has {counted(recording.samples, 'sample')} of {recording.dof} joints in "
        f"{counted(runs, 'run')} ({recording.motion}), with {poses}{by}.",
        f"The joints move over ranges of {least} to {most}.",
    ]
    if recording.position is not None:
        extent = np.ptp(recording.position, axis=0)
        sentences.append(f"The measured points lie within {' × '.join(f'{x:.3f}' for x in extent)} m.")
    if recording.notes:
        sentences.append(f"{counted(len(recording.notes), 'note')} {be(len(recording.notes))} in `notes`.")
    return Description(f"Recording of {settings.arm or 'an arm'}", tuple(sentences), recording.notes)


@describe.register
def _solution(solution: Solution) -> Description:
    data, on = ("calibration", "fresh samples") if solution.noise is None else ("recording", "held-out blocks")
    unsure = np.flatnonzero(solution.free & ~solution.determined)
    sentences = [
        f"The fit of the {data} {solution.result.message}.",
        f"It took {counted(solution.steps, 'step')} and estimated {counted(int(solution.free.sum()), 'parameter')} of "
        f"a {solution.arm.name}.",
        f"The error on {on} is {_errors(solution.checked)}; that of the nominal geometry is "
        f"{_errors(solution.nominal_errors)}.",
        statements.quality_statement(solution.quality.to_dict()) or "",
    ]
    if held := [each.name for each in solution.held]:
        said = f"{counted(len(held), 'parameter')} {be(len(held))} held, because the data do not determine"
        sentences.append(f"{said}: {_first_names(held)}.")
    if unsure.size:
        names = _first_names([solution.form.names[k] for k in unsure])
        sentences.append(f"The data do not determine, and their prior about nominal decides: {names}.")
    if (noise := solution.noise) is not None:
        declared = f"; declared {_mm(noise.declared[0])} mm" if noise.declared and noise.declared[0] is not None else ""
        sentences.append(f"The residuals have a standard deviation of {_mm(noise.position)} mm per axis{declared}.")
    return Description(f"Fit of a {data}, {solution.arm.name}", tuple(filter(None, sentences)), solution.notes)


def _first_names(names: Sequence[str]) -> str:
    return ", ".join(names[:6]) + (", …" if len(names) > 6 else "")


@describe.register
def _fleet(fleet: FleetSolution) -> Description:
    arms = len(fleet.result)
    converged = fleet.result == Result.CONVERGED
    good = int(converged.sum())
    sentences = [
        f"{good} of {counted(arms, 'fit')} converged, each of {counted(fleet.parameters.shape[1], 'parameter')}."
    ]
    if good:
        position = fleet.position_rms[converged]
        sentences.append(
            f"Of these the position error of the fitted data is {_mm(float(np.median(position)))} mm RMS in "
            f"the median and {_mm(float(position.max()))} mm at most."
        )
    for code in sorted(set(fleet.result[~converged].tolist())):
        count = int((fleet.result == code).sum())
        sentences.append(f"For {counted(count, 'arm')} the fit {Result(code).message}.")
    return Description("Fits of a fleet", tuple(sentences))


def _as_shown(title: str, report: Iterable[RenderableType], *before: str) -> Description:
    """The sentences of a terminal's report, without its tables and headings; its notes apart."""
    said = [str(part) for part in report if isinstance(part, Text) and str(part).endswith(".")]
    notes = [line.removeprefix("Note: ") for line in said if line.startswith("Note: ")]
    return Description(title, (*before, *(line for line in said if not line.startswith("Note: "))), tuple(notes))


describe.register(
    Comparison,
    lambda found: _as_shown(
        f"Comparison of {len(found.names)} arms, {found.arm.name}", fits.comparison_report(found, width=80)
    ),
)
describe.register(
    Sensitivity,
    lambda found: _as_shown("Sensitivity of the flange to the tolerances", study.sensitivity_report(found, "")),
)
describe.register(Registration, lambda found: _as_shown("Registration of sensor and tool", registration_report(found)))


@describe.register(Identification)
@describe.register(Plan)
@describe.register(DiscriminationPlan)
def _study(found: Identification | Plan | DiscriminationPlan) -> Description:
    name = found.experiment.arm.name
    if isinstance(found, Identification):
        return _as_shown(f"Identifiability, {name}", study.identification_report(found, name, drawn=False))
    chosen = f"{counted(found.count, 'pose')} of {counted(found.candidates, 'candidate')} {be(found.count)} chosen."
    report = study.plan_report(found) if isinstance(found, Plan) else study.discrimination_report(found)
    return _as_shown(f"Poses to record, {name}", report, chosen)


@describe.register
def _prediction(found: Prediction) -> Description:
    rows, empty = len(found.poses), int(found.empty.sum())
    sentences = [f"{counted(rows, 'pose')} {be(rows)} predicted."]
    if empty:
        sentences.append(f"{counted(empty, 'row')} {be(empty)} empty: the clock offset reaches beyond the motion.")
    if found.position_std is not None:
        std = np.sqrt(np.nansum(found.position_std**2, 1))
        typical, most = (_mm(float(value)) for value in (np.median(std), std.max()))
        sentences.append(f"The standard deviation of a position is {typical} mm in the median, {most} mm at most.")
    return _marked("Predicted poses", sentences, found.outside)


@describe.register
def _torque_prediction(found: TorquePrediction) -> Description:
    rows, joints = found.torque.shape
    units = torque_units(found.sliding, joints)
    largest = each_with_unit(np.nanmax(np.abs(found.torque), 0).tolist(), units)
    sentences = [f"The torques of {counted(joints, 'joint')} are predicted in {counted(rows, 'sample')}.",
                 f"The largest of each joint are {largest}."]  # fmt: skip
    if found.std is not None:
        typical = each_with_unit(np.nanmedian(found.std, 0).tolist(), units)
        sentences.append(f"Their standard deviations are {typical} in the median.")
    return _marked("Predicted torques", sentences, found.outside)


def _marked(title: str, sentences: list[str], outside: NDArray[np.bool_] | None) -> Description:
    """With what is said of the rows that are outside what was recorded."""
    said = "The diagnosis does not say what was recorded, and so which rows are outside of it."
    if outside is not None:
        said = outside_sentence(int(outside.sum()), len(outside), "row")
    return Description(title, (*sentences, said))


@describe.register
def _compensation(found: Compensation) -> Description:
    targets, hit = len(found.reached), int(found.reached.sum())
    sentences = [f"{hit} of {counted(targets, 'target')} {be(hit)} reached."]
    if hit:
        most = _mm(float(np.nanmax(found.position_error[found.reached])))
        sentences.append(f"There the model is at most {most} mm from the target.")
    if found.correction is not None:
        scales, units = joint_units(found.recording.sliding, found.correction.shape[1])
        largest = each_with_unit((scales * np.nanmax(np.abs(found.correction), 0)).tolist(), units)
        sentences.append(f"The joints are moved by up to {largest}.")
    if found.omitted:
        sentences.append(f"Effects of the sensor are left out: {', '.join(found.omitted)}.")
    return _marked("Compensation", sentences, found.outside)._replace(notes=found.notes)


@describe.register
def _diagnosis(found: DomainDiagnosis) -> Description:
    document, torques = found.to_dict(), found.domain == "torques"
    findings = statements.findings_of(document)
    hidden = len(findings) - _MOST_FINDINGS
    sentences = [ranking.headline(document), statements.verdict_statement(document), *statements.cautions(document)]
    sentences += [finding["statement"] for finding in findings[:_MOST_FINDINGS]]
    if hidden > 0:
        sentences.append(f"{counted(hidden, 'more finding')} {be(hidden)} in `findings`.")
    if torques:
        by_joint = (document[stage]["heldout_torque_rms_by_joint_Nm"] for stage in ("before", "after"))
        start, sizes = "torque errors of the joints are", [each_with_unit(e, ranking.units(document)) for e in by_joint]
    else:
        rms = (document[stage]["heldout_position_rms_m"] for stage in ("before", "after"))
        start, sizes = "position error is", [f"{_mm(error)} mm" for error in rms]
    left = f"{sizes[1]} RMS with these effects and " if findings else ""
    sentences.append(f"The held-out {start} {left}{sizes[0]} RMS with the model of the arm alone.")
    if faults := [fault_name(entry["fault"]).lower() for entry in document["data_faults"]]:
        sentences.append(f"The data have {counted(len(faults), 'fault')}: {', '.join(faults)}.")
    notes = [*statements.assumptions(document), *statements.what_to_record(document)]
    what = "the torques of " if torques else ""
    if "torques_refused" in document:
        sentences.append(statements.refusal(document))
    for part in found.parts[1:]:
        what, beside = "the poses and torques of ", describe(part)
        sentences += [*beside.sentences, *map(statements.agreement_statement, document["shared"])]
        notes += beside.notes
    return Description(f"Diagnosis of {what}a {document['model']['arm']}", tuple(sentences), tuple(notes))


def _mm(metres: float) -> str:
    return number(1e3 * metres)


def _errors(errors: Errors) -> str:
    turned = errors.orientation
    shown = "" if turned is None else f" and {number(float(np.rad2deg(np.sqrt(np.mean(turned**2)))), 3)} deg RMS"
    return f"{_mm(errors.position_rms)} mm RMS{shown}"
