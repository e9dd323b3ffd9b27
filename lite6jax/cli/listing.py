"""Commands that list what there is: effects of the catalogues, bundled arms, the joints of an arm."""

import json
from dataclasses import dataclass
from typing import Annotated, Literal, final

from tyro.conf import Positional, arg

from lite6jax.cli.exit_codes import DONE


@final
@dataclass(frozen=True)
class Effects:
    """List the effects that a diagnosis searches for: site, driver, unit and formula of each.

    For example:

        lite6jax effects
        lite6jax effects --domain dynamic --json
    """

    domain: Literal["kinematic", "dynamic"] | None = None
    """Only those on poses (kinematic) or on torques (dynamic)."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        """Prints."""
        from lite6jax.effects.listing import listed

        found = [effect for effect in listed() if self.domain in (None, effect.domain)]
        if self.json:
            _print_json([effect.to_dict() for effect in found])
            return DONE
        from lite6jax.report import screen
        from lite6jax.report.listings import effects_report

        screen.show(effects_report(found, screen.console().width))
        return DONE


@final
@dataclass(frozen=True)
class Arms:
    """List the bundled arms: name, maker, joints, reach, whether inertia is known, and the source of the numbers; or
    show how one arm is read: from which link to which, and its joints.

    For example:

        lite6jax arms
        lite6jax arms robot.urdf#tool0
    """

    arm: Annotated[Positional[str | None], arg(metavar="ARM")] = None
    """A bundled arm, or the file of an arm: a description, URDF, MJCF, calibration or table."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        """Prints."""
        from lite6jax.arms.bundled import bundled_arms, load_bundled
        from lite6jax.arms.files import read_arm
        from lite6jax.report import screen
        from lite6jax.report.listings import arm_entry, arm_report, arms_report, joint_entries

        if self.arm is not None:
            arm = read_arm(self.arm)
            if self.json:
                _print_json(arm_entry(arm).to_dict() | {"joint_list": joint_entries(arm)})
            else:
                screen.show(arm_report(arm))
            return DONE
        entries = [arm_entry(load_bundled(name)) for name in bundled_arms()]
        if self.json:
            _print_json([entry.to_dict() for entry in entries])
            return DONE
        screen.show(arms_report(entries, screen.console().width))
        return DONE


def _print_json(content: object) -> None:
    print(json.dumps(content, indent=1, ensure_ascii=False))
