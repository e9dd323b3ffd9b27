"""Diagnosis files with known models."""

import json

from diagnosis.recorded import GRAVITY, LITE6, PAYLOAD_COM

from lite6jax.diagnosis.document import SCHEMA
from lite6jax.effects import user_effects
from lite6jax.effects.serialization import effect_as_dict, parse_effect

OWN = user_effects.__doc__.split("```python\n")[1].split("```")[0]
"""The file of effects that the documents show: δq = d·tanh(q)."""


def document(made, texts, motion="static", orientation=True):
    """The file that a diagnosis that found exactly the truth would be."""
    return {
        "schema": SCHEMA,
        "model": {
            "arm": "lite6",
            "kinematics": made.kinematics.tolist(),
            "T_sensor_base": made.T_sensor_base.tolist(),
            "T_flange_tool": made.T_flange_tool.tolist(),
            "joint_limits": LITE6.joint_limits.tolist(),
            "orientation": orientation,
            "inertia": {
                "mass": LITE6.mass.tolist(),
                "center_of_mass": LITE6.center_of_mass.tolist(),
                "payload_center": list(PAYLOAD_COM),
                "gravity": list(GRAVITY),
            },
            "reference_temperature_degC": 25.0,
            "motion": motion,
            "effects": [effect_as_dict(*parse_effect(text)) for text in texts],
        },
    }


def stored(folder, content, name="diagnosis.json"):
    path = folder / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path
