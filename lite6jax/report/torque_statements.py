"""The sentences of a diagnosis of torques, made from the codes and numbers of its JSON document alone."""

from collections.abc import Mapping
from typing import Any

from lite6jax.report import data_faults
from lite6jax.report.quantities import quantity
from lite6jax.report.statements import capital, effect_title

Document = Mapping[str, Any]
Entry = Mapping[str, Any]

ESTIMATED = (
    "The torques are declared as estimated by the controller: what is found here is what the controller's own model "
    "lacks or has beyond this arm's, not what its motors feel."
)
_VERDICTS = {
    "consistent": "Consistent: the inverse dynamics of the declared arm and the sensors' noise explain the torques.",
    "explained": "Explained: with the effects below, the held-out errors are the sensors' noise.",
    "partly_explained": "Partly explained: the effects below are significant, and more than the declared noise is left.",
    "unnamed": "Unnamed: no effect of the catalogue explains the largest effect that was found.",
    "unexplained": "Unexplained: more is left than the sensors' noise, and no effect is significant.",
    "undetermined": "Undetermined: the recording is too short to tell whether something is missing.",
}


def with_statements(document: Document) -> dict[str, Any]:
    """A diagnosis as in its JSON file: with a `statement` for each finding and data fault."""
    stated = data_faults.with_statements(document)
    effects = document["model"]["effects"]
    stated["findings"] = [
        {**finding, "statement": finding_statement(finding, effect["where"])}
        for finding, effect in zip(document["findings"], effects, strict=True)
    ]
    return stated


def verdict_statement(document: Document) -> str:
    """The verdict in a sentence or two."""
    verdict = document["verdict"]
    if verdict == "partly_explained" and document["noise"]["declared_torque_Nm"] is None:
        return (
            "Partly explained: the effects below are significant. Whether more remains cannot be tested, because the "
            "sidecar declares no torque_noise_Nm."
        )
    return _VERDICTS[verdict]


def finding_statement(finding: Entry, where: Entry) -> str:
    """A finding in one sentence, with its numbers and what it moves.

    Args:
        finding: of the document.
        where: the fields of its effect.
    """
    moved = f"it moves the torque by {finding['moves_rms_Nm']:.3g} Nm RMS"
    if finding["effect"] == "unnamed":
        times = ", times the direction of motion," if where.get("signed") else ""
        driver = finding["driver"].removesuffix(f" and direction of motion of joint {where['joint']}")
        near = ""
        if "nearest" in finding:
            share = 100 * finding["nearest"]["share"]
            near = f" The nearest one, {effect_title(finding['nearest'])}, explains {share:.0f} % of it."
        return (
            f"No effect of the catalogue explains a function of the {driver.replace(' and ', ' and the ')}{times} at "
            f"{finding['site']}: {moved}.{near}"
        )
    sizes = [quantity(*item) for item in finding["parameters"].items()]
    shown = ", ".join(str(size) for size in sizes if size.std)
    return f"{capital(effect_title(finding))} is significant: {shown}; {moved}."


def filter_statement(document: Document) -> str:
    """How both sides of the equation were filtered."""
    used = document["filter"]
    kept = "every sample" if used["every"] == 1 else f"one sample in {used['every']}"
    return (
        f"Torques and model pass the same zero-phase low pass of {used['cutoff_Hz']:.3g} Hz (of "
        f"{used['rate_Hz']:.4g} samples a second), and {kept} is kept; the motion passes one of "
        f"{used['motion_cutoff_Hz']:.3g} Hz before it is differentiated."
    )


def inertial_statement(document: Document) -> str:
    """What was taken as known of the links' inertia."""
    numbers, std = document["nuisance"]["numbers"], document["nuisance"]["relative_std"]
    if not numbers:
        return "The inertial numbers of the links are taken as declared."
    return (
        f"The inertial numbers of the links are fitted, with a prior standard deviation of {100 * std:.2g} % about "
        "the declared ones."
    )


def undistinguished(finding: Entry) -> list[str]:
    """The effects that the recording does not distinguish from a finding."""
    return [effect_title(rival) for rival in finding["confusable_with"] if rival["status"] != "rejected"]
