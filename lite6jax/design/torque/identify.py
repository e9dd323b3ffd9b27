"""What a motion determines of an arm's dynamics through its torques, and how well."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.arms.joint_units import as_revolute, joint_sizes
from lite6jax.design.determination import independent_columns
from lite6jax.design.identify import NARROW
from lite6jax.design.torque.columns import TorqueModel
from lite6jax.design.torque.fourier import ACCELERATION, VELOCITY, Motion
from lite6jax.errors import InputError

Array = NDArray[np.floating]

WELL = 0.1
"""Of a base parameter's typical size, one standard deviation above which it is weakly determined."""
_STATES = 300
"""Random states that show all that any motion of an arm determines: at least four times as many rows as unknowns."""
_TAKES_PART = 1e-7
"""Of a base parameter's typical size, below which a share in it is rounding."""


class BaseParameter(NamedTuple):
    """A combination of parameters that torques do determine.

    Attributes:
        terms: name and factor of each parameter in it, SI; the first stands for it with factor 1.
        unit: SI.
        scale: its typical size, SI.
    """

    terms: tuple[tuple[str, float], ...]
    unit: str
    scale: float

    @property
    def name(self) -> str:
        """The parameter that stands for it."""
        return self.terms[0][0]


@final
@dataclass(frozen=True, eq=False)
class Structure:
    """What any motion at all of an arm determines.

    Attributes:
        model: its unknowns.
        free: `(base,)` columns that stand for the base parameters.
        base: the base parameters in the same order.
        confounded: of each parameter that is only determined with others: its name, and the base parameters it is in.
        silent: names of parameters that change no torque.
    """

    model: TorqueModel
    free: NDArray[np.integer]
    base: tuple[BaseParameter, ...]
    confounded: tuple[tuple[str, tuple[str, ...]], ...]
    silent: tuple[str, ...]

    @property
    def inertial(self) -> int:
        """How many base parameters are of links."""
        return sum(item.name.startswith("link") for item in self.base)


@final
@dataclass(frozen=True, eq=False)
class TorqueIdentification:
    """What a motion determines.

    Attributes:
        structure: what any motion of the arm determines.
        samples: of the motion.
        span: `(joint,)` rad, m of prismatic joints, over which each joint moves.
        determined: `(base,)` bool, which base parameters this motion determines apart from the others.
        standard_deviation: `(base,)` SI; infinite where not determined.
        condition: of the whitened regressor of the base parameters determined, in their typical sizes.
        log_determinant: of the information about all base parameters in their typical sizes; −inf unless all are
            determined.
        at_rest: whether the arm stands still in all samples.
        notes: what was assumed, a sentence each.
    """

    structure: Structure
    samples: int
    span: Array
    determined: NDArray[np.bool_]
    standard_deviation: Array
    condition: float
    log_determinant: float
    at_rest: bool
    notes: tuple[str, ...] = ()

    @property
    def model(self) -> TorqueModel:
        """The unknowns."""
        return self.structure.model

    @cached_property
    def weak(self) -> NDArray[np.bool_]:
        """`(base,)`: determined no better than to a tenth of their typical size."""
        scale = np.array([item.scale for item in self.structure.base])
        return self.determined & (self.standard_deviation > WELL * scale)

    def narrow(self) -> list[tuple[int, float]]:
        """Joints, counted from 0, that hardly move, and their range in rad, or in m of prismatic joints."""
        span = as_revolute(self.span, "rad", self.model.arm.slides)
        return [(int(j), float(self.span[j])) for j in np.flatnonzero(span < NARROW)]

    def deviation_of(self, joint: int, kind: str) -> float | None:
        """One standard deviation of a joint's parameter, SI; None where it is only determined with others or not."""
        name = f"joint{joint + 1} {kind}"
        for item, deviation, there in zip(self.structure.base, self.standard_deviation, self.determined, strict=True):
            if item.name == name:
                return float(deviation) if there else None
        return None

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain numbers and words, in SI units, for a JSON file."""
        structure = self.structure
        return {
            "schema": "lite6jax/torque_identification/1",
            "arm": self.model.arm.name,
            "samples": self.samples,
            "torque_noise_Nm": [float(value) for value in self.model.noise],
            "gravity_m_per_s2": [float(value) for value in self.model.gravity],
            "rank": int(self.determined.sum()),
            "rank_possible": len(structure.base),
            "condition": self.condition if np.isfinite(self.condition) else None,
            "log_determinant": self.log_determinant if np.isfinite(self.log_determinant) else None,
            "base_parameters": [
                {
                    "name": item.name,
                    "terms": dict(item.terms),
                    "unit": item.unit,
                    "std": float(deviation) if there else None,
                    "typical": item.scale,
                    "weak": bool(weak),
                }
                for item, deviation, there, weak in zip(
                    structure.base, self.standard_deviation, self.determined, self.weak, strict=True
                )
            ],
            "only_with_others": {name: list(carriers) for name, carriers in structure.confounded},
            "without_effect": list(structure.silent),
            "notes": list(self.notes),
        }


def structure_of(model: TorqueModel, seed: int = 0) -> Structure:
    """What any motion determines, found numerically at random states.

    The grouping is that of M. Gautier (ICRA 1990): columns are taken link by link from the base, those that depend on
    the ones before add to them what they share.
    """
    dof = model.arm.dof
    rng = np.random.default_rng(seed)
    q, dq, ddq = (
        rng.uniform(-size, size, (dof, _STATES)) * joint_sizes(1.0, unit, model.arm.slides)[:, None]
        for size, unit in ((np.pi, "rad"), (VELOCITY, "rad/s"), (ACCELERATION, "rad/s²"))
    )
    free, shares = independent_columns(model.root(Motion(q, dq, ddq)) * model.scale, model.order)
    names, units, scale = model.names, model.units, model.scale
    carried: dict[int, list[tuple[str, float, float]]] = {int(k): [] for k in np.flatnonzero(free)}
    confounded, silent = [], []
    for k in sorted(shares):
        carriers = np.flatnonzero(np.abs(shares[k]) > _TAKES_PART)
        if not len(carriers):
            silent.append(names[k])
            continue
        confounded.append((names[k], tuple(names[i] for i in carriers)))
        for i in carriers:
            factor = float(shares[k][i] * scale[i] / scale[k])
            carried[int(i)].append((names[k], factor, float(scale[k])))
    base = tuple(
        BaseParameter(
            ((names[i], 1.0), *((name, factor) for name, factor, _ in others)),
            units[i],
            float(np.sqrt(scale[i] ** 2 + sum((factor * size) ** 2 for _, factor, size in others))),
        )
        for i, others in carried.items()
    )
    return Structure(model, np.array(sorted(carried)), base, tuple(confounded), tuple(silent))


def identify_torques(
    model: TorqueModel, motion: Motion, *, structure: Structure | None = None, notes: tuple[str, ...] = ()
) -> TorqueIdentification:
    """What a motion determines of an arm's base parameters and friction, and how well.

    Args:
        model: from `torque_model`.
        motion: `(joint, sample)` each; its accelerations free of noise, as of a zero-phase filter.
        structure: `structure_of(model)` where known.
        notes: said with the result.

    Raises:
        InputError: another number of joints, numbers that are not finite, or a motion too short: fewer torques than
            there are unknowns.
    """
    structure = structure or structure_of(model)
    checked(model.arm, motion)
    samples, base = motion.q.shape[1], len(structure.base)
    least = -(-base // model.arm.dof)
    if samples < least:
        raise InputError(
            f"motion: {samples} samples of {model.arm.dof} torques for {base} unknowns; record {least} samples or more"
        )
    scale = np.array([item.scale for item in structure.base])
    R = model.root(motion)[:, structure.free] * scale
    kept, _ = independent_columns(R, list(range(base)))
    entangled = _entangled(R, kept)
    determined = kept & ~entangled
    lengths = np.linalg.norm(R[:, kept], axis=0)
    sizes = np.linalg.svd(R[:, determined], compute_uv=False) if determined.any() else np.full(1, np.nan)
    deviation = np.full(base, np.inf)
    inverse = np.linalg.inv(np.linalg.qr(R[:, kept] / lengths, "r")) if kept.any() else np.zeros((0, 0))
    deviation[kept] = np.linalg.norm(inverse, axis=1) / lengths * scale[kept]
    return TorqueIdentification(
        structure=structure,
        samples=samples,
        span=np.ptp(np.asarray(motion.q), axis=1),
        determined=determined,
        standard_deviation=np.where(entangled, np.inf, deviation),
        condition=float(sizes[0] / sizes[-1]),
        log_determinant=float(2 * np.linalg.slogdet(np.linalg.qr(R, "r"))[1]) if kept.all() else -np.inf,
        at_rest=not np.any(motion.dq),
        notes=notes,
    )


def _entangled(R: Array, kept: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Of the columns kept, those on which others depend: only their sum with these is determined."""
    entangled = np.zeros(len(kept), bool)
    if kept.all() or not kept.any():
        return entangled
    shares = np.linalg.lstsq(R[:, kept], R[:, ~kept], rcond=None)[0]
    entangled[kept] = (np.abs(shares) > 1e-6).any(1)
    return entangled


def checked(arm: Arm, motion: Motion) -> None:
    """Refuses a motion of other joints than an arm's, or with numbers that are not finite.

    Raises:
        InputError: as said.
    """
    for name, part in zip(motion._fields, motion, strict=True):
        part = np.asarray(part)
        if part.ndim != 2 or len(part) != arm.dof or part.shape != np.shape(motion.q):
            raise InputError(f"motion: {name} has the shape {part.shape}; {arm.name} takes ({arm.dof}, sample)")
        if not np.isfinite(part).all():
            raise InputError(f"motion: {name} has a number that is not finite; leave those samples out")
