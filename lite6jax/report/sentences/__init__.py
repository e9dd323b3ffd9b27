"""Sentences that depend on a condition, a function each; those without one are in `report/templates`."""
