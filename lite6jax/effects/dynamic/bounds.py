"""Bounds on the parameters of effects on torques: those of the heaviest arms; beyond, a name is implausible."""

TORQUE = 2000.0
"""Nm, of friction, offsets and ripple."""

VISCOUS = 3000.0
"""Nm·s/rad."""

VISCOUS_PER_KELVIN = 100.0
"""Nm·s/rad/K, of either sign."""

COEFFICIENT = 1.0
"""Of friction by load."""

STRIBECK = (1e-3, 2.0)
"""rad/s, the speed over which Stribeck friction vanishes."""

TRANSITION = (0.02, 1.0)
"""rad/s, the speed within which Coulomb friction turns: less is sharp in most logs, more is nearly viscous."""

SCALE = 0.9
"""Of a measured torque, relative; a reversed sign is a data fault."""

ROTOR = 500.0
"""kg·m², reflected to the joint."""

STIFFNESS = 1e4
"""Nm/rad, of cables, hoses and balancers."""

MASS = 500.0
"""kg."""

LENGTH = 2.0
"""m, by which a centre of mass may be displaced."""

TILT = 0.5
"""rad, by which a base may be tilted from what is declared."""

DELAY = 0.5
"""s."""
