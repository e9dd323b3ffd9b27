"""What numbers of effects can be at all: beyond these, a number is that of something else under this name.

The limits are far beyond what is made or wears, so that no real arm reaches them: they refuse a name, never a value.
"""

COMPLIANCE = 1e-3
"""rad/Nm: a gear, link or mount as soft as this sags by a degree under 20 Nm; those of arms are near 1e-5."""
TOOL_COMPLIANCE = 1e-2
"""rad/Nm, of what is on a flange: a gripper's wrist or a force sensor is softer than an arm, by ten times."""
SHIFT = 1e-3
"""m/Nm, of a mount that gives way sideways by a centimetre under 10 Nm."""
GAP = 0.02
"""rad, of a gear: more than a degree of play is a broken one."""
FRICTION = 1e3
"""Nm, of a joint: no motor of such an arm would turn it."""
SLIDE_OFFSET = 0.1
"""m, from the zero of a prismatic joint: more is another way to count."""
SLIDE_COMPLIANCE = 1e-4
"""m/N: a slide as soft as this sags by a centimetre under 100 N; those of machines are near 1e-8."""
SLIDE_GAP = 5e-3
"""m, of a screw, belt or rack: more play is a broken one."""
RATIO = 0.02
"""Of a scale: a radian or a metre that is wrong by more is another unit."""
COUPLING = 0.05
"""Of one joint's motion that shows in another."""
LAG = 0.2
"""s, of a joint behind its encoder: the servo of such an arm would not be stable."""
CLOCK = 60.0
"""s, between two clocks: more is another recording."""
EXPANSION = 1e-4
"""1/K: that of plastics; metals have 1e-5 to 3e-5, and all of them grow."""
THERMAL_OFFSET = 1e-3
"""rad/K: a degree in twenty kelvin."""
WAVE = 0.02
"""rad: the amplitude of a harmonic, of a wobble or of a warm-up; a gear's is below 1e-3."""
OFFSET = 0.5
"""rad, of an encoder's zero: more is another way to count the angle."""
FRAME = {"m": 0.1, "rad": 0.3}
"""Of a frame's displacement: more is another arm."""
TOOL = {"m": 1.0, "rad": 3.2}
"""Of a tool: any rotation."""
DRIFT = 1e-3
"""m/s or rad/s: more is motion."""
MASS = 10.0
"""kg: more than arms of this size carry."""
CENTER = 0.5
"""m, from the declared centre of mass of a payload."""
TILT = 0.2
"""rad, of gravity: more is another way to mount the arm."""
WARM_UP = (1.0, 1e6)
"""s: grams of metal warm up more slowly than the first, and an arm in less than the twelve days of the second."""
