"""The command that finds the corners of a board in images and writes them as a recording."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, final

from tyro.conf import Positional, UseAppendAction, arg

from lite6jax.cli import command
from lite6jax.deferred import import_lazily

with import_lazily():
    from lite6jax import recordings
    from lite6jax.arms import files
    from lite6jax.recordings import boards
    from lite6jax.recordings import settings as sidecar_settings
    from lite6jax.report import screen

if TYPE_CHECKING:
    from rich.console import RenderableType


@final
@dataclass(frozen=True)
class Detect:
    """Find the corners of a ChArUco board in images, by OpenCV, and write them as a recording of a camera.

    Joints are those of a table with a row an image, in the order of the images, or with a column `image` of their
    names. Where no camera is declared, its lens is calibrated from the images and refined with the arm.

    For example:

        lite6jax detect images --board charuco:7x5,20mm --joints joints.csv --arm lite6
        lite6jax detect images --board charuco:7x5,20mm,15mm,5X5_100 --joints joints.csv --mounted on_flange
    """

    source: Annotated[Positional[tuple[str, ...]], arg(metavar="IMAGES")]
    """Images, or the folder that holds them."""
    board: Annotated[str, arg(metavar="charuco:7x5,20mm")]
    """The board by its squares, columns and rows, and their side. A marker's side (three quarters of a square's) and
    the dictionary (4X4_50) may follow."""
    joints: Annotated[Path, arg(metavar="FILE")]
    """The joints at which the images were taken (.csv, .parquet)."""
    out: command.OutFile = None
    """Write the recording here (.csv or .parquet); beside the joints, as NAME_corners.csv, where not given."""
    mounted: Literal["fixed", "on_flange"] = "fixed"
    """fixed: the camera stands, and the board is on the flange; on_flange: the other way round."""
    arm: command.ArmName = None
    """The nominal arm: a bundled name, or a file."""
    set: Annotated[tuple[str, ...], UseAppendAction, arg(metavar="KEY=VALUE")] = ()
    """A key of the sidecar, such as pixel_noise_px=0.2. May be repeated."""
    force: command.Force = False

    def run(self) -> int:
        """Detects, writes, prints."""
        import numpy as np

        out = self.out or self.joints.with_name(f"{self.joints.stem}_corners.csv")
        sidecar = recordings.sidecar_path(out)
        command.check_outputs([out, sidecar], [self.joints, *self.source], self.force)
        board, given = boards.parse_board(self.board), command.parse_pairs("--set", self.set, as_yaml=True)
        arm = None if self.arm is None else files.read_arm(self.arm)
        joints = recordings.read_recording(self.joints, arm=arm)
        images = boards.list_images(self.source)
        rows = boards.match_rows(images, self.joints)
        corners = boards.detect_corners(images, board)
        declared = {"pose_source": "camera", "motion": "static"} | given
        # beside the joints, as their sidecar's paths are; both move with the recording
        named = None if self.arm is None else command.name_arm(self.arm, self.joints)
        settings = sidecar_settings.declared_settings(joints.settings, named, declared)
        settings = replace(settings, board=settings.board or board.settings)
        error = None
        if settings.camera is None:
            camera, error = boards.calibrate_lens(corners, board, self.mounted)
            settings = replace(settings, camera=camera)
        at = {int(row): k for k, row in enumerate(joints.row)}
        kept = [k for k, row in enumerate(rows) if corners.shown[k] and int(row) in at]
        moved = joints.select(np.array([at[int(rows[k])] for k in kept]))
        readings = recordings.readings_from_arrays("camera", pixels=corners.pixels[kept])
        found = moved.made_anew(position=None, quaternion=None, readings=readings, settings=settings)
        written = [recordings.write_recording(found, out, self.force), sidecar]
        screen.show(self._page(found, [images[k].name for k in range(len(images)) if k not in kept], board, error))
        screen.written(written)
        return command.DONE

    def _page(
        self, found: "recordings.Recording", left_out: list[str], board: "boards.Board", error: float | None
    ) -> "Iterator[RenderableType]":
        import numpy as np
        from rich.text import Text

        assert found.readings is not None
        seen = np.isfinite(found.readings.pixels[..., 0]).sum()
        images, every = found.samples + len(left_out), board.settings.columns * board.settings.rows
        yield Text(f"{found.samples} of {images} images show the board: {seen} corners, {every} at most in each.")
        if left_out:
            listed = ", ".join(left_out[:6]) + (f" and {len(left_out) - 6} more" if len(left_out) > 6 else "")
            yield Text(f"Left out, as they show fewer than 6 corners or have no joints: {listed}.")
        camera = found.settings.camera
        if error is not None and camera is not None:
            yield Text(
                f"The camera, calibrated from the images: fx {camera.fx:.1f}, fy {camera.fy:.1f}, cx {camera.cx:.1f}, "
                f"cy {camera.cy:.1f} px; its corners are {error:.2f} px off (RMS). They are "
                "refined with the arm."
            )
