"""The sentences of a diagnosis of torques, made from the codes and numbers of its JSON document alone."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

from lite6jax.report import data_faults, reference, statements, torque_reference, worth
from lite6jax.report.cells import capital, each_with_unit, multiple, significant, torque_units
from lite6jax.report.quantities import OF_TORQUES, Quantity, quantity
from lite6jax.report.remedies import effect_name
from lite6jax.report.statements import Untested, effect_title

Document = Mapping[str, Any]
Entry = Mapping[str, Any]

ESTIMATED = (
    "The torques are declared as estimated by the controller: the findings are differences between the model of the "
    "controller and the model of this arm, and not effects on the motors."
)
_VERDICTS = {
    "consistent": "Consistent: the inverse dynamics of the declared arm and the sensors' noise explain the torques.",
    "explained": "Explained: with the effects below, the held-out errors are the sensors' noise.",
    "partly_explained": "Partly explained: the effects below are significant, and more than noise is left.",
    "unnamed": "Unnamed: no effect of the catalogue explains the largest effect that was found.",
    "unexplained": "Unexplained: what is left is not the sensors' noise alone, and no effect is significant.",
    "undetermined": "Undetermined: the recording is too short to tell whether something is missing.",
}
_LEFT_OVER = ("partly_explained", "unnamed", "unexplained")
_STANDS_OUT = 2.0
"""Times the others, at which one joint is named apart."""


def with_statements(document: Document) -> dict[str, Any]:
    """A diagnosis as in its JSON file: with a `statement` for each finding and data fault."""
    stated = data_faults.with_statements(document)
    stated["findings"] = statements.stated_findings(document, finding_statement)
    if "against" in document:
        stated["against"] = torque_reference.with_statements(document["against"])
    return stated


def verdict_statement(document: Document) -> str:
    """The verdict in a sentence or two."""
    verdict = document["verdict"]
    if verdict == "partly_explained" and document["noise"]["declared_torque_Nm"] is None:
        return (
            "Partly explained: the effects below are significant. Whether more remains cannot be tested, because the "
            "sidecar declares no torque_noise_Nm."
        )
    if verdict == "consistent" and document["noise"]["declared_torque_Nm"] is None:
        return (
            "Consistent: no effect is significant, and the residuals look like noise. Their size is not tested, as the "
            "sidecar declares no torque_noise_Nm."
        )
    if verdict == "undetermined":
        return f"{statements.undetermined(_VERDICTS[verdict], document)} Record a longer one."
    said = [_VERDICTS[verdict], *(_what_is_left(document["left"]) if verdict in _LEFT_OVER else ())]
    return " ".join(said)


def _what_is_left(left: Entry) -> Iterator[str]:
    """What distinguishes it from noise: its size at each joint, and that neighbouring samples are correlated."""
    if left["torque_over_noise"] is not None:
        yield _over_noise(left["torque_over_noise"])
    if not left["white"]:
        yield "Neighbouring samples of what is left are correlated."


def _over_noise(over_noise: Sequence[float]) -> str:
    """Held-out errors of each joint over its declared noise, and the joint that stands out."""
    joint, most = max(enumerate(over_noise, 1), key=lambda pair: pair[1])
    others = [value for number, value in enumerate(over_noise, 1) if number != joint]
    if others and most > _STANDS_OUT * max(others):
        return (
            f"The held-out errors of joint {joint} are {multiple(most)} times the declared noise, those of the others "
            f"{_from_to(others)} times."
        )
    return f"The held-out errors are {_from_to(over_noise)} times the declared noise, and largest of joint {joint}."


def _from_to(values: Sequence[float]) -> str:
    least, most = map(multiple, (min(values), max(values)))
    return least if least == most else f"{least} to {most}"


def cautions(document: Document) -> list[str]:
    """What qualifies the verdict: torques that the controller computed, effects that were not kept."""
    lines = [ESTIMATED] if document["torque_source"] == "estimated" else []
    if document["withdrawn"]:
        names = ", ".join(effect_title(entry) for entry in document["withdrawn"])
        lines.append(f"Significant, but not kept, because the held-out errors are larger with them: {names}.")
    return lines


def setting_statement(document: Document) -> str:
    """The arm and how much was recorded."""
    return f"{document['model']['arm']}, {document['samples']} samples of torques."


def noise_statement(document: Document) -> str:
    """The noise of each joint's torque, declared and estimated."""
    noise = document["noise"]
    estimated = f"the residuals have {by_joint(document, noise['estimated_torque_Nm'])}"
    if noise["declared_torque_Nm"] is None:
        return f"Noise of the torques, one sigma of each joint in turn: {estimated}; none is declared."
    return (
        f"Noise of the torques, one sigma of each joint in turn: {estimated}; "
        f"{by_joint(document, noise['declared_torque_Nm'])} are declared."
    )


def compared(document: Document) -> reference.Compared | None:
    """The comparison with a reference; None where nothing was compared."""
    return reference.compared(document, partial(torque_reference.headline, units=units(document)))


def units(document: Document) -> tuple[str, ...]:
    """Of each joint: Nm, or N of a prismatic one."""
    return torque_units(statements.sliding(document), len(document["model"]["kinematics"]))


def by_joint(document: Document, values: Sequence[float]) -> str:
    """A number of each joint in turn, with its unit."""
    return each_with_unit(values, units(document))


def common_unit(document: Document) -> str:
    """The unit of what all motors exert; empty where revolute and prismatic joints have two."""
    return "" if len(set(units(document))) > 1 else units(document)[0]


class JointError(NamedTuple):
    """A held-out error: of which joints, its unit, which statistic, and its size before and after."""

    joints: str
    unit: str
    statistic: str
    before: float
    after: float


def errors(document: Document, statistics: Iterable[tuple[str, str]]) -> Iterator[JointError]:
    """The held-out errors of all joints of one kind, and the root mean square of each joint.

    Args:
        document: of torques.
        statistics: of all joints: key, such as `rms`, and words.
    """
    before, after = document["before"], document["after"]
    whose = dict.fromkeys(units(document))
    for key, words in statistics:
        for unit in whose:
            at = f"heldout_torque_{key}_{unit}"
            if at in before and at in after:
                kind = "all" if len(whose) == 1 else "prismatic" if unit == "N" else "revolute"
                yield JointError(f"{kind} joints", unit, words, before[at], after[at])
    by_joint = (stage["heldout_torque_rms_by_joint_Nm"] for stage in (before, after))
    for joint, (unit, own, left) in enumerate(zip(units(document), *by_joint, strict=True), 1):
        yield JointError(f"joint {joint}", unit, "RMS", own, left)


def findings_of(document: Document) -> list[dict[str, Any]]:
    """As `statements.findings_of`."""
    return statements.findings_of(document, finding_statement)


def finding_statement(finding: Entry) -> str:
    """A finding in one sentence, with its numbers and the torque; `finding` has the fields of its effect as `where`."""
    moved = f"it contributes {_moved(finding)}"
    what = "force" if finding["where"].get("of_slide") else "torque"
    if finding["effect"] == "unnamed":
        near = ""
        if "described_by" in finding:
            near = f" {_described(finding['described_by'])}"
        elif "nearest" in finding:
            share = 100 * finding["nearest"]["share"]
            near = f" The nearest named effect, {effect_title(finding['nearest'])}, explains {share:.0f} % of it."
        said = "alone explains" if "described_by" in finding else "explains"
        return (
            f"No effect of the catalogue {said} a {what} at {finding['site']} that is a function of "
            f"{_of_what(finding)}: {moved}.{near}"
        )
    shown = ", ".join(str(size) for size in sizes(finding) if size.std)
    said = "is significant" if worth.is_significant(finding) else "is likely"
    return f"{capital(effect_title(finding))} {said}: {shown}; {moved}."


def _moved(finding: Entry) -> str:
    """What a finding adds to the torques of revolute joints, and to the forces of prismatic ones."""
    pairs = (("moves_rms_Nm", "Nm RMS to the torque"), ("moves_rms_N", "N RMS to the force"))
    return " and ".join(f"{significant(finding[key])} {words}" for key, words in pairs if key in finding)


def _described(entry: Entry) -> str:
    """Which named effects come nearest to a curve."""
    shown = []
    for effect in entry["effects"]:
        ((name, value),) = effect["parameters"].items()
        size = quantity(name, {"value": float(f"{value:.3g}"), "std": 0.0}, OF_TORQUES)
        shown.append(f"{effect_name(effect['effect'])} of {size.value} {size.unit}".strip())
    return f"{capital(' and '.join(shown))} would give {100 * entry['share']:.0f} % of its mean square."


def sizes(finding: Entry) -> list[Quantity]:
    """The numbers of a finding as they are read; of a curve its peak to peak."""
    key = peak_to_peak(finding)
    if key:
        return [quantity(key, {"value": float(f"{finding[key]:.3g}"), "std": 0.0})]
    return [quantity(name, estimate, OF_TORQUES) for name, estimate in finding["parameters"].items()]


def peak_to_peak(finding: Entry) -> str:
    """The key of a curve's peak to peak, which has its unit; empty of an effect with a name."""
    return next((key for key in ("peak_to_peak_Nm", "peak_to_peak_N") if key in finding), "")


def _of_what(finding: Entry) -> str:
    """The drivers of a curve."""
    where, driver = finding["where"], finding["driver"]
    times = ""
    for field, factor in (("signed", "direction of motion"), ("full_load", "gravity torque")):
        if where.get(field):
            times = f", multiplied by the {factor}"
            driver = driver.removesuffix(f" and {factor} of joint {where['joint']}")
    return f"the {driver.replace(' and ', ' and the ')}{times}"


def filter_statement(document: Document) -> str:
    """How both sides of the equation were filtered."""
    used = document["filter"]
    if used is None:
        return (
            "Each row is a posture at rest, in which gravity alone is compared: friction, rotors and delays, which "
            "show in a motion, were not tested."
        )
    kept = "every sample" if used["every"] == 1 else f"one sample in {used['every']}"
    return (
        f"Measured and modelled torques pass the same zero-phase low-pass filter of {used['cutoff_Hz']:.3g} Hz (of "
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


def rejected(finding: Entry) -> list[str]:
    """The nearest effects that explain clearly less."""
    return [effect_title(rival) for rival in finding["confusable_with"] if rival["status"] == "rejected"]


def untested(document: Document) -> list[Untested]:
    """The effects that the recording cannot show, by reason."""
    reason = "What they depend on does not vary in this recording."
    if document["nuisance"]["numbers"]:
        reason = "They are confounded with the inertial numbers that are fitted, or what they depend on does not vary."
    return [group if group.remedy else group._replace(reason=reason) for group in statements.untested(document)]


def what_to_record(document: Document) -> list[str]:
    """A sentence for each question that this recording leaves open and another one answers."""
    lines = statements.what_to_record({**document, "confounded": []})
    if document["confounded"] and document["nuisance"]["numbers"]:
        lines.append(
            "To test for effects that are confounded with the inertial numbers, declare these numbers (`inertial` in "
            "the sidecar)."
        )
    return lines
