"""The domains that are known, by name."""

from lite6jax.domains.base import Domain
from lite6jax.domains.pose.entry import PoseDocument
from lite6jax.domains.pose.words import POSE_WORDS
from lite6jax.domains.torque.entry import TorqueDocument
from lite6jax.domains.torque.words import TORQUE_WORDS
from lite6jax.domains.tracking.entry import TrackingDocument
from lite6jax.domains.tracking.words import TRACKING_WORDS

POSES = Domain(
    "poses",
    POSE_WORDS,
    lambda settings: settings.pose_source,
    PoseDocument,
    lambda recording: recording.numbers_per_sample > 0,
)
TORQUES = Domain(
    "torques",
    TORQUE_WORDS,
    lambda settings: settings.torque_source,
    TorqueDocument,
    lambda recording: recording.has_torques,
)
TRACKING = Domain(
    "tracking",
    TRACKING_WORDS,
    lambda settings: settings.joint_source,
    TrackingDocument,
    lambda recording: recording.commanded_position is not None,
    gives_way_to=frozenset({"poses"}),
)

DOMAINS: dict[str, Domain] = {domain.name: domain for domain in (POSES, TORQUES, TRACKING)}
"""By name; a domain that is added here is saved, read and predicted like these."""
