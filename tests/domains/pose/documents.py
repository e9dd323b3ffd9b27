"""Diagnosis files with known models, and what is refused of them."""

import json

import pytest
from diagnosis.recorded import GRAVITY, LITE6, PAYLOAD_COM

from lite6jax.diagnosis.document import SCHEMA
from lite6jax.effects.serialization import effect_as_dict, parse_effect
from lite6jax.errors import InputError

OWN = '''
from dataclasses import dataclass
from typing import ClassVar, final

import jax.numpy as jnp

from lite6jax.effects.drivers import Driver
from lite6jax.effects.effect import Coordinate, JointEffect


@final
@dataclass(frozen=True)
class CableDrag(JointEffect):
    """δq = d·tanh(q)."""

    name: ClassVar[str] = "cable_drag"

    @property
    def coordinates(self):
        return (Coordinate("drag_rad", "rad", 1e-4),)

    @property
    def drivers(self):
        return (Driver("position", self.joint),)

    def angle(self, values, motion, loads):
        return values[0] * jnp.tanh(motion.joint_position[self.joint - 1])


EFFECTS = [CableDrag(joint) for joint in range(1, 7)]
'''


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


def refused(function, *arguments):
    with pytest.raises(InputError) as caught:
        function(*arguments)
    assert "\n" not in str(caught.value)
    return str(caught.value)
