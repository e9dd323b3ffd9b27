"""The wire protocol of the controller, as bytes and back, without a socket.

Sources: the vendor's "Private TCP protocol" and "TCP port data" (xArm-Developer/ufactory_docs), and the bytes that
xarm-python-sdk 1.18.4 sends and accepts, with which the tests compare. The numbers of headers are big-endian, floats
and int32 little-endian. Joint values are in rad, rad/s and N·m and always seven, those of the arm first.
"""

# ruff: noqa: F401 (the package is imported as a whole)

from lite6jax.controller.protocol.frames import (
    CONTROL_PORT,
    JOINTS,
    PRIVATE,
    PRIVATE_ALIVE,
    STANDARD,
    Frame,
    MalformedError,
    Register,
    Status,
    floats,
    read_floats,
    request,
    seven,
    take_frames,
)
from lite6jax.controller.protocol.poses import MM, axis_angle_of_wire_pose, transform_of_wire_pose, wire_pose
from lite6jax.controller.protocol.registers import (
    CALIBRATION_PAYLOAD,
    CALIBRATION_REPLY,
    MOTION_ENDED,
    MOTION_STARTED,
    TEXT,
    Calibration,
    Feedback,
    Identity,
    feedback,
    read_calibration,
    read_identity,
    read_serial_numbers,
    serial_numbers,
)
from lite6jax.controller.protocol.reports import (
    LENGTHS,
    LONGEST_REPORT,
    NORMAL,
    RATES,
    REAL,
    REALTIME,
    RICH,
    read_report,
    report_layout,
    state_of,
    take_reports,
)
