"""Faults of pose recordings: each detected, corrected, and weighed against physics."""
