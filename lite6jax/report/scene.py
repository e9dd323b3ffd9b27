"""A diagnosis in space: the arm along a motion, errors as arrows or as colours of joints, findings at their places.

Arrays and sentences alone, in the frame of the arm's base; `viewer` shows them in a browser.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, final

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from lite6jax.arms.arm import Arm
from lite6jax.design.clearance import Capsule, chain_capsules, link_frames
from lite6jax.domains.pose.predict import DiagnosedArm, predict
from lite6jax.domains.torque.predict import DiagnosedMotors, predict_torques
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import Recording
from lite6jax.report import statements, torque_statements, worth
from lite6jax.report.data_faults import fault_name
from lite6jax.report.reference import origin_statement

Array = NDArray[np.floating]
Document = Mapping[str, Any]

MEDIAN_ARROW = 0.05
"""m, the length of the median arrow as it is drawn at first."""
MOST_ARROWS = 1000
"""Of a longer recording rows at even distances have one."""
WINDOW_S = 0.2
"""Over which the errors of torques are averaged: of single samples the colours would flicker."""
LEAST_LIMIT = 3.0
"""Times the noise, at which colours end at least."""
WITH, WITHOUT = "with the findings", "without the findings"


class Place(NamedTuple):
    """A finding and where it is.

    Attributes:
        number: its rank, from 1.
        title: such as "Joint compliance at joint2".
        statement: a sentence.
        size: what it moves, with its unit; empty where the document does not say.
        parts: of the arm as drawn, `joint2`, `link0` (the base) … or `tool`; none where it is not on the arm.
    """

    number: int
    title: str
    statement: str
    size: str
    parts: tuple[str, ...]


@final
@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Measured against predicted positions.

    Attributes:
        caption: of which prediction.
        predicted: `T_base_tool` `(sample, 4, 4)`, NaN where nothing is predicted.
        error: `(sample, 3)` m, by which the measured point is off the predicted one, along the base's axes.
    """

    caption: str
    predicted: Array
    error: Array

    @cached_property
    def length(self) -> Array:
        """`(sample,)` m."""
        return np.linalg.norm(self.error, axis=1)

    @property
    def median(self) -> float:
        """m; 0 where nothing is predicted."""
        there = self.length[np.isfinite(self.length)]
        return float(np.median(there)) if there.size else 0.0

    @property
    def scale(self) -> float:
        """By which errors are multiplied so that the median arrow is `MEDIAN_ARROW` long, to two digits."""
        return float(f"{MEDIAN_ARROW / self.median:.2g}") if self.median else 1.0

    @cached_property
    def shown(self) -> NDArray[np.integer]:
        """The samples that have an arrow."""
        there = np.flatnonzero(np.isfinite(self.length))
        return there[np.unique(np.linspace(0, len(there) - 1, min(MOST_ARROWS, len(there))).astype(int))]

    def arrows(self, scale: float, samples: "NDArray[np.integer] | Sequence[int] | None" = None) -> Array:
        """Ends `(arrow, 2, 3)` m, from where the point is predicted to where it is measured, enlarged by `scale`.

        Args:
            scale: of the errors.
            samples: those that have an arrow; `shown` where not given.
        """
        rows = self.shown if samples is None else samples
        start = self.predicted[rows, :3, 3]
        return np.stack([start, start + scale * self.error[rows]], 1)


@final
@dataclass(frozen=True, eq=False)
class TorqueErrors:
    """Measured against predicted torques.

    Attributes:
        caption: of which prediction.
        over_noise: `(sample, joint)`, errors over the standard deviation of each joint's noise, RMS over `WINDOW_S`.
    """

    caption: str
    over_noise: Array

    @property
    def limit(self) -> float:
        """At which colours end: what a twentieth of all samples exceeds at the worst joint."""
        worst = self.over_noise.max(axis=1)
        return max(LEAST_LIMIT, float(f"{np.quantile(worst, 0.95):.2g}"))

    def colours(self, sample: int, limit: float) -> NDArray[np.uint8]:
        """`(joint, 3)` red, green, blue from 0 to 255: dark blue without error, yellow from `limit` on."""
        return shades(self.over_noise[sample] / limit)


@final
@dataclass(frozen=True, eq=False)
class Scene:
    """All that is shown.

    Attributes:
        arm: its chain, as identified.
        headline: the cause and its worth.
        remarks: what qualifies the picture, a sentence each.
        findings: ranked.
        capsules: of the links, in their frames; link 0 is the base.
        frames: `T_base_link` `(sample, link, 4, 4)`, of the base and after each joint.
        row: `(sample,)`, in the recording's file, from 1.
        time: `(sample,)` s, or None.
        moving: whether the arm moved on from row to row.
        orientation: `(sample, 3, 3)` of the measured tool in the base's frame, or None.
        poses: errors of each prediction; none of torques.
        torques: the same of torques; none of poses.
    """

    arm: Arm
    headline: str
    remarks: tuple[str, ...]
    findings: tuple[Place, ...]
    capsules: tuple[Capsule, ...]
    frames: Array
    row: NDArray[np.integer]
    time: Array | None
    moving: bool
    orientation: Array | None = None
    poses: tuple[PoseErrors, ...] = ()
    torques: tuple[TorqueErrors, ...] = ()

    @property
    def samples(self) -> int:
        """Rows."""
        return len(self.row)

    @property
    def step(self) -> float:
        """Seconds from row to row of a moving arm; 1 where that is not known."""
        steps = np.diff(self.time) if self.moving and self.time is not None else np.zeros(0)
        return float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0

    def marked(self, numbers: Sequence[int] | None = None) -> dict[str, list[int]]:
        """Part of the arm to the numbers of the findings there.

        Args:
            numbers: of the findings that count; all where not given.
        """
        found: dict[str, list[int]] = {}
        for place in self.findings:
            if numbers is None or place.number in numbers:
                for part in place.parts:
                    found.setdefault(part, []).append(place.number)
        return found


def shades(share: Array) -> NDArray[np.uint8]:
    """Colours `(…, 3)` of shares from 0 to 1 that differ to colour-blind eyes and in grey: cividis."""
    return (255 * mpl.colormaps["cividis"](np.clip(share, 0, 1))[..., :3]).round().astype(np.uint8)


def pose_scene(document: Document, model: DiagnosedArm, recording: Recording) -> Scene:
    """A diagnosis of poses beside a recording.

    Args:
        document: as in its file.
        model: in it.
        recording: the diagnosed one or another of the same set-up; without poses there are no errors.

    Raises:
        InputError: as `predict`.
    """
    arm = Arm(model.arm, np.asarray(model.model.geometry).reshape(-1, 6))
    tool = np.asarray(model.model.T_flange_tool)
    T_base_sensor = np.linalg.inv(np.asarray(model.model.T_sensor_base))
    errors, orientation = (), None
    if recording.position is not None:
        measured = recording.position @ T_base_sensor[:3, :3].T + T_base_sensor[:3, 3]
        errors = tuple(
            PoseErrors(caption, predicted, measured - predicted[:, :3, 3])
            for caption, predicted in _predictions(model, recording, T_base_sensor)
        )
    if recording.quaternion is not None:
        turned = Rotation.from_quat(recording.quaternion, scalar_first=True).as_matrix()
        orientation = T_base_sensor[:3, :3] @ turned
    capsules = tuple(chain_capsules(arm, tool_point=tool[:3, 3]))
    remarks = [] if model.reference is None else [str(origin_statement(model.reference))]
    if recording.position is None:
        remarks.append("The recording has no measured poses: only the motion is shown.")
    return Scene(
        arm=arm,
        headline=worth.headline(document),
        remarks=(*remarks, *_faults(document)),
        findings=_places(document, statements.findings_of(document), capsules),
        capsules=capsules,
        frames=_frames(arm, recording),
        row=recording.row,
        time=recording.time,
        moving=recording.motion == "trajectory",
        orientation=orientation,
        poses=errors,
    )


def torque_scene(document: Document, model: DiagnosedMotors, recording: Recording) -> Scene:
    """A diagnosis of torques beside a recording of torques.

    Args:
        document: that of the torques alone.
        model: in it.
        recording: the diagnosed one or another of the same arm.

    Raises:
        InputError: as `predict_torques`, or it has no torques.
    """
    measured, noise = recording.torques(), np.array(document["noise"]["estimated_torque_Nm"])
    models = [(WITH, model), (WITHOUT, replace(model, terms=Terms(), values=np.zeros(0)))]
    samples = _window(recording.time)
    errors = tuple(
        TorqueErrors(caption, _averaged((measured - predict_torques(each, recording)) / noise, samples))
        for caption, each in models[: 2 if model.terms.terms else 1]
    )
    capsules = tuple(chain_capsules(model.arm))
    return Scene(
        arm=model.arm,
        headline=worth.headline(document),
        remarks=tuple(_faults(document)),
        findings=_places(document, torque_statements.findings_of(document), capsules),
        capsules=capsules,
        frames=_frames(model.arm, recording),
        row=recording.row,
        time=recording.time,
        moving=True,
        torques=errors,
    )


def _predictions(model: DiagnosedArm, recording: Recording, T_base_sensor: Array) -> Iterator[tuple[str, Array]]:
    yield WITH, T_base_sensor @ predict(model, recording)
    if model.physics.effects:
        yield WITHOUT, T_base_sensor @ predict(model.keeping([False] * len(model.physics.effects)), recording)


def _frames(arm: Arm, recording: Recording) -> Array:
    frames = np.zeros((recording.samples, arm.dof + 1, 4, 4))
    frames[:, 0], frames[:, :, 3, 3] = np.eye(4), 1.0
    frames[:, 1:, :3] = np.moveaxis(link_frames(arm, recording.joint_position)[:-1], (0, 3), (1, 0))
    return frames


def _places(
    document: Document, findings: Sequence[Mapping[str, Any]], capsules: Sequence[Capsule]
) -> tuple[Place, ...]:
    links = [capsule.link for capsule in capsules]
    places = []
    for number, finding in enumerate(findings, 1):
        size = worth.moves_size(document, finding)
        places.append(Place(number, finding["title"], finding["statement"], size, _parts(finding["site"], links)))
    return tuple(places)


def _parts(site: str, links: Sequence[int]) -> tuple[str, ...]:
    """Of a site, what is drawn of it; a link without length is the joint before it."""
    if site == "links":
        return tuple(f"link{link}" for link in links if link)
    if site in ("tool", "payload"):
        return ("tool",)
    match = re.fullmatch(r"(joint|link)(\d+)", "link0" if site == "base" else site)
    if match is None:  # the sensor, the clock
        return ()
    number = int(match[2])
    return (site if match[1] == "joint" else f"link{number}" if number in links else f"joint{max(number, 1)}",)


def _faults(document: Document) -> Iterator[str]:
    names = list(dict.fromkeys(fault_name(entry["fault"]).lower() for entry in document["data_faults"]))
    if names:
        yield f"The file is shown as it is. For the diagnosis these were corrected or weighted: {', '.join(names)}."


def _window(time: Array | None) -> int:
    assert time is not None  # torques are predicted of a motion with times
    steps = np.diff(time)
    return max(1, round(WINDOW_S / float(np.median(steps[steps > 0]))))


def _averaged(errors: Array, samples: int) -> Array:
    return np.sqrt(uniform_filter1d(errors**2, samples, axis=0, mode="nearest"))
