"""From the diagnosis of one recording to its reduced form: findings that can be pooled go back into the residual."""

from dataclasses import fields, replace

import numpy as np

from lite6jax.diagnosis.result import Diagnosis
from lite6jax.effects.effect import Effect, Loading
from lite6jax.estimation.score_test import score_test
from lite6jax.populations.reduced import Candidate, Found, PooledTerm, ReducedArm


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
    settings = problem.recording.settings
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
    )


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
