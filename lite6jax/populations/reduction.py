"""From the diagnosis of one recording to its reduced form: findings that can be pooled go back into the residual."""

from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np

from lite6jax.diagnosis.result import Diagnosis
from lite6jax.domains.pose.problem import PoseProblem
from lite6jax.effects.drivers import driver_of
from lite6jax.effects.effect import Effect, Loading
from lite6jax.effects.nonparametric import COMPONENTS, Unnamed
from lite6jax.estimation.score_test import score_test
from lite6jax.populations.candidate import Candidate
from lite6jax.populations.functions import Function
from lite6jax.populations.reduced import Found, PooledTerm, ReducedArm


def reduced(found: Diagnosis) -> ReducedArm:
    """The linear model of a diagnosed recording.

    The noise model is that of the diagnosis. Findings that are candidates for pooling are part of the residual again,
    so that each is tested in the same way in all recordings; the others, such as curves without a name, stay fitted.
    Outlying rows are left out. Masses are those declared: their uncertainty matters beside effects of loads alone.
    """
    problem, engine = found.problem, found.options.engine
    fit = replace(found.fit, training=found.fit.training & ~found.outliers)
    pooled = [pooled_term(term, found) is not None for term in fit.terms.terms]
    terms, values = fit.terms.part(fit.values, [not one for one in pooled])
    beside = replace(fit, terms=terms, values=values)
    test = score_test(problem, beside, engine, within=fit if any(pooled) else None)
    candidates = [effect for effect in problem.candidates if not effect.periodic and not isinstance(effect, Loading)]
    factor = fit.training / test.scale[problem.groups][:, None]
    columns = fit.noise.whitened(problem.columns(candidates, beside=(terms, values))) * factor
    flat = np.zeros((len(columns), test.residual.size))
    flat[:, : columns[0].size] = columns.reshape(len(columns), -1)
    settings, functions = problem.recording.settings, tuple(map(_function, _unnamed(problem)))
    return ReducedArm(
        about={
            "arm": problem.arm.name,
            "joints": problem.motion.dof,
            "rows": problem.samples,
            "date": settings.date,
            "verdict": found.verdict,
        },
        found=tuple(Found(pooled_term(f.effect, found), f.effect.label, f.p_value) for f in found.findings),
        candidates=tuple(map(_candidate, candidates)),
        columns=flat,
        families=tuple(_candidate(family.term(1.0), _family(family.site)) for family in problem.periodic),
        sites=np.array([family.column / test.scale[problem.groups][:, None] for family in problem.periodic]),
        angles=np.array([family.angle for family in problem.periodic]),
        noise=fit.noise,
        training=fit.training,
        basis=test.basis,
        residual=test.residual,
        blocks=test.blocks,
        functions=functions,
        places={
            component: problem.sites[_site(component)] / test.scale[problem.groups][:, None]
            for component in dict.fromkeys(key for function in functions for key in function.components)
        },
        drivers={
            phrase: _values(phrase, problem)
            for phrase in dict.fromkeys(key for function in functions for key in function.drivers)
        },
    )


def _unnamed(problem: PoseProblem) -> Iterator[Unnamed]:
    """What names are tested by in one recording: functions of every site and driver, and finer curves of joints."""
    yield from problem.flexible
    for family in problem.curves:
        for driver in family.drivers:
            low, high = float(driver.values.min()), float(driver.values.max())
            if low < high:
                for pieces in driver.pieces:
                    curve = driver.spline(low, high, pieces)
                    assert isinstance(curve, Unnamed)
                    yield curve


def _function(effect: Unnamed) -> Function:
    """A function without a name in the form that recordings share."""
    along = effect.site.startswith("joint")
    units = ["m" if component in ("x", "y", "z") else "rad" for component in effect.components]
    ranges = np.array((effect.lower, effect.upper, *effect.further)).reshape(-1, 2)
    return Function(
        site=effect.site,
        driver=effect.driver,
        components=tuple(effect.site if along else f"{effect.site} {component}" for component in effect.components),
        units=tuple(units),
        drivers=tuple(driver.phrase for driver in effect.drivers),
        ranges=tuple((float(low), float(high)) for low, high in ranges),
        pieces=0 if effect.degree or effect.orders else effect.pieces,
        products=effect.products if effect.degree else (),
        orders=effect.orders,
        specificity=effect.specificity,
    )


def _site(component: str) -> tuple[str, int, int]:
    """The site of a component of a function: that of a joint, or of a place and a component of its twist."""
    place, _, along = component.partition(" ")
    kind, number = place.rstrip("0123456789"), int("0" + "".join(filter(str.isdecimal, place)))
    return kind, max(number - 1, 0), COMPONENTS.index(along) if along else 0


def _values(phrase: str, problem: PoseProblem) -> np.ndarray:
    driver, found = driver_of(phrase), problem.deflections
    return np.asarray(driver.values(found.host_motion, found.host_loads if driver.loaded else None), float)


def pooled_term(effect: object, found: Diagnosis) -> PooledTerm | None:
    """A finding's effect as a term that is pooled; None where it is none of the candidates."""
    if not isinstance(effect, Effect):
        return None
    if effect.periodic:
        order = getattr(effect, "order", None)
        return None if order is None else PooledTerm(_family(effect.site), float(order))
    if effect in found.problem.candidates and not isinstance(effect, Loading):
        return PooledTerm(_key(effect))
    return None


def _family(site: str) -> str:
    return f"waves:{site}"


def _key(effect: Effect) -> str:
    """Name and fields, such as `joint_coupling:joint=2,source_joint=3`."""
    given = ",".join(f"{field.name}={getattr(effect, field.name)}" for field in fields(effect))
    return f"{effect.name}:{given}"


def _candidate(effect: object, key: str | None = None) -> Candidate:
    assert isinstance(effect, Effect)
    numbers = effect.coordinates

    def each(name: str) -> tuple:
        return tuple(getattr(number, name) for number in numbers)

    return Candidate(
        key=key or _key(effect),
        effect=effect.name,
        site=effect.site,
        driver=" and ".join(driver.phrase for driver in effect.drivers) or "none",
        names=each("name"),
        typical=each("typical"),
        lower=each("lower"),
        upper=each("upper"),
        specificity=effect.specificity,
    )
