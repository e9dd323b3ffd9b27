"""What is said of a diagnosis of poses or of torques, where a condition changes the words.

Each sentence is made from the JSON document alone. The other texts are in `templates/diagnosis.yaml`.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from lite6jax.calibration.quality import NOISES
from lite6jax.diagnosis.document import domain_of, domains_beside, is_of_torques
from lite6jax.domains.base import DomainName
from lite6jax.domains.registry import DOMAINS
from lite6jax.effects.drivers import driver_of
from lite6jax.errors import command_line
from lite6jax.formatting import (
    capital,
    counted,
    each_with_unit,
    joined,
    milli,
    multiple,
    number,
    paragraph,
    plural,
    rows_named,
    significant,
)
from lite6jax.report.remedies import component, drivers_of, effect_name, effect_title, shape, with_articles
from lite6jax.report.sentences.document import (
    Document,
    Entry,
    corrected_faults,
    declares_noise,
    has_computed_poses,
    nearly_significant,
    undeclared_noise,
    units,
    whose_noise,
)
from lite6jax.report.words import fill, read_texts

_TEXTS = read_texts("diagnosis.yaml")
_STANDS_OUT = 2.0
"""Times the others, at which one joint is named apart."""


# ------------------------------------------------------------------ the verdict


def verdict_statement(document: Document) -> str:
    """Says the verdict in a few sentences, with what is left and where that acts."""
    verdict = document["verdict"]
    if verdict == "consistent":
        return consistent(document)
    if verdict == "explained":
        return f"Explained: with the effects below, the held-out errors are the {whose_noise(document)} noise."
    if verdict == "partly_explained":
        sentence = partly_explained(document)
    elif verdict == "unnamed":
        sentence = unnamed(document)
    elif verdict == "unexplained":
        sentence = unexplained(document)
    else:
        sentence = undetermined(document)
    where = document["left"]["acts_at"]
    if where is None:
        return sentence
    return f"{sentence} {fill(_TEXTS['acts_at'], where)}"


def consistent(document: Document) -> str:
    """Says that nothing was found and that what is left is noise."""
    torques = is_of_torques(document)
    if has_computed_poses(document):
        return "Consistent: the table of the arm reproduces what the controller computed from the joints."
    if "against" in document and not torques:
        return "Consistent: beyond the differences above, the two recordings differ by noise."
    corrected = ""
    if corrected_faults(document):
        corrected = ", with the faults of the data corrected"
    if not declares_noise(document):
        return (
            f"Consistent{corrected}: no effect is significant, and the residuals look like noise. Their size is not "
            f"tested, as the sidecar declares {undeclared_noise(document)}."
        )
    if torques:
        return "Consistent: the inverse dynamics of the declared arm and the sensors' noise explain the torques."
    return f"Consistent{corrected}: the model of the arm and the sensor's noise explain the recording."


def partly_explained(document: Document) -> str:
    """Says that more than noise is left beside the findings."""
    sentence = "Partly explained: the effects below are significant"
    if not declares_noise(document):
        return (
            f"{sentence}. Whether more remains cannot be tested, because the sidecar declares "
            f"{undeclared_noise(document)}."
        )
    if is_of_torques(document):
        sentence += ", and more than noise is left"
    return paragraph(f"{sentence}.", error_ratios(document))


def unnamed(document: Document) -> str:
    """Says that the largest effect has no name."""
    sentence = "Unnamed: no effect of the catalogue explains the largest effect that was found."
    if not is_of_torques(document):
        return sentence
    return paragraph(sentence, error_ratios(document))


def unexplained(document: Document) -> str:
    """Says that more than noise is left, and that nothing explains it."""
    torques = is_of_torques(document)
    if not torques and document["quality"]["verdict"] == "bad":
        return "Unexplained: the model of the arm does not describe the poses, and no effect explains why."
    times = max(ratio or 0.0 for ratio in document["left"]["over_noise"].values())
    if not torques and times > NOISES:
        return (
            f"Unexplained: no effect that was tested explains the residuals, which are {multiple(times)} times the "
            "declared noise: check the arm, the frame, the tool and the columns that the sidecar declares."
        )
    return paragraph(
        f"Unexplained: what is left is not the {whose_noise(document)} noise alone, and no effect is significant.",
        error_ratios(document),
    )


def undetermined(document: Document) -> str:
    """Says what the recording is too short to tell, and how much more it takes."""
    near = nearly_significant(document)
    torques = is_of_torques(document)
    if near:
        below = ""
        if document["findings"]:
            below = ", with the effects below,"
        open_question = (
            f"what is left{below} is noise, but {effect_name(near['effect'])} at {near['site']} is nearly significant "
            f"(family-wise p-value {significant(near['p_value'], 2)})."
        )
    elif torques:
        open_question = "the recording is too short to tell whether something is missing."
    else:
        open_question = "there are too few rows to tell whether something is missing."
    if torques:
        return f"Undetermined: {open_question} Record a longer one."
    more = counted(document["rows_needed"] - document["samples"], "more pose")
    return f"Undetermined: {open_question} Record about {more}."


def error_ratios(document: Document) -> str:
    """Says how many times the noise the errors are, and whether they are correlated."""
    if is_of_torques(document):
        correlated = ""
        if not document["left"]["white"]:
            correlated = "Neighbouring samples of what is left are correlated."
        return paragraph(_torque_ratios(document), correlated)
    parts = []
    for what, ratio in document["left"]["over_noise"].items():
        if ratio is None:
            continue
        held_out = ""
        if what == "position":
            held_out = "held-out "
        parts.append(f"{held_out}{what} errors are {multiple(ratio)} times the declared noise")
    if not document["left"]["white"]:
        parts.append("neighbouring rows are correlated")
    return f"{capital(joined(parts))}."


def _torque_ratios(document: Document) -> str:
    """Says how many times the noise the errors of torques are, and of which joint they are largest."""
    sizes = [ratio for ratio in document["left"]["over_noise"].values() if ratio is not None]
    if not sizes:
        return ""
    joint, largest = max(enumerate(sizes, 1), key=lambda pair: pair[1])
    remaining = sizes[: joint - 1] + sizes[joint:]
    if remaining and largest > _STANDS_OUT * max(remaining):
        sentence = (
            f"The held-out errors of joint {joint} are {multiple(largest)} times the declared noise, those of the "
            f"others {_range(remaining)} times."
        )
    else:
        sentence = f"The held-out errors are {_range(sizes)} times the declared noise, and largest of joint {joint}."
    between = (document["left"].get("between_reversals") or {}).get(f"joint{joint}", largest)
    if between >= 0.5 * (1 + largest):  # most of the excess over noise
        return sentence
    return (
        f"{sentence} They are larger where joint {joint} reverses: within a sample it is not known when its friction "
        f"turns. Elsewhere they are {multiple(between)} times."
    )


def _range(ratios: Sequence[float]) -> str:
    return " to ".join(dict.fromkeys(map(multiple, (min(ratios), max(ratios)))))


# ------------------------------------------------------------------ what qualifies the verdict


def not_measured(document: Document) -> list[str]:
    """Says that the controller computed the poses or the torques."""
    lines = []
    if has_computed_poses(document):
        lines.append(
            "The poses are the controller's own computation from the joints: they test nothing but the table of the "
            "arm. To diagnose the arm itself, record the poses with a sensor."
        )
    if is_of_torques(document) and document["source"] == "estimated":
        lines.append(
            "The torques are declared as estimated by the controller: the findings are differences between the model "
            "of the controller and the model of this arm, and not effects on the motors."
        )
    return lines


def refusal(domain: DomainName, reason: str) -> str:
    """Says why a recording was not diagnosed by a domain beside another."""
    return f"The {DOMAINS[domain].measured} of this recording are not diagnosed: {reason}."


def measured(document: Document) -> str:
    """Names what a recording of several domains was diagnosed by."""
    domains = (domain_of(document), *domains_beside(document))
    return joined([DOMAINS[domain].measured for domain in domains])


def nothing_shared(document: Document) -> str:
    """Says that domains have nothing to be compared."""
    return f"No finding concerns a quantity on which both {measured(document)} depend."


def withdrawn_effects(document: Document) -> str:
    """Says which significant effects were not kept, and why."""
    withdrawn = document["withdrawn"]
    names = list(map(effect_title, withdrawn["effects"]))
    if is_of_torques(document):
        return f"Significant, but not kept, because the held-out errors are larger with them: {', '.join(names)}."
    count = len(names)
    before = 1e3 * withdrawn["before"]["heldout_position_rms_m"]
    after = 1e3 * withdrawn["after"]["heldout_position_rms_m"]
    start = (
        f"{capital(joined(names))} {plural(count, 'was', 'were')} significant, but "
        f"{plural(count, 'it is', 'they are')} not kept:"
    )
    if after > before:
        return (
            f"{start} the errors on held-out rows are larger ({number(after, 3)} mm RMS of position) than without "
            f"({number(before, 3)} mm)."
        )
    return (
        f"{start} what is left on held-out rows is several times what is left of the fitted ones ({number(after, 3)} "
        f"mm RMS of position; {number(before, 3)} mm without)."
    )


# ------------------------------------------------------------------ the recording, its errors and their noise


def setting(document: Document) -> str:
    """Says which arm was diagnosed, and from how much."""
    model = document["model"]
    start = f"{model['arm']}, {document['samples']} samples"
    if is_of_torques(document):
        return f"{start} of torques."
    return f"{start} ({model['motion']})."


def held_out(document: Document) -> str:
    """Says how errors were held out."""
    rows = "rows"
    if is_of_torques(document):
        rows = "filtered samples"
    start = f"Errors of {document['heldout_rows']} {rows}, held out in {document['heldout_blocks']} contiguous blocks"
    again = document["searched_again"]
    if again:
        sentence = (
            f"{start}, several at a time: the effects found in all rows were fitted again without them. Of "
            f"{again['blocks']} contiguous blocks, the errors with effects are {significant(again['heldout_ratio'])} "
            "times those without: a block alone may show a part of the effects."
        )
    else:
        sentence = f"{start}: screening and fit of each did without it, and so did the choice among the effects found."
    if document["quick"]:
        sentence += (
            " This was a quick diagnosis: fewer blocks than usual, so that each is predicted from fewer rows and the "
            "errors are rather too large; poses that separate rival effects were not designed."
        )
    return sentence


def noise(document: Document) -> str:
    """Says the noise that the residuals have, beside the declared one."""
    estimated = document["noise"]["estimated"]
    declared = document["noise"]["declared"]
    if is_of_torques(document):
        joint_units = units(document)
        comparison = "none is declared."
        if declared["torque_Nm"] is not None:
            comparison = f"{each_with_unit(declared['torque_Nm'], joint_units)} are declared."
        return (
            "Noise of the torques, one sigma of each joint in turn: the residuals have "
            f"{each_with_unit(estimated['torque_Nm'], joint_units)}; {comparison}"
        )
    comparison = "none is declared."
    if declared["position_m"] is not None:
        comparison = f"{number(1e3 * declared['position_m'])} mm is declared."
    size = number(1e3 * estimated["position_m"])
    return f"Noise per axis of position: the residuals have {size} mm, {comparison}"


def assumptions(document: Document) -> list[str]:
    """Says on what the tests rest beyond the recording."""
    if is_of_torques(document):
        return [_filtering(document), _inertial_numbers(document)]
    lines = []
    drivers = [driver for finding in document["findings"] for driver in drivers_of(finding)]
    if document["model"]["accelerated"] and any(driver_of(driver).loaded for driver in drivers):
        lines.append("The loads include the inertial forces of the moving arm, which the recording supports.")
    undeclared = undeclared_noise(document)
    if undeclared:
        lines.append(f"The sidecar declares {undeclared}: tests use the noise estimated from the residuals.")
    if document["left_out"]:
        lines.append(
            f"A gear may be between its flanks in {rows_named(document['left_out'])}: estimates do without, and the "
            "held-out errors include them."
        )
    return lines


def _filtering(document: Document) -> str:
    """Says through which filters torques and motion pass."""
    low_pass = document["filter"]
    if low_pass is None:
        return (
            "Each row is a posture at rest, in which gravity alone is compared: friction, rotors and delays, which "
            "show in a motion, were not tested."
        )
    kept_samples = f"one sample in {low_pass['every']}"
    if low_pass["every"] == 1:
        kept_samples = "every sample"
    return (
        "Measured and modelled torques pass the same zero-phase low-pass filter of "
        f"{significant(low_pass['cutoff_Hz'])} Hz (of {significant(low_pass['rate_Hz'], 4)} samples a second), and "
        f"{kept_samples} is kept; the motion passes one of {significant(low_pass['motion_cutoff_Hz'])} Hz before it is "
        "differentiated."
    )


def _inertial_numbers(document: Document) -> str:
    """Says whether the inertial numbers of the links are fitted."""
    nuisance = document["nuisance"]
    if not nuisance["numbers"]:
        return "The inertial numbers of the links are taken as declared."
    return (
        "The inertial numbers of the links are fitted, with a prior standard deviation of "
        f"{significant(100 * nuisance['relative_std'], 2)} % about the declared ones."
    )


# ------------------------------------------------------------------ findings


def unnamed_torque(finding: Entry, exerted: str, moves: str) -> str:
    """Says that a function which the catalogue does not have contributes to the torque of a joint."""
    sentence = (
        f"No effect of the catalogue explains a {exerted} at {finding['site']} that is a function of the "
        f"{with_articles(finding['driver'])}: it contributes {moves}."
    )
    if "nearest" not in finding:
        return sentence
    nearest = finding["nearest"]
    return (
        f"{sentence} The nearest named effect, {effect_title(nearest)}, explains {100 * nearest['share']:.0f} % of it."
    )


def unnamed_displacement(finding: Entry, numbers: str, moves: str) -> str:
    """Says that a function which the catalogue does not have moves the measured point."""
    where = finding["where"]
    return (
        f"No effect of the catalogue explains an effect at {finding['site']}{component(where)} as a function of the "
        f"{with_articles(finding['driver'])}: {shape(where)} ({finding['effective_parameters']:.0f} effective "
        f"parameters), {numbers}; it moves the measured point by {moves}."
    )


def named_torque(title: str, numbers: str, moves: str) -> str:
    """Says that an effect of the catalogue contributes to the torque of a joint."""
    return f"{capital(title)} is significant: {numbers}; it contributes {moves}."


def named_displacement(finding: Entry, title: str, numbers: str, moves: str) -> str:
    """Says that an effect of the catalogue moves the measured point."""
    driven = ""
    if finding["driver"] != "none":
        driven = f", a function of the {with_articles(finding['driver'])},"
    return f"{capital(title)}{driven} is significant: {numbers}; it moves the measured point by {moves}."


# ------------------------------------------------------------------ the first sentence


class Worth(NamedTuple):
    """What the largest finding moves, beside the held-out errors before and after, each as shown.

    Attributes:
        moved: what it moves.
        exceeds: whether that is more than the error before, since others cancel a part.
        before: the error without findings.
        after: the error with all of them.
        unit: of the three.
    """

    moved: str
    exceeds: bool
    before: str
    after: str
    unit: str


def headline(document: Document, cause: str, worth: Worth, of_arm: bool) -> str:
    """Says the cause and its worth; findings of the arm alone can be compensated."""
    unit = worth.unit
    share = f"{worth.moved} of {worth.before} {unit}"
    if worth.exceeds:
        share = f"{worth.moved} {unit}, which others partly cancel"
    count = len(document["findings"])
    if count == 1 and of_arm:
        remedy = "compensated"
    elif count == 1:
        remedy = "with it in the model"
    else:
        counted_findings = "both"
        if count > 2:
            counted_findings = f"all {count}"
        how = "in the model"
        if of_arm:
            how = "compensated"
        remedy = f"with {counted_findings} findings {how}"
    noise_left = ""
    if document["verdict"] == "explained":
        noise_left = f", the {whose_noise(document)} noise"
    return f"{capital(cause)}: {share}; {remedy}, {worth.after} {unit} is left{noise_left}."


def nothing_found(document: Document, error: str) -> str:
    """Says what the error is, where no effect was found; begins with a small letter."""
    verdict = document["verdict"]
    declared = next(iter(document["noise"]["declared"].values()))
    if verdict == "consistent" and has_computed_poses(document):
        return f"the poses are the controller's own computation: the arm's table reproduces them to {error}."
    if verdict == "consistent" and declared is None:
        key = "position_noise_m"
        if is_of_torques(document):
            key = "torque_noise_Nm"
        return f"no effect is significant, and the error of {error} looks like noise; declare {key} to test this."
    if verdict == "consistent":
        return f"nothing is missing from the model: the error of {error} is the {whose_noise(document)} noise."
    if verdict != "undetermined":
        source = "poses"
        if is_of_torques(document):
            source = "torques"
        return f"the error of {error} is not the noise of the {source} alone, and nothing explains it."
    if nearly_significant(document):
        return f"the error of {error} is noise, or noise and one more effect, which is nearly significant."
    return f"the recording is too short to tell what the error of {error} is."


# ------------------------------------------------------------------ the comparison with a reference recording


def comparison_headline(comparison: Document, joint_units: Iterable[str] = ()) -> str:
    """Says what was compared, and how far apart it is; of poses, whether the model reproduces the reference."""
    file = comparison["file"]
    if comparison["basis"] == "effects":
        return f"Reference {file}: another motion, so that each recording was diagnosed on its own."
    matched = comparison["matched_rows"]
    rows = f"{matched} of {comparison['rows']}"
    if matched == comparison["rows"]:
        rows = f"{matched}"
    if comparison["basis"] == "rows":
        shown_units = tuple(joint_units)
        return (
            f"Reference {file}, {rows} rows of the same motion. Its torques differ from this recording by "
            f"{each_with_unit(comparison['apart_rms_by_joint_Nm'], shown_units)} RMS (each joint in turn), and from "
            f"the declared rigid arm by {each_with_unit(comparison['reference_rms_by_joint_Nm'], shown_units)}."
        )
    reproduces = "does not reproduce"
    if comparison["reproduced"]:
        reproduces = "reproduces"
    sentence = (
        f"Reference {file}, {rows} rows: the model {reproduces} it, with position errors of "
        f"{number(1e3 * comparison['position_rms_m'])} mm RMS and {number(1e3 * comparison['position_max_m'])} mm at "
        "most."
    )
    if not comparison["differences"]:
        return sentence
    return f"{sentence} With the differences below, {number(1e3 * comparison['left_position_rms_m'])} mm RMS remain."


def reduction(before: float, after: float, together: bool) -> str:
    """Says from what to what differences reduce the position error, m."""
    start = "This reduces"
    if together:
        start = "Together they reduce"
    return f"{start} the position error from {milli(before)} mm to {milli(after)} mm RMS."


def difference_statement(entry: Entry, file: str) -> str:
    """Says in what the arm of a reference differs."""
    difference = entry["difference"]
    if difference == "other_table":
        return f"{file} uses {_chain(entry['reference'])}; this model uses {_chain(entry['model'])}."
    if difference in ("other_frame", "other_tool"):
        return _displaced(entry)
    if difference == "other_geometry":
        return _other_geometry(entry)
    if difference == "not_rigid":
        return _not_rigid(entry, file)
    return fill(_TEXTS["differences"][difference], entry, file=file)


def _chain(table: Entry) -> str:
    return f"{_TEXTS['chains'][table['kind']]} ({table['name']})"


def _displaced(entry: Entry) -> str:
    """Says how far the base frame or the tool is from the declared one."""
    part = "base frame"
    if entry["difference"] == "other_tool":
        part = "tool"
    turned = ""
    if entry["rotation_rad"] is not None:
        turned = f" and rotated by {milli(entry['rotation_rad'])} mrad"
    shift = ", ".join(map(milli, entry["translation_m"]))
    return f"Its {part} is displaced from the declared one by ({shift}) mm{turned}."


def _other_geometry(entry: Entry) -> str:
    """Says by which displacements of links another geometry is explained."""
    parts = []
    for link in entry["links"]:
        name = "the base"
        if link["link"]:
            name = f"link {link['link']}"
        parts.append(f"{name} by {milli(link['distance_m'])} mm and {milli(link['rotation_rad'])} mrad")
    return f"Its geometry differs; the smallest displacements that explain it are {', '.join(parts)}."


def _not_rigid(entry: Entry, file: str) -> str:
    """Says what no rigid arm explains, and how to find its causes."""
    remedy = ""
    if not entry["noise_declared"]:
        remedy = "; if this is noise, declare position_noise_m in its sidecar"
    return (
        f"No rigid arm explains it completely: {milli(entry['position_rms_after_m'])} mm RMS remain, whose causes "
        f"`{command_line('diagnose', file)}` would find{remedy}."
    )


def effect_of_both(entry: Entry, title: str, sides: Mapping[str, str]) -> str:
    """Says whether an effect differs between a recording and its reference; what each says is in `sides`."""
    recording = sides["recording"]
    reference = sides["reference"]
    if entry["agree"] is None:
        without = "this recording"
        if entry["reference"] is None:
            without = "the reference"
        return f"{title}: {recording or reference}; {without} does not show it."
    values = paragraph(recording, "here,", reference, "in the reference.")
    if entry["agree"]:
        return f"{title} does not differ beyond the uncertainty: {values}"
    return f"{title} differs (p = {significant(entry['p_value'], 2)}): {values}"


def shared_quantity(entry: Entry, sides: Mapping[DomainName, str]) -> str:
    """Says whether two domains agree on a quantity on which both depend; what they say is in `sides`."""
    quantity = _TEXTS["quantities"][entry["quantity"]]
    place = f" at {entry['site']}" if "site" in entry else ""
    start = f"Of {quantity['name']}{place},"
    words = {domain: DOMAINS[domain].measured for domain in sides}
    seen = [domain for domain in sides if entry[domain] is not None]
    if entry["agree"] is None:
        shows = seen[0]
        unseen = next(domain for domain in sides if domain != shows)
        return f"{start} only the {words[shows]} say something: {sides[shows]}; the {words[unseen]} do not show it."
    statements = ", ".join(f"{words[domain]} say {stated}" for domain, stated in sides.items())
    both = f"{start} {statements}: they"
    if entry["agree"]:
        return f"{both} agree{'' if place else ', and it is one finding that both sensors see'}."
    p_value = "p < 1e-16"
    if entry["p_value"] > 1e-16:
        p_value = f"p = {entry['p_value']:.2g}"
    return f"{both} disagree ({p_value}). {quantity['remedy']}"


# ------------------------------------------------------------------ what was not tested, and what to record


def confounded_effects(document: Document) -> str:
    """Says why the confounded effects were not tested."""
    torques = is_of_torques(document)
    if document["nuisance"]["numbers"] and torques:
        return "They are confounded with the inertial numbers that are fitted, or what they depend on does not vary."
    if document["nuisance"]["numbers"]:
        return "They are confounded with the fitted frames and geometry, or the sensor does not observe them."
    if torques:
        return "What they depend on does not vary in this recording."
    return "The sensor does not observe them in these poses."


def separate_undecided(document: Document, title: str, alternatives: Sequence[str], drivers: Sequence[str]) -> str:
    """Says what to record so that an effect is distinguished from those that explain the recording as well."""
    more = "more poses"
    if is_of_torques(document):
        more = "another motion"
    independent = ""
    if len(drivers) > 1:
        independent = f" in which {joined(drivers)} vary independently"
    return f"To separate {title} from {joined(alternatives, 'or')}, record {more}{independent}."


_PARTS = {"base": "the sensor's frame", "link": "the arm's own calibration", "tool": "the tool"}


def remedy_of_confounded(document: Document) -> str:
    """Says what to declare or to measure so that confounded effects are tested; empty where nothing helps."""
    if is_of_torques(document):
        if not document["nuisance"]["numbers"]:
            return ""
        return (
            "To test for effects that are confounded with the inertial numbers, declare these numbers (`inertial` in "
            "the sidecar)."
        )
    steps = []
    parts = [words for part, words in _PARTS.items() if part in document["nuisance"]["parts"]]
    if parts:
        steps.append(f"declare {joined(parts)}")
    if not document["model"]["orientation"]:
        steps.append("measure orientations too")
    if not steps:
        return ""
    return f"To test for effects that are confounded or not observed, {joined(steps)}."
