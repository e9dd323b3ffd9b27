"""The slow report: what it says of errors, tool, payload and mounting, and when it says nothing to rely on."""

import numpy as np
import pytest
from live import ARM, emulated

from lite6jax.controller import protocol
from lite6jax.controller.station import Station, parse_condition, read_condition
from lite6jax.emulator import Faults
from lite6jax.errors import InputError


def report(length=587, **fields):
    made = np.zeros((), protocol.report_layout(protocol.RICH, length))
    made["length"] = length
    made["gravity_direction"] = [0, 0, -1]
    for name, value in fields.items():
        made[name] = value
    return made.tobytes()


def settings(tmp_path, **fields):
    condition = parse_condition(report(**fields), "here")
    return Station(ARM, "lite6", None, condition, ()).sidecar_settings(tmp_path / "run.csv")


def test_an_emulated_arms_condition_is_read():
    with emulated(tool=[1, 2, 3, 0.1, 0.2, 0.3], payload=[0.7, 4, 5, 6], faults=Faults(warning=11)) as (_, address):
        condition = read_condition(address)
    np.testing.assert_allclose(condition.tool_offset, [1, 2, 3, 0.1, 0.2, 0.3], rtol=1e-6)
    np.testing.assert_allclose(condition.payload, [0.7, 4, 5, 6], rtol=1e-6)
    assert (condition.error, condition.warning) == (0, 11)
    assert condition.has_tool
    assert not condition.has_world
    assert condition.temperature.shape == (7,)


def test_an_arm_on_the_ceiling_and_its_payload_are_in_the_sidecar(tmp_path):
    made = settings(tmp_path, gravity_direction=[0, 0, 1], payload=[0.5, 10, 20, 30])
    np.testing.assert_allclose(made.gravity_m_per_s2, [0, 0, 9.81])
    np.testing.assert_allclose(made.payload_com_m, [0.01, 0.02, 0.03], rtol=1e-6)
    assert settings(tmp_path, gravity_direction=[0, 0, 0]).gravity_m_per_s2 == (0, 0, -9.81)  # never set
    assert settings(tmp_path, payload=[0, 10, 20, 30]).payload_com_m == (0, 0, 0)


def test_a_base_offset_makes_the_frame_unknown(tmp_path):
    assert settings(tmp_path, world_offset=[0, 0, 1, 0, 0, 0]).pose_frame == "unknown"
    assert settings(tmp_path).pose_frame == "base"
    assert settings(tmp_path).tool == "none"


def test_what_is_not_to_be_relied_on_is_refused():
    short = np.zeros((), protocol.report_layout(protocol.RICH, 133)).tobytes()
    with pytest.raises(InputError, match=r"here: reports of .* end before the tool offset; update the firmware"):
        parse_condition(short, "here")
    for name in ("tool_offset", "payload", "joint_position", "world_offset"):
        with pytest.raises(InputError, match=rf"{name.replace('_', ' ')} is not finite"):
            parse_condition(report(**{name: np.nan}), "here")
