"""A position servo on a pendulum in plain Python: small explicit steps, sharp friction, a held and delayed command."""

import math

import numpy as np


def follow(
    command,
    period,
    *,
    kp,
    kd,
    inertia,
    weight=0.0,
    coulomb=0.0,
    viscous=0.0,
    delay=0.0,
    play=0.0,
    rate=math.inf,
    feedforward=0.0,
    limit=math.inf,
    sticky=None,
    creep=0.0,
    fine=100,
):
    """Read-outs `(sample,)` rad of a joint that follows `command` `(sample,)` from rest in its equilibrium.

    Its weight exerts weight·sin q, in Nm. What it follows moves at `rate` rad/s at most, and feedforward times its
    velocity is added to what the servo exerts, which beside its damping is at most `limit` in Nm. Friction is more by
    sticky(q) in Nm. It holds the joint at rest, or grows with velocity as tanh(v / creep).
    """
    h = period / fine
    command = [float(u) for u in command]
    q = command[0]
    for _ in range(200):
        q = command[0] - weight * math.sin(q) / kp
    v = 0.0
    y = q
    limited = command[0]
    read = np.empty(len(command))
    for k in range(len(command) * fine):
        if k % fine == 0:
            read[k // fine] = y
        late = max(math.floor((k * h - delay) / period + 1e-9), 0)
        change = min(max(command[late] - limited, -rate * h), rate * h)
        limited += change
        drive = min(max(kp * (limited - q) + feedforward * change / h, -limit), limit)
        pulled = drive - (kd + viscous) * v - weight * math.sin(q)
        stopped = v + h * pulled / inertia
        band = h * (coulomb + (sticky(q) if sticky else 0.0)) / inertia
        slower = max(abs(stopped) - band, 0.0)
        v = stopped - band * math.tanh(v / creep) if creep else math.copysign(slower, stopped)
        q += h * v
        y = min(max(y, q - play), q + play)
    return read
