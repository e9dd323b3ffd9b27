"""What is said of possible causes of an error, which `fit` looks for before it fits."""

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from lite6jax.arms.description import VARIANTS, bundled_arms
from lite6jax.formatting import capital, milli, plural, rows_named, significant

if TYPE_CHECKING:
    from lite6jax.domains.pose.check import Cause  # which fits, and what words faults does not


def _table_name(table: str) -> str:
    if table in VARIANTS:
        return f"the vendor's ROS default ({table})"
    if table in bundled_arms():
        return f"the published table ({table})"
    return f"the table of {table}"


def _distances(tables: Iterable[Mapping[str, Any]]) -> str:
    """Says how far each table is."""
    return "; ".join(
        f"{_table_name(table['table'])} {milli(table['rms_m'])} mm RMS, {milli(table['largest_m'])} mm at most"
        for table in tables
    )


def _percent(share: float) -> str:
    """Writes a share; one that is not quite whole is not shown as whole."""
    if 0.99 < share < 0.9995:
        return f"{100 * share:.1f} %"
    return f"{100 * share:.0f} %"


def default_table(cause: "Cause") -> str:
    """Says that a calibration file holds a nominal table."""
    numbers = cause.numbers
    return (
        f"This is {_table_name(numbers['nearest'])}, not the calibration of one arm ({_distances(numbers['tables'])})."
    )


def nominal_table(cause: "Cause") -> str:
    """Says of which arm a calibration is, and which table is nearest."""
    numbers = cause.numbers
    nearer = ""
    if numbers["nearest"] != numbers["tables"][0]["table"]:
        nearer = f", but {_table_name(numbers['nearest'])} is nearer"
    return f"This is a calibration of a {numbers['arm']}{nearer}: {_distances(numbers['tables'])}."


def tool_offset(cause: "Cause") -> str:
    """Says whether a tool offset explains the error."""
    numbers = cause.numbers
    shift = ", ".join(map(milli, numbers["shift_m"]))
    share = (
        f"a shift of ({shift}) mm in the flange frame explains {_percent(numbers['explained'])} of the squared error"
    )
    if numbers["likely"]:
        return f"A tool offset is likely: {share}. Set the tool offset (TCP) to zero, or declare it."
    if cause.suspicious:
        return f"A tool offset is possible: {share}. Check that the tool offset (TCP) is zero."
    beyond = ""
    declared = float(np.linalg.norm(numbers.get("declared_m", 0.0)))
    if declared:
        beyond = f" beyond the declared {milli(declared)} mm"
    return f"No tool offset{beyond}: {share}."


def joint_limits(cause: "Cause") -> str:
    """Says which joint is beyond its limits, and in which rows."""
    numbers = cause.numbers
    if "largest_excess_m" in numbers:
        excess = f"{significant(1e3 * numbers['largest_excess_m'])} mm"
    else:
        excess = f"{significant(float(np.rad2deg(numbers['largest_excess_rad'])))} deg"
    return f"Joint {numbers['joint']} is beyond its limits by up to {excess} in {rows_named(cause.rows)}."


def geometry(cause: "Cause") -> str:
    """Says whether the error is one of the geometry."""
    numbers = cause.numbers
    start = "nominal arm"
    if numbers["start"] == "factory_calibration":
        start = "factory calibration"
    share = (
        f"a change of geometry explains {_percent(numbers['explained'])} of the squared error "
        f"({milli(numbers['before_rms_m'])} mm RMS before, {milli(numbers['heldout_rms_m'])} mm on held-out rows)"
    )
    if numbers["kind"] == "none":
        return f"The {start} is correct to within the sensor noise: {share}."
    if numbers["kind"] == "geometry":
        return f"The error is a calibration error: {share}."
    extent = "not"
    if numbers["kind"] == "partly":
        extent = "partly"
    return f"The error is {extent} a calibration error: {share}. Diagnose the recording."


def one_point(cause: "Cause") -> str:
    """Says that all positions are one point."""
    numbers = cause.numbers
    return (
        "The measured positions are one point, the same in every row: a touched point or a fixed target. They show "
        "neither a scale nor axes. With the nominal arm the tool misses the point by "
        f"{milli(numbers['before_m'])} mm (median), with a fitted geometry by {milli(numbers['fitted_m'])} mm, of "
        "which much is not determined. Touch several points, or measure positions, to calibrate the arm."
    )


def outliers(cause: "Cause") -> str:
    """Says which rows are outliers."""
    count = len(cause.rows)
    if count == 0:
        return "There are no outliers."
    return (
        f"{capital(rows_named(cause.rows))} {plural(count, 'is an outlier', 'are outliers')}, by up to "
        f"{milli(cause.numbers['largest_m'])} mm. Check {plural(count, 'it', 'them')}."
    )


CAUSES: "Mapping[str, tuple[str, Callable[[Cause], str]]]" = {
    "default_table": ("Nominal table", default_table),
    "nominal_table": ("Nominal table", nominal_table),
    "tool_offset": ("Tool offset", tool_offset),
    "joint_limits": ("Joint limits", joint_limits),
    "geometry": ("Geometry", geometry),
    "one_point": ("Positions", one_point),
    "outliers": ("Outliers", outliers),
}
"""The name of each cause, and what is said of it."""
