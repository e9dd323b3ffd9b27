"""What a set of poses determines: singular values, rank, the null space in words, the precision to expect."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms.chains import HayatiForm
from lite6jax.design.information import Experiment
from lite6jax.design.sensor import Quantity
from lite6jax.model import ModelForm

Array = NDArray[np.floating]

_DEPENDENT = 1e-8
"""Sine of a column to the span of those before it, below which it adds nothing; rounding leaves 1e-15."""
_ON_AXIS = 1e-6
"""m."""
_UNOBSERVABLE = 1e-10
"""Length of a column over the longest, below which readings do not depend on the parameter."""
_TAKES_PART = 1e-6
"""Share of a parameter in a dependency, in tolerances, below which it is rounding."""


_QUOTED = {"m": 1e-3, "rad": float(np.deg2rad(1.0))}
"""How far a parameter is moved in a statement: 1 mm, 1 degree; an effect's number by its typical size."""


class Dependency(NamedTuple):
    """A direction in which the parameters move without any reading changing.

    Attributes:
        name: the parameter that is held, because it is confounded with the others.
        unit: of it, SI.
        amount: how far it is moved where a statement says what undoes that, in that unit.
        partners: each other's name, its unit, and how far it moves per SI unit of the first, in SI units.
    """

    name: str
    unit: str
    amount: float
    partners: tuple[tuple[str, str, float], ...]

    @property
    def statement(self) -> str:
        """In words."""
        if not self.partners:
            return f"{self.name} is unobservable: no reading changes with it."
        moves = [(name, unit, self.amount * share) for name, unit, share in self.partners]
        moves.sort(key=lambda move: -abs(move[2]) * _shown(move[1])[0])
        listed = ", ".join(_moved(*move) for move in moves[:4])
        if len(moves) > 4:
            listed += f" and {len(moves) - 4} smaller"
        names = [self.name, *(name for name, _, _ in moves)]
        if len(names) <= 5:
            together = f"{', '.join(names[:-1])} and {names[-1]} move together"
        else:
            together = f"{', '.join(names[:4])} and {len(names) - 4} others move together"
        return f"{together}: {_moved(self.name, self.unit, self.amount)} is undone by {listed}."


class BaseParameter(NamedTuple):
    """A combination that readings do determine: a parameter plus what it carries of those held.

    Attributes:
        name: the parameter that stands for it.
        unit: `m` or `rad`.
        adds: the held ones it carries, their factors (in SI units) and their units.
    """

    name: str
    unit: str
    adds: tuple[tuple[str, float, str], ...]

    @property
    def statement(self) -> str:
        """As a sum, in mm and degrees."""
        return self.name + "".join(
            f" {'−' if factor < 0 else '+'} {_factor(abs(factor), self.unit, unit)}{name}"
            for name, factor, unit in self.adds
        )


@final
@dataclass(frozen=True, eq=False)
class Determination:
    """Which of an experiment's parameters are identifiable from readings at some joint positions, and how precisely.

    Attributes:
        names, units: of the unknown parameters, `(size,)`.
        scale: `(size,)` the tolerance of each, m or rad.
        samples: how many readings.
        singular_values: `(size,)`, falling: standard deviations of all readings together per tolerance of a direction.
            Those beyond the rank are rounding.
        open_directions: `(size, k)`, orthonormal, in tolerances: what neither readings nor prior determine.
        rank: how many combinations of them the readings determine.
        free: `(size,)` bool, a largest set of parameters that the readings and the prior determine together;
            the others are held.
        dependencies: one for each parameter that is confounded with those before it.
        base: the combinations that are determined, where they are more than a parameter.
        theory: how many the best poses determine, by counting; None where it is not known.
        covariance: `(size, size)` of the free ones in m and rad, prior included; zero where held.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    scale: Array
    samples: int
    singular_values: Array
    open_directions: Array
    rank: int
    free: NDArray[np.bool_]
    dependencies: tuple[Dependency, ...]
    base: tuple[BaseParameter, ...]
    theory: int | None
    covariance: Array

    @property
    def size(self) -> int:
        """How many parameters are unknown."""
        return len(self.names)

    @cached_property
    def standard_deviation(self) -> Array:
        """`(size,)` predicted, m and rad; zero where held."""
        return np.sqrt(np.diagonal(self.covariance))

    @cached_property
    def correlation(self) -> Array:
        """`(size, size)`; zero rows where held."""
        sigma = np.where(self.free, self.standard_deviation, 1.0)
        return self.covariance / np.outer(sigma, sigma)

    def weak(self) -> tuple[str, ...]:
        """Free parameters whose predicted standard deviation exceeds their tolerance."""
        worse = self.free & (self.standard_deviation > self.scale)
        return tuple(self.names[i] for i in np.flatnonzero(worse))

    def correlated(self, above: float = 0.95) -> list[tuple[str, str, float]]:
        """Pairs of parameters whose estimates move together, the closest first."""
        rho = np.triu(self.correlation, 1)
        found = sorted(zip(*np.nonzero(np.abs(rho) > above), strict=True), key=lambda ij: -abs(rho[ij]))
        return [(self.names[i], self.names[j], float(rho[i, j])) for i, j in found]


def determine(experiment: Experiment, joint_position: ArrayLike) -> Determination:
    """What readings at `joint_position` `(sample, joint)` rad determine.

    Raises:
        InputError: joints that the arm does not have.
    """
    R = experiment.root(joint_position)
    return determination_of(experiment, R, len(np.asarray(joint_position)))


def determination_of(experiment: Experiment, root: Array, samples: int) -> Determination:
    """As `determine`, from an R `(size, size)` with RᵀR the readings' information, in tolerances."""
    names, units, unit = experiment.names, experiment.units, experiment.unit
    singular = np.linalg.svd(root, compute_uv=False)
    order = _order(experiment)
    determined, shares = independent_columns(root, order)
    dependencies = []
    carried: dict[int, list[tuple[str, float, str]]] = {int(k): [] for k in np.flatnonzero(determined)}
    for k in map(int, np.flatnonzero(~determined)):
        ratio = shares[k] / unit[k] * unit  # of SI units, not of tolerances
        partners = np.flatnonzero(np.abs(shares[k]) > _TAKES_PART)
        # a column that others can copy: its move is undone by theirs the other way round
        dependencies.append(
            Dependency(
                names[k],
                units[k],
                _QUOTED.get(units[k], float(unit[k])),
                tuple((names[i], units[i], -float(ratio[i])) for i in partners),
            )
        )
        for i in partners:
            carried[int(i)].append((names[k], float(ratio[i]), units[k]))
    base = tuple(BaseParameter(names[i], units[i], tuple(adds)) for i, adds in carried.items() if adds)

    known = np.sqrt(np.diagonal(experiment.prior))
    free = independent_columns(np.vstack([root, np.diag(known)]), order)[0] if known.any() else determined
    H = (root.T @ root + experiment.prior)[np.ix_(free, free)]
    covariance = np.zeros((len(names), len(names)))
    covariance[np.ix_(free, free)] = _inverse(H) * np.outer(unit[free], unit[free])
    whole = experiment.movable.all() and not experiment.physics.effects
    return Determination(
        names=names,
        units=units,
        scale=unit,
        samples=samples,
        singular_values=singular,
        open_directions=_null(np.vstack([root, np.diag(known)]), len(names) - int(free.sum())),
        rank=int(determined.sum()),
        free=free,
        dependencies=tuple(dependencies),
        base=base,
        theory=count(experiment.form, experiment.sensor.quantity, on_last_axis(experiment)) if whole else None,
        covariance=covariance,
    )


def count(form: ModelForm, quantity: Quantity, on_last_axis: bool = False) -> int | None:
    """How many parameters the best poses determine of a generic arm, by counting.

    By the product of exponentials a chain is its joints' axes, 4 numbers each, and the flange's pose, 6 (R. Brockett,
    1984; B. Mooring, Z. Roth, M. Driels, Fundamentals of Manipulator Calibration, 1991): 4 n + 6, all observable in
    full poses. A chain without a free tool has a flange that its last axis carries in a set way: 4 n + 4 of Hayati's,
    4 n + 2 of six parameters. A prismatic joint has a direction only, 2 numbers less; where it is the last, six
    parameters determine the whole flange: 4 n + 4. Positions depend on the flange's pose through the point (3) only,
    and one axis or one distance leaves three motions of the whole arm unobservable.

    Args:
        form: the parameters.
        quantity: what is read.
        on_last_axis: whether the point read lies on the last joint's axis, which then does not move it. Six
            parameters then have three observable numbers less; Hayati's form, whose last a moves the point off the
            axis, is counted as off it.

    Returns:
        None where an arm of one joint, or of prismatic joints and less than three others, moves too little for the
        count to hold.
    """
    n, sliding = form.chain.dof, form.chain.sliding
    hayati, last_slides = isinstance(form.chain, HayatiForm), n - 1 in sliding
    axes = 4 * n - 2 * len(sliding)
    if quantity == "pose":
        return axes + (6 if form.tool else 4 if hayati or last_slides else 2)
    if (n == 1 and quantity != "position") or (sliding and (n - len(sliding) < 3 or last_slides)):
        return None
    observable = axes + 3 if form.tool or hayati else axes - 1 if on_last_axis else axes + 2
    return observable if quantity == "position" else observable - 3


def on_last_axis(experiment: Experiment) -> bool:
    """Whether the measured point lies on the last joint's axis, so that this joint does not move it."""
    return bool(np.hypot(*np.asarray(experiment.model.T_flange_tool)[:2, 3]) < _ON_AXIS)


def _order(experiment: Experiment) -> list[int]:
    """Sensor frame and tool first, effects last: what is held is then named after the geometry, or is an effect."""
    geometry = int(experiment.movable[: experiment.form.chain.size].sum())
    rigid = int(experiment.movable[: experiment.form.size].sum())
    return [*range(geometry, rigid), *range(geometry), *range(rigid, experiment.size)]


def _null(root: Array, size: int) -> Array:
    """The `size` directions along which a matrix changes least, orthonormal, with its columns made comparable first."""
    length = np.linalg.norm(root, axis=0)
    scale = np.where(length > _UNOBSERVABLE * length.max(initial=0.0), length, max(length.max(initial=0.0), 1e-300))
    right = np.linalg.svd(root / scale)[2]
    return np.linalg.qr((right[len(scale) - size :] / scale).T)[0]


def independent_columns(root: Array, order: list[int]) -> tuple[NDArray[np.bool_], dict[int, Array]]:
    """Columns that are independent, taken one by one in `order`; of the others, their coordinates `(size,)` in these.

    The coordinates of a dependent column are unique, so that each names the smallest set it depends on.
    """
    size = root.shape[1]
    length = np.linalg.norm(root, axis=0)
    largest = length.max(initial=0.0)
    free = np.zeros(size, bool)
    shares: dict[int, Array] = {}
    Q = np.zeros((len(root), 0))
    for k in order:
        if length[k] <= _UNOBSERVABLE * largest:
            shares[k] = np.zeros(size)
            continue
        rest = root[:, k] / length[k]
        for _ in range(2):  # twice is enough (Kahan): once leaves rounding in proportion to what was removed
            rest = rest - Q @ (Q.T @ rest)
        remaining = float(np.linalg.norm(rest))
        if remaining > _DEPENDENT:
            Q = np.column_stack([Q, rest / remaining])
            free[k] = True
            continue
        share = np.zeros(size)
        taken = np.flatnonzero(free)
        scaled = root[:, taken] / length[taken]
        share[taken] = np.linalg.lstsq(scaled, root[:, k], rcond=None)[0] / length[taken]
        shares[k] = share
    return free, shares


def _inverse(H: Array) -> Array:
    """Of a positive definite matrix, scaled to a unit diagonal first."""
    root = np.sqrt(np.diagonal(H))
    inverse = np.linalg.inv(H / np.outer(root, root)) / np.outer(root, root)
    return (inverse + inverse.T) / 2


def _shown(unit: str) -> tuple[float, str]:
    """From SI to what people read: lengths in mm, angles in degrees, all else as it is."""
    return {"m": (1e3, " mm"), "rad": (180 / np.pi, " deg"), "1": (1.0, "")}.get(unit, (1.0, f" {unit}"))


def _moved(name: str, unit: str, by: float) -> str:
    scale, shown = _shown(unit)
    return f"{name} {'−' if by < 0 else '+'}{abs(scale * by):.3g}{shown}"


def _factor(factor: float, to: str, of: str) -> str:
    (to_scale, to_shown), (of_scale, of_shown) = _shown(to), _shown(of)
    value = factor * to_scale / of_scale
    if to == of:
        return "" if abs(value - 1) < 5e-4 else f"{value:.3g} "
    below = of_shown.strip()
    per = f"/({below})" if "/" in below else f"/{below}" if below else ""
    return f"{value:.3g} {to_shown.strip() or '1'}{per} "
