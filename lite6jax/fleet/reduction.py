"""From the diagnosis of one recording to its reduced form: findings that can be pooled go back into the residual."""

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from lite6jax.diagnosis.diagnose import Diagnosis
from lite6jax.diagnosis.torque_diagnosis import TorqueDiagnosis
from lite6jax.domains.pose.problem import PoseProblem
from lite6jax.domains.torque.problem import TorqueProblem
from lite6jax.effects.effect import Effect, Loading, slides
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Term
from lite6jax.fleet.reduced import Heading, ReducedArm, readings
from lite6jax.fleet.terms import Candidate, Place, Varied
from lite6jax.search.scan import PAIRS, SINGLE


def reduced(found: Diagnosis | TorqueDiagnosis) -> ReducedArm:
    """The linear model of a diagnosed recording.

    The noise model is that of the diagnosis. Findings that are tested where recordings are pooled are part of the
    residual again, so that each is tested in the same way in all; the others stay fitted. Outlying poses are left
    out. Masses are those declared: their uncertainty matters beside effects of loads alone. Waves and processes of
    torques pass the filter that the torques have passed.
    """
    problem, engine, fit, smoothing = found.problem, found.options.engine, found.fit, None
    if isinstance(found, TorqueDiagnosis):
        what, data, joints = "torques", found.problem.data, found.problem.rows
        arm, settings, smoothing = data.arm, data.recording.settings, data.filter
        smoothing = replace(smoothing, kept=smoothing.kept[found.problem.chosen])
        named = [effect for effect in problem.candidates if effect.linear]
    else:
        what, joints = "poses", found.problem.motion.dof
        arm, settings = found.problem.arm, found.problem.recording.settings
        fit = replace(fit, training=fit.training & ~found.outliers)
        named = [effect for effect in problem.candidates if not isinstance(effect, Loading)]
    named = [effect for effect in named if not effect.periodic]
    test = score_test(problem, fit, engine)
    test = test.beside([not _is_pooled(one, named, problem) for one in fit.terms.terms])
    terms, values = test.fit.terms, test.fit.values
    unit = 1 / test.scale[problem.groups][:, None]
    columns = unit * problem.columns(named, beside=(terms, values))
    quantities = problem.quantities
    components = problem.components if quantities else ()
    units = [problem.process(one, quantities[:1], "line", 1.0).coordinates[0].unit for one in components]
    phrases = {one.driver.phrase for one in quantities}
    waves = [family.term(1.0) for family in problem.periodic if family.whole]  # of a slide, along its own stroke
    sites = {one.site for one in components}  # a point on the last axis does not show the turns of its joint
    return ReducedArm(
        heading=Heading(
            about={
                "what": what,
                "arm": arm.name,
                "joints": joints,
                "rows": problem.samples,
                "date": settings.date,
                "verdict": found.verdict,
            },
            found=tuple((one.effect.label, one.p_value) for one in found.findings),
            candidates=tuple(_candidate(effect, _key(effect), problem) for effect in named),
            families=tuple(
                _candidate(wave, f"waves:{wave.site}", problem)
                for wave in waves
                if isinstance(wave, Effect) and wave.drivers[0].phrase in phrases and wave.site in sites
            ),
            places=tuple(Place(one.site, one.name, unit) for one, unit in zip(components, units, strict=True)),
            quantities=tuple(map(Varied.of, quantities)),
        ),
        columns=readings(columns, fit.noise, fit.training, test.residual.size),
        places=np.array([one.column * unit for one in components]).reshape(-1, problem.rows, problem.samples),
        values=np.array([one.values for one in quantities]).reshape(len(quantities), -1),
        run=problem.every_run,
        noise=fit.noise,
        training=fit.training,
        basis=test.basis,
        residual=test.residual,
        blocks=test.blocks,
        smoothing=smoothing,
    )


def _is_pooled(term: Term, named: Sequence[Effect], problem: PoseProblem | TorqueProblem) -> bool:
    """Whether a term is tested where recordings are pooled: a name, a wave of a whole angle, or a process."""
    if term.nonparametric:
        kernel, own = getattr(term, "kernel", ""), {term.site, ""}
        known = {one.driver.phrase: one.own for one in problem.quantities}
        if kernel in PAIRS:
            return all(own & known.get(driver.phrase, frozenset()) for driver in term.drivers)
        return kernel in SINGLE
    if term.periodic:
        return isinstance(term, Effect) and not slides(term) and getattr(term, "order", None) is not None
    return term in named


def _key(effect: Effect) -> str:
    """Name and fields, such as `joint_coupling:joint=2,source_joint=3`."""
    given = ",".join(f"{field.name}={getattr(effect, field.name)}" for field in fields(effect))
    return f"{effect.name}:{given}"


def _candidate(effect: Effect, key: str, problem: PoseProblem | TorqueProblem) -> Candidate:
    numbers, limits = effect.coordinates, problem.limits(effect)
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
