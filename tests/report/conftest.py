"""Diagnoses that the tests of the report share, each made once."""

import diagnosed
import pytest
import torque_diagnosed

from lite6jax.effects.dynamic import CoulombFriction, ViscousFriction
from lite6jax.recordings.fault import DataFault

SPIKES = DataFault("torque_spikes", (7, 9), {"joints": [3], "count": 2})


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    """Makes recordings of an arm whose geometry is known."""
    return diagnosed.recording_maker(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="session")
def compliant(recorded):
    """Of a compliant arm; one rival is as good, one is not."""
    return diagnosed.diagnosed(*recorded(diagnosed.COMPLIANCE))


@pytest.fixture(scope="session")
def found(recorded):
    """A compliance that moves the point by less than the harmonic that was found after it."""
    return diagnosed.diagnosed(*recorded(diagnosed.COMPLIANCE, diagnosed.HARMONIC), outliers=(3, 5))


@pytest.fixture(scope="session")
def clean(recorded):
    return diagnosed.diagnosed(*recorded())


@pytest.fixture(scope="session")
def wavy(recorded):
    return diagnosed.wavy_arm(recorded)


@pytest.fixture(scope="session")
def motors():
    """Of an arm whose joint 2 has friction."""
    return torque_diagnosed.diagnosed(torque_diagnosed.recorded(), (ViscousFriction(2), CoulombFriction(2)), (SPIKES,))
