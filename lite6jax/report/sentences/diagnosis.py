"""What is said of a diagnosis of poses or of torques, where a condition changes the words.

Each sentence is made from the JSON document alone. The other texts are in `templates/diagnosis.yaml`.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from lite6jax.diagnosis.document import domain_of, domains_beside
from lite6jax.domains.base import DomainName
from lite6jax.domains.registry import DOMAINS
from lite6jax.domains.words import undeclared_noise
from lite6jax.errors import command_line
from lite6jax.formatting import (
    capital,
    each_with_unit,
    joined,
    milli,
    number,
    paragraph,
    significant,
)
from lite6jax.report.remedies import effect_name, effect_title, wanders
from lite6jax.report.sentences.document import (
    Document,
    Entry,
    corrected_faults,
    declares_noise,
    has_computed_poses,
    nearly_significant,
    noise_left,
    wandering_joints,
    words_of,
)
from lite6jax.report.words import fill, read_texts

_TEXTS = read_texts("diagnosis.yaml")


# ------------------------------------------------------------------ the verdict


def verdict_statement(document: Document) -> str:
    """Says the verdict in a few sentences, with what is left and where that acts."""
    verdict = document["verdict"]
    if verdict == "consistent":
        return consistent(document)
    if verdict == "explained":
        return f"Explained: with the effects below, the held-out errors are {noise_left(document)}."
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
    words = words_of(document)
    if has_computed_poses(document):
        return "Consistent: the table of the arm reproduces what the controller computed from the joints."
    if "against" in document and words.consistent_beside_reference:
        return words.consistent_beside_reference
    corrected = ""
    if corrected_faults(document):
        corrected = ", with the faults of the data corrected"
    if not declares_noise(document):
        return (
            f"Consistent{corrected}: no effect is significant, and the residuals look like noise. Their size is not "
            f"tested, as the sidecar declares {undeclared_noise(document)}."
        )
    wandering = ""
    if wandering_joints(document):
        wandering = ", read-outs that wander"
    return words.consistent.format(corrected=corrected, wandering=wandering)


def partly_explained(document: Document) -> str:
    """Says that more than noise is left beside the findings."""
    sentence = "Partly explained: the effects below are significant"
    if not declares_noise(document):
        return (
            f"{sentence}. Whether more remains cannot be tested, because the sidecar declares "
            f"{undeclared_noise(document)}."
        )
    words = words_of(document)
    return paragraph(f"{sentence}{words.more_than_noise}.", words.error_ratios(document))


def unnamed(document: Document) -> str:
    """Says that the largest effect has no name."""
    sentence = "Unnamed: no effect of the catalogue explains the largest effect that was found."
    if wanders(max(document["findings"], key=lambda finding: finding["log_likelihood_gain"])):
        sentence = (
            "Unnamed: the largest effect that was found wanders by itself, and nothing that was recorded drives it."
        )
    return paragraph(sentence, words_of(document).errors_of_unnamed(document))


def unexplained(document: Document) -> str:
    """Says that more than noise is left, and that nothing explains it."""
    words = words_of(document)
    gross_error = words.gross_error(document)
    if gross_error:
        return gross_error
    return paragraph(
        f"Unexplained: what is left is not the {words.noise_of} noise alone, and no effect is significant.",
        words.error_ratios(document),
    )


def undetermined(document: Document) -> str:
    """Says what the recording is too short to tell, and how much more it takes."""
    near = nearly_significant(document)
    words = words_of(document)
    open_question = words.too_short
    if near:
        below = ""
        if document["findings"]:
            below = ", with the effects below,"
        open_question = (
            f"what is left{below} is noise, but {effect_name(near['effect'])} at {near['site']} is nearly significant "
            f"(family-wise p-value {significant(near['p_value'], 2)})."
        )
    return f"Undetermined: {open_question} {words.record_more(document)}"


# ------------------------------------------------------------------ what qualifies the verdict


def not_measured(document: Document) -> list[str]:
    """Says that the controller computed the poses or the torques."""
    lines = []
    if has_computed_poses(document):
        lines.append(
            "The poses are the controller's own computation from the joints: they test nothing but the table of the "
            "arm. To diagnose the arm itself, record the poses with a sensor."
        )
    if document["source"] == "estimated":
        lines.append(
            "The torques are declared as estimated by the controller: the findings are differences between the model "
            "of the controller and the model of this arm, and not effects on the motors."
        )
    return lines


def refusal(domain: DomainName, reason: str) -> str:
    """Says why a recording was not diagnosed by a domain beside another."""
    return f"The {DOMAINS[domain].words.measured} of this recording are not diagnosed: {reason}."


def measured(document: Document) -> str:
    """Names what a recording of several domains was diagnosed by."""
    domains = (domain_of(document), *domains_beside(document))
    return joined([DOMAINS[domain].words.measured for domain in domains])


def nothing_shared(document: Document) -> str:
    """Says that domains have nothing to be compared."""
    return f"No finding concerns a quantity on which both {measured(document)} depend."


def withdrawn_effects(document: Document) -> str:
    """Says which significant effects were not kept, and why."""
    withdrawn = document["withdrawn"]
    return words_of(document).withdrawn(list(map(effect_title, withdrawn["effects"])), withdrawn)


# ------------------------------------------------------------------ the recording, its errors and their noise


def setting(document: Document) -> str:
    """Says which arm was diagnosed, and from how much."""
    return f"{document['model']['arm']}, {document['samples']} samples{words_of(document).recorded(document)}"


def held_out(document: Document) -> str:
    """Says how errors were held out."""
    rows = words_of(document).held_out_rows
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
    remainder = ""
    if document["verdict"] == "explained":
        remainder = f", {noise_left(document)}"
    return f"{capital(cause)}: {share}; {remedy}, {worth.after} {unit} is left{remainder}."


def nothing_found(document: Document, error: str) -> str:
    """Says what the error is, where no effect was found; begins with a small letter."""
    verdict = document["verdict"]
    declared = next(iter(document["noise"]["declared"].values()))
    if verdict == "consistent" and has_computed_poses(document):
        return f"the poses are the controller's own computation: the arm's table reproduces them to {error}."
    if verdict == "consistent" and declared is None:
        key = words_of(document).noise_key
        return f"no effect is significant, and the error of {error} looks like noise; declare {key} to test this."
    if verdict == "consistent":
        return f"nothing is missing from the model: the error of {error} is {noise_left(document)}."
    if verdict != "undetermined":
        source = words_of(document).measured
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
    words = {domain: DOMAINS[domain].words.measured for domain in sides}
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


def separate_undecided(document: Document, title: str, alternatives: Sequence[str], drivers: Sequence[str]) -> str:
    """Says what to record so that an effect is distinguished from those that explain the recording as well."""
    more = words_of(document).separating
    independent = ""
    if len(drivers) > 1:
        independent = f" in which {joined(drivers)} vary independently"
    return f"To separate {title} from {joined(alternatives, 'or')}, record {more}{independent}."
