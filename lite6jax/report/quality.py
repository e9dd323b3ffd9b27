"""What is said of a model that does not describe its data."""

from collections.abc import Mapping
from typing import Any

from lite6jax.report.cells import number


def quality_statement(quality: Mapping[str, Any]) -> str | None:
    """Why a model does not describe the poses it was fitted to, and what to check; None where it does.

    Args:
        quality: as in JSON documents.
    """
    if quality["verdict"] != "bad":
        return None
    error = "not finite" if quality["error_m"] is None else f"up to {number(1e3 * quality['error_m'], 3)} mm"
    if quality["explained_share"] is None:
        return f"The model does not reproduce the calibration: its errors are {error}. Check the arm that is named."
    if quality["reason"] == "unrelated":
        return (
            "The model does not describe the poses: it explains less than half of the variance of the positions. Check "
            "that the poses belong to these joint positions, row by row."
        )
    return (
        f"The model does not describe the poses: of three quarters of the held-out rows the errors are {error}, and a "
        f"model of this arm is expected within {number(1e3 * quality['limit_m'], 3)} mm. Check the arm, that the poses "
        "belong to these joint positions, and the order, the signs and the units of the joints."
    )
