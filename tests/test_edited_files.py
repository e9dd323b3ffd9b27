"""Files that were damaged or edited after they were written: what no arm can have is refused, with its place."""

import copy
import json

import numpy as np
import pytest
from diagnosis.recorded import Made
from domains.pose.documents import document
from typed import refusal, refused

from lite6jax.arms.description import load_bundled
from lite6jax.arms.dh import read_table, write_table
from lite6jax.diagnosis.document import SCHEMA, read_model, write_document

EFFECTS = ("joint_compliance:joint=2,compliance_rad_per_Nm=9e-5", "joint_offset:joint=3,offset_rad=2e-4")
LITE6 = load_bundled("lite6")


@pytest.fixture(scope="module")
def diagnosis(tmp_path_factory):
    """A document of the present version with a model, errors and what a prediction's bars need."""
    made = document(Made(tmp_path_factory.mktemp("arm"), seed=1, frame=True, tool=True), EFFECTS)
    errors = {"heldout_position_rms_m": 3e-4, "heldout_position_p95_m": 5e-4, "heldout_position_max_m": 8e-4}
    one = [1e-5, 1e-5]
    made["model"]["uncertainty"] = {
        "sites": [["base", 0, 0]],
        "covariance": [1e-10, 0.0, 1e-12, 0.0, 0.0, 1e-10],
        "left": one,
        "unseen": one,
        "noise": one,
        "recorded": {
            "joint_range_rad": [[-1.0, 1.0]] * 6,
            "joint_position_rad": [[0.1] * 6, [0.2] * 6],
            "spacing_rad": 0.3,
            "drivers": {"gravity torque of joint 2": [-5.0, 5.0]},
        },
    }
    return made | {"schema": SCHEMA, "verdict": "explained", "before": errors, "after": dict(errors), "samples": 30}


# ------------------------------------------------------------------ damage


def changed(*path_and_value):
    *path, last, value = path_and_value

    def apply(content):
        for key in path:
            content = content[key]
        content[last] = value(content[last]) if callable(value) else value

    return apply


DAMAGE = {
    "a rotation's entry of 9": (changed("model", "T_sensor_base", 0, 0, 9.0), "T_sensor_base is no rigid transform"),
    "a mirrored frame": (
        changed("model", "T_flange_tool", lambda T: [[-x for x in T[0]], *T[1:]]),
        "T_flange_tool is no rigid transform",
    ),
    "a negative mass": (changed("model", "inertia", "mass", 2, -1.0), "inertia.mass[2] is -1, which is negative"),
    "an angle of 1e6": (changed("model", "kinematics", 1, 4, 1e6), "Expected `float` <= 6.28318"),
    "a length in millimetres": (
        changed("model", "kinematics", 0, 2, 243.3),
        "Expected `float` <= 10.0 - at `$.model.kinematics[0][2]`",
    ),
    "a text for a number": (
        changed("model", "kinematics", 0, 2, "0.2"),
        "Expected `float`, got `str` - at `$.model.kinematics[0][2]`",
    ),
    "a number for a flag": (changed("model", "orientation", 1), "Expected `bool`, got `int`"),
    "NaN": (changed("model", "inertia", "gravity", 2, float("nan")), "is no JSON (JSON is malformed"),
    "an unknown key": (changed("model", "tool", None), "unknown field `tool` - at `$.model`"),
    "an absurd effect": (
        changed("model", "effects", 0, "parameters", "compliance_rad_per_Nm", "value", 1e6),
        "joint_compliance:joint2: compliance_rad_per_Nm is 1e+06, which is not between",
    ),
    "an effect of another arm": (
        changed(
            "model", "effects", 1, {"effect": "joint_offset", "where": {"joint": 9}, "parameters": {"offset_rad": 1}}
        ),
        "joint_offset:joint9: is of an arm of 9 joints or more, and this one has 6",
    ),
    "a negative variance": (changed("model", "uncertainty", "covariance", 5, -1.0), "a variance of its uncertainty is"),
    "a negative deviation": (changed("model", "uncertainty", "left", 0, -1.0), "Expected `float` >= 0.0"),
    "a mass too few": (changed("model", "inertia", "mass", lambda m: m[1:]), "center_of_mass has the shape"),
    "a negative error": (changed("after", "heldout_position_rms_m", -1.0), "`float` >= 0.0 - at `$.after"),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_diagnosis_is_refused(diagnosis, tmp_path, damage):
    spoil, says = DAMAGE[damage]
    content = copy.deepcopy(diagnosis)
    spoil(content)
    path = tmp_path / "d.json"
    path.write_text(json.dumps(content))
    said = refusal(read_model, path)
    assert said.startswith(f"{path}: ")
    assert says in said


def test_the_undamaged_diagnosis_is_read_without_a_word(diagnosis, tmp_path):
    model = read_model(write_document(diagnosis, tmp_path / "d.json"))
    assert model.dof == 6
    laid_out_anew = json.dumps(dict(reversed(json.loads((tmp_path / "d.json").read_text()).items())), indent=7)
    (tmp_path / "d.json").write_text(laid_out_anew)
    np.testing.assert_array_equal(read_model(tmp_path / "d.json").values, model.values)


@pytest.mark.parametrize("schema", ["lite6jax/diagnosis/1", "lite6jax/diagnosis/2", "lite6jax/diagnosis/4"])
def test_a_diagnosis_of_another_schema_is_to_be_made_again(diagnosis, tmp_path, capsys, schema):
    path = write_document(diagnosis | {"schema": schema}, tmp_path / "d.json")
    line = f"{path}: is a diagnosis of the schema {schema}, and {SCHEMA} is read; diagnose the recording again"
    assert refusal(read_model, path) == line
    out = tmp_path / "out.csv"
    for name, *more in (["report"], ["view"], ["convert", tmp_path / "arm.urdf"], ["predict", path, "--out", out]):
        assert refused(capsys, name, path, *more) == line


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("quality", 3, "fit: quality is"),
        ("checked_position_rms_m", -1.0, "fit: checked_position_rms_m is negative; correct it"),
        ("colour", "red", "fit has the unknown key 'colour'"),
    ],
)
def test_what_a_table_says_of_its_fit_is_checked(tmp_path, key, value, says):
    fit = {"result": "converged", "quality": "good", "checked_position_rms_m": 1e-9} | {key: value}
    path = write_table(LITE6.form, LITE6.hayati, tmp_path / "t.json", fit=fit)
    assert f"{path}: {says}" in refusal(read_table, path)


@pytest.mark.parametrize(
    ("edit", "says"),
    [
        (lambda row: row.update(alpha=1e6), "dh row 3: alpha is 1e+06 degrees, more than two turns; correct it"),
        (lambda row: row.update(a=1e9), "dh row 3: a is 1e+06 m, longer than any arm's link; correct it"),
    ],
)
def test_absurd_numbers_of_a_table_are_refused(tmp_path, edit, says):
    path = write_table(LITE6.form, LITE6.hayati, tmp_path / "t.json")
    content = json.loads(path.read_text())
    edit(content["dh"][2])
    path.write_text(json.dumps(content))
    assert refusal(read_table, path) == f"{path}: {says}"
