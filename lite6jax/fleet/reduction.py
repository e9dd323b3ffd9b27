"""From the diagnosis of one recording to its reduced form: findings that can be pooled go back into the residual."""

from collections.abc import Sequence
from dataclasses import replace
from functools import singledispatch
from typing import Any, NamedTuple

import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.diagnosis.diagnose import Diagnosis
from lite6jax.diagnosis.torque_diagnosis import TorqueDiagnosis
from lite6jax.domains.pose.problem import PoseProblem
from lite6jax.domains.torque.filtering import LowPass
from lite6jax.domains.torque.problem import TorqueProblem
from lite6jax.effects.effect import Effect, Loading, Wave
from lite6jax.effects.kernels import PAIRS, SINGLE
from lite6jax.effects.nonparametric import Process
from lite6jax.estimation.least_squares import Fit
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Term
from lite6jax.fields import field_values
from lite6jax.fleet.reduced import Heading, ReducedArm, readings
from lite6jax.fleet.terms import Candidate, FleetComponent, Varied


class _Parts(NamedTuple):
    """What a diagnosis of each domain has in a place of its own: what is fitted, of which candidates, and filtered."""

    arm: Arm
    fit: Fit
    candidates: list[Any]
    smoothing: LowPass | None


@singledispatch
def _parts(diagnosis: Any) -> _Parts:
    raise NotImplementedError


@_parts.register
def _of_poses(diagnosis: Diagnosis) -> _Parts:
    fit = replace(diagnosis.fit, training=diagnosis.fit.training & ~diagnosis.outliers)
    candidates = [effect for effect in diagnosis.problem.candidates if not isinstance(effect, Loading)]
    return _Parts(diagnosis.problem.arm, fit, candidates, None)


@_parts.register
def _of_torques(diagnosis: TorqueDiagnosis) -> _Parts:
    problem = diagnosis.problem
    smoothing = problem.data.filter
    smoothing = replace(smoothing, kept=smoothing.kept[problem.chosen])
    candidates = [effect for effect in problem.candidates if effect.linear]
    return _Parts(problem.data.arm, diagnosis.fit, candidates, smoothing)


def reduced(diagnosis: Diagnosis | TorqueDiagnosis) -> ReducedArm:
    """The linear model of a diagnosed recording.

    The noise model is that of the diagnosis. Findings that are tested where recordings are pooled are part of the
    residual again, so that each is tested in the same way in all; the others stay fitted. Outlying poses are left
    out. Masses are those declared: their uncertainty matters beside effects of loads alone. Waves and processes of
    torques pass the filter that the torques have passed.
    """
    problem = diagnosis.problem
    engine = diagnosis.options.engine
    parts = _parts(diagnosis)
    fit = parts.fit
    candidates = [effect for effect in parts.candidates if not effect.periodic]
    test = score_test(problem, fit, engine)
    test = test.beside([not _is_pooled(term, candidates, problem) for term in fit.terms.terms])
    terms = test.fit.terms
    values = test.fit.values
    unit = 1 / test.scale[problem.groups][:, None]
    columns = unit * problem.columns(candidates, beside=(terms, values))
    quantities = problem.quantities
    components = problem.components if quantities else ()
    units = [problem.process(component, quantities[:1], "line", 1.0).coordinates[0].unit for component in components]
    phrases = {quantity.driver.phrase for quantity in quantities}
    waves = [family.term(1.0) for family in problem.periodic if family.whole]  # of a slide, along its own stroke
    # a point on the last axis does not show the turns of its joint
    sites = {component.site for component in components}
    return ReducedArm(
        heading=Heading(
            about={
                "what": diagnosis.domain,
                "arm": parts.arm.name,
                "joints": parts.arm.dof,
                "rows": problem.samples,
                "date": diagnosis.recording.settings.date,
                "verdict": diagnosis.verdict,
            },
            found=tuple((finding.effect.label, finding.p_value) for finding in diagnosis.findings),
            candidates=tuple(_candidate(effect, _key(effect), problem) for effect in candidates),
            families=tuple(
                _candidate(wave, f"waves:{wave.site}", problem)
                for wave in waves
                if isinstance(wave, Effect) and wave.drivers[0].phrase in phrases and wave.site in sites
            ),
            places=tuple(
                FleetComponent(component.site, component.name, unit)
                for component, unit in zip(components, units, strict=True)
            ),
            quantities=tuple(map(Varied.of, quantities)),
        ),
        columns=readings(columns, fit.noise, fit.training, test.residual.size),
        places=np.array([component.column * unit for component in components]).reshape(
            -1, problem.rows, problem.samples
        ),
        values=np.array([quantity.values for quantity in quantities]).reshape(len(quantities), -1),
        run=problem.every_run,
        noise=fit.noise,
        training=fit.training,
        basis=test.basis,
        residual=test.residual,
        blocks=test.blocks,
        smoothing=parts.smoothing,
    )


def _is_pooled(term: Term, candidates: Sequence[Effect], problem: PoseProblem | TorqueProblem) -> bool:
    """Tells whether a term is tested where recordings are pooled: a name, a wave of a whole angle, or a process."""
    if term.nonparametric:
        kernel = term.kernel if isinstance(term, Process) else ""
        sites = {term.site, ""}
        sites_of = {quantity.driver.phrase: quantity.own for quantity in problem.quantities}
        if kernel in PAIRS:
            return all(sites & sites_of.get(driver.phrase, frozenset()) for driver in term.drivers)
        return kernel in SINGLE
    if term.periodic:
        return isinstance(term, Wave) and not term.of_slide and term.order is not None
    return term in candidates


def _key(effect: Effect) -> str:
    """Name and fields, such as `joint_coupling:joint=2,source_joint=3`."""
    where = ",".join(f"{name}={value}" for name, value in field_values(effect).items())
    return f"{effect.name}:{where}"


def _candidate(effect: Effect, key: str, problem: PoseProblem | TorqueProblem) -> Candidate:
    numbers = effect.coordinates
    limits = problem.limits(effect)
    return Candidate(
        key=key,
        effect=effect.name,
        site=effect.site,
        driver=" and ".join(driver.phrase for driver in effect.drivers) or "none",
        names=tuple(number.name for number in numbers),
        typical=tuple(number.typical for number in numbers),
        lower=tuple(lower for lower, _ in limits),
        upper=tuple(upper for _, upper in limits),
        usual=effect.usual,
    )
