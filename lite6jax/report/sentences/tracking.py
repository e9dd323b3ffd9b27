"""What is said of a diagnosis of commands and measured joints, where a condition changes the words; the other texts are
in `templates/tracking.yaml`. All lengths of angles are in mrad."""

from collections.abc import Mapping, Sequence
from typing import Any

from lite6jax.formatting import capital, joined, joints_named, paragraph, plural
from lite6jax.report.remedies import place_of
from lite6jax.report.words import fill, read_texts

Document = Mapping[str, Any]
Entry = Mapping[str, Any]

_TEXTS = read_texts("tracking.yaml")


def headline_of_findings(cause: str, before: str, after: str, count: int) -> str:
    """Says the cause, and what is left of the errors with so many findings."""
    model = plural(count, "with it", f"with all {count} findings")
    return f"{capital(cause)}: of {before} mrad RMS between the arm and its rollout, {after} mrad are left {model}."


def joint_following(
    joint: int,
    lag: str,
    delay: str,
    sag: str,
    error: str,
    remainder: str,
    lacking: Sequence[str],
    ratios: Sequence[str],
    has_simulator: bool,
) -> str:
    """Says how a joint follows its commands, what is left of its tracking error, and what is not so in its model.

    Lag and delay are in ms, the sag in mrad per Nm, errors in mrad RMS; without a delay or a sag it is left out.
    """
    behind = f"Joint {joint} lags {lag} ms"
    if delay:
        behind += f" after a delay of {delay} ms"
    if sag:
        behind += f" and sags {sag} mrad per Nm"
    model = "your model"
    if has_simulator:
        model = "your simulator"
    parts = [behind, f"of {error} mrad RMS tracking error {remainder} is left"]
    if lacking:
        parts.append(f"{joined(lacking)}, which {model} lacks")
    if ratios:
        parts.append(f"its {joined(ratios)} times that of {model}")
    return f"{'; '.join(parts)}."


def headline_without_findings(verdict: str, after: str) -> str:
    """Says what the errors are, where nothing was found."""
    if verdict == "consistent":
        return (
            f"The arm follows its commands as described: nothing is missing from the model, and {after} mrad RMS "
            "between the arm and its rollout are noise."
        )
    error = f"{after} mrad RMS between the arm and its rollout are"
    if verdict == "undetermined":
        return f"{error} noise, or noise and one more effect, which is nearly significant."
    return f"{error} more than noise, and no effect explains them."


def verdict_sentence(document: Document, ratios: str, near: str) -> str:
    """Says the verdict; `ratios` are errors over noise, `near` is the nearest effect that is no finding."""
    if document["verdict"] != "consistent":
        return fill(_TEXTS["verdict"][document["verdict"]], {"ratios": ratios, "near": near})
    servos = "servos with a stiffness and a damping"
    if document["servo"] == "declared":
        servos = "the declared servos"
    return f"Consistent: {servos}, the arm as described and the noise of the encoders explain where the joints were."


def setting(document: Document) -> str:
    """Says which arm was diagnosed, from how much, and what is known of its servos."""
    if "simulator" in document:
        servos = f"those of your simulator, {document['simulator']['file']}."
    elif document["servo"] == "declared":
        servos = "as declared in the sidecar."
    else:
        servos = "not declared: stiffness and damping of each joint were fitted."
    masses = ""
    if not document["masses"]:
        masses = "The masses are not known: stiffness is known up to a factor."
    return paragraph(
        f"{document['model']['arm']}, {document['samples']} samples of commands and joints on an even grid; the servos "
        f"are {servos}",
        masses,
    )


def held_out(document: Document) -> str:
    """Says how errors were held out, and what they are compared with."""
    simulator = ""
    if "simulator" in document:
        simulator = "MuJoCo itself, from the same commands, is your simulator."
    return paragraph(fill(_TEXTS["held_out"], {"heldout_rows": document["heldout_rows"]}), simulator)


def simulator_differs(joint: int, apart: str, reasons: Sequence[str]) -> str:
    """Says how far a simulator is from the same model here, and why."""
    start = f"At joint {joint} MuJoCo is {apart} mrad RMS from the rollout here of the same model"
    if reasons:
        return f"{start}: {'; '.join(reasons)}."
    return f"{start}, by what only MuJoCo has in that file."


def withdrawn_effects(names: Sequence[str]) -> str:
    """Says which significant effects were not kept."""
    them = plural(len(names), "it", "them")
    return f"Significant, but not kept, because held-out rollouts err more with {them}: {', '.join(names)}."


def shift_of_loop(component: str, site: str) -> str:
    """Says that the command or the read-out of a joint is off; a clause in small letters."""
    return f"the {component} of {place_of(site)} is off"


def finding_sentence(finding: Entry, title: str, numbers: str, moves: str) -> str:
    """Says which effect was found, with its numbers and what it moves."""
    subject = title
    component = finding.get("component")
    if component:
        subject = f"{capital(shift_of_loop(component, finding['site']))} as a function of the {finding['driver']}"
    elif finding["effect"] == "unnamed":
        subject = (
            f"No effect of the catalogue explains a torque at {finding['site']} that depends on the {finding['driver']}"
        )
    if numbers:
        subject += f": {numbers}"
    return f"{subject}; it moves {joints_named(finding['joints'])} by {moves} mrad RMS."
