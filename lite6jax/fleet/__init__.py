"""Many arms: every file of a folder or URL fitted or diagnosed, and effects pooled over the arms of one type."""

FLEET = "lite6jax/fleet_diagnosis/1"
"""The key `schema` of the document of a fleet."""
