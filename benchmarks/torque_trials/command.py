"""`python -m benchmarks torque`: runs the torque trials, or one of them, and says what came of it."""

from collections.abc import Sequence

from benchmarks.campaigns import command
from benchmarks.torque_trials import report
from benchmarks.torque_trials.campaign import TORQUES
from benchmarks.torque_trials.exported import export
from benchmarks.torque_trials.plans import KINDS, indices
from benchmarks.torque_trials.scores import goals

TRIALS = command.Trials(
    name="torque",
    description="Torque recordings of simulated arms whose hidden physics is drawn by a generator that shares no code "
    "with the library, sealed before the diagnosis begins and opened after it; and what the diagnosis is worth.",
    count=500,
    kinds=KINDS,
    indices=indices,
    campaign=TORQUES,
    sections=report.sections,
    goals=goals,
    story=report.story,
    export=export,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code: 0, 1 where a goal is missed, 2 for arguments that cannot be used, 130 where interrupted."""
    return command.main(TRIALS, arguments)
