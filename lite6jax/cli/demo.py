"""The command that shows the point: a simulated arm with two hidden faults is diagnosed, its factory file fitted."""

import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from lite6jax.cli import command
from lite6jax.cli.diagnose import DiagnoseCommand
from lite6jax.cli.fit import FitCommand
from lite6jax.deferred import import_lazily
from lite6jax.errors import InputError, command_line
from lite6jax.storage import exists, write_atomically

with import_lazily():
    from lite6jax import formatting, recordings, simulation
    from lite6jax.arms import factory as factories
    from lite6jax.effects import serialization
    from lite6jax.report import screen, sections, words

if TYPE_CHECKING:
    from rich.console import RenderableType

CALIBRATION = Path(__file__).parents[1] / "demo" / "lite6_simulated.yaml"
"""The factory calibration of the simulated arm."""
FOLDER = Path("lite6jax-demo")
HIDDEN = ("joint_compliance:joint=2,compliance_rad_per_Nm=9e-5", "joint_backlash:joint=4,gap_rad=1.5e-3")
"""The faults: each is far above the noise of the tracker, and only one of them can be seen without a model."""
_RANKING = "What each finding moves (mm RMS)"
POSES = 200
"""Enough for both faults in half a minute on two cores with nothing compiled before."""


@dataclass(frozen=True)
class DemoCommand:
    """See what the program does: simulate a Lite 6 with two hidden faults, diagnose it, write the page with the
    figures, and fit the arm's factory calibration. Takes less than a minute.

    For example:

        lite6jax demo
        lite6jax demo first_look
    """

    folder: Annotated[Positional[Path | None], arg(metavar="DIR")] = None
    """Write the files here; into lite6jax-demo, or lite6jax-demo-2 …, where not given."""
    force: command.Force = False

    def run(self) -> int:
        """Simulates, diagnoses, fits, and shows what was hidden beside what was found."""
        numbered = (FOLDER.with_name(f"{FOLDER.name}-{number}") for number in count(2))
        free = (folder for folder in chain([FOLDER], numbered) if self.force or not exists(folder))
        folder = self.folder or next(free)
        run, factory, diagnosis, page, table = (
            folder / name for name in ("run.csv", "factory.yaml", "diagnosis.json", "report.html", "model.json")
        )
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{folder}: this folder cannot be created ({error.strerror}); choose another") from error
        outputs = [run, run.with_suffix(".yaml"), factory, diagnosis, page, table]
        command.check_outputs(outputs, [CALIBRATION], self.force)
        write_atomically(factory, CALIBRATION.read_bytes(), self.force)
        arm = factories.read_factory(factory)
        settings = recordings.RecordingSettings(arm="lite6", factory_calibration=factory.name)
        simulated = simulation.simulate(
            arm.arm, effects=HIDDEN, samples=POSES, kinematics=arm.kinematics, settings=settings
        )
        simulated.save(run, overwrite=self.force)
        screen.show(command.say("demo", poses=POSES, run=run))
        diagnose_command = DiagnoseCommand(run, out=diagnosis, report=page, quick=True, force=self.force)
        _, result = diagnose_command.search()
        document = diagnose_command.document(result)
        diagnose_command.write(result, document)
        main = [section for section in sections.sections_of(document) if section.title in ("", _RANKING)]
        _print_command("diagnose", run, "--quick", out=diagnosis, report=page)
        screen.show(sections.show_sections(main))
        screen.show(command.say("demo_fit"))
        _print_command("fit", factory, out=table)
        print()
        FitCommand(factory, out=table, force=self.force).run()
        screen.show(_compare(result))
        print(f"  {page}")
        return command.DONE


def _print_command(*arguments: object, **files: Path) -> None:
    """A command to copy, with a line for each option that names a file."""
    options = (f"--{name} {shlex.quote(str(path))}" for name, path in files.items())
    print(" \\\n    ".join([f"$ {command_line(*arguments)}", *options]))


def _compare(result: Any) -> "Iterator[RenderableType]":
    """The hidden faults beside the findings."""
    findings = {finding.effect.label: finding.parameters for finding in result.findings}
    table = words.listing("", "hidden", "found", "")
    hidden = [serialization.parse_effect(text) for text in HIDDEN]
    for effect, values in hidden:
        for parameter, true in effect.reported(values).items():
            truth = formatting.quantity(parameter, true._asdict())
            shown = "not found"
            if effect.label in findings:
                estimate = formatting.quantity(parameter, findings[effect.label][parameter]._asdict())
                shown = f"{estimate.value} ± {estimate.std}"
            table.add_row(f"{effect.name.replace('_', ' ')} at {effect.site}", truth.value, shown, truth.unit)
    yield from ["", "3. What was hidden, and what was found", table]
    if unexpected := [label for label in findings if label not in {effect.label for effect, _ in hidden}]:
        yield f"Found and not hidden: {', '.join(unexpected)}."
    yield from ["", "The page with the figures, to be opened in a browser:"]
