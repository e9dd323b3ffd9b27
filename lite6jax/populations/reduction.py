"""From the diagnosis of one recording to its reduced form: findings that can be pooled go back into the residual."""

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lite6jax.diagnosis.result import Diagnosis
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.domains.pose.functions import site_of
from lite6jax.domains.pose.problem import PoseProblem
from lite6jax.domains.torque.families import driver_values, torque_at
from lite6jax.domains.torque.problem import TorqueProblem
from lite6jax.effects.drivers import Driver, driver_of
from lite6jax.effects.dynamic.unnamed import UnnamedTorque
from lite6jax.effects.effect import Effect, Loading, slides
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.estimation.least_squares import Fit
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Term
from lite6jax.populations.candidate import Candidate
from lite6jax.populations.functions import Function, in_common
from lite6jax.populations.reduced import Found, PooledTerm, ReducedArm, readings

_LEAST_VARIED = 1e-3
"""Range of a driver, in its unit, below which it did not vary."""


def reduced(found: Diagnosis) -> ReducedArm:
    """The linear model of a diagnosed recording.

    The noise model is that of the diagnosis. Findings that are candidates for pooling are part of the residual again,
    so that each is tested in the same way in all recordings; the others, such as curves without a name, stay fitted.
    Outlying rows are left out. Masses are those declared: their uncertainty matters beside effects of loads alone.
    """
    problem = found.problem
    fit = replace(found.fit, training=found.fit.training & ~found.outliers)
    functions = _functions(problem)
    unit, plain = _linear(found, fit, [effect for effect in problem.candidates if not isinstance(effect, Loading)])
    return replace(
        plain,
        about=_about(found, "poses", problem.arm.name, problem.motion.dof, problem.recording.settings.date),
        functions=functions,
        places={
            component: problem.sites[site_of(*component.partition(" ")[::2])] * unit
            for component in dict.fromkeys(key for function in functions for key in function.components)
        },
        drivers={
            phrase: _values(phrase, problem)
            for phrase in (*_phrases(functions), *(function.direction for function in functions if function.direction))
        },
    )


def reduced_torques(found: TorqueDiagnosis) -> ReducedArm:
    """The linear model of a diagnosed recording of torques, as `reduced`.

    Waves and functions without a name pass the filter that the torques have passed.
    """
    data, problem = found.problem.data, found.problem
    candidates = [effect for effect in problem.candidates if effect.linear]
    unit, plain = _linear(found, found.fit, candidates)
    functions = _functions(problem)
    directions = {
        Driver("direction of motion", j).phrase: problem.dynamics.direction(j) for j in range(1, problem.rows + 1)
    }
    turning = np.flatnonzero(~data.arm.slides)
    return replace(
        plain,
        about=_about(found, "torques", data.arm.name, problem.rows, data.recording.settings.date),
        angles=np.asarray(data.motion.joint_position)[turning],
        functions=functions,
        places={f"joint{j + 1}": torque_at(j, problem.sigma) * unit for j in range(problem.rows)},
        drivers={phrase: _torque_values(phrase, problem) for phrase in _phrases(functions)} | directions,
        smoothing=replace(data.filter, kept=data.filter.kept[problem.chosen]),
    )


def _about(found: Diagnosis | TorqueDiagnosis, what: str, arm: str, joints: int, date: str | None) -> dict[str, Any]:
    rows = found.problem.samples
    return {"what": what, "arm": arm, "joints": joints, "rows": rows, "date": date, "verdict": found.verdict}


def _linear(
    found: Diagnosis | TorqueDiagnosis, fit: Fit, candidates: Sequence[Effect]
) -> tuple[NDArray[np.floating], ReducedArm]:
    """What makes the noise of rows unit, `(row, 1)`, and the linear model of named effects."""
    problem, engine = found.problem, found.options.engine
    named = [effect for effect in candidates if not effect.periodic]

    def term(effect: object) -> PooledTerm | None:
        return _pooled(effect, named)

    pooled = [term(one) is not None for one in fit.terms.terms]
    terms, values = fit.terms.part(fit.values, [not one for one in pooled])
    test = score_test(problem, replace(fit, terms=terms, values=values), engine, within=fit if any(pooled) else None)
    unit = 1 / test.scale[problem.groups][:, None]
    columns = unit * problem.columns(named, beside=(terms, values))
    families = [family for family in problem.periodic if family.whole]  # orders of a slide count along its own stroke
    waves = [(_key_of_waves(family.site), family.term(1.0)) for family in families]
    return unit, ReducedArm(
        about={},
        found=tuple(Found(term(one.effect), one.effect.label, one.p_value) for one in found.findings),
        candidates=tuple(_candidate(effect, _key(effect), problem.limits(effect)) for effect in named),
        columns=readings(columns, fit.noise, fit.training, test.residual.size),
        families=tuple(_candidate(wave, key, problem.limits(wave)) for key, wave in waves),
        sites=np.array([family.column * unit for family in families]),
        angles=np.array([family.angle for family in families]),
        noise=fit.noise,
        training=fit.training,
        basis=test.basis,
        residual=test.residual,
        blocks=test.blocks,
    )


def _functions(problem: PoseProblem | TorqueProblem) -> tuple[Function, ...]:
    """What names are tested by in one recording: functions of every site and driver, and finer curves of joints."""
    # a load that multiplies a function would be another in every arm; what is rare in one arm is not that of all
    tried = [one for one in problem.flexible if not one.rare and not getattr(one, "full_load", 0.0)]
    # a pool has no parts of functions, and those of a whole twist have many numbers to pay for
    found = [_shared(part) for one in tried for part in (one.displacements if isinstance(one, Unnamed) else (one,))]
    for driver in (driver for family in problem.curves for driver in family.drivers):
        low, high = float(driver.values.min()), float(driver.values.max())
        if high - low > _LEAST_VARIED:  # else it is a constant of each recording, another in each
            found += [_shared(driver.spline(low, high, pieces)) for pieces in driver.pieces]
    return tuple(in_common(found).values())


def _shared(effect: Term) -> Function:
    """A function without a name in the form that recordings share."""
    assert isinstance(effect, Unnamed | UnnamedTorque)
    assert isinstance(effect, Unnamed) or not effect.orders  # those of a prismatic joint would count otherwise
    places: tuple[str, ...] = (effect.site,)
    if isinstance(effect, Unnamed) and not effect.site.startswith("joint"):
        places = tuple(f"{effect.site} {component}" for component in effect.components)
    return Function(
        site=effect.site,
        driver=" and ".join(driver.phrase for driver in effect.drivers),
        components=places,
        units=tuple(number.unit for number in effect.coordinates[:: effect.functions]),
        drivers=tuple(driver.phrase for driver in effect.of),
        ranges=_ranges(effect)[: len(effect.of)],
        pieces=0 if effect.degree or effect.orders else effect.pieces,
        products=effect.products if effect.degree else (),
        orders=effect.orders,
        specificity=effect.specificity,
        direction=effect.drivers[-1].phrase if len(effect.drivers) > len(effect.of) else "",
    )


def _ranges(effect: Unnamed | UnnamedTorque) -> tuple[tuple[float, float], ...]:
    bounds = (effect.lower, effect.upper, *effect.further)
    return tuple((float(low), float(high)) for low, high in zip(bounds[::2], bounds[1::2], strict=True))


def _phrases(functions: Sequence[Function]) -> list[str]:
    """The quantities that functions depend on, without directions that multiply them."""
    return list(dict.fromkeys(key for function in functions for key in function.drivers))


def _values(phrase: str, problem: PoseProblem) -> np.ndarray:
    driver, found = driver_of(phrase), problem.deflections
    return np.asarray(driver.values(found.host_motion, found.host_loads if driver.loaded else None), float)


def _torque_values(phrase: str, problem: TorqueProblem) -> np.ndarray:
    values = driver_values(driver_of(phrase), problem.dynamics)
    assert values is not None  # functions are of known drivers
    return values


def _pooled(effect: object, named: Sequence[Effect]) -> PooledTerm | None:
    """An effect of a model as a term that is pooled; None where it is neither a candidate nor a wave of an angle."""
    if not isinstance(effect, Effect):
        return None
    if effect.periodic:
        order = None if slides(effect) else getattr(effect, "order", None)
        return None if order is None else PooledTerm(_key_of_waves(effect.site), float(order))
    return PooledTerm(_key(effect)) if effect in named else None


def _key_of_waves(site: str) -> str:
    return f"waves:{site}"


def _key(effect: Effect) -> str:
    """Name and fields, such as `joint_coupling:joint=2,source_joint=3`."""
    given = ",".join(f"{field.name}={getattr(effect, field.name)}" for field in fields(effect))
    return f"{effect.name}:{given}"


def _candidate(effect: object, key: str, limits: Sequence[tuple[float, float]]) -> Candidate:
    assert isinstance(effect, Effect)
    numbers = effect.coordinates
    return Candidate(
        key=key,
        effect=effect.name,
        site=effect.site,
        driver=" and ".join(driver.phrase for driver in effect.drivers) or "none",
        names=tuple(number.name for number in numbers),
        typical=tuple(number.typical for number in numbers),
        lower=tuple(lower for lower, _ in limits),
        upper=tuple(upper for _, upper in limits),
        specificity=effect.specificity,
    )
