"""The same fits on the processor and an accelerator, in float64, a column each: `python -m benchmarks --device gpu`.

Answers are checked on every device. Products of matrices in both precisions say how weak the float64 of a card is, and
a plain Gauss–Newton compares curvatures in float32 and float64; residuals and gradient are in float64 in both.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import DTypeLike

from benchmarks.fits import convert, fit, wrong_fit
from benchmarks.measure import Record, disagreement, median_time, timed
from benchmarks.problem import NOISE, measured
from benchmarks.seed_way import sample_joints
from lite6jax.arms.description import load_bundled
from lite6jax.calibration.residual import Observations, evaluate, linearise, observe, over_blocks
from lite6jax.calibration.solve import inverse
from lite6jax.design.information import plan_experiment
from lite6jax.design.sensor import Sensor
from lite6jax.errors import InputError
from lite6jax.model import ArmModel, ModelForm


def devices(
    device: str = "cpu",
    arms: Sequence[int] = (1024, 16_384),
    samples: Sequence[int] = (100_000,),
    poses: int = 100_000,
    order: int = 2048,
    repeats: int = 3,
) -> Iterator[Record]:
    """Fits of many arms and of many samples, and the Jacobian of many poses, on the processor and the device.

    Args:
        device: cpu or gpu.
        arms: of 300 samples each.
        samples: of one arm.
        poses: whose Jacobian is computed.
        order: of the square matrices that are multiplied.
        repeats: of each measurement, after one that compiles.

    Raises:
        InputError: there is no such device here.
    """
    try:
        jax.devices(device)
    except RuntimeError as error:
        raise InputError(
            f"--device {device}: JAX sees none here; on a machine with an NVIDIA card pip install 'lite6jax[gpu]', or "
            "leave it out"
        ) from error
    experiment = plan_experiment("lite6", Sensor("pose", *NOISE), frame=False)
    q = sample_joints(poses, np.random.default_rng(0))
    rows = None
    for platform in dict.fromkeys(("cpu", device)):
        with on(platform):
            for count, size in [(count, 300) for count in arms] + [(1, size) for size in samples]:
                problem = measured(count, size, seed=2)
                first, _ = timed(lambda problem=problem: fit(problem))
                seconds, solution = median_time(lambda problem=problem: fit(problem), repeats)
                wrong = wrong_fit(solution, convert(problem))
                work = f"{count} × {size}"
                yield Record("devices", platform, f"first fit of {work}", first, "s", "lower", wrong)
                yield Record("devices", platform, f"fit of {work}, an arm", 1e3 * seconds / count, "ms", "lower", wrong)
            experiment.rows(q)
            seconds, found = median_time(lambda: experiment.rows(q), repeats)
            rows = found if rows is None else rows
            largest = np.abs(rows).max()
            wrong = disagreement(found / largest, rows / largest, 1e-12, "it")
            yield Record("devices", platform, f"Jacobian of {poses} poses", 1e3 * seconds, "ms", "lower", wrong)
            with jax.default_matmul_precision("float32"):  # a card may round its factors to fewer digits
                yield from mixed_precision(platform, arms[0], repeats)
                for kind in (jnp.float64, jnp.float32):
                    matrix = jnp.ones((order, order), kind)
                    (matrix @ matrix).block_until_ready()
                    seconds, _ = median_time(lambda matrix=matrix: (matrix @ matrix).block_until_ready(), repeats)
                    speed = 2 * order**3 / seconds / 1e9
                    yield Record("devices", platform, f"products in {matrix.dtype}", speed, "GFlop/s", "higher")


def mixed_precision(platform: str, arms: int, repeats: int) -> Iterator[Record]:
    """Gauss–Newton with a new curvature in every step, in float64 and in float32: steps, and milliseconds an arm."""
    problem, lite6 = measured(arms, 300, seed=2), load_bundled("lite6")
    form, known = ModelForm(lite6.form), fit(problem).parameters
    q, pose = jnp.asarray(problem.joint_position), jnp.asarray(problem.pose)
    start = ArmModel(*(jnp.asarray(part) for part in (lite6.hayati, np.eye(4), lite6.T_joint_flange)))
    whitener, weight = 1 / jnp.asarray(NOISE), jnp.ones(q.shape[1])
    observed = jax.vmap(partial(observe, form, weight=weight, whitener=whitener, block=q.shape[1]))(q, pose)
    solve = jax.jit(jax.vmap(partial(_gauss_newton, form, start), (0, None)), static_argnums=1)
    for kind in (jnp.float64, jnp.float32):
        jax.block_until_ready(solve(observed, kind))
        seconds, (found, steps) = median_time(lambda kind=kind: jax.block_until_ready(solve(observed, kind)), repeats)
        wrong = disagreement(np.asarray(found), known, 1e-9, "parameters (m, rad)")
        curvature = f"curvature in {jnp.dtype(kind).name}"
        yield Record("devices", platform, f"{curvature}: steps", float(np.mean(steps)), "", "lower", wrong)
        yield Record("devices", platform, f"{curvature}: an arm", 1e3 * seconds / arms, "ms", "lower", wrong)


def _gauss_newton(form: ModelForm, start: ArmModel, observed: Observations, kind: DTypeLike) -> tuple[Array, Array]:
    """The Hayati parameters of one arm, and its steps until one is below 1e-10 m and rad."""

    def linearised(model: ArmModel) -> tuple[Array, Array]:
        if kind == jnp.float64:
            return over_blocks(lambda block: linearise(form, model, block, None), observed)[1:]
        _, gradient = over_blocks(lambda block: evaluate(form, model, block, None), observed)
        rough, seen = jax.tree.map(lambda leaf: leaf.astype(kind), (model, observed))
        return gradient, over_blocks(lambda block: linearise(form, rough, block, None), seen)[2].astype(gradient.dtype)

    def step(state: tuple[ArmModel, Array, Array]) -> tuple[ArmModel, Array, Array]:
        model, _, count = state
        gradient, H = linearised(model)
        along = -inverse(H) @ gradient
        return form.retract(model, along), jnp.abs(along).max(), count + 1

    going = (start, jnp.asarray(jnp.inf), jnp.asarray(0))
    model, _, count = jax.lax.while_loop(lambda state: (state[1] > 1e-10) & (state[2] < 20), step, going)
    return model.geometry, count


@contextmanager
def on(platform: str) -> Iterator[None]:
    """What is computed inside is computed on the first such device, by every thread."""
    before = getattr(jax.config, "jax_default_device", None)
    jax.config.update("jax_default_device", jax.devices(platform)[0])
    try:
        yield
    finally:
        jax.config.update("jax_default_device", before)
