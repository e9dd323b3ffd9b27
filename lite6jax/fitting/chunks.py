"""Many arms solved in chunks whose arrays stay in a core's cache, on every core: the batched solve below every fit."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, export
from jax.typing import ArrayLike

from lite6jax import threads
from lite6jax.arms.se3 import joint_turn
from lite6jax.fitting import gauss_newton
from lite6jax.fitting.compiled import Exported
from lite6jax.fitting.gauss_newton import Prior, Solved, solve_chunk
from lite6jax.fitting.quick_turn import quick_turn
from lite6jax.fitting.residual import Observations, Robust, differences, predict_frames, whiten
from lite6jax.fitting.status import NOT_FINITE, SINGULAR
from lite6jax.model import ArmModel, ModelForm

CHUNK = 16
"""Arms solved together: their Jacobians of 300 poses (16 × 43 × 900 doubles, 5 MB) stay in a core's cache."""
ON_ACCELERATOR = 1024
"""The same on an accelerator, which works on all at once; not tuned, as none was at hand."""
BLOCK = 2400
"""Samples walked together, for the same reason; memory beyond the input does not grow with their number."""
MAX_STEPS = 100
SINGULAR_ABOVE = 1e11
"""Inflation of a variance by correlation beyond which rounding decides the parameter."""

_COMPILED: set[tuple[object, ...]] = set()
# One thread a chunk: XLA's own pool would otherwise be shared by the chunks that run side by side.
SINGLE_THREADED = {"xla_cpu_multi_thread_eigen": False}


class Summary(NamedTuple):
    """What is kept of a chunk, one row an arm: the solver's answer, covariance, squared whitened residuals, the number
    of samples that were used, and root-mean-square errors."""

    solved: Solved
    covariance: Array
    squares: Array
    samples: Array
    position_rms: Array
    orientation_rms: Array


def observe(
    form: ModelForm, joint_position: Array, pose: Array, weight: Array, whitener: Array, block: int
) -> Observations:
    """One arm's data as the residual wants it, cut into blocks.

    Args:
        form: whose chain says which joints are prismatic.
        joint_position: `(sample, joint)` rad, and m of prismatic joints.
        pose: `(sample, 4, 4)`, or `(sample, 3)` where only positions were measured; missing where not finite.
        weight: `(sample,)`.
        whitener: `(2,)` or `(sample, row, row)`.
        block: samples in a block; divides their number.
    """
    axes = tuple(range(1, pose.ndim))
    finite = jnp.all(jnp.isfinite(pose), axes) & jnp.all(jnp.isfinite(joint_position), 1)
    used = finite & (weight > 0)
    pose = jnp.where(used.reshape(-1, *[1] * len(axes)), pose, 1.0)
    q = jnp.where(used[:, None], joint_position, 0.0)

    def blocked(leaf: Array) -> Array:
        return jnp.moveaxis(leaf.reshape(-1, block, *leaf.shape[1:]), 1, -1)

    position, rotation = (pose[:, :3, 3], pose[:, :3, :3]) if pose.ndim == 3 else (pose, pose[:, None, :0])
    count = weight.shape[0] // block
    rotation = blocked(rotation) if pose.ndim == 3 else jnp.zeros((count, 3, 3, 0))
    whitener = jnp.broadcast_to(whitener, (count, 2)) if whitener.ndim == 1 else blocked(whitener)
    joint = joint_turn(blocked(q), form.chain.sliding, quick_turn)
    return Observations(joint, blocked(position), rotation, blocked(jnp.where(used, weight, 0.0)), whitener)


def _solve_and_measure(
    form: ModelForm,
    start: ArmModel,
    joint_position: Array,
    pose: Array,
    weight: Array,
    whitener: Array,
    robust: Robust | None,
    prior: Prior,
    block: int,
    max_steps: ArrayLike,
    keep_curvature: bool = True,
) -> Summary:
    shared = joint_position.ndim == 2
    prepare = jax.vmap(partial(observe, form, block=block), in_axes=(None if shared else 0, 0, 0, 0))
    observed = prepare(joint_position, pose, weight, whitener)
    solved = solve_chunk(form, start, observed, robust, prior, max_steps, keep_curvature)
    covariance = jax.vmap(gauss_newton.inverse)(solved.curvature) * (prior.free[:, :, None] * prior.free[:, None, :])
    # how much its correlation with the others inflates a parameter's variance
    inflation = jnp.diagonal(covariance, axis1=1, axis2=2) * jnp.diagonal(solved.curvature, axis1=1, axis2=2)
    regular = jnp.all((prior.free == 0) | ((inflation > 0.5) & (inflation < SINGULAR_ABOVE)), 1)
    doubtful = (solved.status != NOT_FINITE) & ~regular
    covariance = jnp.where(regular[:, None, None], covariance, jnp.nan)
    solved = solved._replace(status=jnp.where(doubtful, SINGULAR, solved.status))
    squares, shift, spin = jax.vmap(partial(_errors, form))(solved.model, observed)
    used = jnp.sum(observed.weight > 0, (1, 2))
    count = jnp.maximum(used, 1)
    rms = [jnp.sqrt(jnp.sum(part, 1) / count) for part in (shift, spin)]
    return Summary(solved, covariance, squares, used, rms[0], rms[1])


for _kind in (ArmModel, Prior, Robust, Solved, Summary):
    export.register_namedtuple_serialization(_kind, serialized_name=f"lite6jax.{_kind.__name__}")
_fit_chunk = Exported("fit_chunk", _solve_and_measure, (0, 8), SINGLE_THREADED)
# For one small fit, where a second of the compiler's optimisation would save five milliseconds.
_fit_once = Exported(
    "fit_once",
    partial(_solve_and_measure, keep_curvature=False),
    (0, 8),
    SINGLE_THREADED | {"xla_backend_optimization_level": 0},
)


def _errors(form: ModelForm, model: ArmModel, observed: Observations) -> tuple[Array, Array, Array]:
    """Squared whitened residuals, distances and angles, `(sample,)` each, zero where missing."""

    def one(block: Observations) -> tuple[Array, Array, Array]:
        raw = differences(block, predict_frames(form, model, block.joint)[1])
        there = block.weight > 0
        rows = (whiten(block.whitener, raw), raw[:3], raw[3:])
        return tuple(jnp.where(there, jnp.sum(part**2, 0), 0.0) for part in rows)  # type: ignore[return-value]

    return tuple(leaf.reshape(-1) for leaf in jax.lax.map(one, observed))  # type: ignore[return-value]


def padded_size(samples: int) -> tuple[int, int]:
    """How many samples to pad to, and a block's size: few shapes, so that few are compiled; it adds at most 1/16."""
    if samples > BLOCK:
        return -(-samples // BLOCK) * BLOCK, BLOCK
    grain = max(4, 2 ** (max(samples - 1, 1).bit_length() - 5))
    size = -(-samples // grain) * grain
    return size, size


def pad(array: np.ndarray, axis: int, size: int) -> np.ndarray:
    """The array with zeros appended along an axis."""
    missing = size - array.shape[axis]
    if missing == 0:
        return array
    return np.pad(array, [(0, missing if i == axis else 0) for i in range(array.ndim)])


def _platform() -> str:
    """Of the device that computes where nothing else is said."""
    device = getattr(jax.config, "jax_default_device", None)
    return jax.default_backend() if device is None else getattr(device, "platform", device)


def fit_chunks(
    form: ModelForm,
    start: ArmModel,
    joint_position: np.ndarray,
    pose: np.ndarray,
    weight: np.ndarray,
    whitener: np.ndarray,
    robust: Robust | None,
    prior: Prior,
    chunk: int | None = None,
    once: bool = False,
    max_steps: int = MAX_STEPS,
    progress: Callable[[int], object] | None = None,
) -> Summary:
    """Fits arms chunk by chunk on every core.

    Args:
        form: what moves.
        start: where from, one for all or with a leading arm axis.
        joint_position: `(arm, sample, joint)`, or `(sample, joint)` shared.
        pose: `(arm, sample, 4, 4)` or `(arm, sample, 3)`.
        weight: `(arm, sample)`.
        whitener: `(2,)` one for all, or `(arm, sample, row, row)`.
        robust: the loss, one for all or with a leading arm axis; None is least squares.
        prior: one for all or with a leading arm axis.
        chunk: arms in a chunk; `CHUNK` or `ON_ACCELERATOR` where not given.
        once: whether this is all that will be solved of this kind, so that compiling fast matters more than running.
        max_steps: most steps an arm may take.
        progress: called with the number of arms done since the last call.

    Returns:
        NumPy arrays, a row an arm.
    """
    arms, samples = weight.shape
    chunk = min(chunk or (CHUNK if _platform() == "cpu" else ON_ACCELERATOR), arms)
    size, block = padded_size(samples)

    def part(array: np.ndarray, first: int) -> np.ndarray:
        """A chunk's arms of an array; the last chunk is filled up with its last arm."""
        arms = array[first : first + chunk]
        return arms if len(arms) == chunk else np.concatenate([arms, np.repeat(arms[-1:], chunk - len(arms), 0)])

    def each(leaf: ArrayLike, ndim: int, first: int) -> Any:
        """As `part`, of a leaf that lacks the arm axis where all arms share it."""
        array = np.asarray(leaf, float)
        return part(array, first) if array.ndim > ndim else np.broadcast_to(array, (chunk, *array.shape))

    def solve(first: int) -> Summary:
        q = joint_position if joint_position.ndim == 2 else part(joint_position, first)
        result = (_fit_once if once else _fit_chunk)(
            form,
            ArmModel(*(each(leaf, ndim, first) for leaf, ndim in zip(start, (1, 2, 2), strict=True))),
            pad(q, q.ndim - 2, size),
            pad(part(pose, first), 1, size),
            pad(part(weight, first), 1, size),
            pad(part(whitener, first), 1, size) if whitener.ndim == 4 else each(whitener, 1, first),
            robust and Robust(*(each(leaf, 0, first) for leaf in robust)),
            Prior(*(each(leaf, 1, first) for leaf in prior)),
            block,
            max_steps,
        )
        kept = min(chunk, arms - first)
        result = jax.tree.map(lambda leaf: np.asarray(leaf)[:kept], result)
        return result._replace(squares=result.squares[:, :samples])

    def counted(results: Iterable[Summary]) -> Iterator[Summary]:
        for result in results:
            if progress:
                progress(len(result.squares))
            yield result

    firsts = range(0, arms, chunk)
    compiled = (once, form, chunk, size, block, robust is None, joint_position.ndim, pose.ndim, whitener.ndim)
    workers = min(threads.available(), len(firsts))
    if workers == 1:
        parts = [*counted(map(solve, firsts))]
    else:
        head = (
            [] if compiled in _COMPILED else [*counted([solve(firsts[0])])]
        )  # once, before the threads could each begin to
        with ThreadPoolExecutor(workers) as pool:
            parts = [*head, *counted(pool.map(solve, firsts[len(head) :]))]
    _COMPILED.add(compiled)
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
