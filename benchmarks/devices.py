"""The same fits on the processor and on an accelerator, in float64, a column each: `python -m benchmarks --device gpu`.

Answers are checked on every device. Products of matrices in both precisions say how weak the float64 of a card is.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.fits import convert, fit, wrong_fit
from benchmarks.measure import Record, disagreement, median_time, timed
from benchmarks.problem import NOISE, measured
from benchmarks.seed_way import sample_joints
from lite6jax.identifiability.information import plan_experiment
from lite6jax.identifiability.sensor import Sensor

DEVICES = ("cpu", "gpu")


def absent(device: str) -> str:
    """Why there is no such device; empty where there is one."""
    try:
        jax.devices(device)
    except RuntimeError:
        return (
            f"--device {device}: JAX sees none here; on a machine with an NVIDIA card pip install 'lite6jax[gpu]', or "
            "leave it out"
        )
    return ""


def devices(
    device: str = "cpu",
    arms: Sequence[int] = (1024, 16_384),
    samples: Sequence[int] = (100_000,),
    poses: int = 100_000,
    order: int = 2048,
    repeats: int = 3,
) -> Iterator[Record]:
    """Fits of many arms and of many samples, and the information of many poses, on the processor and the device.

    Args:
        device: one of `DEVICES`.
        arms: of 300 samples each.
        samples: of one arm.
        poses: whose information is computed.
        order: of the square matrices that are multiplied.
        repeats: of each measurement, after one that compiles.
    """
    experiment = plan_experiment("lite6", Sensor("pose", *NOISE), frame=False)
    q = sample_joints(poses, np.random.default_rng(0))
    information = None
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
            experiment.information(q)
            seconds, found = median_time(lambda: experiment.information(q), repeats)
            information = found if information is None else information
            wrong = disagreement(
                found / np.abs(information).max(), information / np.abs(information).max(), 1e-12, "it"
            )
            yield Record("devices", platform, f"information of {poses} poses", 1e3 * seconds, "ms", "lower", wrong)
            for kind in (jnp.float64, jnp.float32):
                matrix = jnp.ones((order, order), kind)
                (matrix @ matrix).block_until_ready()
                seconds, _ = median_time(lambda matrix=matrix: (matrix @ matrix).block_until_ready(), repeats)
                speed = 2 * order**3 / seconds / 1e9
                yield Record("devices", platform, f"products in {matrix.dtype}", speed, "GFlop/s", "higher")


@contextmanager
def on(platform: str) -> Iterator[None]:
    """What is computed inside is computed on the first such device, by every thread."""
    before = getattr(jax.config, "jax_default_device", None)
    jax.config.update("jax_default_device", jax.devices(platform)[0])
    try:
        yield
    finally:
        jax.config.update("jax_default_device", before)
