"""Commands that list what there is: effects of the catalogues, bundled arms."""

import json
from dataclasses import dataclass
from typing import Literal, final

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
    """List the bundled arms: name, maker, joints, reach, whether inertia is known, and the source of the numbers.

    For example:

        lite6jax arms
    """

    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        """Prints."""
        from lite6jax.arms.bundled import bundled_arms, load_bundled
        from lite6jax.report import screen
        from lite6jax.report.listings import arm_entry, arms_report

        entries = [arm_entry(load_bundled(name)) for name in bundled_arms()]
        if self.json:
            _print_json([entry.to_dict() for entry in entries])
            return DONE
        screen.show(arms_report(entries, screen.console().width))
        return DONE


def _print_json(content: object) -> None:
    print(json.dumps(content, indent=1, ensure_ascii=False))
