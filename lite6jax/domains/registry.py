"""The domains that are known, by name."""

from lite6jax.domains.base import Domain
from lite6jax.domains.pose.entry import PoseDocument
from lite6jax.domains.torque.entry import TorqueDocument
from lite6jax.domains.tracking.entry import TrackingDocument

POSES = Domain("poses", "pose_source", PoseDocument)
TORQUES = Domain("torques", "torque_source", TorqueDocument)
TRACKING = Domain("tracking", "joint_source", TrackingDocument)

DOMAINS: dict[str, Domain] = {domain.name: domain for domain in (POSES, TORQUES, TRACKING)}
"""By name; a domain that is added here is saved, read and predicted like these."""
