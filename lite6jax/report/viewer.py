"""A scene in the browser, by viser: what is drawn, the controls beside it, and what they do."""

import html
import socket
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, final

import numpy as np
import rich
from matplotlib.colors import to_rgb
from scipy.spatial.transform import Rotation

from lite6jax.errors import InputError
from lite6jax.report.canvas import AFTER, BEFORE
from lite6jax.report.cells import number
from lite6jax.report.scene import PoseErrors, Scene, TorqueErrors, shades

if TYPE_CHECKING:
    from viser import ViserServer

PORT = 8080
"""Where none is asked for: this one, or the next that is free."""
FOUND, ARROWS = BEFORE, AFTER
"""Vermillion and blue of Okabe and Ito: with colour blindness too they differ from each other and from grey."""
ARM, TOOL, PREDICTED = "#B4B8BD", "#6B7077", "#000000"
ALL = "all findings"

_Colour = tuple[int, int, int]


@contextmanager
def served(scene: Scene, host: str, port: int | None) -> "Iterator[Shown]":
    """The scene in a web server of this machine, within the `with` statement.

    Args:
        scene: what is shown.
        host: the address on which to listen.
        port: 0 for any; `PORT` or the next one that is free where None.

    Raises:
        InputError: viser is not installed; nothing can listen there.
    """
    try:
        import viser
    except ImportError as error:
        raise InputError("view takes the package viser; pip install 'lite6jax[view]'") from error
    port = _listening(host, port)
    console = rich.get_console()  # viser prints to it; what is said here is said by the command
    quiet, console.quiet = console.quiet, True
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
    tried = range(PORT, PORT + 100) if port is None else [port]
    refused: OSError | None = None
    for one in tried:
        try:
            family, kind, *_, address = socket.getaddrinfo(host, one, type=socket.SOCK_STREAM)[0]
            with socket.socket(family, kind) as trial:
                trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                trial.bind(address)
                return one
        except (OSError, OverflowError, UnicodeError) as error:
            refused = error if isinstance(error, OSError) else OSError(0, "no such address or port")
    assert refused is not None
    where = f"--host {host}" if port is None else f"--host {host} --port {port}"
    raise InputError(f"{where}: nothing can listen there ({refused.strerror}); give another address or port")


@final
class Shown:
    """A scene as it is shown: all browsers that look at it see the same."""

    def __init__(self, scene: Scene, server: "ViserServer") -> None:
        self.scene, self.server = scene, server
        self._lock, self._at = threading.RLock(), 0.0
        self._size = scene.arm.reach / 20
        self._marks: list[Any] = []
        self._drawn: tuple[str, float] | None = None
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
        scene, add, r = self.scene, self.server.scene, 0.75 * self._size
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
                wxyz=_from_z(axis), position=0.5 * (capsule.start + capsule.end),
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
        add, r, none = self.server.scene, self._size, np.zeros((0, 2, 3))
        style: dict[str, Any] = {"shaft_radius": 0.05 * r, "head_radius": 0.15 * r, "head_length": 0.35 * r}
        self._arrows = add.add_arrows("/errors", none, _rgb(ARROWS), **style)
        self._arrow = add.add_arrows("/error", none, _rgb(ARROWS), **{key: 2 * size for key, size in style.items()})
        axes: dict[str, Any] = {"axes_length": 2 * r, "axes_radius": 0.06 * r, "origin_radius": 0.3 * r}
        self._predicted = add.add_frame("/predicted", origin_color=_rgb(PREDICTED), **axes)
        oriented = self.scene.orientation is not None
        self._measured = add.add_frame("/measured", origin_color=_rgb(ARROWS), **axes) if oriented else None

    def _add_controls(self) -> None:
        scene, gui = self.scene, self.server.gui
        gui.add_html(_paragraphs([scene.headline, *scene.remarks]))
        with gui.add_folder("Motion"):
            last = max(scene.samples, 2)
            self.row = gui.add_slider("row", 1, last, 1, 1, disabled=scene.samples < 2)
            self.playing = gui.add_checkbox("play", False)
            if scene.moving:
                self.speed = gui.add_slider("times real time", 0.1, 10.0, 0.1, 1.0)
            else:
                self.speed = gui.add_slider("rows per second", 0.5, 20.0, 0.5, 2.0)
            self._status = gui.add_html("")
        errors: Sequence[PoseErrors | TorqueErrors] = scene.poses or scene.torques
        if errors:
            with gui.add_folder("Errors"):
                captions = [each.caption for each in errors]
                # first what was found, which then shrinks to what is left
                self.prediction = gui.add_dropdown("prediction", captions, initial_value=captions[-1])
                self.prediction.on_update(lambda _: self._choose())
                if scene.poses:
                    self._add_scale(scene.poses)
                else:
                    self._limit = max(each.limit for each in scene.torques)
                    gui.add_html(_torque_legend(self._limit))
        with gui.add_folder("Findings"):
            if scene.findings:
                names = [ALL, *(f"{place.number}. {place.title}" for place in scene.findings)]
                self.highlight = gui.add_dropdown("highlight", names, initial_value=ALL)
                self.highlight.on_update(lambda _: self._mark())
            gui.add_html(_finding_list(scene))
        self.row.on_update(lambda _: self._to(self.row.value - 1))

    def _add_scale(self, errors: Sequence[PoseErrors]) -> None:
        gui, usual = self.server.gui, errors[-1].scale
        self.scale = gui.add_slider("enlarged", 0.0, 2 * max(each.scale for each in errors), usual / 20, usual)
        self._caption = gui.add_html("")
        self.scale.on_update(lambda _: self._choose())

    def _choose(self) -> None:
        """Another prediction, or another scale."""
        with self._lock:
            self._to(self.row.value - 1)

    @property
    def _errors(self) -> Any:
        errors: Sequence[PoseErrors | TorqueErrors] = self.scene.poses or self.scene.torques
        return next((each for each in errors if each.caption == self.prediction.value), None) if errors else None

    def _to(self, sample: int) -> None:
        """Moves everything to a sample."""
        with self._lock, self.server.atomic():
            self._at = self._at if int(self._at) == sample else float(sample)
            frames = self.scene.frames[sample]
            turned = Rotation.from_matrix(frames[:, :3, :3]).as_quat(scalar_first=True)
            for link, wxyz, T in zip(self._links, turned, frames, strict=True):
                link.wxyz, link.position = wxyz, T[:3, 3]
            errors, said = self._errors, self._row_statement(sample)
            if isinstance(errors, PoseErrors):
                said += self._compare(errors, sample)
            elif isinstance(errors, TorqueErrors):
                for joint, colour in enumerate(errors.colours(sample, self._limit), 1):
                    self._parts[f"joint{joint}"].color = tuple(map(int, colour))
                worst = int(errors.over_noise[sample].argmax())
                said += f": joint {worst + 1} is off most, by {errors.over_noise[sample, worst]:.2g} times its noise"
            self._status.content = _paragraphs([said])

    def _row_statement(self, sample: int) -> str:
        time = "" if self.scene.time is None else f", {self.scene.time[sample]:.2f} s"
        return f"Row {self.scene.row[sample]}{time}"

    def _compare(self, errors: PoseErrors, sample: int) -> str:
        """Draws the errors and the tool of a sample; says how large its error is."""
        shown = (errors.caption, self.scale.value)
        if shown != self._drawn:
            self._drawn = shown
            self._arrows.points = errors.arrows(self.scale.value).astype(np.float32)
            self._caption.content = _paragraphs([self._caption_of(errors)])
        there = bool(np.isfinite(errors.length[sample]))
        for node in (self._arrow, self._predicted, self._measured):
            if node is not None:
                node.visible = there
        if not there:
            return ": nothing is predicted here"
        self._arrow.points = errors.arrows(self.scale.value, [sample]).astype(np.float32)
        T = errors.predicted[sample]
        self._predicted.wxyz, self._predicted.position = _wxyz(T[:3, :3]), T[:3, 3]
        if self._measured is not None and self.scene.orientation is not None:
            self._measured.wxyz = _wxyz(self.scene.orientation[sample])
            self._measured.position = T[:3, 3] + self.scale.value * errors.error[sample]
        return f": error {number(1e3 * errors.length[sample])} mm"

    def _caption_of(self, errors: PoseErrors) -> str:
        few = len(errors.shown) < self.scene.samples
        some = f" {len(errors.shown)} of {self.scene.samples} rows have one." if few else ""
        return (
            "Arrows lead from where the tool is predicted to where it was measured. They are enlarged "
            f"{_times(self.scale.value)} times: the median error of {number(1e3 * errors.median)} mm is "
            f"{1e3 * self.scale.value * errors.median:.0f} mm long.{some}"
        )

    def _mark(self) -> None:
        """Colours and labels the places of the findings that are chosen."""
        with self._lock, self.server.atomic():
            numbers = None
            if self.scene.findings and self.highlight.value != ALL:
                numbers = [int(self.highlight.value.partition(".")[0])]
            marked, add = self.scene.marked(numbers), self.server.scene
            while self._marks:
                self._marks.pop().remove()
            for part, node in self._parts.items():
                if not (self.scene.torques and part.startswith("joint")):  # whose colours are those of errors
                    node.color = _rgb(FOUND if part in marked else TOOL if part == "tool" else ARM)
                elif part in marked:
                    ring = 0.75 * self._size
                    self._marks.append(add.add_cylinder(f"{node.name}/ring", 1.3 * ring, 0.5 * ring, _rgb(FOUND)))
                if part in marked:
                    self._marks.append(add.add_label(f"{node.name}/label", ", ".join(map(str, marked[part]))))


def _times(scale: float) -> str:
    return f"{scale:.0f}" if scale >= 100 else f"{scale:.3g}"


def _from_z(axis: np.ndarray) -> np.ndarray:
    """The quaternion that turns z into a direction."""
    z = axis / np.linalg.norm(axis)
    if z[2] < -1 + 1e-12:
        return np.array([0.0, 1.0, 0.0, 0.0])
    half = np.array([1 + z[2], -z[1], z[0], 0.0])
    return half / np.linalg.norm(half)


def _wxyz(R: np.ndarray) -> np.ndarray:
    return Rotation.from_matrix(R).as_quat(scalar_first=True)


def _rgb(colour: str) -> _Colour:
    red, green, blue = (round(255 * part) for part in to_rgb(colour))
    return red, green, blue


_STYLE = "font-size: 0.85em; line-height: 1.35; margin: 0.3em 0.6em"


def _paragraphs(texts: Sequence[str]) -> str:
    """As HTML; nothing of a document or of a file is markup."""
    return "".join(f'<p style="{_STYLE}">{html.escape(text)}</p>' for text in texts)


def _finding_list(scene: Scene) -> str:
    if not scene.findings:
        return _paragraphs(["None."])
    dot = f'<span style="color: {FOUND}">&#9632;</span>'
    entries = []
    for place in scene.findings:
        size = f" <b>{html.escape(place.size)}</b>." if place.size else ""
        where = f"{dot} {', '.join(place.parts)}." if place.parts else "Not on the arm."
        entries.append(f"<li>{html.escape(place.title)}: {size} {where} {html.escape(place.statement)}</li>")
    return f'<ol style="{_STYLE}; padding-left: 1.4em">{"".join(entries)}</ol>'


def _torque_legend(limit: float) -> str:
    stops = ", ".join(f"rgb({r},{g},{b})" for r, g, b in shades(np.linspace(0, 1, 6)))
    bar = f'<div style="height: 0.8em; margin: 0.3em 0.6em; background: linear-gradient(to right, {stops})"></div>'
    return bar + _paragraphs(
        [f"Joints are coloured by the error of their torque, from 0 to {limit:.3g} times its noise (RMS over 0.2 s)."]
    )
