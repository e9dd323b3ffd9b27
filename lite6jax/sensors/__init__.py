"""Sensors: each one class, a function of the tool's pose with unknowns of its own, for fits, plans and simulations.

`sensor.py` says what every sensor is, `usual.py` names them.
"""
