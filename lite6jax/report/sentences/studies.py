"""What a terminal says of studies and designs, where a condition changes the words; the other texts are in
`templates/studies.yaml`."""

from collections.abc import Sequence

import numpy as np

from lite6jax.design.candidates import Candidates
from lite6jax.design.determination import Determination
from lite6jax.design.identify import Accuracy, Identification
from lite6jax.design.information import Experiment
from lite6jax.design.poses import DiscriminationPlan, Plan
from lite6jax.design.torques import WELL, TorqueExperiment, TorqueIdentification
from lite6jax.formatting import be, capital, counted, joined, number, significant

_MOST_PAIRS = 6
"""Correlated pairs that are listed."""
_CLEAR = 5.0
"""Standard deviations between two models at which a test at a level of 1 % has a power of 99 % or more."""


def unchecked_pairs(disabled: Sequence[tuple[str, str]]) -> list[str]:
    """Says which pairs of links are not checked for collision."""
    if not disabled:
        return []
    pairs = ", ".join(f"{first} with {second}" for first, second in disabled)
    return [f"Not checked for collision, as they overlap nearly always: {pairs}."]


# ------------------------------------------------------------------ what poses determine


def poses_studied(experiment: Experiment, samples: int, drawn: bool, sensor: str) -> str:
    """Says which poses of which arm were studied, and with which sensor."""
    inside = ""
    if drawn:
        inside = " drawn inside the limits"
    return f"{experiment.arm.name}, {counted(samples, 'pose')}{inside}; a sensor of {sensor}."


def _share_determined(rank: int, size: int) -> str:
    if rank == size:
        return f"all {size}"
    return f"{rank} of {size}"


def rank_of_poses(identification: Identification, narrow: str) -> list[str]:
    """Says how many parameters poses determine, and what would determine more; `narrow` names joints that hardly "
    "move."""
    determination = identification.determination
    lines = [f"These poses determine {_share_determined(determination.rank, determination.size)} unknown parameters."]
    if identification.missed:
        remedy = "record more poses, or others (lite6jax design)"
        if narrow:
            remedy = f"{narrow} only; move it further"
        lines.append(f"Other poses of this arm determine {identification.possible.rank}: {remedy}.")
        return lines
    sentence = "Other poses inside its limits determine no more."
    if determination.rank < determination.size and identification.on_last_axis:
        sentence += " The measured point lies on the last joint's axis (--tool-at)."
    lines.append(sentence)
    return lines


def accuracy_of_poses(accuracy: Accuracy, determination: Determination) -> list[str]:
    """Says how accurately a fit predicts the workspace, and which parameters are weak or correlated."""
    lines = []
    if accuracy.position_determined:
        orientation = ""
        if accuracy.orientation_determined:
            orientation = f" and ±{number(float(np.rad2deg(accuracy.orientation_rms)))} deg"
        lines.append(
            f"The fitted model predicts the whole workspace to ±{number(1e3 * accuracy.position_rms)} mm{orientation}."
        )
    else:
        lines.append(
            "The fitted model does not predict the whole workspace: positions there depend on combinations that these "
            "poses do not determine."
        )
    weak = determination.weak()
    if weak:
        lines.append(f"Weak: {joined(weak)} {be(len(weak))} determined no better than by the tolerances of assembly.")
    pairs = [f"{first} with {second} ({rho:+.3f})" for first, second, rho in determination.correlated()]
    if pairs:
        further = ""
        if len(pairs) > _MOST_PAIRS:
            further = f" and {len(pairs) - _MOST_PAIRS} pairs more"
        lines.append(f"Strongly correlated estimates (above 0.95): {', '.join(pairs[:_MOST_PAIRS])}{further}.")
    return lines


# ------------------------------------------------------------------ which poses to record


def design_studied(plan: Plan | DiscriminationPlan, drawn: Candidates, sensor: str) -> str:
    """Says among how many candidates poses were chosen, and how many were refused."""
    refused = ", ".join(f"{name} refused {count}" for name, count in drawn.refused.items() if count)
    if refused:
        refused = f" ({refused})"
    return f"{plan.count} poses of {len(drawn.joint_position)} candidates{refused}; a sensor of {sensor}."


def worth_of_poses(plan: Plan, reached: float, random: float, accuracy: float | None, tried: int) -> list[str]:
    """Says how accurate a fit to designed poses is, beside as many random ones.

    Args:
        plan: the designed poses.
        reached: m, the accuracy that they allow; infinite where it is unbounded.
        random: m, the same of random ones.
        accuracy: m, that was asked for, if one was.
        tried: the most poses that were tried for it.
    """
    lines = []
    if not np.isfinite(reached):
        lines.append(
            "Positions over the workspace depend on combinations that this sensor does not determine, however many the "
            "poses: the accuracy of predictions is unbounded (lite6jax identify names the combinations)."
        )
    else:
        beside = "do not determine all parameters"
        if np.isfinite(random):
            beside = f"to ±{number(1e3 * random)} mm ({random / reached:.2f} times as much)"
        lines.append(
            f"These poses let the fit predict positions to ±{number(1e3 * reached)} mm over the workspace; as many "
            f"drawn at random {beside}."
        )
        if plan.worth is None:
            lines.append(f"{len(plan.random_accuracy)} random poses predict less accurately.")
        else:
            lines.append(f"They are worth {plan.worth} random poses.")
    if accuracy is not None:
        lines.append(_poses_needed(plan, f"±{number(1e3 * accuracy)} mm", tried))
    return lines


def _poses_needed(plan: Plan, accuracy: str, tried: int) -> str:
    """Says how many poses an accuracy takes."""
    needed = plan.needed
    if needed is None:
        return f"{accuracy} is not reached by {tried} poses either."
    if needed <= plan.count:
        return f"{accuracy} is reached by {needed} of them; give --poses {needed}."
    return f"{accuracy} takes {needed} poses; give --poses {needed}."


def rivals_apart(plan: DiscriminationPlan, reached: float, random: float) -> list[str]:
    """Says how many standard deviations two effects are apart at designed poses, and at random ones."""
    first, second = plan.rivals
    ratio = ""
    if random > 0:
        ratio = f" (ratio {reached / random:.2f})"
    lines = [
        f"If {first} has the size given, the readings at these poses are {reached:.1f} standard deviations from the "
        f"closest that {second} explains with all other unknowns refitted; {random:.1f} at as many drawn at "
        f"random{ratio}."
    ]
    if reached < _CLEAR:
        lines.append(f"A reliable decision takes {_CLEAR:g}: record more poses, or use a sensor with less noise.")
    return lines


# ------------------------------------------------------------------ what motions determine


def rank_of_motion(rank: int, links: int, joints: int, inertial: bool) -> str:
    """Says how many base parameters a motion determines, and of what they are."""
    of_links = ""
    if inertial:
        of_links = f"{links} of the links, "
    return (
        f"This motion determines {_share_determined(rank, links + joints)} base parameters ({of_links}{joints} of the "
        "joints)."
    )


def missed_by_motion(
    identification: TorqueIdentification, missed: Sequence[str], narrow: str, none_moves: bool
) -> list[str]:
    """Says which parameters a motion does not determine, and which motion would; `narrow` names joints that hardly "
    "move."""
    lines = []
    if missed:
        lines.append(f"Not determined apart from others: {', '.join(missed)}.")
        lines.append(_motion_to_record(identification, narrow, none_moves))
    silent = identification.model.silent
    if silent:
        lines.append(f"No torque changes with {', '.join(silent)}.")
    return lines


def _motion_to_record(identification: TorqueIdentification, narrow: str, none_moves: bool) -> str:
    """Says which motion determines more."""
    if none_moves:
        return "No joint moves over more than 10 deg: record a motion of all joints (lite6jax design --torque)."
    if narrow:
        return f"{capital(narrow)} only; move it further."
    if identification.at_rest:
        return "The arm stands still in all samples, which show gravity only: record it in motion."
    return "Another motion determines them: record a longer one, or that of lite6jax design --torque."


def links_in_combinations(model: TorqueExperiment) -> list[str]:
    """Says which inertial numbers of links show only together with others."""
    names = [name for name in model.confounded if name.startswith("link")]
    if not names:
        return []
    return [f"Only in combinations: {', '.join(names)}."]


def quality_of_motion(identification: TorqueIdentification, weak: Sequence[str]) -> list[str]:
    """Says the condition of a motion, and which parameters are weak."""
    lines = ["Nothing is determined."]
    if identification.determined.any():
        lines = [
            f"Condition number {significant(identification.condition, 4)} (regressor in standard deviations, "
            "parameters in typical sizes)."
        ]
    if weak:
        lines.append(f"Weak: {', '.join(weak)} (over {100 * WELL:.0f} % of the typical size).")
    return lines


def gain_of_motion(median: str, best: str, count: int) -> str:
    """Says how many times smaller the standard deviations of a designed motion are than those of random ones.

    Each is the ratio as shown: beside the median, and beside the best, of `count` motions; empty where random motions
    do not determine all parameters.
    """
    if not best:
        return f"None of {count} random motions of the same limits determines all of them."
    smaller = "much"
    if median:
        smaller = f"{median} times"
    return (
        f"In the geometric mean its standard deviations are {smaller} smaller than those of a random motion of the "
        f"same limits (the median of {count}), {best} times smaller than those of the best of them."
    )
