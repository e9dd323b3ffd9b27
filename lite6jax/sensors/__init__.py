"""Sensors: each one function of the tool's pose with unknowns of its own; residuals and columns follow from it.

`touch_sensor` of `lite6jax.domains.pose.rigid_arm` makes those of a recording; those of plans are in
`lite6jax.design.sensor`.
"""
