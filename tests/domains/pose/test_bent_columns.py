"""Derivatives of poses about an arm that is deflected at every site, beside differences of its residuals."""

import jax.numpy as jnp
import numpy as np
import pytest

from lite6jax.arms.chains import SixParameterForm
from lite6jax.domains.pose.kinematics import bent_residual, site_columns
from lite6jax.effects.deflection import Deflection, dense
from lite6jax.model import arm_model
from lite6jax.sensors.pose import PoseSensor
from tests.oracles.arms import random_kinematics
from tests.oracles.transforms import displacement

DOF = 4
SAMPLES = 20
STEP = 1e-6
TWISTED = ("base", "link", "tool", "sensor")


@pytest.mark.parametrize("sliding", [(), (1,)])
@pytest.mark.parametrize("size", [0.0, 2e-3])
def test_they_are_exact_but_for_what_a_scale_and_a_stretch_do_to_each_other(sliding, size):
    rng = np.random.default_rng(5)
    model = arm_model(random_kinematics(rng, DOF).ravel(), displacement(rng.uniform(-0.3, 0.3, 6)))
    q = rng.uniform(-1.0, 1.0, (DOF, SAMPLES))
    bent = Deflection(*(size * rng.normal(size=part.shape) for part in dense(Deflection(), DOF, SAMPLES)))
    turned = np.moveaxis(np.tile(np.eye(3), (SAMPLES, 1, 1)), 0, -1)
    measured = PoseSensor(np.zeros((3, SAMPLES)), turned, np.ones(2))
    form = SixParameterForm(DOF, sliding)

    def residual(deflection):
        return np.asarray(bent_residual(form, model, jnp.asarray(q), deflection, measured))

    columns = site_columns(model, q, measured, sliding, bent)
    for (name, place, component), column in columns.items():
        part = np.zeros_like(getattr(bent, name))
        if name in TWISTED:
            (part[place] if name == "link" else part)[component] = STEP
        else:
            (part if name == "scale" else part[place])[:] = STEP
        more, less = (bent._replace(**{name: getattr(bent, name) + sign * part}) for sign in (1, -1))
        difference = (residual(more) - residual(less)) / (2 * STEP)
        exact = component > 2 and name in TWISTED
        error = np.linalg.norm(column - difference) / max(np.linalg.norm(difference), 1e-9)
        assert error < (1e-6 if exact or not size else 3 * size), (name, place, component)
