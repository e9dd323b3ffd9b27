"""Reports of 250 Hz as rows of a recording: units, clock, duplicates, gaps and the convention of orientations."""

from collections.abc import Mapping
from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.controller import protocol
from lite6jax.controller.condition import Condition
from lite6jax.controller.gaps import Gap, Gaps
from lite6jax.controller.station import Station
from lite6jax.controller.stream import SILENCE_S, Reports
from lite6jax.recordings.torque_source import WINDOW, TorqueNoise

Array = NDArray[np.floating]

PERIOD_US = round(1e6 / protocol.RATES[protocol.REALTIME])
_STOPPED_CLOCK = 100
"""The number of consecutive reports with the same time after which the clock counts as stopped."""
_DISTINCT_RAD = 0.02
"""Two conventions of orientation are distinguished by a larger difference of their errors."""
_IMPLAUSIBLE_RAD = 0.05
"""A convention with a larger error relative to the chain is rejected; assembly tolerances are smaller."""

SOURCES: Mapping[str, str] = {
    "time_s": "controller's clock",
    **{f"q{i}_rad": "measured, encoders" for i in range(1, 8)},
    **{f"dq{i}_rad_per_s": "measured, encoders" for i in range(1, 8)},
    **{f"tau{i}_Nm": "estimated by the controller" for i in range(1, 8)},
    **{f"current{i}_A": "measured" for i in range(1, 8)},
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
        gaps: the missing reports.
        repeated: the number of duplicate reports.
        names: the columns, after the first row.
    """

    def __init__(self, station: Station, seconds: float | None = None) -> None:
        self.condition: Condition | None = station.condition
        self.lost = ""
        self.seconds, self.complete, self.stopped = seconds, False, ""
        self.count = self.repeated = self.run = 0
        self.time = self.recent_rate = 0.0
        self.gaps = Gaps()
        self.names: tuple[str, ...] = ()
        self._torque_noise = TorqueNoise()
        self._window: list[Array] = []
        self._station = station
        rows = station.arm.kinematics if station.calibration is None else station.calibration.kinematics
        self._links = np.stack([frames.transform_from_row(row) for row in rows])
        self._payload = station.condition is not None
        self._temperature = station.condition is not None and station.condition.temperature is not None
        self._orientations: _Orientations | None = None
        self._connection = 0
        self._clock = 0  # µs, of the last row by the controller
        self._time_us = 0  # of the last row in the recording
        self._heard = 0.0
        self._steps = self._elapsed_us = 0
        self._still = self._set_back = self._jumped = self._not_finite = 0
        self._span = (0.0, 0.0, 0.0, 0.0)  # first and last time of the first connection, and when they were heard

    @property
    def missing(self) -> int:
        """The number of missing reports within and between runs."""
        return self.gaps.within + self.gaps.between

    @property
    def torques_computed(self) -> bool:
        """Whether the torques have no noise, as those of the controller's own model."""
        return self._torque_noise.absent

    @property
    def rate(self) -> float:
        """Hz, the rate of rows within runs."""
        return 1e6 * self._steps / self._elapsed_us if self._elapsed_us else 0.0

    def take(self, event: Reports) -> dict[str, NDArray] | None:
        """The columns of new reports; None if all are duplicates."""
        parts = []
        for length, same in groupby(event.reports, len):
            layout = protocol.report_layout(protocol.REALTIME, length)
            parts += self._segments(np.frombuffer(b"".join(same), layout), event)
        if not parts:
            return None
        columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        self.names = self.names or tuple(columns)
        return columns

    def _segments(self, reports: NDArray, event: Reports) -> list[dict[str, NDArray]]:
        """The columns of reports of equal length, cut where the clock is not continuous."""
        steps = np.diff(reports["time_us"].astype(np.uint64)).view(np.int64)  # modulo 2⁶⁴, which the clock may exceed
        cuts = np.flatnonzero((steps < 0) | (steps > self._largest_step_us(event))) + 1
        made = [self._columns(part, event) for part in np.split(reports, cuts)]
        return [columns for columns in made if columns is not None]

    def _largest_step_us(self, event: Reports) -> float:
        """µs between two reports beyond which the clock has jumped, as a silent connection would have been closed.

        A connection that was lost for longer leaves a step as long as it lasted, at the rate of the controller's clock.
        """
        began, ended, first, last = self._span
        rate = max(1.0, (ended - began) / (last - first)) if last > first else 1.0
        return 1e6 * (SILENCE_S + 2 * rate * (event.heard - self._heard if self.count else 0.0))

    def _columns(self, reports: NDArray, event: Reports) -> dict[str, NDArray] | None:
        clock = reports["time_us"].astype(np.uint64)
        elapsed = (clock - clock[0]).view(np.int64)
        new_connection = event.connection != self._connection
        step = int(clock[0]) - self._clock if self.count else 0
        onwards = step % 2**64  # as the clock counts
        continuous = onwards <= self._largest_step_us(event)
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
        paused = max(PERIOD_US, round(1e6 * (event.heard - self._heard)) if new_connection else PERIOD_US)
        start = self._time_us + (onwards if continuous else paused) if self.count else 0
        time_us = start + elapsed
        if self.seconds is not None:
            late = time_us / 1e6 >= self.seconds - 1e-9
            self.complete = self.complete or bool(late.any())
            new &= ~late
        if not new.any():
            return None
        run = self.run + bool(self.count and (new_connection or not continuous))
        gaps = self._gaps(np.diff(time_us[new], prepend=self._time_us), run, new_connection, 0 if continuous else step)
        if not self.count:
            self._span = (0.0, 0.0, event.heard, event.heard)
        if run != self.run:
            self._window.clear()
        self._account(time_us[new], run, event)
        self._clock = int(clock[new][-1])
        return self._table(reports[new], time_us[new] / 1e6, gaps)

    def _gaps(self, steps: NDArray[np.int64], run: int, new_connection: bool, jump: int) -> list[Gap]:
        """The gaps before rows with these steps in µs; `jump` is that of the clock before the first row, or zero."""
        missing = np.maximum(np.rint(steps / PERIOD_US).astype(np.int64), 1) - 1
        first = ""
        if self.count and run != self.run:
            reasons = [f"connection lost ({self.lost})" if self.lost else "new connection"] if new_connection else []
            if jump:
                how = "was set back" if jump < 0 else "jumped"
                reasons.append(f"the controller's clock {how} by {abs(jump) / 1e6:.6g} s")
                self._set_back, self._jumped = self._set_back + (jump < 0), self._jumped + (jump > 0)
            first = "; ".join(reasons)
        gaps = []
        for i in map(int, np.flatnonzero((missing > 0) | ((np.arange(len(missing)) == 0) & bool(first)))):
            reason = first if i == 0 and first else "reports not received"
            starts = bool(i == 0 and first)
            gaps.append(Gap(self.count + i + 1, run, int(missing[i]), float(steps[i]) / 1e6, reason, starts))
        return gaps

    def _account(self, time_us: NDArray[np.int64], run: int, event: Reports) -> None:
        """Updates the counts of rows, and the rates."""
        within = self.count and run == self.run
        steps = np.diff(time_us, prepend=self._time_us) if within else np.diff(time_us)
        self._steps += len(steps)
        self._elapsed_us += int(steps.sum())
        if len(steps):
            weight = min(1.0, len(steps) / 250)  # over about a second
            rate = 1e6 * len(steps) / max(int(steps.sum()), 1)
            self.recent_rate += (weight if self.recent_rate else 1.0) * (rate - self.recent_rate)
        self._connection, self._heard, self.run = event.connection, event.heard, run
        self.count += len(time_us)
        self._time_us = int(time_us[-1])
        self.time = self._time_us / 1e6
        if self.run == 0:
            self._span = (self._span[0], self.time, self._span[2], event.heard)

    def _table(self, reports: NDArray, time: Array, gaps: list[Gap]) -> dict[str, NDArray]:
        dof, count = self._station.arm.dof, len(reports)
        fields = {
            "q{}_rad": "joint_position",
            "dq{}_rad_per_s": "joint_velocity",
            "tau{}_Nm": "torque",
            "current{}_A": "current",
        }
        table: dict[str, NDArray] = {"time_s": time}
        self._observe_torques(np.stack([reports["joint_position"], reports["torque"]], 1).astype(float))
        for pattern, field in fields.items():
            values = reports[field].astype(float)
            table |= {pattern.format(i + 1): values[:, i] for i in range(dof)}
        if self.condition is not None:
            if self._temperature and self.condition.temperature is not None:
                table |= {f"temp{i + 1}_degC": np.full(count, self.condition.temperature[i]) for i in range(dof)}
            if self._payload:
                table["payload_kg"] = np.full(count, max(float(self.condition.payload[0]), 0.0))
        table["run"] = np.full(count, self.run)
        pose = reports["pose"].astype(float)
        table |= {f"{axis}_m": pose[:, i] / protocol.MM for i, axis in enumerate("xyz")}
        q = reports["joint_position"][:, :dof].astype(float)
        if self._orientations is None:
            self._orientations = _Orientations(self._links, self._station.T_flange_tool)
        quaternions = self._orientations.quaternions(q, pose[:, 3:])
        if quaternions is not None:
            table |= {name: quaternions[:, i] for i, name in enumerate(("qw", "qx", "qy", "qz"))}
        finite = np.isfinite(np.column_stack([values for name, values in table.items() if name != "run"]))
        self._not_finite += int((~finite.all(axis=1)).sum())
        table["missing"], table["gap"] = np.zeros(count, np.int64), np.full(count, None, object)
        for gap in gaps:
            self.gaps.add(gap)
            row = gap.row - 1 - (self.count - count)
            table["missing"][row], table["gap"][row] = gap.missing, gap.reason
        return table

    def _observe_torques(self, both: Array) -> None:
        """Whole windows of consecutive joint positions and torques `(row, 2, joint)`; the rest waits for the next."""
        both = np.concatenate([*self._window, both])
        whole = len(both) // WINDOW * WINDOW
        for start in range(0, whole, WINDOW):
            position, torque = np.swapaxes(both[start : start + WINDOW], 0, 1)
            self._torque_noise.add(position, torque)
        self._window = [both[whole:]]

    def notes(self) -> tuple[str, ...]:
        """Remarks about the rows, one sentence each."""
        notes = []
        if self.torques_computed:
            notes.append(
                "the torques have no noise, not even at rest: the controller computes them from its own model, and they"
                " say nothing of friction or load that it does not know"
            )
        if self._orientations is not None:
            notes += self._orientations.notes()
        if self._not_finite:
            notes.append(f"{self._not_finite} rows contain values that are not finite, as sent by the controller")
        for times, how in ((self._set_back, "was set back"), (self._jumped, "jumped")):
            if times:
                notes.append(f"the controller's clock {how} {times} times; each time starts a run")
        began, ended, first, last = self._span
        if last - first > 5 and not 0.95 < (ended - began) / (last - first) < 1.05:
            notes.append(
                f"the controller's clock runs {(ended - began) / (last - first):.3g} times as fast as this one"
            )
        return tuple(notes)


class _Orientations:
    """Interprets the three numbers of an orientation as roll pitch yaw or as a rotation vector, by the chain.

    The vendor calls them rx ry rz on port 30000 without a definition. At many poses, including the zero pose, both
    conventions agree.
    """

    def __init__(self, links: Array, T_flange_tool: Array) -> None:
        self._links, self._tool = links, T_flange_tool
        self._choice: str | None = None
        self._decided = False
        self._omitted = False

    def quaternions(self, q: Array, numbers: Array) -> Array | None:
        """`(sample, 4)` scalar first, or None if neither convention fits the orientation of the chain."""
        if self._omitted:
            return None
        finite = np.logical_and.reduce(np.isfinite(np.hstack([numbers, q])), axis=1)
        safe = np.where(finite[:, None], numbers, 0.0)
        conventions = {
            "roll pitch yaw": Rotation.from_euler("xyz", safe),
            "a rotation vector": Rotation.from_rotvec(safe),
        }
        if not self._decided and finite.any():
            some = np.flatnonzero(finite)[:: max(1, int(finite.sum()) // 20)]
            expected = (frames.chain(self._links, q[some]) @ self._tool)[:, :3, :3]
            off = {name: _largest_angle(expected, turns.as_matrix()[some]) for name, turns in conventions.items()}
            best = min(off, key=lambda name: off[name])
            if self._choice is None and off[best] > _IMPLAUSIBLE_RAD:
                self._omitted = True
                return None
            self._choice = best
            self._decided = max(off.values()) - off[best] > _DISTINCT_RAD
        choice = self._choice or "roll pitch yaw"
        quaternions = conventions[choice].as_quat(scalar_first=True)
        quaternions[~finite] = np.nan
        return quaternions

    def notes(self) -> list[str]:
        """The convention, once it is determined."""
        if self._omitted:
            return [
                "orientations are omitted: in both conventions they differ from the chain's by over 3°; check the tool"
            ]
        if not self._decided:
            return []
        return [f"the controller's orientations are {self._choice}: the other convention contradicts the chain"]


def _largest_angle(a: Array, b: Array) -> float:
    """rad, the largest angle between rotations `(sample, 3, 3)`."""
    chord = np.linalg.norm(a - b, axis=(1, 2))
    return float(2 * np.arcsin(np.clip(chord / np.sqrt(8), 0, 1)).max())
