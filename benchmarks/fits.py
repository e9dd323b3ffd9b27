"""One arm and fleets of them, fitted to noisy measured poses: the library against the rivals."""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.optimize import least_squares

from benchmarks import seed_way
from benchmarks.measure import AGREES, Record, disagreement, median_time, timed, unlikely
from benchmarks.problem import NOISE, SCALE, Measured, chain_error, measured
from benchmarks.seed_way import NOMINAL, sample_joints
from lite6jax.arms.chains import HayatiForm
from lite6jax.arms.description import load_bundled
from lite6jax.arms.dh import six_parameter_to_hayati
from lite6jax.calibration.fleet import FleetSolution, fit_fleet
from lite6jax.calibration.quality import Result
from lite6jax.calibration.residual import Observations, observe, residuals
from lite6jax.model import ModelForm, arm_model

OURS = "lite6jax"
TOLERANCE = 1e-12
"""Of step and cost, relative: tight enough to agree to 1e-9, loose enough that no rival runs in place."""


class Rival(NamedTuple):
    """Another way to fit one arm to the same whitened residual, from the nominal parameters.

    Attributes:
        name: for the table.
        solve: of joint positions `(sample, 6)` and measured poses `(sample, 4, 4)` the seed's 28 parameters.
        arms: of a fleet, how many it is given; the slower, the fewer.
        compiles: whether its first call is to be kept out of the timing.
    """

    name: str
    solve: Callable[[np.ndarray, np.ndarray], np.ndarray]
    arms: int
    compiles: bool = False


def python_loop(joint_position: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """The seed's way, which takes SciPy's default method."""
    return seed_way.fit(joint_position, pose, SCALE, TOLERANCE)


FORM = ModelForm(HayatiForm(6, (1,)))


@jax.jit
def _residuals(parameters: Array, observed: Observations) -> Array:
    return residuals(FORM, arm_model(parameters), observed).reshape(-1)


_jacobian = jax.jit(jax.jacfwd(_residuals))


def jax_jacobian(joint_position: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """MINPACK's Levenberg–Marquardt, SciPy's fastest method here, with the forward-mode Jacobian of the residual."""
    weight = jnp.ones(len(pose))
    blocks = observe(FORM, jnp.asarray(joint_position), jnp.asarray(pose), weight, jnp.array(SCALE), len(pose))
    observed = jax.tree.map(lambda leaf: leaf[0], blocks)
    return least_squares(
        lambda x: np.asarray(_residuals(x, observed)),
        NOMINAL,
        jac=lambda x: np.asarray(_jacobian(x, observed)),  # pyright: ignore[reportArgumentType]
        method="lm",
        x_scale="jac",
        xtol=TOLERANCE,
        ftol=TOLERANCE,
        gtol=TOLERANCE,
    ).x


SEED = Rival("seed's way", python_loop, 1)
JACOBIAN = Rival("SciPy, JAX Jacobian", jax_jacobian, 4, compiles=True)
RIVALS = (SEED, JACOBIAN)


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


def one(samples: int = 300, repeats: int = 7, rivals: Sequence[Rival] = RIVALS) -> Iterator[Record]:
    """One arm: milliseconds a fit, and how many times slower each rival is."""
    yield from _raced("one", measured(1, samples, seed=1), repeats, rivals)


def fleet(
    sizes: Sequence[int] = (64, 1024), samples: int = 300, repeats: int = 7, rivals: Sequence[Rival] = RIVALS
) -> Iterator[Record]:
    """Many arms, each with its own joint positions: milliseconds an arm; rivals get as many arms as they say."""
    for arms in sizes:
        yield from _raced(f"fleet of {arms}", measured(arms, samples, seed=2), repeats, rivals)


def _raced(work: str, problem: Measured, repeats: int, rivals: Sequence[Rival]) -> Iterator[Record]:
    arms, truth = len(problem.pose), convert(problem)
    first, _ = timed(lambda: fit(problem))
    seconds, solution = median_time(lambda: fit(problem), repeats)
    # the truth itself is checked: the chains of the closed form, walked in NumPy, are those that were measured
    error = chain_error(problem.kinematics, truth, sample_joints(50, np.random.default_rng(2)))
    wrong = wrong_fit(solution, truth) or disagreement(np.array(error), np.array(0.0), 1e-12, "flange poses")
    yield Record(work, OURS, "first call, with compilation", 1e3 * first, "ms", "lower", wrong)
    yield Record(work, OURS, "fit an arm", 1e3 * seconds / arms, "ms", "lower", wrong)
    yield Record(work, OURS, "steps an arm", float(solution.steps.mean()), "", "lower", wrong)
    for rival in rivals:
        given = list(zip(problem.joint_position, problem.pose, strict=True))[: rival.arms]
        if rival.compiles:
            rival.solve(*given[0])
        taken, answers = timed(lambda rival=rival, given=given: np.array([rival.solve(*each) for each in given]))
        wrong = disagreement(answers, solution.parameters[: len(given)], AGREES, "parameters (m, rad)")
        yield Record(work, rival.name, "fit an arm", 1e3 * taken / len(given), "ms", "lower", wrong)
        ratio = taken / len(given) * arms / seconds
        yield Record(work, OURS, f"faster than {rival.name}", ratio, "×", "higher", wrong)
