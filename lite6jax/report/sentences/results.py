"""What is said of each kind of result where it is printed; a list holds its sentences in their order."""

from collections.abc import Sequence

import numpy as np

from lite6jax.array_types import Array
from lite6jax.calibration.fleet import FleetSolution
from lite6jax.calibration.quality import Result
from lite6jax.calibration.solution import Errors, Solution
from lite6jax.domains.pose.compensate import Compensation
from lite6jax.domains.pose.predict import Prediction
from lite6jax.domains.torque.predict import TorquePrediction
from lite6jax.formatting import be, counted, number
from lite6jax.recordings import Recording
from lite6jax.report.sentences.faults import quality_statement

NOT_SAID = "The diagnosis does not say what was recorded, and so which rows are outside of it."
_MOST_NAMES = 6
"""Parameters that are named."""


def describe_recording(recording: Recording, measured: str, least: str, most: str) -> list[str]:
    """Says what a recording holds; `least` and `most` are the ranges over which joints move, with units."""
    runs = counted(1 + int(np.count_nonzero(np.diff(recording.run))), "run")
    sensor = ""
    if recording.settings.pose_source != "unknown":
        sensor = f" by {recording.settings.pose_source.replace('_', ' ')}"
    sentences = [
        f"{recording.source} has {counted(recording.samples, 'sample')} of {recording.dof} joints in {runs} "
        f"({recording.motion}), with {measured}{sensor}.",
        f"The joints move over ranges of {least} to {most}.",
    ]
    if recording.position is not None:
        extent = " × ".join(f"{length:.3f}" for length in np.ptp(recording.position, axis=0))
        sentences.append(f"The measured points lie within {extent} m.")
    if recording.notes:
        count = len(recording.notes)
        sentences.append(f"{counted(count, 'note')} {be(count)} in `notes`.")
    return sentences


def _errors(errors: Errors) -> str:
    shown = f"{number(1e3 * errors.position_rms)} mm RMS"
    if errors.orientation is None:
        return shown
    return f"{shown} and {number(float(np.rad2deg(np.sqrt(np.mean(errors.orientation**2)))), 3)} deg RMS"


def _names(names: Sequence[str]) -> str:
    listed = ", ".join(names[:_MOST_NAMES])
    if len(names) > _MOST_NAMES:
        return f"{listed}, …"
    return listed


def describe_solution(solution: Solution, data: str) -> list[str]:
    """Says how a fit ended, its errors, and what the data do not determine; `data` are a calibration or a recording."""
    noise = solution.noise
    rows = "held-out blocks"
    if noise is None:
        rows = "fresh samples"
    sentences = [
        f"The fit of the {data} {solution.result.message}.",
        f"It took {counted(solution.steps, 'step')} and estimated {counted(int(solution.free.sum()), 'parameter')} of "
        f"a {solution.arm.name}.",
        f"The error on {rows} is {_errors(solution.checked)}; that of the nominal geometry is "
        f"{_errors(solution.nominal_errors)}.",
    ]
    bad = quality_statement(solution.quality.to_dict())
    if bad is not None:
        sentences.append(bad)
    held = [parameter.name for parameter in solution.held]
    if held:
        count = len(held)
        sentences.append(
            f"{counted(count, 'parameter')} {be(count)} held, because the data do not determine: {_names(held)}."
        )
    unsure = [solution.form.names[k] for k in np.flatnonzero(solution.free & ~solution.determined)]
    if unsure:
        sentences.append(f"The data do not determine, and their prior about nominal decides: {_names(unsure)}.")
    if noise is not None:
        declared = ""
        if noise.declared and noise.declared[0] is not None:
            declared = f"; declared {number(1e3 * noise.declared[0])} mm"
        sentences.append(
            f"The residuals have a standard deviation of {number(1e3 * noise.position)} mm per axis{declared}."
        )
    return sentences


def describe_fleet(fleet: FleetSolution) -> list[str]:
    """Says how many fits converged, with which errors, and how the others ended."""
    good = fleet.result == Result.CONVERGED
    position = fleet.position_rms[good]
    parameters = counted(fleet.parameters.shape[1], "parameter")
    sentences = [f"{len(position)} of {counted(len(fleet.result), 'fit')} converged, each of {parameters}."]
    if len(position):
        median = float(np.median(position))
        sentences.append(
            "Of these the position error of the fitted data is "
            f"{number(1e3 * median)} mm RMS in the median and {number(1e3 * position.max())} mm at most."
        )
    for code in sorted(set(fleet.result[~good].tolist())):
        arms = counted(int((fleet.result == code).sum()), "arm")
        sentences.append(f"For {arms} the fit {Result(code).message}.")
    return sentences


def describe_prediction(prediction: Prediction, outside: str) -> list[str]:
    """Says how many poses are predicted, and how uncertain; `outside` says how many leave what was recorded."""
    count = len(prediction.poses)
    sentences = [f"{counted(count, 'pose')} {be(count)} predicted."]
    empty = int(prediction.empty.sum())
    if empty:
        sentences.append(f"{counted(empty, 'row')} {be(empty)} empty: the clock offset reaches beyond the motion.")
    if prediction.position_std is not None:
        std = np.sqrt(np.nansum(prediction.position_std**2, 1))
        sentences.append(
            f"The standard deviation of a position is {number(1e3 * np.median(std))} mm in the median, "
            f"{number(1e3 * std.max())} mm at most."
        )
    return [*sentences, outside]


def describe_torques(prediction: TorquePrediction, largest: str, deviations: str, outside: str) -> list[str]:
    """Says which torques are predicted: the largest of each joint and their deviations, with units."""
    samples, joints = prediction.torque.shape
    sentences = [
        f"The torques of {counted(joints, 'joint')} are predicted in {counted(samples, 'sample')}.",
        f"The largest of each joint are {largest}.",
    ]
    if deviations:
        sentences.append(f"Their standard deviations are {deviations} in the median.")
    return [*sentences, outside]


def describe_compensation(compensation: Compensation, largest: str, outside: str) -> list[str]:
    """Says how many targets are reached, and how near; `largest` is how far each joint is moved, with units."""
    reached = compensation.reached
    hit = int(reached.sum())
    sentences = [f"{hit} of {counted(len(reached), 'target')} {be(hit)} reached."]
    if hit:
        error: Array = compensation.position_error[reached]
        sentences.append(f"There the model is at most {number(1e3 * float(np.nanmax(error)))} mm from the target.")
    if largest:
        sentences.append(f"The joints are moved by up to {largest}.")
    if compensation.omitted:
        sentences.append(f"Effects of the sensor are left out: {', '.join(compensation.omitted)}.")
    return [*sentences, outside]
