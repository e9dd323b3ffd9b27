"""What the document of a fleet must be to be shown again."""

from pathlib import Path
from typing import Any

from lite6jax.errors import InputError
from lite6jax.populations.population import POINTS, SCHEMA
from lite6jax.schema import array, flag, items, mapping, number, one_of, optional, record, text

_P_VALUE = number(0.0, 1.0)
_INTERVAL = array(2)
_NAMED = {"effect": text, "site": text, "driver": text}
_CHOSEN = {"order": number(0.0), "source_joint": number(1)}
_ESTIMATE = record({"value": number(), "std": number(0.0)})
_EFFECT = record(
    {
        **_NAMED,
        "found_by": one_of("mean", "any", "drift", "one"),
        "p_value": _P_VALUE,
        "parameters": mapping(
            record({"mean": number(), "std": number(0.0), "interval_95": _INTERVAL, "between_std": number(0.0)})
        ),
        "between_p_value": _P_VALUE,
        "arms": items(record({"file": text, "parameters": mapping(_ESTIMATE), "outlier_p_value": optional(_P_VALUE)})),
        "rivals": items(record({**_NAMED, "log_likelihood_gap": number()}, _CHOSEN)),
    },
    {
        **_CHOSEN,
        **dict.fromkeys(("amplitude_rms_rad", "amplitude_rms_Nm"), number(0.0)),
        "curve": record(
            {
                "name": text,
                **dict.fromkeys(("driver", "mean"), items(number(), POINTS)),
                "std": items(number(0.0), POINTS),
            }
        ),
        "nearest": record({**_NAMED, "share": number(0.0, 1.0)}, _CHOSEN),
        "drift": record(
            {
                "p_value": _P_VALUE,
                "per_day": mapping(record({"value": number(), "std": number(0.0), "interval_95": _INTERVAL})),
            }
        ),
    },
)
_RECORDING = record(
    {
        "file": text,
        "used": flag,
        "reason": optional(text),
        "date": optional(text),
        "verdict": optional(text),
        "found_alone": items(record({"label": text, "p_value": _P_VALUE})),
        "outlier_in": items(record(_NAMED, _CHOSEN)),
    }
)
_DOCUMENT = record(
    {
        "schema": one_of(SCHEMA),
        "arm": text,
        "over": optional(one_of("date")),
        "mean_date": optional(text),
        "level": _P_VALUE,
        "searched": number(0.0),
        "recordings": items(_RECORDING),
        "effects": items(_EFFECT),
    },
    {"checksum": text},
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
        _DOCUMENT(document, "fleet")
    except InputError as error:
        raise InputError(f"{path}: {error}; run `lite6jax diagnose --fleet` again") from error
