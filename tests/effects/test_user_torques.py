"""Effects on torques that a user defines: checked when read, found, written, and read again with their file."""

import json
import re

import numpy as np
import pytest
from domains.torque.moved import recorded

from lite6jax.diagnosis.document import model_from_document
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.torque_diagnosis import diagnose_torques
from lite6jax.domains.predict import predict
from lite6jax.effects import user_effects
from lite6jax.effects.user_effects import load_effects
from lite6jax.errors import InputError

BLOCKS = re.findall(r"```python\n(.*?)```", user_effects.__doc__, re.DOTALL)
OWN = f"{BLOCKS[0].split('@final')[0]}\n{BLOCKS[2]}\nEFFECTS = [AirDrag(joint) for joint in range(1, 7)]\n"
"""The effect on torques that the documents show."""


def written(tmp_path, text=OWN):
    path = tmp_path / "mine.py"
    path.write_text(text)
    return path


def test_an_effect_of_ones_own_is_found_and_predicted(tmp_path):
    effects = load_effects(written(tmp_path))
    recording, arm = recorded(seed=1)
    speed = recording.velocities()[:, 1]
    torque = recording.torques().copy()
    torque[:, 1] += 0.5 * speed * np.abs(speed)
    dragged = recorded(seed=1, change=lambda _: torque)[0]
    found = diagnose_torques(dragged, arm, effects=effects, options=Options(folds=2))
    (finding,) = found.findings
    assert finding.effect == effects[1]
    (estimate,) = finding.parameters.values()
    assert abs(estimate.value - 0.5) < 4 * estimate.std < 0.2
    document = json.loads(json.dumps(found.to_dict()))
    with pytest.raises(
        InputError, match="its model has the effect 'air_drag', and the catalogue has none of this name"
    ):
        model_from_document(document)
    model = model_from_document(document, effects)
    np.testing.assert_allclose(predict(model, dragged), predict(found.model, dragged), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("speed * abs(speed)", "speed[:2]"), "AirDrag.* fails on a trial motion|could not"),
        (("return values[0]", "return 1.0 + values[0]"), "changes torques at zero"),
        (("return values[0]", "return values[0] ** 2"), "is not proportional to its coordinates"),
        (('"air_drag"', '"viscous_friction"'), "has the name of a built-in effect"),
        (("abs(speed)", "nothing"), "fails on a trial motion"),
        (("@final\n", ""), "is not final"),
    ],
)
def test_what_is_no_effect_on_torques(tmp_path, change, message):
    with pytest.raises(InputError, match=message):
        load_effects(written(tmp_path, OWN.replace(*change)))


def test_an_effect_of_a_joint_that_the_arm_lacks_is_refused(tmp_path):
    effects = load_effects(written(tmp_path, OWN.replace("range(1, 7)", "range(1, 8)")))
    with pytest.raises(InputError, match="acts at joint 7, but the arm has 6 joints; remove it from EFFECTS"):
        diagnose_torques(*recorded(seed=1), effects=effects)
