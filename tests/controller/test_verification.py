"""The calibration beside the controller's own forward kinematics: the floor, the gate, tools shown and hidden."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from live import ARM, KINEMATICS, emulated, snapshot

from lite6jax.arms.factory import FactoryCalibration
from lite6jax.controller import sdk
from lite6jax.controller.sdk import FLOOR_M, GATE_M, verify
from lite6jax.emulator import Faults
from lite6jax.errors import InputError
from tests.oracles.chains import six_parameter_poses

TOOL = [10.0, -20.0, 150.0, 0.1, -0.2, 0.3]


def calibration(kinematics=KINEMATICS):
    return FactoryCalibration(np.array(kinematics), ARM, ARM.T_joint_flange, "arm")


def test_the_precision_floor_of_the_sdk():
    with emulated() as (controller, address):
        found = verify(calibration(), address, samples=1500)
        assert set(snapshot(controller).requests) == {1, 44}
    assert found.passed
    assert found.position.max() <= FLOOR_M
    assert found.position.mean() < 2e-8
    assert found.orientation.max() < 6e-7
    # joints that are rounded on the wire cost more than poses that are
    assert found.position_unrounded.max() < 1.6e-7
    np.testing.assert_allclose(found.position_unrounded.mean(), 3.4e-8, rtol=0.15)
    limits = ARM.joint_limits
    assert (found.joint_position >= limits[:, 0]).all()
    assert (found.joint_position <= limits[:, 1]).all()
    assert found.version == "6,9,LI1006,DL1000,v2.7.1"
    assert found.tool == "none"


def test_another_chain_does_not_pass():
    with emulated(faults=Faults(nominal_kinematics=True)) as (_, address):
        found = verify(calibration(), address, samples=60)
    assert not found.passed
    assert (found.hidden_tool, found.other_chain) == (None, "lite6")
    q = found.joint_position.astype(np.float32).astype(float)
    apart = six_parameter_poses(KINEMATICS, q)[:, :3, 3] - six_parameter_poses(ARM.kinematics, q)[:, :3, 3]
    np.testing.assert_allclose(found.position, np.linalg.norm(apart, axis=1), atol=2e-7)


def test_a_tool_is_taken_into_account():
    with emulated(tool=TOOL) as (_, address):
        found = verify(calibration(), address, samples=40)
    assert found.passed
    assert found.tool == "applied"
    np.testing.assert_allclose(found.condition.tool_offset, TOOL, atol=1e-5)
    assert found.tool_agrees[0] < GATE_M


def report_with(monkeypatch, tool):
    """Lets the slow report say another tool than the controller computes with."""
    read = sdk.read_condition
    changed = lambda address: replace(read(address), tool_offset=np.array(tool))  # noqa: E731
    monkeypatch.setattr(sdk, "read_condition", changed)


def test_a_tool_that_the_kinematics_leave_out_is_said(monkeypatch):
    report_with(monkeypatch, TOOL)
    with emulated() as (_, address):
        found = verify(calibration(), address, samples=20)
    assert found.passed
    assert found.tool == "omitted by the controller"


def test_a_tool_that_no_report_shows_is_found(monkeypatch):
    report_with(monkeypatch, np.zeros(6))
    with emulated(tool=TOOL) as (_, address):
        found = verify(calibration(), address, samples=50)
    assert not found.passed
    assert found.tool_agrees[0] > 0.1
    np.testing.assert_allclose(found.hidden_tool, TOOL, atol=1e-3)


@pytest.mark.parametrize(
    ("faults", "says"),
    [
        (Faults(error=22), "reports error 22, .*; clear the error"),
        (Faults(silent_reports=True), r"port 30002: no report within 0\.4 s; check"),
        (Faults(nan=frozenset({"kinematics"})), "gives a pose that is not finite"),
        (Faults(nan=frozenset({"reports"})), "joint position is not finite; restart"),
    ],
)
def test_what_cannot_be_verified_says_why(faults, says, monkeypatch):
    monkeypatch.setattr(sdk, "read_condition", partial(sdk.read_condition, seconds=0.4))
    with emulated(faults=faults) as (_, address), pytest.raises(InputError, match=says) as error:
        verify(calibration(), address, samples=5)
    assert str(error.value).startswith(address.host)
