"""Terminal reports of a study of an arm: what poses determine, and which parameters its error comes from."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from rich.console import RenderableType
from rich.text import Text

from lite6jax.arms.chains import HayatiForm
from lite6jax.design.determination import Dependency, Determination
from lite6jax.design.identify import Identification, Refits, on_last_axis
from lite6jax.design.information import Experiment
from lite6jax.design.sensitivity import GlobalSensitivity, Sensitivity
from lite6jax.design.sensor import Sensor
from lite6jax.model import TWIST_NAMES
from lite6jax.report import screen
from lite6jax.report.cells import SCREEN, joint_units, listing, number, plus_minus
from lite6jax.report.tables import hayati_columns, joint_name

Array = NDArray[np.floating]

_MOST_LISTED = 12
_MOST_PAIRS = 6


def described(sensor: Sensor) -> str:
    """A sensor in a phrase."""
    noise = f"{1e3 * sensor.position_noise:.3g} mm"
    reads = {
        "position": "positions",
        "pose": "positions and orientations",
        "axis": "positions along one axis",
        "distance": "distances to a point",
    }[sensor.quantity]
    if sensor.orientation_noise is not None:
        noise += f" and {np.rad2deg(sensor.orientation_noise):.2g} deg"
    per = " per axis" if sensor.rows > 1 else ""
    joints = f", joints read to ±{np.rad2deg(sensor.joint_noise):.2g} deg" if sensor.joint_noise else ""
    return f"{reads} to ±{noise}{per}{joints}"


def identification_report(found: Identification, source: str, drawn: bool) -> Iterator[RenderableType]:
    """What poses determine: the rank, the dependent parameters, the predicted deviations, the remedy.

    Args:
        found: the study.
        source: the arm or the file.
        drawn: whether the poses were drawn inside the limits.
    """
    experiment, determination = found.experiment, found.determination
    poses = (
        f"{determination.samples} pose{'s' * (determination.samples != 1)}{' drawn inside the limits' if drawn else ''}"
    )
    yield Text(source, no_wrap=True, overflow="ignore")
    yield Text(f"{experiment.arm.name}, {poses}; a sensor of {described(experiment.sensor)}.")
    yield ""
    yield Text(_verdict(found))
    yield from (Text(sentence) for sentence in _reasons(found))
    yield ""
    if determination.dependencies:
        yield from _in_words(experiment, determination.dependencies)
        yield ""
    yield Text("Predicted standard deviations (mm, deg)")
    yield ""
    yield from deviation_tables(experiment, determination)
    yield Text(_expected(found))
    yield from _warnings(determination)
    yield ""
    yield from _indices(found)
    if found.refits is not None:
        yield ""
        yield Text(refits_in_words(found.refits))
    yield from screen.notes(found.notes)


def _verdict(found: Identification) -> str:
    d = found.determination
    whole = "all" if d.rank == d.size else f"{d.rank} of"
    return f"These poses determine {whole} {d.size} unknown parameters."


def _reasons(found: Identification) -> Iterator[str]:
    d = found.determination
    if found.missed:
        narrow = found.narrow()
        scales, units = joint_units(found.experiment.arm.sliding, found.experiment.arm.dof)
        which = " and ".join(f"joint {j + 1} moves over {scales[j] * span:.2g} {units[j]}" for j, span in narrow)
        some = 0 < len(narrow) < found.experiment.arm.dof
        remedy = f"{which} only; move it further" if some else "record more poses, or others (lite6jax design)"
        yield f"Other poses of this arm determine {found.possible.rank}: {remedy}."
    elif d.theory is None:
        yield "Other poses inside its limits determine no more."
    elif d.rank == d.theory:
        yield f"By theory no poses determine more than {d.theory}."
    elif d.rank > d.theory:
        yield f"Counting expects {d.theory} of an arm in general; this one shows more."
    else:
        on_axis = on_last_axis(found.experiment)
        why = " (the measured point lies on the last joint's axis: --tool-at)" if on_axis else ""
        yield f"Other poses inside its limits determine no more; of an arm in general {d.theory} can be{why}."


def _in_words(experiment: Experiment, dependencies: Sequence[Dependency]) -> Iterator[RenderableType]:
    """The dependent parameters; those confounded with the sensor's frame or the tool take one sentence each."""
    rest = list(dependencies)
    if experiment.precision.any():  # the amounts of a direction that a prior keeps short would mislead
        yield Text(f"The readings do not determine {len(rest)} combinations; their prior does.")
        return
    for part, phrase in (("frame_", "The sensor's frame does"), ("tool_", "The tool does")):
        same = [d for d in rest if d.partners and all(name.startswith(part) for name, _, _ in d.partners)]
        if len(same) > 1:
            rest = [d for d in rest if d not in same]
            yield Text(f"{phrase} what {_listed([d.name for d in same])} do.")
    unobservable = [d for d in rest if not d.partners]
    if len(unobservable) > 1:
        rest = [d for d in rest if d.partners]
        yield Text(f"No reading changes with {_listed([d.name for d in unobservable])}.")
    yield from (Text(d.statement) for d in rest)
    yield Text("The data do not distinguish these: a fit holds the first of each at nominal.")


def deviation_tables(experiment: Experiment, determination: Determination) -> Iterator[RenderableType]:
    """A row a joint, then the sensor's frame and the tool."""
    shown = {}
    for name, unit, deviation, free in zip(
        determination.names, determination.units, determination.standard_deviation, determination.free, strict=True
    ):
        shown[name] = plus_minus(SCREEN.get(unit, (1.0, unit))[0] * deviation) if free else "held"

    def cells(names: Sequence[str]) -> list[str]:
        return [shown.get(name, "") for name in names]

    chain = experiment.form.chain
    if experiment.movable[: chain.size].any():
        if isinstance(chain, HayatiForm):
            in_base, columns = hayati_columns(chain)
            base = listing("base", *in_base)
            base.add_row("", *cells([f"base_{name}" for name in in_base]))
            yield base
            yield ""
            table = listing("joint", *columns)
            for i in range(chain.dof):
                table.add_row(joint_name(chain, i), *cells([f"{name}{i + 1}" for name in columns]))
        else:
            columns = ("x", "y", "z", "roll", "pitch", "yaw")
            table = listing("joint", *columns)
            for i in range(chain.dof):
                table.add_row(f"J{i + 1}", *cells([f"joint{i + 1}_{name}" for name in columns]))
        yield table
        yield ""
    parts = [part for part in ("frame", "tool") if getattr(experiment.form, part)]
    if parts:
        table = listing("", *TWIST_NAMES)
        for part in parts:
            table.add_row(part, *cells([f"{part}_{twist}" for twist in TWIST_NAMES]))
        yield table
        yield ""
    if experiment.physics.effects:
        table = listing("effect", "deviation", "typical", "unit")
        rigid = experiment.size - experiment.physics.size
        for i in range(rigid, experiment.size):
            deviation = f"{determination.standard_deviation[i]:.2g}" if determination.free[i] else "held"
            table.add_row(
                determination.names[i], deviation, f"{determination.scale[i]:.2g}", determination.units[i].strip("1")
            )
        yield table
        yield ""


def _warnings(determination: Determination) -> Iterator[RenderableType]:
    weak = determination.weak()
    if weak:
        are = "is" if len(weak) == 1 else "are"
        yield Text(f"Weak: {_listed(weak)} {are} determined no better than by the tolerances of assembly.")
    pairs = determination.correlated()
    if pairs:
        listed = ", ".join(f"{a} with {b} ({rho:+.3f})" for a, b, rho in pairs[:_MOST_PAIRS])
        more = f" and {len(pairs) - _MOST_PAIRS} pairs more" if len(pairs) > _MOST_PAIRS else ""
        yield Text(f"Strongly correlated estimates (above 0.95): {listed}{more}.")


def _indices(found: Identification) -> Iterator[RenderableType]:
    o = found.observability
    if o is None:
        return
    yield Text("Observability (parameters in units of 0.8 mm and 0.15 deg, readings in standard deviations)")
    yield ""
    table = listing("O1", "O2", "O3", "O4", "O5", "condition")
    table.columns[0].justify = "right"
    table.add_row(*(f"{value:.4g}" for value in (o.O1, o.O2, o.O3, o.O4, o.O5, o.condition)))
    yield table
    yield Text(
        f"Noise amplification: one standard deviation moves the worst direction {o.noise_amplification:.2g} units."
    )


def refits_in_words(refits: Refits) -> str:
    """How far the spread of the simulated fits is from the prediction."""
    count, ratio = len(refits.errors), refits.ratio
    if not len(ratio):
        return "No parameter is determined, so that none was refitted."
    if not refits.settled.any():
        return f"None of {count} refits converged: the noise is too large for the linear prediction to hold."
    lost = int((~refits.settled).sum())
    ended = f" {lost} of them did not converge." if lost else ""
    return (
        f"{count} refits of simulated readings spread {ratio.min():.2f} to {ratio.max():.2f} times as far as predicted"
        f" (chance alone: ±{3 / np.sqrt(2 * count):.2f}).{ended}"
    )


def sensitivity_report(
    found: Sensitivity, over_arms: GlobalSensitivity | None, source: str
) -> Iterator[RenderableType]:
    """Which parameters make up the error of an arm as assembled."""
    length, angle = (
        next((t for t, unit in zip(found.tolerance, found.units, strict=True) if unit == kind), 0.0)
        for kind in ("m", "rad")
    )
    yield Text(source, no_wrap=True, overflow="ignore")
    yield Text(
        f"Arms made to ±{1e3 * length:.3g} mm and ±{np.rad2deg(angle):.3g} deg in each number, one standard deviation."
    )
    yield ""
    expected = found.expected_error
    yield Text(
        f"The flange stands {1e3 * np.sqrt(np.mean(expected**2)):.1f} mm (RMS) from nominal over the workspace,"
        f" {1e3 * expected.min():.1f} mm where it is best and {1e3 * expected.max():.1f} mm where it is worst."
    )
    if over_arms is not None:
        low, middle, high = 1e3 * np.quantile(over_arms.error, (0.05, 0.5, 0.95))
        yield Text(
            f"An arm's largest error over its poses: {middle:.1f} mm (median of {len(over_arms.error)} arms);"
            f" 90 % lie in {low:.1f} to {high:.1f} mm."
        )
    yield ""
    order = np.argsort(-(found.share if over_arms is None else over_arms.total))[:_MOST_LISTED]
    header = ["parameter", "mm per unit", "share"]
    if over_arms is not None:
        header += ["alone", "in all"]
    table = listing(*header)
    for i in order:
        scale, unit = SCREEN[found.units[i]]
        row = [found.names[i], f"{1e3 * found.per_unit[i] / scale:.3g} /{unit}", f"{100 * found.share[i]:.1f} %"]
        if over_arms is not None:
            row += [
                f"{value[i]:.2f} ±{interval[i]:.2f}"
                for value, interval in (
                    (over_arms.first, over_arms.first_interval),
                    (over_arms.total, over_arms.total_interval),
                )
            ]
        table.add_row(*row)
    yield table
    largest = found.share.max()
    yield Text(
        f"share: of the mean squared error, to first order; even shares would be {100 / len(found.names):.1f} % each"
        f" (the largest is {100 * largest:.1f} %)."
    )
    if over_arms is not None:
        yield Text(
            "alone, in all: Sobol's indices of an arm's largest error, the share of its variance from arm to arm that"
            " the parameter explains by itself, and with all it does together with others; ± 95 %."
        )


def _expected(found: Identification) -> str:
    accuracy = found.accuracy
    if not accuracy.position_determined:
        return (
            "The fitted model does not predict the whole workspace: positions there depend on combinations that these"
            " poses do not determine."
        )
    expected = f"±{number(1e3 * accuracy.position_rms)} mm"
    if accuracy.orientation_determined:
        expected += f" and ±{number(np.rad2deg(accuracy.orientation_rms))} deg"
    return f"The fitted model predicts the whole workspace to {expected}."


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
