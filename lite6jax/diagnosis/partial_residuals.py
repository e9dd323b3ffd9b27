"""Each finding's fitted curve beside its partial residuals: what the data show at its site without it.

Partial residuals are the residuals of the whole model with the finding's own curve added back (W. Larsen and
S. McCleary, The Use of Partial Residual Plots in Regression Analysis, Technometrics 14, 1972).
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal, NamedTuple, cast

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import as_revolute
from lite6jax.diagnosis.result import Diagnosis, DomainDiagnosis, Finding
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.domains.pose.columns import site_of
from lite6jax.domains.pose.kinematics import Site
from lite6jax.effects.deflection import Deflection
from lite6jax.effects.drivers import Driver
from lite6jax.effects.dynamic.torque_effect import JointTorque, Scaling, TorqueEffect, UnnamedTorque
from lite6jax.effects.effect import Bending, Effect
from lite6jax.effects.kernels import orders_of
from lite6jax.effects.kinematic.joints import JointHarmonic
from lite6jax.effects.motion import Motion, motion_of
from lite6jax.effects.nonparametric import Unnamed

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

_POINTS = 1000
"""Points of a curve over the position of a joint; a nonparametric effect has half as many at least."""
_POINTS_PER_WAVE = 16
_MANY_PERIODS = 8.0
"""Periods of a harmonic over a joint's range, beyond which one period is shown."""
_SAME = 0.9999
"""Correlation with one of several drivers from which a displacement is a function of that one alone."""
_POORLY_OBSERVED = 4.0
"""Standard deviation of a partial residual, over the median, beyond which it is left out."""
_LEVELS = (10, 50, 90)
"""Percentiles of a second driver at which a function of two drivers is shown."""


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
        hysteresis: whether the curve is not a function of `at`: it then has a point for each sample.
        beside: of a function of two drivers the second one, and the value of it that the curve is at. Each of several
            curves has the samples that are nearest to it.
    """

    finding: int
    over: Literal["driver", "phase", "displacement", "row"]
    quantity: Driver | None
    site: Site | None
    unit: Literal["m", "rad", "1", "Nm", "N", "sigma"]
    driver: Array
    partial: Array
    at: Array
    curve: Array
    std: Array
    periods: float = 1.0
    hysteresis: bool = False
    beside: tuple[Driver, float] | None = None


class _Movement(NamedTuple):
    """Sites with one displacement by an effect: that `(sample,)`, and its derivatives by numbers `(number, sample)`."""

    sites: list[Site]
    shape: Array
    slope: Array


def finding_curves(found: DomainDiagnosis[Any], k: int) -> list[FindingCurve]:
    """The k-th finding over its driver: of torques one curve, of poses one for each way in which it moves a site.

    A nonparametric effect of two drivers is shown over one of them at some values of the other. Another finding of
    poses that no single driver describes is shown along the displacement of the measured pose.
    """
    if isinstance(found, TorqueDiagnosis):
        return _torque_curves(found, k)
    assert isinstance(found, Diagnosis)
    finding, used = found.findings[k], found.fit.training & ~found.outliers
    effect, curves = finding.effect, []
    if isinstance(effect, Unnamed):
        return _of_process(found, k, effect, used)
    if isinstance(effect, Bending):
        for movement in _movements(found, effect, finding):
            curve = _over_driver(found, k, movement, used)
            curves += [] if curve is None else [curve]
        few = effect.drivers and len(curves) <= 3
        if curves and (few or effect.site.startswith("joint")):
            return curves
    return [_along(found, k, used)]


def _movements(found: Diagnosis, effect: Bending, finding: Finding) -> Iterator[_Movement]:
    problem = found.problem
    unit = problem.deflections.unit(effect) if effect.linear else problem.deflections.slope(effect, finding.values)
    bent = effect.deflect(jnp.asarray(finding.values), problem.time_shifted, problem.loads)
    for field, moved, slopes in zip(Deflection._fields, bent, unit, strict=True):
        if moved is None or slopes is None:
            continue
        flat = np.asarray(moved).reshape(-1, problem.samples)
        slope = np.asarray(slopes).reshape(effect.size, -1, problem.samples)
        moving = [int(i) for i in np.flatnonzero(flat.any(-1))]
        uniform = field == "stretch" and all(np.allclose(flat[i], flat[moving[0]]) for i in moving)
        keys = [_site(field, i, np.ndim(moved)) for i in moving]
        if uniform and moving:
            yield _Movement(keys, flat[moving[0]], slope[:, moving[0]])
        else:
            yield from (_Movement([key], flat[i], slope[:, i]) for key, i in zip(keys, moving, strict=True))


def _site(field: str, i: int, dimensions: int) -> Site:
    if dimensions == 3:
        return (field, *divmod(i, 6))
    return (field, 0, i) if field in ("base", "tool", "sensor") else (field, i, 0)


def _over_driver(found: Diagnosis, k: int, movement: _Movement, used: Mask) -> FindingCurve | None:
    """One movement over the driver that it follows; None where it follows none."""
    problem, finding = found.problem, found.findings[k]
    effect, key = finding.effect, movement.sites[0]
    assert isinstance(effect, Bending)
    at_joint = key[0] == "joint"
    choices = effect.drivers or ((Driver("position", key[1] + 1),) if at_joint else ())
    motion, loads = problem.time_shifted, problem.loads
    known = [np.asarray(driver.values(motion, loads), float) for driver in choices]
    follows = [_correlation(values, movement.shape) for values in known]
    if not choices or (len(choices) > 1 and max(follows) < _SAME):
        return None
    best = int(np.argmax(follows))
    driver, x = choices[best], known[best]
    left, good = _left_at(found, np.sum([problem.sites[at] for at in movement.sites], 0), used)
    partial = movement.shape + left
    at, curve, slope, over = x, movement.shape, movement.slope, "driver"
    if driver.quantity in ("position", "slide position") and at_joint and len(effect.drivers) <= 1:
        at = np.linspace(x.min(), x.max(), _POINTS)
        curve, slope = _along_joint(effect, finding.values, driver.place, key[1], problem.motion, at)
    if isinstance(effect, JointHarmonic) and effect.order and effect.order * np.ptp(x) > 2 * np.pi * _MANY_PERIODS:
        x, at, over = np.mod(effect.order * x, 2 * np.pi), np.mod(effect.order * at, 2 * np.pi), "phase"
    std = _deviation(slope, finding.covariance)
    order = np.argsort(at, kind="stable")
    turns = at_joint and key[1] not in problem.motion.sliding.joints
    unit = "1" if key[0] in ("stretch", "scale") else "rad" if turns or key[2] > 2 else "m"
    return FindingCurve(k, over, driver, key, unit, x[good], partial[good], at[order], curve[order], std[order])


def _left_at(found: Diagnosis, site: Array, used: Mask) -> tuple[Array, Mask]:
    """What the whole model leaves along a site's column `(row, sample)`, in its unit; and where that is well known."""
    power = np.sum(site**2, 0)
    left = -np.sum(site * found.fit.residuals.rows, 0) / np.where(power > 0, power, np.inf)
    spread = np.sqrt(1 / np.where(power > 0, power, np.finfo(float).tiny))
    return left, used & (spread < _POORLY_OBSERVED * np.median(spread))


def _of_process(found: Diagnosis, k: int, effect: Unnamed, used: Mask) -> list[FindingCurve]:
    """A nonparametric effect over its driver, or over one of two at some values of the other.

    It and its partial residuals are about its mean over the samples, as a constant may be the calibration's instead.
    """
    finding, of = found.findings[k], found.problem.deflections
    site, unit = site_of(effect.where, effect.component), cast(Literal["m", "rad", "1"], effect.unit)
    left, good = _left_at(found, found.problem.sites[site], used)
    drivers, own = np.asarray(effect.values_at(of.host_motion, of.host_loads), float), of.basis(effect)
    shown = _Process(k, finding, drivers, own, left, good, own[:, good].mean(1), site, unit)
    return _over_drivers(effect, shown)


class _Process(NamedTuple):
    """A nonparametric finding on the samples: attributes as of `FindingCurve`, and

    Attributes:
        of: the finding.
        drivers: `(driver, sample)`.
        functions: `(function, sample)`.
        left: `(sample,)`, what the whole model leaves where it acts.
        good: `(sample,)` bool, the samples that are shown.
        mean: `(function,)`, about which it is shown.
    """

    finding: int
    of: Finding
    drivers: Array
    functions: Array
    left: Array
    good: Mask
    mean: Array
    site: Site
    unit: Literal["m", "rad", "1", "Nm", "N"]


def _over_drivers(effect: Unnamed | UnnamedTorque, of: _Process) -> list[FindingCurve]:
    """A process over its driver, or over one of two at some values of the other."""
    k, drivers, good, key, unit = of.finding, of.drivers, of.good, of.site, of.unit

    def shown(functions: Array) -> tuple[Array, Array]:
        about = functions - of.mean[:, None]
        return of.of.values @ about, _deviation(about, of.of.covariance)

    def over(main: int, placed: Callable[[Array], Array], rows: Mask, **more: Any) -> FindingCurve:
        x, waves = drivers[main], more.get("periods", 1.0)
        at = np.linspace(x.min(), x.max(), max(_POINTS // 2, int(_POINTS_PER_WAVE * waves)))
        functions = (np.asarray(effect.functions_at(placed(along))) for along in (at, x[rows]))  # type: ignore[arg-type]
        (curve, std), (moved, _) = map(shown, functions)
        driver, partial = effect.drivers[main], moved + of.left[rows]
        return FindingCurve(k, "driver", driver, key, unit, x[rows], partial, at, curve, std, **more)

    if effect.hysteretic:
        x, (moved, std) = drivers[0], shown(of.functions)
        order, partial = np.argsort(x, kind="stable"), moved + of.left
        points = x[order], moved[order], std[order]
        return [
            FindingCurve(k, "driver", effect.drivers[0], key, unit, x[good], partial[good], *points, hysteresis=True)
        ]
    if len(drivers) == 1:
        highest = orders_of(effect.bounds)[-1] if effect.kernel == "spectrum" else 0.0
        return [over(0, lambda x: x[None], good, periods=max(highest * np.ptp(drivers[0]) / (2 * np.pi), 1.0))]
    main = 1 if effect.drivers[0].discrete else 0
    second, values = effect.drivers[1 - main], drivers[1 - main]
    few = np.unique(np.sign(values[good])) if second.discrete else values
    levels = few[few != 0] if second.discrete else np.percentile(values[good], _LEVELS)
    nearest = np.argmin(np.abs(values - levels[:, None]), 0)
    return [
        over(
            main,
            lambda x, level=level: np.stack([x, np.full(len(x), level)][:: -1 if main else 1]),  # type: ignore[misc]
            good & (nearest == i),
            beside=(second, float(level)),
        )
        for i, level in enumerate(levels)
    ]


def _along_joint(
    effect: Bending, values: Array, moved: int, joint: int, whole: Motion, at: Array
) -> tuple[Array, Array]:
    """What adds at a joint over the position `at` of joint `moved`, counted from 1, and its derivatives by numbers."""
    q = np.zeros((len(at), whole.dof))
    q[:, moved - 1] = at
    motion = motion_of(q, sliding=whole.sliding.joints)

    def angle(numbers: Array) -> Array:
        bent = effect.deflect(jnp.asarray(numbers), motion, None).joint
        assert bent is not None
        return np.asarray(bent)[joint]

    if effect.linear:
        return angle(values), np.stack([angle(step) for step in np.eye(effect.size)])
    return angle(values), _slopes(angle, effect, values, 1e-6)


def _along(found: Diagnosis, k: int, used: Mask) -> FindingCurve:
    """A finding along the direction in which it displaces each measured pose, over the length of that displacement."""
    problem, finding, fit = found.problem, found.findings[k], found.fit
    effect: Effect = finding.effect
    without = fit.values.copy()
    without[fit.terms.slices[k]] = 0.0
    rows = problem.residual(fit.nuisance, fit.terms, without)
    columns = problem.columns([effect], finding.values, beside=(fit.terms, fit.values))
    scale, unit = 1.0, "sigma"
    if problem.measured.whitener.ndim == 1 and np.sum(columns[:, :3] ** 2) > 0.5 * np.sum(columns**2):
        columns, rows = columns[:, :3], rows[:3]
        scale, unit = 1 / float(problem.measured.whitener[0]), "m"
    moved = np.tensordot(finding.values, columns, 1)
    size = np.sqrt(np.sum(moved**2, 0))
    safe = np.where(size > 0, size, np.inf)
    partial = -np.sum(moved * rows, 0) / safe
    along = np.sum(columns * moved, 1) / safe
    std = _deviation(along, finding.covariance)
    good = used & (size > 0)
    x, over = scale * size, "displacement"
    if not good.any() or np.ptp(size[good]) < 1e-3 * size.max():  # the same everywhere
        x, over = problem.recording.row.astype(float), "row"
    order = np.argsort(x, kind="stable")
    return FindingCurve(
        k, over, None, None, unit, x[good], scale * partial[good], x[order], scale * size[order], scale * std[order]
    )  # fmt: skip


def _correlation(a: Array, b: Array) -> float:
    return 0.0 if np.ptp(a) == 0 or np.ptp(b) == 0 else float(abs(np.corrcoef(a, b)[0, 1]))


def _torque_curves(found: TorqueDiagnosis, k: int) -> list[FindingCurve]:
    """A finding of one joint over its driver; another over the torque that it adds where it adds most.

    A named one of several drivers has no curve over one of them: it has a point for each sample.
    """
    problem, fit, finding = found.problem, found.fit, found.findings[k]
    effect, used = finding.effect, problem.valid
    assert isinstance(effect, TorqueEffect)
    moved = added_torque(found, [k])
    j = int(np.argmax(np.sum(as_revolute(moved[:, used], "Nm", problem.data.arm.slides) ** 2, 1)))
    unit: Literal["N", "Nm"] = "N" if problem.data.arm.slides[j] else "Nm"
    left = problem.measured - problem.torque(fit.nuisance, fit.terms, fit.values)
    partial = (left + moved)[j, used]
    if not isinstance(effect, JointTorque) or isinstance(effect, Scaling):
        columns = problem.columns([effect], finding.values, (fit.terms, fit.values))[:, j] * problem.sigma[j]
        at, std = moved[j, used], _deviation(columns[:, used], finding.covariance)
        order = np.argsort(at, kind="stable")
        x = at[order]
        return [FindingCurve(k, "displacement", None, ("joint", j, 0), unit, at, partial, x, x, std[order])]
    dynamics, key = problem.dynamics, ("joint", j, 0)
    if isinstance(effect, UnnamedTorque):
        kept, own = problem.data.filter.kept[problem.chosen], problem.columns([effect])[:, j] * problem.sigma[j]
        drivers = effect.values_in(dynamics)[:, kept]
        return _over_drivers(effect, _Process(k, finding, drivers, own, left[j], used, np.zeros(len(own)), key, unit))
    choices = effect.drivers or (Driver("time"),)
    driver, loads = choices[0], dynamics.loads
    values = np.asarray(driver.values(dynamics.motion, loads))
    x = values[problem.data.filter.kept][problem.chosen][used]
    if len(choices) > 1:
        own = moved[j, used]
        return [FindingCurve(k, "driver", driver, key, unit, x, partial, x, own, np.zeros_like(own), hysteresis=True)]
    # not filtered, so that it is a function of its driver
    order = np.argsort(values, kind="stable")
    curve, slope = (
        effect.at_joint(finding.values, dynamics),
        _slopes(lambda values: effect.at_joint(values, dynamics), effect, finding.values, 1e-4),
    )
    std = _deviation(slope, finding.covariance)
    return [FindingCurve(k, "driver", driver, key, unit, x, partial, values[order], curve[order], std[order])]


def added_torque(found: TorqueDiagnosis, chosen: Sequence[int]) -> Array:
    """Torques `(joint, sample)` that some of the findings add to the others, filtered."""
    problem, fit = found.problem, found.fit
    without = fit.values.copy()
    for k in chosen:
        without[fit.terms.slices[k]] = 0.0
    whole, rest = (problem.torque(fit.nuisance, fit.terms, values) for values in (fit.values, without))
    return whole - rest


def _slopes(shown: Callable[[Array], Array], effect: Effect, values: Array, step: float) -> Array:
    """Derivatives `(number, sample)` of what is shown by numbers, by central differences of so much of their size."""
    steps = step * np.array([number.typical for number in effect.coordinates])
    return np.stack([(shown(values + s) - shown(values - s)) / (2 * s.sum()) for s in np.diag(steps)])


def _deviation(slope: Array, covariance: Array) -> Array:
    """One standard deviation `(sample,)` of what has derivatives `(number, sample)` by numbers of a covariance."""
    return np.sqrt(np.maximum(np.einsum("is,ij,js->s", slope, covariance, slope), 0.0))
