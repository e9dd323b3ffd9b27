"""Where the time of a fleet's fit goes: a chunk's parts on one thread, against JᵀJ at the speed of a matrix product."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.fits import wrong_fit
from benchmarks.measure import Record, disagreement, median_time
from benchmarks.problem import NOISE, SCALE, measured
from lite6jax.arms.bundled import load_bundled
from lite6jax.arms.dh import six_parameter_to_hayati
from lite6jax.fitting import gauss_newton
from lite6jax.fitting.fleet import fit_fleet
from lite6jax.fitting.gauss_newton import CHUNK
from lite6jax.fitting.residual import (
    POSE,
    evaluate,
    linearise,
    observe,
    padded_size,
    predict_frames,
    residuals,
)
from lite6jax.model import ModelForm, arm_model
from tests.oracles.chains import seed_poses

SUBJECT = "one thread"


def profile(samples: int = 300, repeats: int = 50) -> Iterator[Record]:
    """Milliseconds an arm of each part, called once, and of the whole fit of one chunk (one worker, so one thread)."""
    lite6 = load_bundled("lite6")
    form = ModelForm(lite6.form)
    problem = measured(CHUNK, samples, seed=5)
    size, block = padded_size(samples)
    fill = [(0, 0), (0, size - samples)]
    joint_position = jnp.asarray(np.pad(problem.joint_position, [*fill, (0, 0)]))
    pose = jnp.asarray(np.pad(problem.pose, [*fill, (0, 0), (0, 0)]))
    weight = jnp.asarray(np.pad(np.ones((CHUNK, samples)), fill))
    data = (joint_position, pose, weight, jnp.broadcast_to(jnp.array(SCALE), (CHUNK, 2)))

    parts = {"data preparation": _single_threaded(jax.vmap(partial(observe, form, block=block)))}
    seconds, observed = median_time(partial(_done, parts["data preparation"], *data), repeats)
    observed = jax.tree.map(lambda leaf: leaf[:, 0], observed)  # one block an arm
    model = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (CHUNK, *leaf.shape)), arm_model(lite6.hayati))
    yield _record("data preparation", seconds)

    def per_arm(function: Callable) -> Callable:
        return _single_threaded(jax.vmap(lambda model, seen: function(form, model, seen, None)))

    def walked(form: ModelForm, model: Any, seen: Any, robust: None) -> Any:
        return predict_frames(form, model, seen.joint)[1]

    def differentiated(form: ModelForm, model: Any, seen: Any, robust: None) -> Any:
        """What the Gauss–Newton pieces are checked against: automatic differentiation of the plain residual."""

        def flat(step: jax.Array) -> jax.Array:
            return residuals(form, form.retract(model, step), seen).reshape(-1)

        zero = jnp.zeros(form.size)
        r, J = flat(zero), jax.jacfwd(flat)(zero)
        return 0.5 * r @ r, J.T @ r, J.T @ J

    cost, gradient, curvature = (np.asarray(leaf) for leaf in per_arm(differentiated)(model, observed))

    def relative(answers: tuple, *references: np.ndarray, within: float) -> str:
        pairs = zip(answers, references, strict=True)
        scaled = [np.abs(np.asarray(a) - b).max() / np.abs(b).max() for a, b in pairs]
        return disagreement(np.array(scaled), np.zeros(len(scaled)), within, "relative to automatic differentiation")

    seconds, frame = median_time(partial(_done, per_arm(walked), model, observed), repeats)
    reached = np.moveaxis(np.asarray(frame.origin), 1, 2)[:, :samples]
    plain = np.array([seed_poses(lite6.hayati, q)[:, :3, 3] for q in problem.joint_position])
    yield _record("chain alone", seconds, disagreement(reached, plain, 1e-12, "flange positions"))
    seconds, answer = median_time(partial(_done, per_arm(evaluate), model, observed), repeats)
    yield _record("cost and gradient", seconds, relative(answer, cost, gradient, within=1e-10))
    seconds, answer = median_time(partial(_done, per_arm(linearise), model, observed), repeats)
    # the curvature leaves out the logarithm's own derivative, half the residual angle of some milliradians
    wrong = relative(answer[:2], cost, gradient, within=1e-10) or relative(answer[2:], curvature, within=1e-2)
    yield _record("cost, gradient and curvature", seconds, wrong)

    def jacobian(form: ModelForm, model: Any, seen: Any, robust: None) -> Any:
        step = jnp.zeros(form.size)
        return jax.jacfwd(lambda step: residuals(form, form.retract(model, step), seen).reshape(-1))(step).T

    J = jax.block_until_ready(per_arm(jacobian)(model, observed))
    limit, product = median_time(partial(_done, _single_threaded(jax.vmap(lambda J: J @ J.T)), J), repeats)
    host = np.asarray(J)
    reference = host @ np.swapaxes(host, 1, 2)
    yield _record(f"JᵀJ alone, {form.size} × {POSE * size}", limit, relative((product,), reference, within=1e-12))
    inverse = _single_threaded(jax.vmap(gauss_newton.inverse))
    seconds, inverted = median_time(partial(_done, inverse, product), repeats)
    # rows and columns scaled: the parameters' units differ by the sensor's
    scale = np.sqrt(np.diagonal(reference, axis1=1, axis2=2))
    unit = np.asarray(inverted) @ reference * scale[:, :, None] / scale[:, None, :]
    wrong = disagreement(unit, np.broadcast_to(np.eye(form.size), unit.shape), 1e-8, "inverse times matrix")
    yield _record("inverse", seconds, wrong)

    def whole() -> Any:
        return fit_fleet(problem.joint_position, problem.pose, nominal=lite6, noise=NOISE)

    whole()
    seconds, solution = median_time(whole, repeats)
    wrong = wrong_fit(solution, six_parameter_to_hayati(lite6.form, problem.kinematics, lite6.hayati))
    yield _record(f"whole fit, chunk of {CHUNK}", seconds, wrong)
    yield Record("profile", SUBJECT, "steps an arm", float(solution.steps.mean()), "", "lower", wrong)
    yield Record("profile", SUBJECT, "whole fit over JᵀJ alone", seconds / limit, "×", "lower", wrong)


def _single_threaded(function: Callable) -> Callable:
    """Compiled as the fleet's chunks are."""
    return jax.jit(function, compiler_options={"xla_cpu_multi_thread_eigen": False})


def _done(function: Callable, *arguments: Any) -> Any:
    return jax.block_until_ready(function(*arguments))


def _record(part: str, seconds: float, wrong: str = "") -> Record:
    return Record("profile", SUBJECT, part, 1e3 * seconds / CHUNK, "ms an arm", "lower", wrong)
