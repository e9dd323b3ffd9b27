"""One arm and fleets of them, fitted to noisy measured poses: the library against the rivals."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
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
STEPS = 1000
"""Most evaluations a fit may take."""


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


def jax_jacobian(joint_position: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """SciPy's fastest method here, with the forward-mode Jacobian of the residual."""
    form, free = ModelForm(HayatiForm(6, (1,))), np.arange(len(NOMINAL))
    return by_minpack(form, NOMINAL, free, joint_position, pose, SCALE, TOLERANCE)[0]


def by_minpack(
    form: ModelForm,
    start: np.ndarray,
    free: np.ndarray,
    joint_position: np.ndarray,
    pose: np.ndarray,
    scale: tuple[float, float],
    tolerance: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Parameters by MINPACK's Levenberg–Marquardt, with the exact Jacobian of those that are free, and that."""
    observed = _observed(form, joint_position, pose, jnp.array(scale))

    def whole(moved: np.ndarray) -> np.ndarray:
        parameters = start.copy()
        parameters[free] = moved
        return parameters

    solved = least_squares(
        lambda moved: np.asarray(_residuals(form, whole(moved), observed)),
        start[free],
        # its stub knows only the names of finite differences
        lambda moved: np.asarray(_jacobian(form, whole(moved), observed))[free].T,  # pyright: ignore[reportArgumentType]
        method="lm",
        x_scale="jac",
        xtol=tolerance,
        ftol=tolerance,
        gtol=tolerance,
        max_nfev=STEPS,
    )
    return whole(solved.x), solved.jac


@partial(jax.jit, static_argnums=0)
def _observed(form: ModelForm, joint_position: Array, pose: Array, scale: Array) -> Observations:
    blocks = observe(form, joint_position, pose, jnp.ones(len(pose)), scale, len(pose))
    return jax.tree.map(lambda leaf: leaf[0], blocks)


@partial(jax.jit, static_argnums=0)
def _residuals(form: ModelForm, parameters: Array, observed: Observations) -> Array:
    return residuals(form, arm_model(parameters), observed).reshape(-1)


@partial(jax.jit, static_argnums=0)
def _jacobian(form: ModelForm, parameters: Array, observed: Observations) -> Array:
    """`(parameter, residual)`."""
    return jax.jacfwd(_residuals, 1)(form, parameters, observed).T


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
