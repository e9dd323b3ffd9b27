"""A diagnosis in space, in a browser by viser: the arm along a motion, errors as arrows or colours, findings in place.

A `Scene` is arrays and sentences alone, in the frame of the arm's base; `served` shows one.
"""

import html
import re
import socket
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, final

import matplotlib as mpl
import numpy as np
import rich
from matplotlib.colors import to_rgb
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from lite6jax.arms.arm import Arm
from lite6jax.array_types import Array, Integers
from lite6jax.design.candidates import Capsule, chain_capsules, link_frames
from lite6jax.domains.pose.predict import DiagnosedArm
from lite6jax.domains.predict import predict
from lite6jax.domains.torque.predict import DiagnosedMotors
from lite6jax.domains.tracking.predict import DiagnosedServos
from lite6jax.errors import InputError
from lite6jax.estimation.terms import Terms
from lite6jax.formatting import number
from lite6jax.recordings import Recording
from lite6jax.recordings.sequence import spread_rows
from lite6jax.report import ranking, statements, tracking
from lite6jax.report.faults import fault_name
from lite6jax.report.figures import AFTER, BEFORE

if TYPE_CHECKING:
    from viser import ViserServer

Document = Mapping[str, Any]

MEDIAN_ARROW = 0.05
"""m, the length of the median arrow as it is drawn at first."""
MOST_ARROWS = 1000
"""Of a longer recording rows at even distances have one."""
WINDOW_S = 0.2
"""Over which the errors of joints are averaged: of single samples the colours would flicker."""
PLAIN_REACH = 0.5
"""m, of which a chain without lengths is drawn: axes that all meet."""
LEAST_LIMIT = 3.0
"""Times the noise, at which colours end at least."""
WITH = "with the findings"
WITHOUT = "without the findings"


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
        finite_lengths = self.length[np.isfinite(self.length)]
        if finite_lengths.size:
            return float(np.median(finite_lengths))
        return 0.0

    @property
    def scale(self) -> float:
        """By which errors are multiplied so that the median arrow is `MEDIAN_ARROW` long, to two digits."""
        if self.median:
            return float(f"{MEDIAN_ARROW / self.median:.2g}")
        return 1.0

    @cached_property
    def shown(self) -> Integers:
        """The samples that have an arrow."""
        predicted_samples = np.flatnonzero(np.isfinite(self.length))
        return predicted_samples[spread_rows(len(predicted_samples), MOST_ARROWS)]

    def arrows(self, scale: float, samples: "Integers | Sequence[int] | None" = None) -> Array:
        """Ends `(arrow, 2, 3)` m, from predicted to measured, of some samples or of `shown`."""
        rows = self.shown if samples is None else samples
        start = self.predicted[rows, :3, 3]
        return np.stack([start, start + scale * self.error[rows]], 1)


@final
@dataclass(frozen=True, eq=False)
class JointErrors:
    """Measured against predicted torques, or angles of joints that follow commands.

    Attributes:
        caption: of which prediction.
        quantity: what was measured, in words.
        over_noise: `(sample, joint)`, errors over the standard deviation of each joint's noise, RMS over `WINDOW_S`.
    """

    caption: str
    quantity: str
    over_noise: Array

    @property
    def limit(self) -> float:
        """At which colours end: what a twentieth of all samples exceeds at the worst joint."""
        worst = self.over_noise.max(axis=1)
        return max(LEAST_LIMIT, float(f"{np.nanquantile(worst, 0.95):.2g}"))

    def colours(self, sample: int, limit: float) -> NDArray[np.uint8]:
        """`(joint, 3)` red, green, blue from 0 to 255: dark blue without error, yellow from `limit` on."""
        return shades(np.nan_to_num(self.over_noise[sample]) / limit)


@final
@dataclass(frozen=True, eq=False)
class Scene:
    """All that is shown.

    Attributes:
        arm: its chain, as identified.
        headline: the cause and its worth.
        remarks: what qualifies the picture, a sentence each.
        findings: as `statements.findings_of` gives them, with `parts` of the arm as drawn: `joint2`, `link0` (the base)
            … or `tool`; none of what is not on the arm.
        capsules: of the links, in their frames; link 0 is the base.
        frames: `T_base_link` `(sample, link, 4, 4)`, of the base and after each joint.
        row: `(sample,)`, in the recording's file, from 1.
        time: `(sample,)` s, or None.
        moving: whether the arm moved on from row to row.
        orientation: `(sample, 3, 3)` of the measured tool in the base's frame, or None.
        poses: errors of each prediction of poses, else none.
        joints: errors of each prediction of torques or of angles, else none.
    """

    arm: Arm
    headline: str
    remarks: tuple[str, ...]
    findings: tuple[Document, ...]
    capsules: tuple[Capsule, ...]
    frames: Array
    row: Integers
    time: Array | None
    moving: bool
    orientation: Array | None = None
    poses: tuple[PoseErrors, ...] = ()
    joints: tuple[JointErrors, ...] = ()

    @property
    def samples(self) -> int:
        """Rows."""
        return len(self.row)

    @property
    def errors(self) -> "Sequence[PoseErrors | JointErrors]":
        """Those of poses or of joints; none of a motion alone."""
        return self.poses or self.joints

    @property
    def step(self) -> float:
        """Seconds from row to row of a moving arm; 1 where that is not known."""
        steps = np.diff(self.time) if self.moving and self.time is not None else np.zeros(0)
        if (steps > 0).any():
            return float(np.median(steps[steps > 0]))
        return 1.0

    def marked(self) -> dict[str, list[int]]:
        """Part of the arm to the numbers of the findings there."""
        parts = dict.fromkeys(part for finding in self.findings for part in finding["parts"])
        return {part: [finding["rank"] for finding in self.findings if part in finding["parts"]] for part in parts}


def shades(share: Array) -> NDArray[np.uint8]:
    """Colours `(…, 3)` of shares from 0 to 1 that differ to colour-blind eyes and in grey: cividis."""
    return (255 * mpl.colormaps["cividis"](np.clip(share, 0, 1))[..., :3]).round().astype(np.uint8)


def pose_scene(document: Document, model: DiagnosedArm, recording: Recording) -> Scene:
    """A diagnosis of poses beside its recording or another of the same set-up; without poses there are no errors.

    Raises:
        InputError: as `predict`.
    """
    arm = Arm(model.arm, np.asarray(model.model.geometry).reshape(-1, 6))
    T_base_sensor = np.linalg.inv(np.asarray(model.model.T_sensor_base))
    models = [(WITH, model)]
    errors = ()
    orientation = None
    if effects := model.physics.effects:
        models.append((WITHOUT, model.keeping([False] * len(effects))))
    if recording.position is not None:
        measured = recording.position @ T_base_sensor[:3, :3].T + T_base_sensor[:3, 3]
        predicted = [(caption, T_base_sensor @ predict(variant, recording)) for caption, variant in models]
        errors = tuple(PoseErrors(caption, poses, measured - poses[:, :3, 3]) for caption, poses in predicted)
    if recording.quaternion is not None:
        turned = Rotation.from_quat(recording.quaternion, scalar_first=True).as_matrix()
        orientation = T_base_sensor[:3, :3] @ turned
    origin = model.reference
    remarks = []
    if origin is not None:
        remarks = [statements.model_statement(origin.file, origin.basis)]
    if recording.position is None:
        remarks.append("The recording has no measured poses: only the motion is shown.")
    capsules = chain_capsules(arm, tool_point=np.asarray(model.model.T_flange_tool)[:3, 3])
    shown = model.correct_zeros(recording)
    scene = _scene(document, arm, shown, capsules, ranking.headline(document), statements.findings_of(document))
    remarks = (*remarks, *scene.remarks)
    moving = recording.motion == "trajectory"
    return replace(scene, remarks=remarks, moving=moving, orientation=orientation, poses=errors)


def joint_scene(document: Document, model: DiagnosedMotors | DiagnosedServos, recording: Recording) -> Scene:
    """A diagnosis of torques or of commands, its own document, beside its recording or another of the same arm.

    Raises:
        InputError: as `predict`, or the recording has no torques.
    """
    estimated = document["noise"]["estimated"]
    if isinstance(model, DiagnosedServos):
        quantity = "angle"
        measured = recording.joint_position
        noise = np.array(estimated["joint_rad"])
        headline = tracking.headline(document)
        findings = tracking.findings_of(document)
    else:
        quantity = "torque"
        measured = recording.torques()
        noise = np.array(estimated["torque_Nm"])
        headline = ranking.headline(document)
        findings = statements.findings_of(document)
    models = [(WITH, model)]
    if model.terms.terms:
        models.append((WITHOUT, replace(model, terms=Terms(), values=np.zeros(0))))
    # what is predicted of joints has times
    steps = np.diff(np.asarray(recording.time))
    window = max(1, round(WINDOW_S / float(np.median(steps[steps > 0]))))

    average = partial(uniform_filter1d, size=window, axis=0, mode="nearest")

    def averaged(predicted: Array) -> Array:
        errors = (measured - predicted) / noise
        finite = np.isfinite(errors)  # in long gaps of uneven times nothing is predicted
        squares = average(np.where(finite, errors**2, 0.0))
        share = average(1.0 * finite)
        return np.sqrt(np.where(finite, squares / np.maximum(share, 1e-9), np.nan))

    errors = tuple(
        JointErrors(caption, quantity, averaged(predict(alternative, recording))) for caption, alternative in models
    )
    scene = _scene(document, model.arm, recording, chain_capsules(model.arm), headline, findings)
    return replace(scene, joints=errors)


def _scene(
    document: Document,
    arm: Arm,
    recording: Recording,
    capsules: Sequence[Capsule],
    headline: str,
    findings: Sequence[Document],
) -> Scene:
    """The arm along the motion, with the findings; errors, and what else is to be remarked, are added to it."""
    frames = np.zeros((recording.samples, arm.dof + 1, 4, 4))
    frames[:, 0] = np.eye(4)
    frames[:, :, 3, 3] = 1.0
    frames[:, 1:, :3] = np.moveaxis(link_frames(arm, recording.joint_position)[:-1], (0, 3), (1, 0))
    faults = list(dict.fromkeys(fault_name(entry["fault"]).lower() for entry in document["data_faults"]))
    remark = "The file is shown as it is. For the diagnosis these were corrected or weighted"
    links = [capsule.link for capsule in capsules]
    shown = tuple({**finding, "parts": _parts(finding["site"], links)} for finding in findings)
    return Scene(
        arm=arm,
        headline=headline,
        remarks=(f"{remark}: {', '.join(faults)}.",) if faults else (),
        findings=shown,
        capsules=tuple(capsules),
        frames=frames,
        row=recording.row,
        time=recording.time,
        moving=True,
    )


def _parts(site: str, links: Sequence[int]) -> tuple[str, ...]:
    """What is drawn of a site; a link without length is the joint before it."""
    if site == "links":
        return tuple(f"link{link}" for link in links if link)
    if site in ("tool", "payload"):
        return ("tool",)
    match = re.fullmatch(r"(joint|link)(\d+)", "link0" if site == "base" else site)
    if match is None:  # the sensor, the clock
        return ()
    number = int(match[2])
    if match[1] == "joint":
        return (site,)
    return (f"link{number}" if number in links else f"joint{max(number, 1)}",)


# ------------------------------------------------------------------ in the browser


PORT = 8080
"""Where none is asked for: this one, or the next that is free."""
FOUND = BEFORE
ARROWS = AFTER
"""Vermillion and blue of Okabe and Ito: with colour blindness too they differ from each other and from grey."""
ARM = "#B4B8BD"
TOOL = "#6B7077"
PREDICTED = "#000000"


@contextmanager
def served(scene: Scene, host: str, port: int | None) -> "Iterator[Shown]":
    """The scene in a web server of this machine, within the `with` statement; of no port, `PORT` or the next free one.

    Raises:
        InputError: viser is not installed; nothing can listen there.
    """
    try:
        import viser
    except ImportError as error:
        raise InputError("view takes the package viser; pip install 'lite6jax[view]'") from error
    port = _listening(host, port)
    console = rich.get_console()  # viser prints to it; what is said here is said by the command
    quiet = console.quiet
    console.quiet = True
    try:
        server = viser.ViserServer(host=host, port=port, label=f"lite6jax: {scene.arm.name}", verbose=False)
        try:
            yield Shown(scene, server)
        finally:
            server.stop()
    finally:
        console.quiet = quiet


def _listening(host: str, port: int | None) -> int:
    """A port on which to listen; viser would go on to others for ever, or wait where the address is none."""
    refused = ""
    for candidate_port in range(PORT, PORT + 100) if port is None else [port]:
        try:
            family, kind, *_, address = socket.getaddrinfo(host, candidate_port, type=socket.SOCK_STREAM)[0]
            with socket.socket(family, kind) as listener:
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                listener.bind(address)
                return candidate_port
        except (OSError, OverflowError, UnicodeError) as error:
            refused = "no such address or port"
            if isinstance(error, OSError):
                refused = error.strerror or ""
    where = f"--host {host}" if port is None else f"--host {host} --port {port}"
    raise InputError(f"{where}: nothing can listen there ({refused}); give another address or port")


@final
class Shown:
    """A scene as it is shown: all browsers that look at it see the same."""

    def __init__(self, scene: Scene, server: "ViserServer") -> None:
        self.scene = scene
        self.server = server
        self._lock = threading.RLock()
        self._at = 0.0
        self._size = (scene.arm.reach or PLAIN_REACH) / 20
        self._drawn = ""
        server.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        server.scene.add_grid("/floor", width=40 * self._size, height=40 * self._size, cell_size=2 * self._size)
        middle = np.array([0.0, 0.0, 8 * self._size])
        server.initial_camera.look_at = middle
        server.initial_camera.position = middle + self._size * np.array([15.0, -15.0, 9.0])
        self._draw_arm()
        self._draw_errors()
        self._add_controls()
        self._mark()
        self._to(0)

    @property
    def url(self) -> str:
        """Where a browser on this machine finds it."""
        host = self.server.get_host()
        host = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, f"[{host}]" if ":" in host else host)
        return f"http://{host}:{self.server.get_port()}"

    def play(self, seconds: float) -> None:
        """Moves the arm on by so much time, where it is set to play; after the last row comes the first."""
        if self.playing.value:
            rows = self.speed.value * seconds / self.scene.step
            self._at = (self._at + rows) % self.scene.samples
            self.row.value = int(self._at) + 1

    def _draw_arm(self) -> None:
        scene = self.scene
        add = self.server.scene
        r = 0.75 * self._size
        self._links = [
            add.add_frame(f"/arm/{k}", show_axes=not k, axes_length=3 * r, axes_radius=0.1 * r)
            for k in range(scene.frames.shape[1])
        ]
        self._parts: dict[str, Any] = {}
        for capsule in scene.capsules:
            axis = capsule.end - capsule.start
            name = f"link{capsule.link}"
            self._parts[name] = add.add_cylinder(
                f"/arm/{capsule.link}/{name}", 0.6 * r, float(np.linalg.norm(axis)), _rgb(ARM),
                wxyz=Rotation.align_vectors([axis], [[0.0, 0.0, 1.0]])[0].as_quat(scalar_first=True),
                position=0.5 * (capsule.start + capsule.end),
            )  # fmt: skip
            if capsule.link == scene.arm.dof:
                self._parts["tool"] = add.add_icosphere(
                    f"/arm/{capsule.link}/tool", 0.8 * r, _rgb(TOOL), position=capsule.end
                )
        if "tool" not in self._parts:
            self._parts["tool"] = add.add_icosphere(f"/arm/{scene.arm.dof}/tool", 0.8 * r, _rgb(TOOL))
        for joint in range(1, scene.arm.dof + 1):
            self._parts[f"joint{joint}"] = add.add_cylinder(f"/arm/{joint}/joint{joint}", r, 2.2 * r, _rgb(ARM))

    def _draw_errors(self) -> None:
        if not self.scene.poses:
            return
        add = self.server.scene
        r = self._size
        none = np.zeros((0, 2, 3))
        style: dict[str, Any] = {"shaft_radius": 0.05 * r, "head_radius": 0.15 * r, "head_length": 0.35 * r}
        self._arrows = add.add_arrows("/errors", none, _rgb(ARROWS), **style)
        self._arrow = add.add_arrows("/error", none, _rgb(ARROWS), **{key: 2 * size for key, size in style.items()})
        axes: dict[str, Any] = {"axes_length": 2 * r, "axes_radius": 0.06 * r, "origin_radius": 0.3 * r}
        self._predicted = add.add_frame("/predicted", origin_color=_rgb(PREDICTED), **axes)
        oriented = self.scene.orientation is not None
        self._measured = add.add_frame("/measured", origin_color=_rgb(ARROWS), **axes) if oriented else None

    def _add_controls(self) -> None:
        scene = self.scene
        gui = self.server.gui
        gui.add_html(_paragraphs([scene.headline, *scene.remarks]))
        with gui.add_folder("Motion"):
            last = max(scene.samples, 2)
            self.row = gui.add_slider("row", 1, last, 1, 1, disabled=scene.samples < 2)
            self.playing = gui.add_checkbox("play", False)
            speeds = (
                ("times real time", 0.1, 10.0, 0.1, 1.0) if scene.moving else ("rows per second", 0.5, 20.0, 0.5, 2.0)
            )
            self.speed = gui.add_slider(*speeds)
            self._status = gui.add_html("")
        if scene.errors:
            with gui.add_folder("Errors"):
                captions = [errors.caption for errors in scene.errors]
                # first what was found, which then shrinks to what is left
                self.prediction = gui.add_dropdown("prediction", captions, initial_value=captions[-1])
                self.prediction.on_update(lambda _: self._to(self.row.value - 1))
                if scene.poses:
                    self._caption = gui.add_html("")
                else:
                    self._limit = max(errors.limit for errors in scene.joints)
                    gui.add_html(_joint_legend(self._limit, scene.joints[0].quantity))
        with gui.add_folder("Findings"):
            gui.add_html(_finding_list(scene))
        self.row.on_update(lambda _: self._to(self.row.value - 1))

    def _to(self, sample: int) -> None:
        """Moves everything to a sample."""
        with self._lock, self.server.atomic():
            self._at = self._at if int(self._at) == sample else float(sample)
            for link, T in zip(self._links, self.scene.frames[sample], strict=True):
                link.wxyz = _wxyz(T[:3, :3])
                link.position = T[:3, 3]
            time = ""
            if self.scene.time is not None:
                time = f", {self.scene.time[sample]:.2f} s"
            status = f"Row {self.scene.row[sample]}{time}"
            for errors in self.scene.poses:
                if errors.caption == self.prediction.value:
                    status += self._compare(errors, sample)
            for errors in self.scene.joints:
                if errors.caption != self.prediction.value:
                    continue
                for joint, colour in enumerate(errors.colours(sample, self._limit), 1):
                    self._parts[f"joint{joint}"].color = tuple(map(int, colour))
                row = errors.over_noise[sample]
                if np.isfinite(row).all():
                    status += f": joint {row.argmax() + 1} is off most, by {row.max():.2g} times its noise"
            self._status.content = _paragraphs([status])

    def _compare(self, errors: PoseErrors, sample: int) -> str:
        """Draws the errors and the tool of a sample; says how large its error is."""
        scale = self.scene.poses[-1].scale
        if errors.caption != self._drawn:
            self._drawn = errors.caption
            self._arrows.points = errors.arrows(scale).astype(np.float32)
            thinned = len(errors.shown) < self.scene.samples
            thinning_note = ""
            if thinned:
                thinning_note = f" {len(errors.shown)} of {self.scene.samples} rows have one."
            legend = (
                "Arrows lead from where the tool is predicted to where it was measured. They are enlarged "
                f"{f'{scale:.0f}' if scale >= 100 else f'{scale:.3g}'} times: the median error of "
                f"{number(1e3 * errors.median)} mm is {1e3 * scale * errors.median:.0f} mm long.{thinning_note}"
            )
            self._caption.content = _paragraphs([legend])
        is_predicted = bool(np.isfinite(errors.length[sample]))
        for node in (self._arrow, self._predicted, self._measured):
            if node is not None:
                node.visible = is_predicted
        if not is_predicted:
            return ": nothing is predicted here"
        self._arrow.points = errors.arrows(scale, [sample]).astype(np.float32)
        T = errors.predicted[sample]
        self._predicted.wxyz = _wxyz(T[:3, :3])
        self._predicted.position = T[:3, 3]
        if self._measured is not None and self.scene.orientation is not None:
            self._measured.wxyz = _wxyz(self.scene.orientation[sample])
            self._measured.position = T[:3, 3] + scale * errors.error[sample]
        return f": error {number(1e3 * errors.length[sample])} mm"

    def _mark(self) -> None:
        """Colours and labels the places of the findings."""
        add = self.server.scene
        for part, numbers in self.scene.marked().items():
            if (node := self._parts.get(part)) is None:
                continue
            if self.scene.joints and part.startswith("joint"):  # whose colours are those of errors
                ring = 0.75 * self._size
                add.add_cylinder(f"{node.name}/ring", 1.3 * ring, 0.5 * ring, _rgb(FOUND))
            else:
                node.color = _rgb(FOUND)
            add.add_label(f"{node.name}/label", ", ".join(map(str, numbers)))


def _wxyz(R: np.ndarray) -> np.ndarray:
    return Rotation.from_matrix(R).as_quat(scalar_first=True)


def _rgb(colour: str) -> Any:
    return tuple(round(255 * part) for part in to_rgb(colour))


_STYLE = "font-size: 0.85em; line-height: 1.35; margin: 0.3em 0.6em"


def _paragraphs(texts: Sequence[str]) -> str:
    """As HTML; nothing of a document or of a file is markup."""
    return "".join(f'<p style="{_STYLE}">{html.escape(text)}</p>' for text in texts)


def _finding_list(scene: Scene) -> str:
    if not scene.findings:
        return _paragraphs(["None."])
    dot = f'<span style="color: {FOUND}">&#9632;</span>'
    entries = []
    for finding in scene.findings:
        title, size, statement = (html.escape(finding[key]) for key in ("title", "contribution", "statement"))
        where = "Not on the arm."
        if finding["parts"]:
            where = f"{dot} {', '.join(finding['parts'])}."
        entries.append(f"<li>{title}: <b>{size}</b>. {where} {statement}</li>")
    return f'<ol style="{_STYLE}; padding-left: 1.4em">{"".join(entries)}</ol>'


def _joint_legend(limit: float, quantity: str) -> str:
    stops = ", ".join(f"rgb({r},{g},{b})" for r, g, b in shades(np.linspace(0, 1, 6)))
    bar = f'<div style="height: 0.8em; margin: 0.3em 0.6em; background: linear-gradient(to right, {stops})"></div>'
    legend = (
        f"Joints are coloured by the error of their {quantity}, from 0 to {limit:.3g} times its noise (RMS over 0.2 s)."
    )
    return bar + _paragraphs([legend])
