"""Commands on arms and effects as such: write an arm in another form, list bundled arms, an arm's joints, effects."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, final

from tyro.conf import Positional, arg

from lite6jax.cli import command
from lite6jax.deferred import import_lazily
from lite6jax.errors import InputError

with import_lazily():
    from lite6jax.arms import arm as arms
    from lite6jax.arms import description, files
    from lite6jax.calibration import source as sources
    from lite6jax.diagnosis import document, export, servo_export
    from lite6jax.effects import catalogue
    from lite6jax.estimation import prior as priors
    from lite6jax.report import listings, screen


@final
@dataclass(frozen=True)
class ConvertCommand:
    """Write one arm's file in another form; what the new form cannot hold is reported, or refused.

    For example:

        lite6jax convert arm.yaml arm.urdf
        lite6jax convert lite6 arm.xml
        lite6jax convert robot.urdf arm.yaml --base torso_link --tip tool0
        lite6jax convert model.json arm.yaml --to ur
        lite6jax convert diagnosis.json arm.urdf
        lite6jax convert diagnosis.json new.urdf --into robot.urdf
        lite6jax convert diagnosis.json rollout.py
        lite6jax convert diagnosis.json actuators.py --to isaac
    """

    source: Annotated[Positional[str], arg(metavar="FILE|ARM")]
    """A calibration (.yaml, .json, .conf), a description, a URDF or MJCF, a bundled arm's name, or what
    `diagnose` wrote (.json): of poses the arm's chain as identified, of torques its friction, rotors, springs and
    links, of commands its servos, friction and rotors."""
    target: Annotated[Positional[Path], arg(metavar="FILE")]
    """The file to write."""
    to: Annotated[
        Literal["vendor", "ur", "table", "urdf", "mjcf", "description", "numpy", "isaac"] | None, arg(metavar="FORM")
    ] = None
    """vendor or ur (.yaml), table (.json), urdf, mjcf (.xml), or description (.yaml); of a diagnosis of commands also
    numpy, a rollout of one page, or isaac, actuators of Isaac Lab (.py). By the suffix where not given: a calibration
    becomes vendor .yaml, any other .yaml is a description, and .py the rollout."""
    into: Annotated[str | None, arg(metavar="ROBOT.urdf")] = None
    """Write this URDF (robot.urdf#tip or #base:tip) with the numbers of FILE: names, meshes, limits, efforts and
    velocities stay."""
    base: str | None = None
    """Of a URDF or MJCF, the link or body that is the arm's base; the root where not given."""
    tip: str | None = None
    """Likewise the one that is the flange; the end of the only chain where not given."""
    arm: command.ArmName = None
    """The nominal arm of a calibration: that of --into, or recognised, where not given. Of a diagnosis, where the
    inertia is from that it does not say: by default the bundled arm of its name, or the file that the recording's
    sidecar names."""
    effects: command.OwnEffects = None
    json: command.Json = False
    force: command.Force = False

    def run(self) -> int:
        """Converts and reads back."""
        into = self.into.partition("#")[0] if self.into else None
        command.check_outputs([self.target], [self.source, self.arm, into, self.effects], self.force)
        source = files.name_chain(self.source, self.base, self.tip)
        nominal = sources.load_nominal(self.arm)
        arm = None
        left_out = ()
        if self.into is not None and self.to not in (None, "urdf"):
            raise InputError(f"--into writes a URDF, and --to asks for {self.to}; give one of them")
        servos: Any = None
        if Path(source).suffix.lower() == ".json":  # a table of DH parameters, or a diagnosis
            content = document.parse_document(source)
            if document.is_of_tracking(content):
                own_effects = command.load_own_effects(self.effects)
                servos = document.model_from_document(content, own_effects, source)
            else:
                arm, left_out, nominal = self._read_diagnosis(source, content, nominal)
        if servos is not None:
            if self.arm is not None:
                raise InputError(f"--arm: {source} is of commands and has an arm; leave it out")
            done = servo_export.convert_servos(servos, self.target, self.to, self.force, self.into, source)
        else:
            done = files.convert_file(arm or source, self.target, self.to, nominal, self.force, left_out, self.into)
        if self.json:
            return command.present(True, done, (), [done.path])
        screen.written([done.path])
        screen.show(listings.conversion_report(done))
        return command.DONE

    def _read_diagnosis(
        self, source: str, content: Any, nominal: "arms.Arm | None"
    ) -> "tuple[arms.Arm | None, tuple[str, ...], arms.Arm | None]":
        """The arm of a diagnosis, what it leaves out, and its nominal arm; None of another file."""
        if not (isinstance(content, dict) and content.get("schema") == document.SCHEMA):
            return None, (), nominal
        effects = command.load_own_effects(self.effects)
        alone = self.into is None
        nominal = nominal or sources.load_nominal(command.find_nominal(content, Path(source)))
        arm, left_out = export.read_diagnosed_arm(source, nominal, effects, alone)
        if arm.inertia is None and alone and (self.to or files.form_of(self.target, False)) == "mjcf":
            raise InputError(
                f"{source}: MuJoCo needs the mass and inertia of every link, which a diagnosis of poses lacks;"
                f" add --arm with the URDF, MJCF or description of {arm.name} that has them, or write a .urdf"
            )
        if nominal is None and arm.name in description.bundled_arms():
            nominal = description.load_bundled(arm.name)
        return arm, left_out, nominal


@final
@dataclass(frozen=True)
class EffectsCommand:
    """List the effects that a diagnosis searches for: formula, site, driver and numbers of each, its parameter in
    simulators and what looks like it; or what each kind of explanation costs before any data.

    For example:

        lite6jax effects
        lite6jax effects --domain dynamic --json
        lite6jax effects --domain tracking
        lite6jax effects --prior
    """

    domain: Literal["kinematic", "dynamic", "tracking"] | None = None
    """Only those on poses (kinematic), on torques (dynamic), or on how joints follow their commands (tracking)."""
    prior: bool = False
    """The prior probabilities of explanations instead: effects, faults of the data, errors of what was declared."""
    json: command.Json = False

    def run(self) -> int:
        """Prints."""
        if self.prior:
            if self.domain is not None:
                raise InputError("--prior: holds for all domains; leave --domain out")
            entries = priors.PRIOR.entries
            return command.present(self.json, lambda: _as_json(entries), listings.prior_report(entries))
        listed_effects = [effect for effect in catalogue.listed() if self.domain in (None, effect.domain)]
        return command.present(
            self.json,
            lambda: _as_json([effect.to_dict() for effect in listed_effects]),
            listings.effects_report(listed_effects),
        )


@final
@dataclass(frozen=True)
class ArmsCommand:
    """List the bundled arms: name, maker, joints, reach, whether inertia is known, and the source of the numbers; or
    show how one arm is read: from which link to which, and its joints.

    For example:

        lite6jax arms
        lite6jax arms robot.urdf#tool0
    """

    arm: Annotated[Positional[str | None], arg(metavar="ARM")] = None
    """A bundled arm, or the file of an arm: a description, URDF, MJCF, calibration or table."""
    json: command.Json = False

    def run(self) -> int:
        """Prints."""
        if self.arm is not None:
            arm = files.read_arm(self.arm)
            document = listings.arm_entry(arm)._asdict() | {"joint_list": listings.joint_entries(arm)}
            report = listings.arm_report(arm)
        else:
            entries = [listings.arm_entry(description.load_bundled(name)) for name in description.bundled_arms()]
            document = [entry._asdict() for entry in entries]
            report = listings.arms_report(entries, screen.console().width)
        return command.present(self.json, lambda: _as_json(document), report)


def _as_json(content: object) -> str:
    return json.dumps(content, indent=1, ensure_ascii=False)
