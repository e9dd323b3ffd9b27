"""Levenberg–Marquardt of many small problems at once, each damped by itself (D. Marquardt, J. SIAM 11, 1963).

Problems are the last axis. Their normal equations are solved by elimination that is unrolled: for numbers as few as
those of a pose or an arm's joints this takes less than LAPACK does.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from lite6jax.deferred import JaxArray, jax, jnp, lax

_STILL = 1e-12
"""Change of all numbers below which a problem is solved; in rad or m it is rounding."""
_FLAT = 1e-12
"""Relative rise of the cost that is rounding: near a solution, where the cost is flat, a step is taken all the same."""


class Linearised(NamedTuple):
    """Problems about some numbers: cost + 2 gradient·step + step·curvature·step.

    Attributes:
        cost: `(problem,)`, what is minimised; of a sum of squares |r|² the rest is Jᵀr and JᵀJ.
        gradient: `(number, problem)`; zero of a number that is held.
        curvature: `(number, number, problem)`, positive semidefinite; the identity's row of a number that is held.
        damped: `(number, problem)`, what the damping multiplies: one, or the curvature's diagonal where units differ.
        detail: what else a caller wants of the solution, arrays with the problem last.
    """

    cost: JaxArray
    gradient: JaxArray
    curvature: JaxArray
    damped: JaxArray
    detail: Any = ()


class Minimum(NamedTuple):
    """What `minimise` returns, and its state on the way.

    Attributes:
        numbers: `(number, problem)`, those reached.
        linearised: the problems there.
        proposal: `(number, problem)`, where to look next.
        damping: `(problem,)`.
        ended: `(problem,)`, whether it converged.
        steps: how often the problems were linearised.
    """

    numbers: JaxArray
    linearised: Linearised
    proposal: JaxArray
    damping: JaxArray
    ended: JaxArray
    steps: JaxArray


def minimise(
    linearise: Callable[[JaxArray], Linearised],
    advance: Callable[[JaxArray, JaxArray], JaxArray],
    start: JaxArray,
    steps: Any,
    enough: float = 0.0,
    creeping: float = 0.0,
) -> Minimum:
    """The numbers of least cost of problems, each from its start; plain JAX.

    Args:
        linearise: of numbers `(number, problem)`.
        advance: numbers after a step, both `(number, problem)`; it keeps them within their limits.
        start: `(number, problem)`.
        steps: the most; with zero the numbers stay, and the problems are linearised there.
        enough: a cost below which a problem is solved.
        creeping: relative decrease of the cost below which a step is the last.
    """
    count, problems = start.shape

    def improve(state: Minimum) -> Minimum:
        proposed = linearise(state.proposal)
        # the start is taken as it is: where it cannot be computed, so is what is returned
        better = (proposed.cost <= (1 + _FLAT) * state.linearised.cost) | jnp.isinf(state.linearised.cost)
        numbers, reached = jax.tree.map(
            lambda new, old: jnp.where(better, new, old),
            (state.proposal, proposed),
            (state.numbers, state.linearised),
        )
        damping = jnp.clip(jnp.where(better, state.damping / 8, state.damping * 4), 1e-14, 1e4)
        curvature = reached.curvature + jnp.eye(count)[:, :, None] * (damping * reached.damped)
        proposal = advance(numbers, _solve_definite(curvature, -reached.gradient))
        crept = better & (jnp.abs(state.linearised.cost - proposed.cost) < creeping * proposed.cost)
        still = jnp.abs(proposal - numbers).max(0) < _STILL
        ended = state.ended | crept | still | (reached.cost < enough)
        return Minimum(numbers, reached, jnp.where(ended, numbers, proposal), damping, ended, state.steps + 1)

    empty = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(linearise, start))
    nowhere = empty._replace(cost=jnp.full(problems, jnp.inf))
    state = Minimum(start, nowhere, start, jnp.full(problems, 1e-3), jnp.zeros(problems, bool), jnp.zeros((), int))
    return lax.while_loop(lambda state: (state.steps <= steps) & ~state.ended.all(), improve, state)


def _solve_definite(A: JaxArray, b: JaxArray) -> JaxArray:
    """x `(number, problem)` with A x = b for positive definite `(number, number, problem)`, without pivots."""
    system = jnp.concatenate([A, b[:, None]], 1)
    for k in range(len(b)):
        row = system[k] / system[k, k]
        system = (system - system[:, k, None] * row).at[k].set(row)
    return system[:, -1]
