"""One arm and fleets of them, fitted to noisy measured poses: the library against the rivals, and the closed form."""

from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.measure import AGREES, Record, disagreement, median_time, timed, unlikely
from benchmarks.problem import NOISE, Measured, chain_error, measured
from benchmarks.rivals import OPTIMISTIX, RIVALS, Rival, plain_optimistix_fleet
from benchmarks.seed_way import sample_joints
from lite6jax.arms.bundled import load_bundled
from lite6jax.arms.dh import six_parameter_to_hayati
from lite6jax.fitting.fleet import FleetSolution, fit_fleet
from lite6jax.fitting.quality import Result

OURS, CLOSED_FORM = "lite6jax", "lite6jax, closed form"
VMAPPED = 8
"""Arms that a vmapped rival gets at a time, of which each takes it half a second and more."""


def fit(problem: Measured) -> FleetSolution:
    """The library's fit of all arms."""
    return fit_fleet(problem.joint_position, problem.pose, nominal="lite6", noise=NOISE)


def convert(problem: Measured) -> np.ndarray:
    """The arms' true Hayati parameters `(arm, 28)`, in closed form."""
    lite6 = load_bundled("lite6")
    return six_parameter_to_hayati(lite6.form, problem.kinematics, lite6.hayati)


def wrong_fit(solution: FleetSolution, truth: np.ndarray) -> str:
    """Why the library's fit is not right; empty where it is."""
    stopped = int((solution.result != Result.CONVERGED).sum())
    if stopped:
        return f"{stopped} of {len(solution.result)} arms did not converge"
    return unlikely(solution.parameters, solution.covariance, truth)


def wrong_truth(problem: Measured, truth: np.ndarray) -> str:
    """Why the closed form is not right: its chains, walked in NumPy, are not the true ones."""
    error = chain_error(problem.kinematics, truth, sample_joints(50, np.random.default_rng(2)))
    return disagreement(np.array(error), np.array(0.0), 1e-12, "flange poses")


def one(samples: int = 300, repeats: int = 7, rivals: Sequence[Rival] = RIVALS) -> Iterator[Record]:
    """One arm: milliseconds a fit, and how many times slower each rival is."""
    problem = measured(1, samples, seed=1)
    truth = convert(problem)
    first, _ = timed(lambda: fit(problem))
    seconds, solution = median_time(lambda: fit(problem), repeats)
    wrong = wrong_fit(solution, truth) or wrong_truth(problem, truth)
    yield Record("one", OURS, "first call, with compilation", 1e3 * first, "ms", "lower", wrong)
    yield Record("one", OURS, "fit", 1e3 * seconds, "ms", "lower", wrong)
    for rival in rivals:
        taken, wrong = _race(rival, problem, solution, 1)
        yield Record("one", rival.name, "fit", 1e3 * taken, "ms", "lower", wrong)
        yield Record("one", OURS, f"faster than {rival.name}", taken / seconds, "×", "higher", wrong)


def fleet(
    sizes: Sequence[int] = (64, 1024), samples: int = 300, repeats: int = 7, rivals: Sequence[Rival] = RIVALS
) -> Iterator[Record]:
    """Many arms, each with its own joint positions: milliseconds an arm.

    Rivals get some arms of the first fleet, as many as their subject says.
    """
    taken: dict[str, tuple[float, str]] = {}
    for arms in sizes:
        problem = measured(arms, samples, seed=2)
        work, truth = f"fleet of {arms}", convert(problem)
        first, _ = timed(lambda problem=problem: fit(problem))
        seconds, solution = median_time(lambda problem=problem: fit(problem), repeats)
        exact, _ = median_time(lambda problem=problem: convert(problem), repeats)
        wrong = wrong_fit(solution, truth)
        if arms == sizes[0]:
            yield Record(work, OURS, "first call, with compilation", 1e3 * first, "ms", "lower", wrong)
        yield Record(work, OURS, "fit an arm", 1e3 * seconds / arms, "ms", "lower", wrong)
        yield Record(work, OURS, "steps an arm", float(solution.steps.mean()), "", "lower", wrong)
        wrong = wrong_truth(problem, truth)
        yield Record(work, CLOSED_FORM, "conversion an arm", 1e3 * exact / arms, "ms", "lower", wrong)
        yield Record(work, CLOSED_FORM, "faster than the fit", seconds / exact, "×", "higher", wrong)
        if arms == sizes[0]:
            for rival in rivals:
                count = min(rival.arms, arms)
                taken[f"{rival.name} (on {count})"] = _race(rival, problem, solution, count)
            if OPTIMISTIX in rivals:
                count = min(VMAPPED, arms)
                taken[f"{OPTIMISTIX.name}, vmapped (on {count})"] = _race_vmapped(problem, solution, count)
            for name, (rival_seconds, wrong) in taken.items():
                yield Record(work, name, "fit an arm", 1e3 * rival_seconds, "ms", "lower", wrong)
        for name, (rival_seconds, wrong) in taken.items():
            yield Record(work, OURS, f"faster than {name}", rival_seconds * arms / seconds, "×", "higher", wrong)


def _race(rival: Rival, problem: Measured, solution: FleetSolution, arms: int) -> tuple[float, str]:
    """Seconds a rival takes for an arm, the mean of some, and why its answer is wrong: it is not the library's."""
    if rival.compiles:
        rival.solve(problem.joint_position[0], problem.pose[0])
    pairs = list(zip(problem.joint_position, problem.pose, strict=True))[:arms]
    seconds, answers = timed(lambda: np.array([rival.solve(q, pose) for q, pose in pairs]))
    return seconds / arms, _disagrees(answers, solution)


def _race_vmapped(problem: Measured, solution: FleetSolution, arms: int) -> tuple[float, str]:
    plain_optimistix_fleet(problem.joint_position[:arms], problem.pose[:arms])
    seconds, answers = timed(lambda: plain_optimistix_fleet(problem.joint_position[:arms], problem.pose[:arms]))
    return seconds / arms, _disagrees(answers, solution)


def _disagrees(answers: np.ndarray, solution: FleetSolution) -> str:
    return disagreement(answers, solution.parameters[: len(answers)], AGREES, "parameters (m, rad)")
