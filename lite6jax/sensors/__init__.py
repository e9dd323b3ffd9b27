"""Sensors: each one function of the tool's pose with unknowns of its own; residuals and columns follow from it."""
