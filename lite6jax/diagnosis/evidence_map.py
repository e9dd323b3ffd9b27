"""What figures show of a diagnosis, as tables: of poses explained shares of variance and spectra of orders; of
torques their course over time, friction over velocity, and power spectra.
"""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from lite6jax.array_types import Array
from lite6jax.diagnosis.diagnose import Diagnosis
from lite6jax.diagnosis.partial_residuals import added_torque
from lite6jax.diagnosis.torque_diagnosis import TorqueDiagnosis
from lite6jax.domains.pose.kinematics import Site
from lite6jax.domains.pose.problem import PoseProblem
from lite6jax.domains.torque.predict import motion_of_joint
from lite6jax.effects.drivers import Driver
from lite6jax.effects.dynamic import Dynamics, Scaling, TorqueEffect
from lite6jax.effects.kinematic import JointHarmonic
from lite6jax.effects.nonparametric import SCALE, Unnamed
from lite6jax.estimation.evidence import Marginal, log_orders, of_process
from lite6jax.estimation.least_squares import Fit
from lite6jax.estimation.problem import PeriodicFamily
from lite6jax.estimation.score_test import ScoreTest, score_test
from lite6jax.estimation.thresholds import CONFOUNDED, EXACT_BELOW
from lite6jax.search.scan import ModelScan, Scan
from lite6jax.search.spectrum import spectrum

_KINDS = {
    **dict.fromkeys(
        ("gravity torque", *(f"{of} moment {axis}" for of in ("gravity", "base") for axis in "xy")), "load"
    ),
    "temperature rise": "temperature",
    **dict.fromkeys((f"measured position {axis}" for axis in "xyz"), "measured position"),
    **dict.fromkeys((f"measured position's {k}" for k in ("distance", "azimuth", "elevation")), "measured position"),
}
"""Quantities of drivers that share a column of the map."""
_COLUMNS = (
    *("constant", "position", "other positions", "direction of motion", "velocity", "load"),
    *("temperature", "time", "payload", "measured position", "two drivers"),
)
_AT_ONCE = 32
"""Orders whose gains are computed in one call, which bounds the memory."""
_LONGEST = 400
"""Samples of a run that are shown over time: more are not legible."""
_POINTS = 400
"""Of a curve of friction."""


class ExplainedShares(NamedTuple):
    """The share of the variance of the nuisance fit's residuals that a process of each driver explains at each site.

    Attributes:
        sites: `joint1` …, `link1` …, `base`, `tool` and `sensor`; where no process acts there, only the joints.
        drivers: kinds of them, such as the position of the joint itself and those of other joints; `load` is gravity's
            torque or moment, and `two drivers` are any two, of which the likeliest processes alone are there.
        shares: `(site, driver)`, from 0 to 1, adjusted for the degrees of freedom of the process; NaN where the driver
            is not known, does not vary, or is confounded with the nuisance.
    """

    sites: tuple[str, ...]
    drivers: tuple[str, ...]
    shares: Array


class Spectrum(NamedTuple):
    """What a harmonic of each order `(order,)` per turn explains of the variance that the model leaves, 0 to 1."""

    orders: Array
    shares: Array


class JointSpectra(NamedTuple):
    """The spectra of one joint.

    Attributes:
        site: `jointN`.
        before: of the residuals of the nuisance alone.
        after: of the residuals of the whole model; None where there are no findings.
        noise: `(order,)` of the last stage's orders: the share, of the variance that the whole model leaves, that any
            order of any joint exceeds in noise with the probability of the family-wise level. Findings are tested over
            all other effects too.
        harmonics: orders of the harmonics found at this joint.
        spectra: the lowest and the highest order of each spectrum that was found at this joint.
        observed: whether the sensor observes the joint.
    """

    site: str
    before: Spectrum
    after: Spectrum | None
    noise: Array
    harmonics: tuple[float, ...]
    spectra: tuple[tuple[float, float], ...]
    observed: bool


def stages(found: Diagnosis) -> list[tuple[PoseProblem, Fit]]:
    """The problem and fit of the nuisance alone and, where there are findings, of the whole model."""
    reference = found.selection.reference
    assert isinstance(reference, PoseProblem)
    before = [(reference, found.selection.state.baseline)]
    if found.findings:
        return [*before, (found.problem, found.fit)]
    return before


def explained_shares(found: Diagnosis) -> ExplainedShares:
    """The share of the variance left by the nuisance that a process of each driver explains at each site.

    Every process is a smooth one of the likeliest amplitude, and of two drivers the likeliest one. They contain a
    constant, which is shown alone too. Of several of one site and column it is the largest share.
    """
    problem, baseline = stages(found)[0]
    engine = found.options.engine
    test = score_test(problem, baseline, engine)
    weigh = _Shares(test)
    scan = Scan(problem, engine)
    numbered = [f"{kind}{k + 1}" for kind in ("joint", "link") for k in range(problem.motion.dof)]
    sites = [*numbered, "base", "tool", "sensor"]
    shares = np.full((len(sites), len(_COLUMNS)), np.nan)

    def put(site: str, column: str, share: float) -> None:
        at = sites.index(site), _COLUMNS.index(column)
        shares[at] = np.fmax(shares[at], share)

    for site in sites:
        constant = np.stack([column for at, column in problem.sites.items() if _name(at) == site])
        (score,) = test.score_columns([constant])
        if not score.confounded:
            put(site, "constant", weigh.adjusted(2 * score.gain, score.size))
    discrete_drivers = [k for k, discrete in enumerate(scan.discrete) if discrete]
    kinds = ((kernel, indices, np.stack([scan.features((k,), kernel) for k in indices]))
             for kernel, indices in (("line", discrete_drivers), ("smooth", scan.splines[0])) if indices)  # fmt: skip
    for (_, indices, functions), component in product(kinds, problem.components):
        for k, share in zip(indices, weigh.of(component.column, functions), strict=True):
            if scan.may_act(component.site, k):
                put(component.site, _column(component.site, scan.quantities[k].driver), share)
    for candidate in ModelScan(scan, test).ranked():
        if len(candidate.process) and len(candidate.process[1]) == 2:
            component, indices, kernel, rolloff = candidate.process
            (share,) = weigh.of(component.column, scan.features(indices, kernel, rolloff)[None])
            put(candidate.site, "two drivers", share)
    finite = np.isfinite(shares)
    rows = [i for i, site in enumerate(sites) if site.startswith("joint") or finite[i].any()]
    columns = [j for j in range(len(_COLUMNS)) if finite[:, j].any()]
    at = np.ix_(rows, columns)
    return ExplainedShares(tuple(sites[i] for i in rows), tuple(_COLUMNS[j] for j in columns), shares[at])


class _Shares:
    """What explains how much of the residuals that a model leaves, in white noise."""

    def __init__(self, test: ScoreTest) -> None:
        self._test = test
        self._marginal = Marginal(test)
        self._total = _left(test)

    def of(self, column: Array, functions: Array) -> Array:
        """`(group,)`, of processes `(group, function, sample)` at a site's column; NaN where they are confounded."""
        sums = self._marginal.sums(column)
        shares = np.full(len(functions), np.nan)
        pulls, informations = self._marginal.equations(sums, functions)
        s = of_process(pulls, informations, sums.left, sums.freedom, CONFOUNDED).variance
        total_weight = (functions**2 * sums.weight).sum((1, 2))
        for k, (pull, information) in enumerate(zip(pulls, informations, strict=True)):
            if np.trace(information) > CONFOUNDED * total_weight[k]:
                posterior = np.linalg.inv(information + np.eye(len(pull)) / s[k])
                values = posterior @ pull
                explained = values @ (2 * pull - information @ values)
                shares[k] = self.adjusted(explained, np.trace(posterior @ information))
        return shares

    def adjusted(self, explained: float, size: float) -> float:
        """The share that a sum of squares is, adjusted for its degrees of freedom (adjusted R²)."""
        unexplained = 1 - min(explained / self._total, 1.0)
        freedom = self._test.freedom
        return float(max(1 - unexplained * freedom / max(freedom - size, 1.0), 0.0))


def _name(site: Site) -> str:
    """The name of the place of a column of the problem: readings grow in the sensor."""
    kind, number, _ = site
    if kind in ("joint", "link"):
        return f"{kind}{number + 1}"
    return "sensor" if kind == SCALE else kind


def _column(site: str, driver: Driver) -> str:
    """The column of a driver: what it is; of a joint's position, whether it is that of the joint itself."""
    kind = _KINDS.get(driver.generalised, driver.generalised)
    is_own_joint = site in (f"joint{driver.place}", f"link{driver.place}")
    if kind != "position" or is_own_joint:
        return kind
    return "other positions"


def joint_spectra(found: Diagnosis) -> list[JointSpectra]:
    """The spectra of orders of each revolute joint, before and after."""
    engine = found.options.engine
    tests = [score_test(problem, fit, engine) for problem, fit in stages(found)]
    effects = [finding.effect for finding in found.findings]
    gear_effects = [effect for effect in effects if isinstance(effect, Unnamed) and effect.covariance.of_gear]
    gears = [(effect.site, effect.covariance.orders(effect.bounds)) for effect in gear_effects]
    exact_below = max([EXACT_BELOW, *(orders[-1] for _, orders in gears)])
    spectra = []
    for k, family in enumerate(found.problem.periodic):
        site = family.site
        stage_spectra = [_spectrum(test, test.problem.periodic[k], exact_below) for test in tests]
        among = log_orders(stage_spectra[-1].orders, engine, whole=False, highest=family.highest)
        highest = chdtri(2, engine.level / (len(found.problem.periodic) * np.exp(among)))
        spectra.append(
            JointSpectra(
                site=site,
                before=stage_spectra[0],
                after=stage_spectra[1] if len(stage_spectra) > 1 else None,
                noise=highest / np.maximum(_left(tests[-1]), highest),
                harmonics=tuple(
                    e.order for e in effects if isinstance(e, JointHarmonic) and e.site == site and e.order
                ),
                spectra=tuple((orders[0], orders[-1]) for gear_site, orders in gears if gear_site == site),
                observed=bool(found.problem.sites["joint", int(site.removeprefix("joint")) - 1, 0].any()),
            )
        )
    return spectra


def _spectrum(test: ScoreTest, family: PeriodicFamily, exact_below: float) -> Spectrum:
    """The nuisance is projected out of orders up to `exact_below`, with which it is confounded."""
    orders, gains = spectrum(test, family)
    low = int(np.searchsorted(orders, exact_below, side="right"))
    for start in range(0, low, _AT_ONCE):
        part = slice(start, min(start + _AT_ONCE, low))
        gains[part] = test.gains(family.column, family.waves_of(orders[part]))
    return Spectrum(orders, 2 * gains / _left(test))


def _left(test: ScoreTest) -> float:
    """The sum of squares of the residual that a model leaves."""
    remainder = test.residual - (test.basis @ test.residual) @ test.basis
    return max(float(remainder @ remainder), np.finfo(float).tiny)


# ------------------------------------------------------------------ torques


class JointFriction(NamedTuple):
    """The friction of one joint.

    Attributes:
        velocity: `(sample,)` rad/s, or m/s.
        partial: `(sample,)` Nm, what was measured, less the model without friction of this joint.
        at: `(point,)` rad/s, ascending; none where no friction was found.
        friction: `(point,)` Nm, as found, at the median of load and temperature, with the other joints at rest.
    """

    velocity: Array
    partial: Array
    at: Array
    friction: Array


def torques_over_time(found: TorqueDiagnosis) -> tuple[Array, dict[str, Array]]:
    """The middle of the longest run, filtered: times `(sample,)` s since the start, and torques `(joint, sample)` Nm.

    These are by name what was measured, what the rigid arm alone needs, and the model with the findings.
    """
    problem = found.problem
    state = found.selection.state
    edges = np.concatenate([[0], np.flatnonzero(np.diff(problem.run)) + 1, [problem.samples]])
    longest = int(np.argmax(np.diff(edges)))
    start = edges[longest]
    stop = edges[longest + 1]
    start = start + max(0, stop - start - _LONGEST) // 2
    shown = slice(start, min(start + _LONGEST, stop))
    recorded = problem.data.recording.time
    assert recorded is not None
    rigid, modelled = (problem.torque(fit.nuisance, fit.terms, fit.values) for fit in (state.baseline, state.fit))
    torques = {"measured": problem.measured, "rigid body": rigid, "modelled, with the findings": modelled}
    time = problem.data.time[problem.chosen][shown] - recorded[0]
    return time, {name: torque[:, shown] for name, torque in torques.items()}


def joint_frictions(found: TorqueDiagnosis) -> tuple[JointFriction, ...]:
    """The friction of each joint."""
    problem = found.problem
    fit = found.fit
    used = problem.valid
    velocity = np.asarray(problem.data.motion.joint_velocity)[:, problem.data.filter.kept][:, problem.chosen]
    residual = problem.measured - problem.torque(fit.nuisance, fit.terms, fit.values)
    shown = []
    for j in range(problem.rows):
        terms = enumerate(fit.terms.terms)
        frictions = [k for k, effect in terms if isinstance(effect, TorqueEffect) and effect.is_friction_of(j + 1)]
        partial = residual[j] + added_torque(found, frictions)[j]
        at = friction = np.zeros(0)
        if frictions:
            at = np.linspace(velocity[j].min(), velocity[j].max(), _POINTS)
            at = np.sort(np.append(at, [-1e-9, 1e-9]))  # so that a step at zero is one
            friction = _friction_at(found, frictions, j, at)
        shown.append(JointFriction(velocity[j, used], partial[used], at, friction))
    return tuple(shown)


def _friction_at(diagnosis: TorqueDiagnosis, chosen: Sequence[int], j: int, velocity: Array) -> Array:
    """Friction `(point,)` Nm of joint j, from 0, at velocities, with everything else as it typically is."""
    fit = diagnosis.fit
    dynamics = diagnosis.problem.dynamics
    typical = _still(dynamics, j, velocity)
    total = np.zeros_like(velocity)
    for k in chosen:
        effect = fit.terms.terms[k]
        assert isinstance(effect, TorqueEffect)
        total = total + effect.torque(fit.values[fit.terms.slices[k]], typical)[j]
    scales = (
        fit.values[part][0] for effect, part in fit.terms.pairs if isinstance(effect, Scaling) and effect.joint == j + 1
    )
    return total * (1 + sum(scales))


def _still(dynamics: Dynamics, j: int, velocity: Array) -> Dynamics:
    """The dynamics in which only joint j, from 0, moves, its load and all temperatures at their medians."""
    shape = (len(dynamics.torque), len(velocity))
    motion = dynamics.motion
    typical = {}
    rises = {"joint_temperature_rise": motion.joint_temperature_rise, "temperature_rise": motion.temperature_rise}
    for name, rise in rises.items():
        if rise is not None:
            rise = np.median(np.asarray(rise), axis=-1, keepdims=True)
            typical[name] = np.broadcast_to(rise, (*rise.shape[:-1], len(velocity)))
    alone = motion_of_joint(j, velocity, motion.sliding.mask(shape[0]))._replace(**typical)
    load = np.where(np.arange(shape[0])[:, None] == j, np.median(np.abs(dynamics.torque[j])), 0.0) * np.ones(shape)
    return dynamics._replace(motion=alone, torque=load)
