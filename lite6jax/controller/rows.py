"""Reports of 250 Hz as rows of a recording: units, clock, duplicates, gaps and the convention of orientations."""

from collections.abc import Mapping
from functools import partial
from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.array_types import Array
from lite6jax.controller import protocol
from lite6jax.controller.connection import SILENCE_S, Reports
from lite6jax.controller.station import Condition, Station
from lite6jax.recordings.checks import WINDOW, TorqueNoise

PERIOD_US = round(1e6 / protocol.RATES[protocol.REALTIME])
_STOPPED_CLOCK = 100
"""The number of consecutive reports with the same time after which the clock counts as stopped."""
_DISTINCT_RAD = 0.02
"""Two conventions of orientation are distinguished by a larger difference of their errors."""
_IMPLAUSIBLE_RAD = 0.05
"""A convention with a larger error relative to the chain is rejected; assembly tolerances are smaller."""
_CONVENTIONS = {"roll pitch yaw": partial(Rotation.from_euler, "xyz"), "a rotation vector": Rotation.from_rotvec}
_FIELDS = {
    "joint_position": ("q{}_rad", "measured, encoders"),
    "joint_velocity": ("dq{}_rad_per_s", "measured, encoders"),
    "torque": ("tau{}_Nm", "estimated by the controller"),
    "current": ("current{}_A", "measured"),
    "target_position": ("cmd{}_rad", "commanded, the controller's target"),
}
"""Of each field of a report with a number per joint, the columns and their source."""

SOURCES: Mapping[str, str] = {
    "time_s": "controller's clock",
    **{pattern.format(i): source for pattern, source in _FIELDS.values() for i in range(1, 8)},
    **{f"temp{i}_degC": "measured, at 5 Hz" for i in range(1, 8)},
    "payload_kg": "as set",
    "run": "counts connections, and jumps of the clock",
    "missing": "reports missing before the row",
    "gap": "why they are, or why a run starts",
    **dict.fromkeys(("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"), "computed by the controller, from measured joints"),
}
"""The source of each column."""


class Rows:
    """Converts reports to columns, in order and without duplicates.

    The clock of the controller is continuous within a run. Where it is set back or jumps, a run starts, and the time of
    the recording goes on by what passed on this computer.

    Attributes:
        condition: of the last 5 Hz report, or None; the caller updates it.
        lost: the reason why the last connection ended; the caller updates it.
        seconds: the duration by the controller's clock, or None.
        complete: whether the duration is reached.
        stopped: why no further rows can come; empty while they can.
        count, run, time: the number of rows, and the run and the time in s of the last one.
        gaps: the number of gaps: missing reports between two rows, or the start of a run.
        missing_within, missing_between: the number of missing reports within and between runs.
        repeated: the number of duplicate reports.
        names: the columns, after the first row.
    """

    def __init__(self, station: Station, seconds: float | None = None) -> None:
        self.condition: Condition | None = station.condition
        self.lost = ""
        self.seconds = seconds
        self.complete = False
        self.stopped = ""
        self.count = self.repeated = self.run = 0
        self.time = 0.0
        self.gaps = self.missing_within = self.missing_between = 0
        self.names: tuple[str, ...] = ()
        self._dof = station.arm.dof
        self._has_condition = station.condition is not None  # whether there are columns of the 5 Hz report
        self._warms = station.condition is not None and station.condition.temperature is not None
        rows = station.arm.kinematics if station.calibration is None else station.calibration.kinematics
        self._links = frames.transform_from_row(rows)
        self._tool = np.eye(4) if station.condition is None else station.condition.T_flange_tool
        self._convention: str | None = None  # of orientations; empty if none fits the chain
        self._certain = False
        self._torque_noise = TorqueNoise()
        self._window = np.zeros((0, 2, protocol.JOINTS))
        self._connection = self._clock = self._time_us = 0  # the clock in µs, of the last row
        self._heard = 0.0
        self._steps = self._elapsed_us = 0
        self._still = self._set_back = self._jumped = self._not_finite = 0
        self._first_run = (0.0, 0.0, 0.0)  # when its first and its last row were heard, and the time of the last, s

    @property
    def missing(self) -> int:
        """The number of missing reports within and between runs."""
        return self.missing_within + self.missing_between

    @property
    def torques_computed(self) -> bool:
        """Tells whether the torques have no noise, as those of the controller's own model."""
        return self._torque_noise.absent

    @property
    def rate(self) -> float:
        """Hz, the rate of rows within runs, by the controller's clock."""
        if self._elapsed_us:
            return 1e6 * self._steps / self._elapsed_us
        return 0.0

    def take(self, event: Reports) -> dict[str, NDArray] | None:
        """The columns of new reports; None if all are duplicates."""
        parts = []
        for length, group in groupby(event.reports, len):
            reports = np.frombuffer(b"".join(group), protocol.report_layout(protocol.REALTIME, length))
            steps = np.diff(reports["time_us"].astype(np.int64))
            cuts = np.flatnonzero((steps < 0) | (steps > self._largest_step_us(event))) + 1
            parts += [self._continue(part, event) for part in np.split(reports, cuts)]
        parts = [part for part in parts if part is not None]
        if not parts:
            return None
        return {name: np.concatenate([part[name] for part in parts]) for name in self.names}

    def _largest_step_us(self, event: Reports) -> float:
        """µs between two reports beyond which the clock has jumped, as a silent connection would have been closed.

        A connection that was lost for longer leaves a step as long as it lasted, at the rate of the controller's clock.
        """
        first, last, time = self._first_run
        rate = max(1.0, time / (last - first)) if last > first else 1.0
        return 1e6 * (SILENCE_S + 2 * rate * (event.heard - self._heard if self.count else 0.0))

    def _continue(self, reports: NDArray, event: Reports) -> dict[str, NDArray] | None:
        """The columns of reports with a continuous clock; None if all are duplicates or too late."""
        clock = reports["time_us"].astype(np.int64)
        elapsed = clock - clock[0]
        reconnected = event.connection != self._connection
        step = int(clock[0]) - self._clock if self.count else 0
        continuous = 0 <= step <= self._largest_step_us(event)
        new = np.diff(elapsed, prepend=-1) > 0
        if self.count and step == 0:
            new[0] = False
        self.repeated += int((~new).sum())
        self._still = len(new) - 1 - int(np.flatnonzero(new)[-1]) if new.any() else self._still + len(new)
        if self._still > _STOPPED_CLOCK:
            self.stopped = (
                f"port {protocol.REALTIME}: the controller's clock has stopped at {int(clock[-1])} µs; update the"
                " firmware"
            )
        pause = max(PERIOD_US, round(1e6 * (event.heard - self._heard)) if reconnected else PERIOD_US)
        time_us = elapsed + (self._time_us + (step if continuous else pause) if self.count else 0)
        if self.seconds is not None:
            late = time_us / 1e6 >= self.seconds - 1e-9
            self.complete = self.complete or bool(late.any())
            new &= ~late
        if not new.any():
            return None
        reports = reports[new]
        time_us = time_us[new]
        steps = np.diff(time_us, prepend=self._time_us)
        missing = np.maximum(np.rint(steps / PERIOD_US).astype(np.int64), 1) - 1
        gap = np.full(len(missing), None, object)
        gap[missing > 0] = "reports not received"
        reasons = []
        if self.count and reconnected:
            reasons.append(f"connection lost ({self.lost})" if self.lost else "new connection")
        if self.count and not continuous:
            how = "was set back" if step < 0 else "jumped"
            reasons.append(f"the controller's clock {how} by {abs(step) / 1e6:.6g} s")
            self._set_back = self._set_back + (step < 0)
            self._jumped = self._jumped + (step > 0)
        if reasons:
            gap[0] = "; ".join(reasons)
            self.run += 1
            self._window = self._window[:0]
        between = int(missing[0]) if reasons else 0
        self.gaps += int(gap.astype(bool).sum())
        self.missing_between += between
        self.missing_within += int(missing.sum()) - between
        within = steps[1:] if reasons or not self.count else steps
        self._steps, self._elapsed_us = self._steps + len(within), self._elapsed_us + int(within.sum())
        if self.run == 0:
            first = self._first_run[0] if self.count else event.heard
            self._first_run = (first, event.heard, time_us[-1] / 1e6)
        self._connection = event.connection
        self._heard = event.heard
        self._clock = int(clock[new][-1])
        self.count += len(time_us)
        self._time_us = int(time_us[-1])
        self.time = self._time_us / 1e6
        table = self._convert(reports, time_us / 1e6) | {"missing": missing, "gap": gap}
        self.names = self.names or tuple(table)
        return table

    def _convert(self, reports: NDArray, time: Array) -> dict[str, NDArray]:
        """The columns of new reports, in SI units."""
        count = len(reports)
        joints = range(self._dof)
        table: dict[str, NDArray] = {"time_s": time}
        for name, (pattern, _) in _FIELDS.items():
            values = reports[name].astype(float)
            table |= {pattern.format(i + 1): values[:, i] for i in joints}
        if self._has_condition and self.condition is not None:
            if self._warms:
                degrees = self.condition.temperature
                table |= {
                    f"temp{i + 1}_degC": np.full(count, np.nan if degrees is None else degrees[i]) for i in joints
                }
            table["payload_kg"] = np.full(count, max(float(self.condition.payload[0]), 0.0))
        table["run"] = np.full(count, self.run)
        pose = reports["pose"].astype(float)
        table |= {f"{axis}_m": pose[:, i] / protocol.MM for i, axis in enumerate("xyz")}
        q = reports["joint_position"].astype(float)
        quaternions = self._read_orientations(q[:, : self._dof], pose[:, 3:])
        if quaternions is not None:
            table |= {name: quaternions[:, i] for i, name in enumerate(("qw", "qx", "qy", "qz"))}
        finite = np.isfinite(np.column_stack([values for name, values in table.items() if name != "run"]))
        self._not_finite += int((~finite.all(axis=1)).sum())
        # whole windows of consecutive rows show the noise of torques; the rest waits for the next ones
        self._window = np.concatenate([self._window, np.stack([q, reports["torque"].astype(float)], 1)])
        while len(self._window) >= WINDOW:
            self._torque_noise.add(self._window[:WINDOW, 0], self._window[:WINDOW, 1])
            self._window = self._window[WINDOW:]
        return table

    def _read_orientations(self, q: Array, numbers: Array) -> Array | None:
        """`(sample, 4)` quaternions, scalar first, or None if neither convention fits the orientation of the chain.

        The vendor calls the numbers rx ry rz on port 30000 without a definition. Whether they are roll pitch yaw or a
        rotation vector follows from the chain. At many poses, including the zero pose, both agree.
        """
        if self._convention == "":
            return None
        finite = np.logical_and.reduce(np.isfinite(np.hstack([numbers, q])), axis=1)
        safe = np.where(finite[:, None], numbers, 0.0)
        if not self._certain and finite.any():
            sampled = np.flatnonzero(finite)[:: max(1, int(finite.sum()) // 20)]
            expected = frames.chain(self._links, q[sampled]) @ self._tool
            measured = expected.copy()
            off = {}
            for name, read in _CONVENTIONS.items():
                measured[:, :3, :3] = read(safe[sampled]).as_matrix()
                off[name] = float(frames.compare_transforms(expected, measured)[1].max())
            convention = min(off, key=lambda name: off[name])
            if self._convention is None and not self.names and off[convention] > _IMPLAUSIBLE_RAD:
                self._convention = ""
                return None
            self._convention = convention
            self._certain = max(off.values()) - off[convention] > _DISTINCT_RAD
        quaternions = _CONVENTIONS[self._convention or "roll pitch yaw"](safe).as_quat(scalar_first=True)
        quaternions[~finite] = np.nan
        return quaternions

    def notes(self) -> tuple[str, ...]:
        """Remarks about the rows, one sentence each."""
        notes = []
        if self.torques_computed:
            notes.append(
                "the torques have no noise, not even at rest: the controller computes them from its own model, and they"
                " say nothing of friction or load that it does not know"
            )
        if self._convention == "":
            notes.append(
                "orientations are omitted: in both conventions they differ from the chain's by over 3°; check the tool"
            )
        elif self._certain:
            notes.append(
                f"the controller's orientations are {self._convention}: the other convention contradicts the chain"
            )
        if self._not_finite:
            notes.append(f"{self._not_finite} rows contain values that are not finite, as sent by the controller")
        for times, how in ((self._set_back, "was set back"), (self._jumped, "jumped")):
            if times:
                notes.append(f"the controller's clock {how} {times} times; each time starts a run")
        first, last, time = self._first_run
        if last - first > 5 and not 0.95 < time / (last - first) < 1.05:
            notes.append(f"the controller's clock runs {time / (last - first):.3g} times as fast as this one")
        return tuple(notes)
