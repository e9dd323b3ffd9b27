"""What sentences ask of the JSON document of a diagnosis of poses or of torques."""

from lite6jax.diagnosis.document import domain_of
from lite6jax.diagnosis.result import NEARLY_SIGNIFICANT
from lite6jax.domains.registry import DOMAINS
from lite6jax.domains.words import Document, Entry, SectionWords
from lite6jax.formatting import joints_named, plural

_WANDERING = "wandering_readout"
_NOT_CORRECTED = ("outliers", "computed_pose", "arm_deviation", _WANDERING)
"""Faults of the data that are said and not corrected."""


def words_of(document: Document) -> SectionWords:
    """The words of the domain of a document, or of a finding with its `domain`."""
    words = DOMAINS[domain_of(document)].words
    assert isinstance(words, SectionWords)
    return words


def corrected_faults(document: Document) -> list[Entry]:
    """The faults of the data that were corrected: nothing corrects what is no more than said."""
    return [fault for fault in document["data_faults"] if fault["fault"] not in _NOT_CORRECTED]


def wandering_joints(document: Document) -> list[int]:
    """The joints whose read-outs wander by themselves, which is noise that held-out errors contain."""
    faults = (fault for fault in document["data_faults"] if fault["fault"] == _WANDERING)
    return sorted(joint for fault in faults for joint in fault["numbers"]["joints"])


def noise_left(document: Document) -> str:
    """Says of what the error is where nothing is missing from the model."""
    noise = f"the {words_of(document).noise_of} noise"
    joints = wandering_joints(document)
    if joints:
        read_outs = plural(len(joints), "read-out", "read-outs")
        verb = plural(len(joints), "wanders", "wander")
        return f"{noise} and what the {read_outs} of {joints_named(joints)} {verb} by"
    return noise


def has_computed_poses(document: Document) -> bool:
    """Tells whether no sensor measured the poses: the controller computed them from the joints."""
    of_controller = any(fault["fault"] == "computed_pose" for fault in document["data_faults"])
    return of_controller or document.get("source") == "controller_fk"


def declares_noise(document: Document) -> bool:
    """Tells whether the sidecar declares the noise of what is compared, so that the size of what is left is tested."""
    return bool(next(iter(document["noise"]["declared"].values())))


def nearly_significant(document: Document) -> Entry | None:
    """The nearest effect that is no finding, where it is nearly significant; documents do not hold that threshold."""
    nearest = document["nearest"]
    if nearest is not None and nearest["p_value"] < NEARLY_SIGNIFICANT:
        return nearest
    return None
