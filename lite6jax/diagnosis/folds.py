"""Blocks of rows that are held out, contiguous or spread over the recording, and work on several of them at once."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextvars import copy_context
from typing import TypeVar

import numpy as np

from lite6jax import threads
from lite6jax.diagnosis.fold_processes import RemoteWork, at_hand
from lite6jax.diagnosis.options import Options
from lite6jax.domains.pose.problem import PoseProblem
from lite6jax.errors import InputError
from lite6jax.estimation.noise import NoiseModel
from lite6jax.estimation.problem import Mask
from lite6jax.progress import part
from lite6jax.recordings import Recording
from lite6jax.recordings.sequence import contiguous_blocks

_MANY_ROWS = 60
"""Rows from which positions alone determine the frames and the geometry of any arm of up to about 14 joints."""

Fold = TypeVar("Fold")
Result = TypeVar("Result")


def held_out_folds(problem: PoseProblem, options: Options) -> list[Mask]:
    """The blocks `(sample,)` that are held out, one after the other.

    Raises:
        InputError: no row can be held back, because the others would be too few for the unknowns.
    """
    return problem.recording.contiguous_folds(fold_count(problem.samples, options, _rows_needed(problem)))


def likely_folds(recording: Recording, options: Options) -> list[Mask] | None:
    """The blocks of `held_out_folds`, before a problem is made, where no arm needs more of them; None of fewer rows."""
    count = fold_count(recording.samples, options)
    if fold_count(recording.samples, options, _MANY_ROWS) != count:
        return None
    return recording.contiguous_folds(count)


def fold_count(samples: int, options: Options, needed: int = 0) -> int:
    """How many blocks of so many rows are held out: more than usual where the other rows would be fewer than `needed`,
    and at most one for each row.
    """
    count = min(options.folds, samples)
    while count < samples and samples - -(-samples // count) < needed:
        count += 1
    return count


def spread_folds(folds: Sequence[Mask], noise: NoiseModel, options: Options) -> list[Mask]:
    """As many sets of rows `(sample,)` as these contiguous ones, each of up to `spread_blocks` blocks over all rows.

    A block is several autocorrelation times of the noise long, so that the rows beside it do not know its noise.
    """
    count, samples = len(folds), folds[0].size
    long = max(options.block_times * model.time if model.share else 1.0 for model in noise.models)
    blocks = contiguous_blocks(samples, count * int(np.clip(samples / long / count, 1, options.spread_blocks)))
    return [np.any(blocks[number::count], 0) for number in range(count)]


def block_count(folds: Sequence[Mask]) -> int:
    """How many contiguous blocks of rows these sets have in all."""
    return sum(int(np.sum(np.diff(held.astype(int), prepend=0) > 0)) for held in folds)


def _rows_needed(problem: PoseProblem) -> int:
    """The fewest rows that determine frames, geometry and one more number; the recording must have one more row."""
    recording, unknowns = problem.recording, problem.undeclared + 1
    needed = -(-unknowns // recording.numbers_per_sample)
    if recording.samples <= needed:
        raise InputError(
            f"{recording.source}: {recording.samples} samples are what {unknowns} numbers to determine need, so that "
            f"none can be held back; record at least {needed + 1}"
        )
    return needed


def side_by_side(
    work: Callable[[Fold], Result], folds: Sequence[Fold], elsewhere: RemoteWork[Result] | None = None
) -> list[Result]:
    """What `work` makes of each fold, in their order.

    Where other processes are at hand they take a part. Else as many threads as `threads.available` says share compiled
    functions and what is known of all rows; operations on arrays release the interpreter's lock. The stages belong to
    part 1 + the folds completed.

    Args:
        work: on a fold, here.
        folds: all.
        elsewhere: how another process works on one; None where only this one can.
    """
    others = at_hand()
    if others is not None and elsewhere is not None:
        with part(1, 1 + len(folds)) as going:
            return others.results(work, elsewhere, folds, lambda done: setattr(going, "number", 1 + done))
    pool = ThreadPoolExecutor(min(len(folds), threads.available()))
    try:
        with part(1, 1 + len(folds)) as going:
            # each in a copy of this context, which says who follows the progress
            begun = [pool.submit(copy_context().run, work, fold) for fold in folds]
            for each in as_completed(begun):
                each.result()
                going.number += 1
        return [each.result() for each in begun]
    finally:
        pool.shutdown(wait=False, cancel_futures=True)  # after an interrupt, nobody waits for the others
