"""Each finding's fitted curve beside its partial residuals: what the data show at its site without it.

Partial residuals are the residuals of the whole model with the finding's own curve added back (W. Larsen and
S. McCleary, The Use of Partial Residual Plots in Regression Analysis, Technometrics 14, 1972).
"""

from collections.abc import Callable, Iterator, Sequence
from functools import singledispatch
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np

from lite6jax.arms.arm import as_revolute
from lite6jax.array_types import Array, Mask
from lite6jax.diagnosis.diagnose import Diagnosis
from lite6jax.diagnosis.result import DomainDiagnosis
from lite6jax.diagnosis.torque_diagnosis import TorqueDiagnosis
from lite6jax.domains.pose.deflections import site_of
from lite6jax.domains.pose.kinematics import Site
from lite6jax.effects.deflection import Deflection
from lite6jax.effects.drivers import Driver
from lite6jax.effects.dynamic import JointTorque, TorqueEffect, UnnamedTorque
from lite6jax.effects.effect import Bending, Effect
from lite6jax.effects.kinematic import JointHarmonic
from lite6jax.effects.motion import motion_of
from lite6jax.effects.nonparametric import Unnamed

_POINTS = 1000
"""Points of a curve over the position of a joint; a nonparametric effect has half as many at least."""
_POINTS_PER_WAVE = 16
_MANY_PERIODS = 8.0
"""Periods of a harmonic over a joint's range, beyond which one period is shown."""
_SAME = 0.9999
"""Correlation with one of several drivers from which a displacement is a function of that one alone."""
_POORLY_OBSERVED = 4.0
"""Standard deviation of a partial residual, over the median, beyond which it is left out."""


class FindingCurve(NamedTuple):
    """A finding over one quantity, all in SI units.

    Attributes:
        finding: its place among the findings, from 0.
        over: what `driver` and `at` are: values of a driver, the phase of a harmonic (rad), the length of the whole
            displacement (m, or standard deviations of the sensor), or row numbers of the recording.
        quantity: the driver, where there is one; of a phase, the joint's position.
        site: what moves: a field of `Deflection`, the joint or link from 0, the component of a twist; None where it is
            the measured pose.
        unit: of `partial`, `curve` and `std`: `m`, `rad`, `1`, `Nm`, `N`, or `sigma` for standard deviations of the
            sensor.
        driver: `(sample,)`.
        partial: `(sample,)`, partial residuals.
        at: `(point,)`, ascending.
        curve: `(point,)`, as fitted.
        std: `(point,)`, standard deviation of the curve.
        periods: of a curve over the range shown.
        scattered: whether the curve is not a function of `at` alone: it then has a point for each sample.
    """

    finding: int
    over: Literal["driver", "phase", "displacement", "row"]
    quantity: Driver | None
    site: Site | None
    unit: str
    driver: Array
    partial: Array
    at: Array
    curve: Array
    std: Array
    periods: float = 1.0
    scattered: bool = False


class _Samples(NamedTuple):
    """A finding on the samples: what moves by how much, its derivatives by numbers, and what the whole model leaves."""

    site: Site | None
    unit: str
    moved: Array
    slope: Array
    left: Array
    good: Mask


@singledispatch
def finding_curves(found: DomainDiagnosis[Any], k: int) -> list[FindingCurve]:
    """The k-th finding over its driver: of torques one curve, of poses one for each way in which it moves a site.

    A function of several drivers is shown over the first, with a point for each sample. A finding of poses that no
    driver describes is shown along the displacement of the measured pose.
    """
    raise NotImplementedError


@finding_curves.register
def _pose_curves(found: Diagnosis, k: int) -> list[FindingCurve]:
    finding = found.findings[k]
    used = found.fit.training & ~found.outliers
    effect = finding.effect
    if isinstance(effect, Unnamed):
        of = found.problem.deflections
        site = site_of(effect.where, effect.component)
        residual, good = _residual_at(found, found.problem.sites[site], used)
        functions = of.basis(effect)
        mean = functions[:, good].mean(1)  # a constant may be the calibration's instead
        about = functions - mean[:, None]
        samples = _Samples(site, effect.unit, finding.values @ about, about, residual, good)
        drivers = np.asarray(effect.values_at(of.host_motion, of.loads), float)
        return [_process_curve(found, k, samples, drivers, mean)]
    curves = []
    if isinstance(effect, Bending):
        for samples in _movements(found, effect, k, used):
            curve = _driver_curve(found, k, samples)
            curves += [] if curve is None else [curve]
        has_few_curves = effect.drivers and len(curves) <= 3
        if curves and (has_few_curves or effect.site.startswith("joint")):
            return curves
    return [_displacement_curve(found, k, used)]


def _curve(
    diagnosis: DomainDiagnosis[Any], k: int, over: Any, quantity: Driver | None, x: Array, of: _Samples, **more: Any
):
    """The curve through what is fitted at the samples, or at the points that are given with `at`."""
    at, moved, slope = more.pop("points", (x, of.moved, of.slope))
    order = np.argsort(at, kind="stable")
    std = np.sqrt(np.maximum(np.einsum("is,ij,js->s", slope, diagnosis.findings[k].covariance, slope), 0.0))[order]
    shown = x[of.good], (of.moved + of.left)[of.good]
    return FindingCurve(k, over, quantity, of.site, of.unit, *shown, at[order], moved[order], std, **more)


# ------------------------------------------------------------------ of poses


def _movements(diagnosis: Diagnosis, effect: Bending, k: int, used: Mask) -> Iterator[_Samples]:
    """Each way in which an effect moves sites; those that move alike are one."""
    problem = diagnosis.problem
    values = diagnosis.findings[k].values
    unit = problem.deflections.unit(effect) if effect.linear else problem.deflections.slope(effect, values)
    bent = effect.deflect(jnp.asarray(values), problem.time_shifted, problem.loads)
    for field, moved, slopes in zip(Deflection._fields, bent, unit, strict=True):
        if moved is None or slopes is None:
            continue
        flat = np.asarray(moved).reshape(-1, problem.samples)
        slope = np.asarray(slopes).reshape(effect.size, -1, problem.samples)
        moving = [int(i) for i in np.flatnonzero(flat.any(-1))]
        uniform = field == "stretch" and all(np.allclose(flat[i], flat[moving[0]]) for i in moving)
        for group in [moving] if uniform and moving else [[i] for i in moving]:
            sites = [_site(field, i, np.ndim(moved)) for i in group]
            residual, good = _residual_at(diagnosis, np.sum([problem.sites[at] for at in sites], 0), used)
            yield _Samples(sites[0], "", flat[group[0]], slope[:, group[0]], residual, good)


def _site(field: str, i: int, dimensions: int) -> Site:
    if dimensions == 3:
        return (field, *divmod(i, 6))
    if field in ("base", "tool", "sensor"):
        return (field, 0, i)
    return (field, i, 0)


def _driver_curve(diagnosis: Diagnosis, k: int, of: _Samples) -> FindingCurve | None:
    """One movement over the driver that it follows; None where it follows none."""
    problem = diagnosis.problem
    effect = diagnosis.findings[k].effect
    assert isinstance(effect, Bending)
    assert of.site is not None
    field, joint, component = of.site
    at_joint = field == "joint"
    choices = effect.drivers or ((Driver("position", joint + 1),) if at_joint else ())
    driver_values = [np.asarray(driver.values(problem.time_shifted, problem.loads), float) for driver in choices]
    follows = [_correlation(values, of.moved) for values in driver_values]
    if not choices or (len(choices) > 1 and max(follows) < _SAME):
        return None
    closest = int(np.argmax(follows))
    driver = choices[closest]
    x = driver_values[closest]
    turns = at_joint and joint not in problem.motion.sliding.joints
    unit = "rad" if turns or component > 2 else "m"
    if field in ("stretch", "scale"):
        unit = "1"
    of = of._replace(unit=unit)
    points = x, of.moved, of.slope
    if driver.quantity in ("position", "slide position") and at_joint and len(effect.drivers) <= 1:
        at = np.linspace(x.min(), x.max(), _POINTS)
        q = np.zeros((_POINTS, problem.motion.dof))
        q[:, driver.place - 1] = at
        motion = motion_of(q, sliding=problem.motion.sliding.joints)
        shown = lambda values: np.asarray(effect.deflect(jnp.asarray(values), motion, None).joint)[joint]  # noqa: E731
        values = diagnosis.findings[k].values
        points = at, shown(values), _slopes(shown, effect, values)
    if isinstance(effect, JointHarmonic) and effect.order and effect.order * np.ptp(x) > 2 * np.pi * _MANY_PERIODS:
        phase = lambda angle: np.mod(effect.order * angle, 2 * np.pi)  # noqa: E731
        return _curve(diagnosis, k, "phase", driver, phase(x), of, points=(phase(points[0]), *points[1:]))
    return _curve(diagnosis, k, "driver", driver, x, of, points=points)


def _residual_at(diagnosis: Diagnosis, site: Array, used: Mask) -> tuple[Array, Mask]:
    """What the whole model leaves along a site's column `(row, sample)`, in its unit; and where that is well known."""
    power = np.sum(site**2, 0)
    residual = -np.sum(site * diagnosis.fit.residuals.rows, 0) / np.where(power > 0, power, np.inf)
    spread = np.sqrt(1 / np.where(power > 0, power, np.finfo(float).tiny))
    return residual, used & (spread < _POORLY_OBSERVED * np.median(spread))


def _displacement_curve(diagnosis: Diagnosis, k: int, used: Mask) -> FindingCurve:
    """A finding along the direction in which it displaces each measured pose, over the length of that displacement."""
    problem = diagnosis.problem
    finding = diagnosis.findings[k]
    fit = diagnosis.fit
    without = fit.values.copy()
    without[fit.terms.slices[k]] = 0.0
    rows = problem.residual(fit.nuisance, fit.terms, without)
    columns = problem.columns([finding.effect], finding.values, beside=(fit.terms, fit.values))
    scale = 1.0
    unit = "sigma"
    if problem.measured.whitener.ndim == 1 and np.sum(columns[:, :3] ** 2) > 0.5 * np.sum(columns**2):
        columns = columns[:, :3]
        rows = rows[:3]
        scale = 1 / float(problem.measured.whitener[0])
        unit = "m"
    moved = np.tensordot(finding.values, columns, 1)
    size = np.sqrt(np.sum(moved**2, 0))
    safe = np.where(size > 0, size, np.inf)
    partial = -np.sum(moved * rows, 0) / safe
    good = used & (size > 0)
    slope = scale * np.sum(columns * moved, 1) / safe
    samples = _Samples(None, unit, scale * size, slope, scale * (partial - size), good)
    if not good.any() or np.ptp(size[good]) < 1e-3 * size.max():  # the same everywhere
        return _curve(diagnosis, k, "row", None, problem.recording.row.astype(float), samples)
    return _curve(diagnosis, k, "displacement", None, scale * size, samples)


def _correlation(a: Array, b: Array) -> float:
    if np.ptp(a) == 0 or np.ptp(b) == 0:
        return 0.0
    return float(abs(np.corrcoef(a, b)[0, 1]))


# ------------------------------------------------------------------ of torques


@finding_curves.register
def _torque_curves(diagnosis: TorqueDiagnosis, k: int) -> list[FindingCurve]:
    return [_torque_curve(diagnosis, k)]


def _torque_curve(diagnosis: TorqueDiagnosis, k: int) -> FindingCurve:
    """A finding of one joint over its driver; another over the torque that it adds where it adds most."""
    problem = diagnosis.problem
    fit = diagnosis.fit
    finding = diagnosis.findings[k]
    effect = finding.effect
    used = problem.valid
    dynamics = problem.dynamics
    assert isinstance(effect, TorqueEffect)
    moved = added_torque(diagnosis, [k])
    j = int(np.argmax(np.sum(as_revolute(moved[:, used], "Nm", problem.data.arm.slides) ** 2, 1)))
    columns = problem.columns([effect], finding.values, (fit.terms, fit.values))[:, j] * problem.sigma[j]
    residual = (problem.measured - problem.torque(fit.nuisance, fit.terms, fit.values))[j]
    unit = "N" if problem.data.arm.slides[j] else "Nm"
    samples = _Samples(("joint", j, 0), unit, moved[j], columns, residual, used)
    filter_samples = problem.data.filter.kept
    if not effect.shown_over_driver:
        return _curve(diagnosis, k, "displacement", None, moved[j], samples)
    assert isinstance(effect, JointTorque)
    if effect.nonparametric:
        assert isinstance(effect, UnnamedTorque)
        return _process_curve(diagnosis, k, samples, effect.values_in(dynamics)[:, filter_samples][:, problem.chosen])
    driver = next(iter(effect.drivers), Driver("time"))
    x = np.asarray(driver.values(dynamics.motion, dynamics.loads))
    if len(effect.drivers) > 1:
        return _curve(diagnosis, k, "driver", driver, x[filter_samples][problem.chosen], samples, scattered=True)
    # not filtered, so that it is a function of its driver
    shown = lambda values: effect.at_joint(values, dynamics)  # noqa: E731
    points = x, shown(finding.values), _slopes(shown, effect, finding.values)
    return _curve(diagnosis, k, "driver", driver, x[filter_samples][problem.chosen], samples, points=points)


def added_torque(found: TorqueDiagnosis, chosen: Sequence[int]) -> Array:
    """Torques `(joint, sample)` that some of the findings add to the others, filtered."""
    problem = found.problem
    fit = found.fit
    without = fit.values.copy()
    for k in chosen:
        without[fit.terms.slices[k]] = 0.0
    full_torque, other_torque = (problem.torque(fit.nuisance, fit.terms, values) for values in (fit.values, without))
    return full_torque - other_torque


# ------------------------------------------------------------------ of both


def _process_curve(
    diagnosis: DomainDiagnosis[Any], k: int, of: _Samples, drivers: Array, mean: Array | float = 0.0
) -> FindingCurve:
    """A nonparametric effect over its first driver, about a mean of its functions."""
    finding = diagnosis.findings[k]
    x = drivers[0]
    effect: Any = finding.effect
    if effect.hysteretic or len(drivers) > 1:
        return _curve(diagnosis, k, "driver", effect.drivers[0], x, of, scattered=True)
    highest = np.max(effect.covariance.orders(effect.bounds, effect.rolloff), initial=0.0)
    periods = max(highest * np.ptp(x) / (2 * np.pi), 1.0)
    at = np.linspace(x.min(), x.max(), max(_POINTS // 2, int(_POINTS_PER_WAVE * periods)))
    functions = np.asarray(effect.functions_at(at[None])) - np.reshape(mean, (-1, 1))
    points = at, finding.values @ functions, functions
    return _curve(diagnosis, k, "driver", effect.drivers[0], x, of, points=points, periods=periods)


def _slopes(shown: Callable[[Array], Array], effect: Effect, values: Array) -> Array:
    """Derivatives `(number, sample)` of what is shown by numbers, by central differences of 1e-4 of their size."""
    steps = 1e-4 * np.array([number.typical for number in effect.coordinates])
    return np.stack([(shown(values + s) - shown(values - s)) / (2 * s.sum()) for s in np.diag(steps)])
