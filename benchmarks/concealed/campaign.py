"""The campaign of the pose trials: what its results hold, how a trial is drawn, diagnosed and scored."""

import json
from pathlib import Path

import pyarrow as pa

from benchmarks.campaigns.campaign import FLAG, NUMBER, TEXT, Campaign, Drawn, Row, fields, sealed_text
from benchmarks.campaigns.columns import read_columns
from benchmarks.concealed.scores import scored
from benchmarks.concealed.trials import draw

ESTIMATE = pa.struct(fields({"name": TEXT, "true off std bound": NUMBER}))
_HIDDEN = pa.struct(
    fields(
        {
            "effect site": TEXT,
            "size seen moved_m": NUMBER,
            "rival rival_site": TEXT,
            "apart": NUMBER,
            "site_found named in_set": FLAG,
            "numbers": pa.list_(ESTIMATE),
        }
    )
)
FINDING = pa.struct(
    fields(
        {
            "effect site driver": TEXT,
            "p_value gain order source_joint": NUMBER,
            "true": FLAG,
            "rivals": pa.list_(TEXT),
        }
    )
)
SCHEMA = pa.schema(
    fields(
        {
            "seed index rows": pa.int64(),
            "kind engine arm sensor geometry noise fault sha256 error verdict edge statement why": TEXT,
            "moving mounted detected exact exact_in_set top_site top_named top_in_set fault_found": FLAG,
            "masses_off sealed found": FLAG,
            "seconds planned_size before_m after_m noise_m estimated_noise_m": NUMBER,
            "nearest_effect nearest_site": TEXT,
            "nearest_p moved_m unseen_m unseen_rad unseen_missing oracle_m oracle_rad": NUMBER,
            "inside_components inside_covered outside_components outside_covered": NUMBER,
            "faults": pa.list_(TEXT),
            "hidden": pa.list_(_HIDDEN),
            "findings": pa.list_(FINDING),
        }
    )
)
"""Of the results: a row a trial."""


def _drawn(seed: int, index: int, sealed: bool) -> Drawn:
    trial = draw(seed, index, sealed)
    return Drawn(trial.files, sealed_text(trial.truth))


def _commands(given: Path) -> None:
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


POSES = Campaign(SCHEMA, _drawn, _commands, _scored)
