"""The campaign of the torque trials: what its results hold, how a trial is drawn, diagnosed, and scored."""

import json
from pathlib import Path

import pyarrow as pa

from benchmarks.campaigns.campaign import FLAG, NUMBER, TEXT, Campaign, Drawn, Row, fields, sealed_text
from benchmarks.campaigns.columns import read_columns
from benchmarks.concealed.campaign import ESTIMATE, FINDING
from benchmarks.torque_trials.scores import scored
from benchmarks.torque_trials.trials import draw

_HIDDEN = pa.struct(
    fields(
        {
            "effect site rival rival_site": TEXT,
            "size seen moved_Nm apart": NUMBER,
            "site_found named in_set": FLAG,
            "numbers": pa.list_(ESTIMATE),
        }
    )
)
SCHEMA = pa.schema(
    fields(
        {
            "seed index rows": pa.int64(),
            "kind engine arm inertial source noise edge fault sha256 error verdict": TEXT,
            "sealed detected found exact exact_in_set top_site top_named top_in_set": FLAG,
            "wrong_name fault_found absurd honest": FLAG,
            "seconds planned_size before_Nm after_Nm unseen_Nm bound_Nm": NUMBER,
            "faults false": pa.list_(TEXT),
            "hidden": pa.list_(_HIDDEN),
            "findings": pa.list_(FINDING),
        }
    )
)
"""Of the results: a row a trial."""


def _drawn(seed: int, index: int, sealed: bool) -> Drawn:
    trial = draw(seed, index, sealed)
    return Drawn(trial.files, sealed_text(trial.truth))


def _diagnosed(given: Path) -> None:
    from lite6jax.cli.diagnose import Diagnose
    from lite6jax.cli.diagnosis import Predict
    from lite6jax.fitting.compiled import keep_compiled_code

    keep_compiled_code()
    diagnosis = given / "diagnosis.json"
    Diagnose(given / "recording.csv", out=diagnosis, force=True).run()
    Predict(diagnosis, given / "unseen.csv", out=given / "predicted.csv", force=True).run()


def _scored(truth: Row, given: Path, seconds: float, error: str) -> Row:
    diagnosis, predicted = given / "diagnosis.json", given / "predicted.csv"
    said = json.loads(diagnosis.read_text()) if diagnosis.exists() else None
    shown = read_columns(predicted) if predicted.exists() else None
    return scored(truth, said, shown, seconds, error)


TORQUES = Campaign(SCHEMA, _drawn, _diagnosed, _scored)
