"""Reports of ports 30000 to 30003: their fields by name and offset, as bytes and back."""

from collections.abc import Iterator
from functools import cache

import numpy as np

from lite6jax.controller.protocol.frames import JOINTS, MalformedError

REALTIME, NORMAL, RICH, REAL = 30000, 30001, 30002, 30003
RATES = {REALTIME: 250.0, NORMAL: 5.0, RICH: 5.0, REAL: 100.0}
"""Hz of each report port."""

_U8, _U16, _U32, _U64, _F = "u1", ">u2", ">u4", ">u8", "<f4"
_COMMON = {
    "length": (0, _U32, ()),
    "state_mode": (4, _U8, ()),
    "commands": (5, _U16, ()),
    "joint_position": (7, _F, JOINTS),
    "pose": (35, _F, 6),
    "torque": (59, _F, JOINTS),
}
_NORMAL = _COMMON | {
    "brakes": (87, _U8, ()),
    "enabled": (88, _U8, ()),
    "error": (89, _U8, ()),
    "warning": (90, _U8, ()),
    "tool_offset": (91, _F, 6),
    "payload": (115, _F, 4),
    "collision_sensitivity": (131, _U8, ()),
    "teach_sensitivity": (132, _U8, ()),
    "gravity_direction": (133, _F, 3),
}
_FIELDS: dict[int, dict[str, tuple[int, str, int | tuple[()]]]] = {
    REALTIME: {
        "length": (0, _U32, ()),
        "time_us": (4, _U64, ()),
        "state_mode": (12, _U8, ()),
        "commands": (13, _U16, ()),
        "target_position": (32, _F, JOINTS),
        "target_velocity": (60, _F, JOINTS),
        "target_acceleration": (88, _F, JOINTS),
        "joint_position": (116, _F, JOINTS),
        "joint_velocity": (144, _F, JOINTS),
        "joint_acceleration": (172, _F, JOINTS),
        "current": (200, _F, JOINTS),
        "torque": (228, _F, JOINTS),
        "target_pose": (424, _F, 6),
        "target_pose_speed": (448, _F, 6),
        "pose": (472, _F, 6),
        "pose_speed": (496, _F, 6),
    },
    NORMAL: _NORMAL,
    RICH: _NORMAL
    | {
        "type": (145, _U8, ()),
        "dof": (146, _U8, ()),
        "master": (147, _U8, ()),
        "slave": (148, _U8, ()),
        "version": (151, "S30", ()),
        "pose_limits": (181, _F, 5),
        "joint_limits": (201, _F, 5),
        "turn_limits": (221, _F, 2),
        "servo_status": (229, _U8, 14),
        "temperature": (245, "i1", JOINTS),
        "pose_speed": (252, _F, ()),
        "joint_velocity": (256, _F, JOINTS),
        "counter": (284, _U32, ()),
        "world_offset": (288, _F, 6),
        "voltage": (341, _U16, JOINTS),
        "current": (355, _F, JOINTS),
        "axis_angle": (482, _F, 3),
    },
    REAL: _COMMON,
}
LENGTHS = {REALTIME: 784, NORMAL: 145, RICH: 587, REAL: 135}
"""Bytes of each report of firmware 2.7. Reports of other versions are longer or shorter; the first field is the length.

On port 30000 `joint_position`, `joint_velocity`, `joint_acceleration` and `pose` are the vendor's "actual" values, and
`target_…` the commanded ones. `pose_limits` and `joint_limits` of RICH are jerk, smallest and largest acceleration,
smallest and largest speed. `voltage` is in hundredths of a volt.
"""


@cache
def report_layout(port: int, length: int | None = None) -> np.dtype:
    """The fields of a report as a NumPy record type, by name and offset.

    `np.frombuffer(b"".join(reports), report_layout(port, length))` reads many reports of one length at once, and
    `np.zeros(count, report_layout(port))` is an array of reports to fill.

    Args:
        port: 30000 to 30003.
        length: bytes of the report; fields beyond are omitted. None for that of firmware 2.7.

    Raises:
        MalformedError: the length is too short for the fields that every report of the port has.
    """
    length = LENGTHS[port] if length is None else length
    fields = {}
    for name, (offset, kind, shape) in _FIELDS[port].items():
        dtype = np.dtype((kind, shape))
        if offset + dtype.itemsize <= length:
            fields[name] = (dtype, offset)
    if "torque" not in fields or (port == REALTIME and "pose" not in fields):
        raise MalformedError(f"a report of {length} bytes on port {port}; it has {LENGTHS[port]}")
    formats, offsets = zip(*fields.values(), strict=True)
    return np.dtype({"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": length})


LONGEST_REPORT = 4096
"""Bytes; a larger length field is invalid."""


def take_reports(received: bytearray) -> Iterator[bytes]:
    """Removes the complete reports from the start of `received` and yields them; an incomplete one remains.

    Raises:
        MalformedError: an invalid length field, so that the stream does not start with a report.
    """
    while len(received) >= 4:
        length = int.from_bytes(received[:4], "big")
        if not 4 < length <= LONGEST_REPORT:
            raise MalformedError(f"a report of {length} bytes")
        if len(received) < length:
            return
        report = bytes(received[:length])
        del received[:length]
        yield report


def read_report(port: int, report: bytes) -> np.void:
    """The fields of a report by name; `dtype.names` omits those beyond its length.

    Raises:
        MalformedError: too short, or of another length than its first field.
    """
    if len(report) < 4 or int.from_bytes(report[:4], "big") != len(report):
        raise MalformedError(f"a report of {len(report)} bytes with another length in its first field")
    return np.frombuffer(report, report_layout(port, len(report)))[0]


def state_of(state_mode: int | np.integer) -> tuple[int, int]:
    """State (1 moving, 2 ready, 3 paused, 4 stopped, 5 reset) and mode (0 position, 1 servo) of a report's byte."""
    return int(state_mode) & 0x0F, int(state_mode) >> 4
