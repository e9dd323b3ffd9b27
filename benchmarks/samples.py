"""One arm with very many samples: is the time linear in them, and the memory bounded?

Each size runs in a process of its own, `python -m benchmarks.samples N`, whose peak memory is therefore its alone.
"""

import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.measure import ROOT, Record, median_time, timed


def samples(sizes: Sequence[int] = (100_000, 1_000_000)) -> Iterator[Record]:
    """Seconds and peak memory for each number of samples, and the ratio of the times over that of the sizes."""
    seconds: list[float] = []
    wrong = ""
    for size in sizes:
        work = f"{size:.0e} samples".replace("e+0", "e")
        command = [sys.executable, "-m", __spec__.name, str(size)]
        run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
        if run.returncode:
            reason = (run.stderr.strip().splitlines() or [f"exit code {run.returncode}"])[-1]
            yield Record(work, "lite6jax", "fit", None, "s", "lower", reason)
            return
        figures = json.loads(run.stdout.splitlines()[-1])
        seconds.append(figures["seconds"])
        wrong = wrong or figures["wrong"]
        yield Record(work, "lite6jax", "first call, with compilation", figures["first"], "s", "lower", figures["wrong"])
        yield Record(work, "lite6jax", "fit", figures["seconds"], "s", "lower", figures["wrong"])
        yield Record(work, "lite6jax", "peak memory", figures["peak"] / 1e6, "MB", "lower", figures["wrong"])
        yield Record(work, "lite6jax", "of that before the fit", figures["before"] / 1e6, "MB", "lower")
    growth = seconds[-1] / seconds[0] * sizes[0] / sizes[-1]
    yield Record("samples", "lite6jax", "time over linear", growth, "×", "lower", wrong)


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


def main(size: int, repeats: int = 3) -> None:
    """Prints one JSON line of figures."""
    from benchmarks.fits import convert, fit, wrong_fit
    from benchmarks.problem import measured

    problem = measured(1, size, seed=3)
    before = peak_memory()
    first, _ = timed(lambda: fit(problem))
    seconds, solution = median_time(lambda: fit(problem), repeats)
    peak = peak_memory()
    wrong = wrong_fit(solution, convert(problem))
    print(json.dumps({"first": first, "seconds": seconds, "peak": peak, "before": before, "wrong": wrong}))


if __name__ == "__main__":
    main(int(sys.argv[1]))
