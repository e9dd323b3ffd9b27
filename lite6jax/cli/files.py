"""Commands on files as they are: write an arm in another form, rule out the easy causes of a mismatch."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, final

from tyro.conf import Positional, arg

from lite6jax.cli.arguments import ArmName, refuse_inputs
from lite6jax.cli.exit_codes import DONE
from lite6jax.cli.inputs import diagnosed_nominal
from lite6jax.errors import InputError
from lite6jax.storage import check_writable

if TYPE_CHECKING:
    from lite6jax.arms.arm import Arm


@final
@dataclass(frozen=True)
class Convert:
    """Write one arm's file in another form; what the new form cannot hold is reported, or refused.

    For example:

        lite6jax convert arm.yaml arm.urdf
        lite6jax convert lite6 arm.xml
        lite6jax convert robot.urdf arm.yaml --base torso_link --tip tool0
        lite6jax convert model.json arm.yaml --to ur
        lite6jax convert diagnosis.json arm.urdf
        lite6jax convert diagnosis.json new.urdf --into robot.urdf
    """

    source: Annotated[Positional[str], arg(metavar="FILE|ARM")]
    """A calibration (.yaml, .json, .conf), a description, a URDF or MJCF, a bundled arm's name, or what
    `diagnose` wrote (.json): of poses the arm's chain as identified, of torques its friction, rotors, springs and
    links."""
    target: Annotated[Positional[Path], arg(metavar="FILE")]
    """The file to write."""
    to: Annotated[Literal["vendor", "ur", "table", "urdf", "mjcf", "description"] | None, arg(metavar="FORM")] = None
    """vendor or ur (.yaml), table (.json), urdf, mjcf (.xml), or description (.yaml). By the suffix where not given: a
    calibration becomes vendor .yaml, everything else a description."""
    into: Annotated[str | None, arg(metavar="ROBOT.urdf")] = None
    """Write this URDF (robot.urdf#tip or #base:tip) with the numbers of FILE: names, meshes, limits, efforts and
    velocities stay."""
    base: str | None = None
    """Of a URDF or MJCF, the link or body that is the arm's base; the root where not given."""
    tip: str | None = None
    """Likewise the one that is the flange; the end of the only chain where not given."""
    arm: ArmName = None
    """The nominal arm of a calibration: that of --into, or recognised, where not given. Of a diagnosis, where the
    inertia is from that it does not say: by default the bundled arm of its name, or the file that the recording's
    sidecar names."""
    effects: Annotated[Path | None, arg(metavar="FILE.py")] = None
    """Effects of your own that a diagnosis has. Runs the file."""
    json: bool = False
    """Print JSON instead of the report."""
    force: bool = False
    """Replace the file if it exists."""

    def run(self) -> int:
        """Converts and reads back."""
        check_writable(self.target, self.force)
        into = self.into.partition("#")[0] if self.into else None
        refuse_inputs([self.target], [self.source.partition("#")[0], self.arm, into, self.effects])
        from lite6jax.arms.files import convert_file, name_chain
        from lite6jax.fitting.source import load_nominal
        from lite6jax.report import listings, screen

        source = name_chain(self.source, self.base, self.tip)
        nominal, arm, left_out = load_nominal(self.arm), None, ()
        if self.into is not None and self.to not in (None, "urdf"):
            raise InputError(f"--into writes a URDF, and --to asks for {self.to}; give one of them")
        if Path(source).suffix.lower() == ".json":  # a table of DH parameters, or a diagnosis
            arm, left_out, nominal = self._diagnosed(source, nominal)
        done = convert_file(arm or source, self.target, self.to, nominal, self.force, left_out, self.into)
        if self.json:
            from lite6jax.report import documents

            print(documents.text(documents.document(done), [done.path]))
            return DONE
        screen.written([done.path])
        screen.show(listings.conversion_report(done))
        return DONE

    def _diagnosed(self, source: str, nominal: "Arm | None") -> "tuple[Arm | None, tuple[str, ...], Arm | None]":
        """The arm of a diagnosis, what it leaves out, and its nominal arm; None of another file."""
        from lite6jax.arms.bundled import bundled_arms, load_bundled
        from lite6jax.arms.files import form_of
        from lite6jax.diagnosis.document import parsed_document
        from lite6jax.diagnosis.export import is_diagnosis, read_diagnosed_arm
        from lite6jax.effects.user_effects import load_effects
        from lite6jax.fitting.source import load_nominal

        if not is_diagnosis(source):
            return None, (), nominal
        effects = load_effects(self.effects) if self.effects else ()
        nominal = nominal or load_nominal(diagnosed_nominal(parsed_document(source), Path(source)))
        arm, left_out = read_diagnosed_arm(source, nominal, effects, alone=self.into is None)
        if arm.inertia is None and self.into is None and (self.to or form_of(self.target, False)) == "mjcf":
            raise InputError(
                f"{source}: MuJoCo needs the mass and inertia of every link, which a diagnosis of poses lacks;"
                f" add --arm with the URDF, MJCF or description of {arm.name} that has them, or write a .urdf"
            )
        return arm, left_out, nominal or (load_bundled(arm.name) if arm.name in bundled_arms() else None)


@final
@dataclass(frozen=True)
class Check:
    """Rule out the easy causes of a mismatch first: nominal table, tool offset, smooth or jumping error.

    For example:

        lite6jax check arm.yaml run7.csv
    """

    files: Annotated[Positional[tuple[Path, ...]], arg(metavar="FILE…")]
    """Calibrations (.yaml, .json, .conf) and recordings (.csv, .parquet)."""
    arm: ArmName = None
    """The nominal arm; recognised, or from the sidecar, where not given."""
    assume_degrees: bool = False
    """Take joint columns that say rad as degrees."""
    assume_millimetres: bool = False
    """Take position columns that say m as millimetres."""
    json: bool = False
    """Print a JSON object for each file, a line each, instead of the report."""

    def run(self) -> int:
        """Reads, checks, prints."""
        if not self.files:
            raise InputError("check needs a file or more; name them")
        from lite6jax.domains.pose.check import check_calibration, check_recording
        from lite6jax.fitting.source import load_nominal, read_source
        from lite6jax.recordings import Recording
        from lite6jax.report import data_faults, screen

        nominal = load_nominal(self.arm)
        for path in self.files:
            source = read_source(
                path, nominal, assume_degrees=self.assume_degrees, assume_millimetres=self.assume_millimetres
            )
            found = check_recording(source, nominal) if isinstance(source, Recording) else check_calibration(source)
            if self.json:
                from lite6jax.report import documents

                print(documents.line({"file": str(path), **documents.document(found)}))
            else:
                screen.show(data_faults.check_report(path, found))
        return DONE
