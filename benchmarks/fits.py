"""Fits of simulated arms to noisy poses: beside SciPy and Ceres in C++, of many samples, and on an accelerator.

The arms are of the seed's tolerance, and the tests' oracle says what a noisy sensor reads of them: nothing of the
library is used but the bundled arm's nominal numbers.

Ceres takes a C++ compiler and Debian's `libceres-dev`; both are compiled with what this machine's processor has. Ratios
are of processor time, which other work on the machine changes less than wall time.
"""

import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import DTypeLike
from scipy.optimize import least_squares

from benchmarks import seed_way
from benchmarks.measure import AGREES, OURS, ROOT, Record, disagreement, median_time, time_call, unlikely
from benchmarks.seed_way import NOMINAL, sample_joints
from lite6jax.arms.chains import HayatiForm
from lite6jax.arms.description import load_bundled
from lite6jax.arms.dh import six_parameter_to_hayati
from lite6jax.calibration.fleet import FleetSolution, fit_fleet
from lite6jax.calibration.quality import Result
from lite6jax.calibration.residual import Observations, evaluate, linearise, observe, over_blocks, residuals
from lite6jax.calibration.solve import inverse
from lite6jax.errors import InputError
from lite6jax.model import ArmModel, ModelForm, arm_model
from tests.oracles.arms import ASSEMBLY
from tests.oracles.chains import seed_poses, six_parameter_poses
from tests.oracles.transforms import perturb_poses

NOISE = (20e-6, 0.1e-3)  # one standard deviation of a measured position (m) and orientation (rad), per axis
SCALE = (1 / NOISE[0], 1 / NOISE[1])
BLOCK = 50_000
TOLERANCE = 1e-12  # of step and cost, relative: tight enough to agree to 1e-9, loose enough that no rival runs in place
STEPS = 1000  # most evaluations a fit may take
SOURCE = Path(__file__).with_name("ceres.cpp")
HEADERS = Path("/usr/include/ceres/ceres.h")
CERES = "Ceres in C++"


class Measured(NamedTuple):
    """Simulated measurements."""

    kinematics: np.ndarray  # the true `(arm, 6, 6)`
    joint_position: np.ndarray  # `(arm, sample, 6)` rad
    pose: np.ndarray  # what the sensor reads, `(arm, sample, 4, 4)`


def simulated_arms(arms: int, seed: int) -> np.ndarray:
    """True six-parameter chains `(arm, 6, 6)`, each number normal about the Lite 6's with the seed's size as its sd."""
    spread = ASSEMBLY * np.random.default_rng(seed).standard_normal((arms, 6, 6))
    return load_bundled("lite6").kinematics + spread


def measured(arms: int, samples: int, seed: int) -> Measured:
    """Arms that each take their own joint positions, and their noisy poses."""
    rng = np.random.default_rng((seed, 1))
    kinematics = simulated_arms(arms, seed)
    joint_position = sample_joints(arms * samples, rng).reshape(arms, samples, 6)
    pose = np.empty((arms, samples, 4, 4))
    for arm in range(arms):
        for first in range(0, samples, BLOCK):
            part = slice(first, first + BLOCK)
            pose[arm, part] = perturb_poses(
                rng, six_parameter_poses(kinematics[arm], joint_position[arm, part]), *NOISE
            )
    return Measured(kinematics, joint_position, pose)


def chain_error(kinematics: np.ndarray, parameters: np.ndarray, joint_position: np.ndarray) -> float:
    """The largest difference in any entry of the flange pose of true chains `(arm, 6, 6)` and models `(arm, 28)`."""
    pairs = zip(kinematics, parameters, strict=True)
    return max(
        float(np.abs(six_parameter_poses(true, joint_position) - seed_poses(model, joint_position)).max())
        for true, model in pairs
    )


class Rival(NamedTuple):
    """Another way to fit one arm to the same whitened residual, from the nominal parameters."""

    name: str  # for the table
    # of joint positions `(sample, 6)` and measured poses `(sample, 4, 4)` the seed's 28 parameters
    solve: Callable[[np.ndarray, np.ndarray], np.ndarray]
    arms: int  # of a fleet, how many it is given; the slower, the fewer


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

    # any, as its stub knows only the names of finite differences
    jacobian: Any = lambda moved: np.asarray(_jacobian(form, whole(moved), observed))[free].T  # noqa: E731
    tight: dict[str, Any] = dict.fromkeys(("xtol", "ftol", "gtol"), tolerance) | {"max_nfev": STEPS}
    left = lambda moved: np.asarray(_residuals(form, whole(moved), observed))  # noqa: E731
    solved = least_squares(left, start[free], jacobian, method="lm", x_scale="jac", **tight)
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


JACOBIAN = Rival("SciPy, JAX Jacobian", jax_jacobian, 4)
RIVALS = (Rival("seed's way", python_loop, 1), JACOBIAN)


def fit(problem: Measured) -> FleetSolution:
    """The library's fit of all arms."""
    return fit_fleet(problem.joint_position, problem.pose, nominal="lite6", noise=NOISE)


def wrong_fit(solution: FleetSolution, problem: Measured) -> str:
    """Why the library's fit is not right; empty where it is."""
    stopped = int((solution.result != Result.CONVERGED).sum())
    if stopped:
        return f"{stopped} of {len(solution.result)} arms did not converge"
    lite6 = load_bundled("lite6")
    truth = six_parameter_to_hayati(lite6.form, problem.kinematics, lite6.hayati)
    # the truth itself is checked: the chains of the closed form, walked in NumPy, are those that were measured
    few = slice(0, 100)
    error = chain_error(problem.kinematics[few], truth[few], sample_joints(50, np.random.default_rng(2)))
    wrong = unlikely(solution.parameters, solution.covariance, truth)
    return wrong or disagreement(np.array(error), 0.0, 1e-12, "flange poses")


# ------------------------------------------------------------------ beside SciPy


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
    arms = len(problem.pose)
    first, _ = time_call(lambda: fit(problem))
    seconds, solution = median_time(lambda: fit(problem), repeats)
    wrong = wrong_fit(solution, problem)
    yield Record(work, OURS, "first call, with compilation", 1e3 * first, "ms", wrong)
    yield Record(work, OURS, "fit an arm", 1e3 * seconds / arms, "ms", wrong)
    for rival in rivals:
        given = list(zip(problem.joint_position, problem.pose, strict=True))[: rival.arms]
        if rival.solve is not python_loop:
            rival.solve(*given[0])  # compiles
        taken, answers = time_call(lambda rival=rival, given=given: np.array([rival.solve(*each) for each in given]))
        wrong = disagreement(answers, solution.parameters[: len(given)], AGREES, "parameters (m, rad)")
        yield Record(work, rival.name, "fit an arm", 1e3 * taken / len(given), "ms", wrong)
        yield Record(work, OURS, f"faster than {rival.name}", taken / len(given) * arms / seconds, "×", wrong)


# ------------------------------------------------------------------ beside Ceres Solver in C++, on the same threads


def ceres(arms: int = 64, samples: int = 300, threads: int = 2, repeats: int = 7) -> Iterator[Record]:
    """Milliseconds of processor time and of wall time an arm, and their ratios; runs alternate."""
    if shutil.which("g++") is None or not HEADERS.exists():
        raise InputError("no C++ compiler or no Ceres here; apt-get install g++ libceres-dev")
    problem = measured(arms, samples, seed=2)
    work = f"fleet of {arms} × {samples}, {threads} threads"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        program, given, out = folder / "ceres", folder / "in", folder / "out"
        flags = ["-O3", "-march=native", "-DNDEBUG", "-std=c++17", "-I/usr/include/eigen3"]
        subprocess.run(["g++", *flags, SOURCE, "-o", program, "-lceres", "-lglog", "-lpthread"], check=True)
        poses = np.concatenate([problem.pose[..., :3, :3].reshape(arms, samples, 9), problem.pose[..., :3, 3]], -1)
        data = np.concatenate([problem.joint_position.reshape(arms, -1), poses.reshape(arms, -1)], 1)
        np.concatenate([[arms, samples, threads, 1], SCALE, NOMINAL, data.ravel()]).tofile(given)
        solution, ours, theirs, found = fit(problem), [], [], np.zeros(0)
        for _ in range(repeats):
            subprocess.run([program, given, out], check=True)
            found = np.fromfile(out)
            theirs.append(found[:2])
            wall, processor = time.perf_counter(), time.process_time()
            fit(problem)
            ours.append((time.perf_counter() - wall, time.process_time() - processor))
    wrong = wrong_fit(solution, problem)
    parameters = found[2:].reshape(arms, -1)[:, :-1]
    theirs_wrong = disagreement(parameters, solution.parameters, AGREES, "parameters (m, rad)")
    for k, kind in enumerate(("wall time", "processor time")):
        best = [min(run[k] for run in runs) for runs in (ours, theirs)]
        for subject, seconds, said in zip((OURS, CERES), best, (wrong, theirs_wrong), strict=True):
            yield Record(work, subject, f"{kind} an arm", 1e3 * seconds / arms, "ms", said)
        yield Record(work, OURS, f"faster in {kind}", best[1] / best[0], "×", wrong or theirs_wrong)


# ------------------------------------------------------------------ very many samples


def samples(sizes: Sequence[int] = (100_000, 1_000_000)) -> Iterator[Record]:
    """Seconds and peak memory for each number of samples, and the ratio of the times over that of the sizes.

    Each size runs in a process of its own, `python -m benchmarks.fits N`, whose peak memory is therefore its alone.
    """
    seconds: list[float] = []
    for size in sizes:
        work = f"{size:.0e} samples".replace("e+0", "e")
        command = [sys.executable, "-m", __spec__.name, str(size)]
        run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
        if run.returncode:
            reason = (run.stderr.strip().splitlines() or [f"exit code {run.returncode}"])[-1]
            yield Record(work, OURS, "fit", None, "s", reason)
            return
        said = json.loads(run.stdout.splitlines()[-1])
        seconds.append(said["seconds"])
        yield Record(work, OURS, "fit", said["seconds"], "s", said["wrong"])
        yield Record(work, OURS, "peak memory", said["peak"] / 1e6, "MB", said["wrong"])
    yield Record("samples", OURS, "time over linear", seconds[-1] / seconds[0] * sizes[0] / sizes[-1], "×")


def peak_memory() -> int:
    """Bytes of memory this process has had at most.

    Linux counts into `ru_maxrss` what the parent had when it started us; the high-water mark in /proc is ours alone.
    """
    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return 1024 * int(line.split()[1])
    import resource  # absent on Windows

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def _print_samples(size: int, repeats: int = 3) -> None:
    """One JSON line of figures."""
    problem = measured(1, size, seed=3)
    fit(problem)
    seconds, solution = median_time(lambda: fit(problem), repeats)
    peak = peak_memory()
    print(json.dumps({"seconds": seconds, "peak": peak, "wrong": wrong_fit(solution, problem)}))


# ------------------------------------------------------------------ an accelerator beside the processor


def devices(
    device: str = "cpu", arms: Sequence[int] = (1024, 16_384), order: int = 2048, repeats: int = 3
) -> Iterator[Record]:
    """Fits of many arms on the processor and the device, in float64; answers are checked on each.

    Products of matrices in both precisions say how weak the float64 of a card is, and a plain Gauss–Newton compares
    curvatures in float32 and float64; residuals and gradient are in float64 in both.

    Args:
        device: cpu or gpu.
        arms: of 300 samples each.
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
    for platform in dict.fromkeys(("cpu", device)):
        with computing_on(platform):
            for count in arms:
                problem = measured(count, 300, seed=2)
                first, _ = time_call(lambda problem=problem: fit(problem))
                seconds, solution = median_time(lambda problem=problem: fit(problem), repeats)
                wrong = wrong_fit(solution, problem)
                yield Record("devices", platform, f"first fit of {count} × 300", first, "s", wrong)
                yield Record("devices", platform, f"fit of {count} × 300, an arm", 1e3 * seconds / count, "ms", wrong)
            with jax.default_matmul_precision("float32"):  # a card may round its factors to fewer digits
                yield from _mixed_precision(platform, arms[0], repeats)
                for kind in (jnp.float64, jnp.float32):
                    matrix = jnp.ones((order, order), kind)
                    (matrix @ matrix).block_until_ready()
                    seconds, _ = median_time(lambda matrix=matrix: (matrix @ matrix).block_until_ready(), repeats)
                    speed = 2 * order**3 / seconds / 1e9
                    yield Record("devices", platform, f"products in {matrix.dtype}", speed, "GFlop/s")


def _mixed_precision(platform: str, arms: int, repeats: int) -> Iterator[Record]:
    """Gauss–Newton with a new curvature in every step, in float64 and in float32: milliseconds an arm."""
    problem, lite6 = measured(arms, 300, seed=2), load_bundled("lite6")
    form, known = ModelForm(lite6.form), fit(problem).parameters
    q, pose = jnp.asarray(problem.joint_position), jnp.asarray(problem.pose)
    start = ArmModel(*(jnp.asarray(part) for part in (lite6.hayati, np.eye(4), lite6.T_joint_flange)))
    whitener, weight = 1 / jnp.asarray(NOISE), jnp.ones(q.shape[1])
    observed = jax.vmap(partial(observe, form, weight=weight, whitener=whitener, block=q.shape[1]))(q, pose)
    solve = jax.jit(jax.vmap(partial(_gauss_newton, form, start), (0, None)), static_argnums=1)
    for kind in (jnp.float64, jnp.float32):
        jax.block_until_ready(solve(observed, kind))
        seconds, found = median_time(lambda kind=kind: jax.block_until_ready(solve(observed, kind)), repeats)
        wrong = disagreement(np.asarray(found), known, AGREES, "parameters (m, rad)")
        curvature = f"curvature in {jnp.dtype(kind).name}: an arm"
        yield Record("devices", platform, curvature, 1e3 * seconds / arms, "ms", wrong)


def _gauss_newton(form: ModelForm, start: ArmModel, observed: Observations, kind: DTypeLike) -> Array:
    """The Hayati parameters of one arm, when a step is below 1e-10 m and rad."""

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

    going: Any = (start, jnp.asarray(jnp.inf), jnp.asarray(0))
    model, _, _ = jax.lax.while_loop(lambda state: (state[1] > 1e-10) & (state[2] < 20), step, going)
    return model.geometry


@contextmanager
def computing_on(platform: str) -> Iterator[None]:
    """What is computed inside is computed on the first such device, by every thread."""
    before = getattr(jax.config, "jax_default_device", None)
    jax.config.update("jax_default_device", jax.devices(platform)[0])
    try:
        yield
    finally:
        jax.config.update("jax_default_device", before)


if __name__ == "__main__":
    _print_samples(int(sys.argv[1]))
