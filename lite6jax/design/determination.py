"""What the columns of a least-squares problem determine: rank, the null space in words, the precision to expect.

Columns are those of poses or of torques: how whitened readings change per typical size of each parameter. The order in
which columns are taken says which parameter stands for those that it is confounded with.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.arms.arm import as_revolute
from lite6jax.array_types import Array, Mask
from lite6jax.calibration.residual import pad

NARROW = float(np.deg2rad(10.0))
"""A joint that moves over less than this tells little of what stands on either side of it; rad."""
_DEPENDENT = 1e-8
"""Sine of a column to the span of those before it, below which it adds nothing; rounding leaves 1e-15."""
_UNOBSERVABLE = 1e-10
"""Length of a column over the longest, below which readings do not depend on the parameter."""
_TAKES_PART = 1e-6
"""Share of a parameter in a dependency, in typical sizes, below which it is rounding."""
_CORRELATED = 0.95
_QUOTED = {"m": 1e-3, "rad": float(np.deg2rad(1.0))}
"""How far a parameter is moved in a statement: 1 mm, 1 degree; another one by its typical size."""
_SHOWN = {"m": (1e3, "mm"), "rad": (180 / np.pi, "deg")}
"""From SI to what people read."""


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
        # to six digits: rounding decides no order
        moves.sort(key=lambda move: -float(f"{abs(move[2]) * _SHOWN.get(move[1], (1.0, ''))[0]:.6g}"))
        listed = ", ".join(_shift(*move) for move in moves[:4])
        if len(moves) > 4:
            listed += f" and {len(moves) - 4} smaller"
        names = [self.name, *(name for name, _, _ in moves)]
        last = names[-1] if len(names) <= 5 else f"{len(names) - 4} others"
        together = f"{', '.join(names[: min(len(names) - 1, 4)])} and {last} move together"
        return f"{together}: {_shift(self.name, self.unit, self.amount)} is undone by {listed}."


class BaseParameter(NamedTuple):
    """A combination that readings do determine: a parameter plus what it carries of those held.

    Attributes:
        terms: name and factor of each parameter in it, SI; the first stands for it with factor 1.
        units: of these parameters, SI.
        scale: its typical size, in the unit of the first.
    """

    terms: tuple[tuple[str, float], ...]
    units: tuple[str, ...]
    scale: float

    @property
    def name(self) -> str:
        """The parameter that stands for it."""
        return self.terms[0][0]

    @property
    def unit(self) -> str:
        """SI, of the parameter that stands for it."""
        return self.units[0]

    @property
    def statement(self) -> str:
        """As a sum, in mm and degrees."""
        return self.name + "".join(
            f" {'−' if factor < 0 else '+'} {_factor(abs(factor), self.unit, unit)}{name}"
            for (name, factor), unit in zip(self.terms[1:], self.units[1:], strict=True)
        )


@final
@dataclass(frozen=True, eq=False)
class Determination:
    """Which parameters of a least-squares problem are identifiable, and how precisely.

    Attributes:
        names, units: of the unknown parameters, `(size,)`.
        scale: `(size,)` the tolerance or typical size of each, SI.
        samples: how many readings.
        singular_values: `(size,)`, falling: standard deviations of all readings together per typical size of a
            direction. Those beyond the rank are rounding.
        open_directions: `(size, k)`, orthonormal, in typical sizes: what neither readings nor prior determine.
        rank: how many combinations of them the readings determine.
        free: `(size,)` bool, a largest set of parameters that the readings and the prior determine together;
            the others are held.
        dependencies: one for each parameter that is confounded with those before it.
        base: the combinations that the readings determine, in the order of the parameters that stand for them.
        covariance: `(size, size)` of the free ones in SI units, prior included; zero where held.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    scale: Array
    samples: int
    singular_values: Array
    open_directions: Array
    rank: int
    free: Mask
    dependencies: tuple[Dependency, ...]
    base: tuple[BaseParameter, ...]
    covariance: Array

    @property
    def size(self) -> int:
        """How many parameters are unknown."""
        return len(self.names)

    @cached_property
    def standard_deviation(self) -> Array:
        """`(size,)` predicted, SI; zero where held."""
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

    def correlated(self) -> list[tuple[str, str, float]]:
        """Pairs of parameters whose estimates correlate above 0.95, the closest first."""
        rho = np.triu(self.correlation, 1)
        index_pairs = sorted(zip(*np.nonzero(np.abs(rho) > _CORRELATED), strict=True), key=lambda ij: -abs(rho[ij]))
        return [(self.names[i], self.names[j], float(rho[i, j])) for i, j in index_pairs]


def each_block(rows: Callable[..., Array], parts: Sequence[Array], block: int) -> Iterator[Array]:
    """Rows `(size, row, sample)` of parts `(sample, …)` that they depend on, `block` samples at a time.

    Parts are filled up with zeros to one shape, which is compiled once.
    """
    for first in range(0, len(parts[0]), block):
        padded = (pad(part[first : first + block], 0, block) for part in parts)
        yield rows(*padded)[..., : len(parts[0]) - first]


def accumulate_root(blocks: Iterable[Array], size: int) -> Array:
    """An upper triangular R `(size, size)` with RᵀR the information of readings, by orthogonal steps.

    Its singular values are those of the rows to rounding, where an eigenvalue of RᵀR would lose half the digits. The
    rows are blocks `(size, row, sample)`.
    """
    R = np.zeros((size, size))
    for J in blocks:
        R = np.asarray(np.linalg.qr(np.concatenate([R, J.reshape(size, -1).T]), mode="r"))
    return R


def determination_of(
    root: Array,
    names: Sequence[str],
    units: Sequence[str],
    scale: Array,
    samples: int,
    order: Sequence[int] | None = None,
    prior: Array | None = None,
) -> Determination:
    """What the columns of a least-squares problem determine.

    Args:
        root: `(row, size)` any R with RᵀR the readings' information, its columns per `scale` of each parameter.
        names, units, scale, samples: as in `Determination`.
        order: in which columns stand for those that they are confounded with; as they are where not given.
        prior: `(size,)` the information of the prior about each, in these sizes; none where not given.
    """
    names, units, size = tuple(names), tuple(units), len(names)
    order = range(size) if order is None else order
    determined, shares = _independent_columns(root, order)
    dependencies = []
    carried = {int(i): [(int(i), 1.0)] for i in np.flatnonzero(determined)}
    for k in map(int, np.flatnonzero(~determined)):
        ratio = shares[k] * scale / scale[k]  # of SI units
        partners = np.flatnonzero(np.abs(shares[k]) > _TAKES_PART)
        # a column that others can copy: its move is undone by theirs the other way round
        undone = tuple((names[i], units[i], -float(ratio[i])) for i in partners)
        dependencies.append(Dependency(names[k], units[k], _QUOTED.get(units[k], float(scale[k])), undone))
        for i in partners:
            carried[int(i)].append((k, float(ratio[i])))
    base = tuple(
        BaseParameter(
            tuple((names[k], factor) for k, factor in terms),
            tuple(units[k] for k, _ in terms),
            float(np.linalg.norm([factor * scale[k] for k, factor in terms])),
        )
        for terms in carried.values()
    )
    prior_root = np.zeros(size) if prior is None else np.sqrt(prior)
    rows = np.vstack([root, np.diag(prior_root)])
    free = _independent_columns(rows, order)[0] if prior_root.any() else determined
    length = np.linalg.norm(rows, axis=0)
    half = np.linalg.inv(np.linalg.qr(rows[:, free] / length[free], mode="r")) * (scale[free] / length[free])[:, None]
    covariance = np.zeros((size, size))
    covariance[np.ix_(free, free)] = half @ half.T
    # the directions along which the rows change least, with their columns made comparable first
    longest = max(length.max(initial=0.0), 1e-300)
    comparable = np.where(length > _UNOBSERVABLE * longest, length, longest)
    null_space = np.linalg.svd(rows / comparable)[2][int(free.sum()) :]
    return Determination(
        names=names,
        units=units,
        scale=scale,
        samples=samples,
        singular_values=np.linalg.svd(root, compute_uv=False),
        open_directions=np.linalg.qr((null_space / comparable).T)[0],
        rank=int(determined.sum()),
        free=free,
        dependencies=tuple(dependencies),
        base=base,
        covariance=covariance,
    )


def _independent_columns(root: Array, order: Sequence[int]) -> tuple[Mask, dict[int, Array]]:
    """Columns that are independent, taken one by one in `order`; of the others, their coordinates `(size,)` in these.

    The coordinates of a dependent column are unique, so that each names the smallest set it depends on.
    """
    length = np.linalg.norm(root, axis=0)
    observable = length > _UNOBSERVABLE * length.max(initial=0.0)
    unit = root / np.where(observable, length, 1.0)
    free = np.zeros(len(length), bool)
    shares = dict[int, Array]()
    for k in order:
        share = np.zeros(len(length))
        basis = np.flatnonzero(free)
        if observable[k]:
            coordinates = np.linalg.lstsq(unit[:, basis], root[:, k], rcond=None)[0]
            if np.linalg.norm(root[:, k] - unit[:, basis] @ coordinates) > _DEPENDENT * length[k]:
                free[k] = True
                continue
            share[basis] = coordinates / length[basis]
        shares[k] = share
    return free, shares


def narrow_joints(span: Array, slides: Mask) -> list[tuple[int, float]]:
    """Joints, counted from 0, that hardly move, and their range `(joint,)` rad, or m of prismatic joints."""
    return [(int(j), float(span[j])) for j in np.flatnonzero(as_revolute(span, "rad", slides) < NARROW)]


def _shift(name: str, unit: str, by: float) -> str:
    scale, shown = _SHOWN.get(unit, (1.0, "" if unit == "1" else unit))
    return f"{name} {'−' if by < 0 else '+'}{abs(scale * by):.3g} {shown}".rstrip()


def _factor(factor: float, to: str, of: str) -> str:
    (to_scale, to_shown), (of_scale, of_shown) = (_SHOWN.get(u, (1.0, "" if u == "1" else u)) for u in (to, of))
    value = factor * to_scale / of_scale
    if to == of:
        return "" if abs(value - 1) < 5e-4 else f"{value:.3g} "
    per = f"/({of_shown})" if "/" in of_shown else f"/{of_shown}" if of_shown else ""
    return f"{value:.3g} {to_shown or '1'}{per} "


class Observability(NamedTuple):
    """The five indices of Y. Sun and J. Hollerbach, "Observability index selection for robot calibration", ICRA 2008.

    With σ₁ ≥ … ≥ σ_L the singular values of the identification Jacobian of m poses; higher is better. They depend on
    how the parameters are scaled, O1's ranking of pose sets excepted.

    Attributes:
        O1: (σ₁ … σ_L)^(1/L) / √m, the volume of the ellipsoid of the observable parameters (J. Borm, C. Menq,
            IJRR 10(5), 1991): D-optimality.
        O2: σ_L / σ₁, the inverse of the condition number (M. Driels, U. Pathre, J. Robotic Systems 7(2), 1990).
        O3: σ_L, the smallest singular value (A. Nahvi, J. Hollerbach, V. Hayward, ICRA 1994): E-optimality.
        O4: σ_L² / σ₁, the noise amplification index (A. Nahvi, J. Hollerbach, ICRA 1996).
        O5: 1 / Σ 1/σᵢ, the harmonic mean over L (Sun and Hollerbach): close to A-optimality.
        condition: σ₁ / σ_L.
        noise_amplification: 1 / σ_L, how much of a unit of noise the worst direction of the parameters receives.
    """

    O1: float
    O2: float
    O3: float
    O4: float
    O5: float
    condition: float
    noise_amplification: float


def observability(singular_values: ArrayLike, samples: int) -> Observability:
    """The indices of the determined singular values `(rank,)`, above 0, of `samples` poses."""
    s = np.sort(np.asarray(singular_values, float))[::-1]
    first = float(s[0])
    last = float(s[-1])
    volume = float(np.exp(np.mean(np.log(s))) / np.sqrt(samples))
    harmonic = float(1 / np.sum(1 / s))
    return Observability(volume, last / first, last, last**2 / first, harmonic, first / last, 1 / last)
