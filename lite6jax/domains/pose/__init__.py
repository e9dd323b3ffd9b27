"""Measured poses as an estimation problem, and what a diagnosed arm predicts."""
