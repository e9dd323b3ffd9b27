"""What the document of a fleet must be to be shown again."""

from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta

from lite6jax.errors import InputError
from lite6jax.fleet.population import POINTS, SCHEMA
from lite6jax.schema import ESTIMATE, PLACE, Positive, Share, check, record

_INTERVAL = tuple[float, float]
_CURVE = Annotated[list[float], Meta(min_length=POINTS, max_length=POINTS)]
_DEVIATIONS = Annotated[list[Positive], Meta(min_length=POINTS, max_length=POINTS)]
_CHOSEN: dict[str, Any] = {
    "order": Positive,
    "source_joint": Annotated[float, Meta(ge=1.0)],
    "component": str,
    "kernel": str,
}
_PARAMETER = record({"mean": float, "std": Positive, "interval_95": _INTERVAL, "between_std": Positive})
_SLOPE = record({"value": float, "std": Positive, "interval_95": _INTERVAL})
_ARM = record({"file": str, "parameters": dict[str, ESTIMATE], "outlier_p_value": Share | None})
_RIVAL = record(PLACE | {"log_likelihood_gap": float}, _CHOSEN)
_EFFECT = record(
    {
        **PLACE,
        "found_by": Literal["mean", "any", "one", "drift"],
        "p_value": Share,
        "parameters": dict[str, _PARAMETER],
        "between_p_value": Share,
        "arms": list[_ARM],
        "rivals": list[_RIVAL],
    },
    {
        **_CHOSEN,
        **dict.fromkeys(("amplitude_rms_rad", "amplitude_rms_Nm"), Positive),
        "curve": record({"name": str, "driver": _CURVE, "mean": _CURVE, "std": _DEVIATIONS}),
        "nearest": record(PLACE | {"share": Share}, _CHOSEN),
        "drift": record({"p_value": Share, "per_day": dict[str, _SLOPE]}),
    },
)
_FOUND_ALONE, _OUTLIER = record({"label": str, "p_value": Share}), record(PLACE, _CHOSEN)
_RECORDING = record(
    {
        "file": str,
        "used": bool,
        "reason": str | None,
        "date": str | None,
        "verdict": str | None,
        "found_alone": list[_FOUND_ALONE],
        "outlier_in": list[_OUTLIER],
    }
)
_DOCUMENT = record(
    {
        "schema": Literal[SCHEMA],
        "arm": str,
        "over": Literal["date"] | None,
        "mean_date": str | None,
        "level": Share,
        "recordings": list[_RECORDING],
        "effects": list[_EFFECT],
    }
)


def is_of_fleet(document: Any) -> bool:
    """Whether a document says that it is that of a fleet."""
    return isinstance(document, dict) and document.get("schema") == SCHEMA


def check_fleet_document(document: Any, path: str | Path) -> None:
    """Refuses what is no whole document of a fleet.

    Raises:
        InputError: with the path, the place, and the remedy.
    """
    try:
        check(document, _DOCUMENT, "fleet")
    except InputError as error:
        raise InputError(f"{path}: {error}; run `lite6jax diagnose --fleet` again") from error
