"""Joints that follow position commands, rolled out in plain NumPy.

    from rollout import rollout
    q = rollout(time, command)  # (sample,) s and (sample, joint) rad; q is (sample, joint) rad, what encoders show

Of each joint, with command u, true position q and read-out y, L being what the other joints and gravity exert:

    A q'' + M q'' + L + b q' + friction + k q + t  =  clip(kp e + ki ∫e + kf u_c', ±limit) - kd q'
    e = dead band(u_c - q),  u_c = rate limit(low pass(u(time·(1 + r) - delay))),  y = play(q)

L and M are those along the rollout before; a few of them end at the coupled arm.
"""

import numpy as np

# -- numbers: of each joint, SI units
STEP = 0.001  # s, of integration at most
INTERPOLATED = False  # whether commands go on a line to the next, or hold
KINEMATICS = np.array([[0.0, 0.0, 0.0, 1.5707963267948966, 0.0, 0.0]])  # x y z roll pitch yaw of each joint in the last
LINKS = np.array([[1.0, 0.0, -0.2, 0.0, 0.04, 0.0, 0.04, 0.0, 0.0, 0.0]])  # m, m·c, tensor xx yy zz xy xz yz
GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s², in the base frame
STIFFNESS = np.array([100.0])  # kp, Nm/rad
DAMPING = np.array([5.0])  # kd, Nm·s/rad
INTEGRAL = np.array([0.0])  # ki, Nm/(rad·s)
FEEDFORWARD = np.array([0.0])  # kf, Nm·s/rad
DELAY = np.array([0.0])  # s
CLOCK_RATE = np.array([0.0])  # r
TIME_CONSTANT = np.array([0.0])  # s, of the low pass
RATE_LIMIT = np.array([1e9])  # rad/s, of the command
DEAD_BAND = np.array([0.0])  # rad, half its width
TORQUE_LIMIT = np.array([1e9])  # Nm
TORQUE_DROOP = np.array([0.0])  # s/rad, share of the limit that is lost per speed
VISCOUS = np.array([0.0])  # b, Nm·s/rad
COULOMB = np.array([0.0])  # Nm
STRIBECK = np.array([0.0])  # Nm, more of it at rest
STRIBECK_SPEED = np.array([0.1])  # rad/s
LOAD_FRICTION = np.array([0.0])  # Nm per Nm of load
GRIP = np.array([1e9])  # kg·m², how firmly friction holds a joint at rest
INERTIA = np.array([0.1])  # A, kg·m², of the rotor
SPRING = np.array([0.0])  # k, Nm/rad
SPRING_TORQUE = np.array([0.0])  # t, Nm
BACKLASH = np.array([0.0])  # rad, half its width
OFFSET = np.array([0.0])  # rad, of the read-out
SCALE = np.array([0.0])  # of the read-out
SINE = np.array([0.0])  # rad, of the read-out
COSINE = np.array([0.0])  # rad, of the read-out
HOLDS = np.array([0.0])  # 1 where friction holds a joint at rest, and 0 where it rests at its command
FRICTION_SHARE = np.array([0.0])  # of c by which it holds it there, from -1 to 1
TABLES = []  # of further torques: joint from 0, of "position" or "velocity", the values, Nm that resist there
# -- end of numbers

SETTLING = 2.0  # s, for which the first command holds before the first time
SWEEPS = 12
SETTLED = 1e-6  # rad RMS, by which rollouts differ at the end
RETURN = 2 / (0.95 * 0.002)  # 1/s, by which friction brings a joint at rest to a halt


def rollout(time, command):
    """Read-outs (sample, joint) rad of joints that follow commands (sample, joint) rad, from rest under the first."""
    time = np.asarray(time, float)
    command = np.asarray(command, float)
    period = np.median(np.diff(time))
    h = period / np.ceil(period / STEP - 1e-9)
    before = h * np.ceil(SETTLING / h)
    grid = time[0] - before + h * np.arange(int(np.ceil((time[-1] - time[0] + before) / h - 1e-6)) + 1)
    target, rate = shaped(*delayed(time, command, grid, h), h)
    q = target
    dq = ddq = np.zeros_like(q)
    for _ in range(SWEEPS):
        last = q
        mass = diagonal(q)
        load = torques(q, dq, ddq, GRAVITY) - mass * ddq
        q, dq, ddq = roll(target, rate, load, mass, further_torques(q, dq), h)
        if np.sqrt(np.mean((q - last) ** 2)) < SETTLED:
            break
    return np.stack([np.interp(time, grid, column) for column in read_out(q).T], 1)


def delayed(time, command, grid, h):
    """The commands that arrive (step, joint) rad: means over the steps around times of the grid, and at their ends."""
    edges = np.append(grid, grid[-1] + h) - 0.5 * h - time[0]
    columns = []
    ends = []
    for joint, u in enumerate(command.T):
        at = time[0] + edges * (1 + CLOCK_RATE[joint]) - DELAY[joint]
        if INTERPOLATED:
            columns.append(np.interp(0.5 * (at[1:] + at[:-1]), time, u))
            ends.append(np.interp(at[1:], time, u))
            continue
        ends.append(u[np.maximum(np.searchsorted(time, at[1:], side="right") - 1, 0)])
        area = np.append(0.0, np.cumsum(u[:-1] * np.diff(time)))  # ∫u, of commands that hold
        early = np.minimum(at - time[0], 0.0) * u[0]
        late = np.maximum(at - time[-1], 0.0) * u[-1]
        columns.append(np.diff(np.interp(at, time, area) + early + late) / np.diff(at))
    return np.stack(columns, 1), np.stack(ends, 1)


def shaped(command, ends, h):
    """Commands after low pass and rate limit, means over steps (step, joint) rad, and how fast they move, in rad/s."""
    decay = np.exp(-h / np.maximum(TIME_CONSTANT, 1e-9))
    mean_decay = np.maximum(TIME_CONSTANT, 1e-9) / h * (1 - decay)
    filtered = TIME_CONSTANT > 1e-9
    most = RATE_LIMIT * h
    low = limited = last = command[0]
    targets = []
    changes = []
    for u, end in zip(command, ends, strict=True):
        mean_low = u + (low - u) * mean_decay
        low = np.where(filtered, u + (low - u) * decay, end)
        # the share of the step in which the command before still holds
        rise = end - last
        early = np.where(filtered | (rise == 0), 1.0, np.clip((end - u) / np.where(rise == 0, 1.0, rise), 0.0, 1.0))
        last = end
        wanted = np.where(filtered | (rise == 0), low, end - rise) - limited
        first = np.clip(wanted, -most * early, most * early)
        second = np.clip(low - limited - first, -most * (1 - early), most * (1 - early))
        passes = (first == wanted) & (second == low - limited - first)
        mean = limited + first * (1 - 0.5 * abs(first) / most) + second * (1 - early - 0.5 * abs(second) / most)
        targets.append(np.where(passes, mean_low, mean))
        changes.append(first + second)
        limited = limited + first + second
    return np.array(targets), np.array(changes) / h


def roll(target, rate, load, mass, extra, h):
    """Motion (step, joint) of joints, each alone under its load: leapfrog, with damping half implicit."""
    drag = DAMPING + VISCOUS
    inertia = mass + INERTIA + 0.25 * h * h * STIFFNESS  # a stiffness acts as its mean over neighbouring steps
    inertia = np.maximum(inertia, h * drag / 6)  # a lighter joint would turn to and fro at every step
    kept = inertia / h - 0.5 * drag
    resisted = inertia / h + 0.5 * drag + 1e-12
    outer = FEEDFORWARD * rate, load + SPRING_TORQUE + extra
    held = GRIP * (1 / h + RETURN)
    bends = np.any(STRIBECK) or np.any(LOAD_FRICTION)
    stick = COULOMB
    still = np.zeros_like(target[:1])
    resting = FRICTION_SHARE * COULOMB - torques(target[:1], still, still, GRAVITY)[0]
    q = target[0] + HOLDS * resting / np.maximum(STIFFNESS, 1e-9)
    v = a = error = np.zeros_like(q)
    # before the first time an integral part has balanced what acts on a joint at rest
    summed = np.where(INTEGRAL > 0, (SPRING * q + outer[1][0]) / np.where(INTEGRAL > 0, INTEGRAL, 1.0), 0.0)
    places = []
    speeds = [v]
    for n, u in enumerate(target):
        e = u - q
        e = e - np.minimum(np.maximum(e, -DEAD_BAND), DEAD_BAND)
        summed = summed + 0.5 * h * (e + error)
        error = e
        pull = STIFFNESS * e + INTEGRAL * summed + outer[0][n]
        most = TORQUE_LIMIT * np.maximum(1 - TORQUE_DROOP * v * np.sign(pull), 0.0)
        size = np.abs(pull)
        force = kept[n] * v + np.where(size < most, pull, np.sign(pull) * most) - SPRING * q - outer[1][n]
        if bends:
            stick = COULOMB + STRIBECK * np.exp(-((v / STRIBECK_SPEED) ** 2))
            stick = stick + LOAD_FRICTION * np.abs(load[n] + mass[n] * a)
        creep = (force + GRIP / h * v) / (resisted[n] + held)
        grip = held * creep - GRIP / h * v
        new = np.where(np.abs(grip) < stick, creep, (force - np.sign(grip) * stick) / resisted[n])
        a = (new - v) / h
        v = new
        places.append(q)
        speeds.append(v)
        q = q + h * v
    between = np.array(speeds)  # half a step before each time, and after it
    return np.array(places), 0.5 * (between[1:] + between[:-1]), np.diff(between, axis=0) / h


def read_out(q):
    """What encoders show (step, joint) rad, behind a play that they follow."""
    y = q[0]
    shown = []
    for place in q:
        y = np.minimum(np.maximum(y, place - BACKLASH), place + BACKLASH)
        shown.append(y)
    y = np.array(shown)
    return y * (1 + SCALE) + OFFSET + SINE * np.sin(y) + COSINE * np.cos(y)


def further_torques(q, dq):
    """Nm (sample, joint) that resist, of tables over a joint's own motion."""
    extra = np.zeros_like(q)
    for joint, of, values, torque in TABLES:
        extra[:, joint] += np.interp((q if of == "position" else dq)[:, joint], values, torque)
    return extra


def diagonal(q):
    """kg·m² (sample, joint), the diagonal of the mass matrix."""
    still = np.zeros_like(q)
    units = (np.eye(q.shape[1])[j] + still for j in range(q.shape[1]))
    return np.stack([torques(q, still, unit, np.zeros(3))[:, j] for j, unit in enumerate(units)], 1)


def torques(q, dq, ddq, gravity):
    """Nm (sample, joint) of rigid bodies: the recursive Newton-Euler algorithm in the frames of the links."""
    z = np.array([0.0, 0.0, 1.0])
    w = alpha = np.zeros((len(q), 3))
    a = np.zeros((len(q), 3)) - gravity
    frames = []
    wrenches = []
    for j, (row, link) in enumerate(zip(KINEMATICS, LINKS, strict=True)):
        p = row[:3]
        R = turn(row[3:]) @ about_z(q[:, j])
        a = back(R, a + np.cross(alpha, p) + np.cross(w, np.cross(w, p)))
        w_last = back(R, w)
        alpha = back(R, alpha) + np.cross(w_last, z) * dq[:, j, None] + z * ddq[:, j, None]
        w = w_last + z * dq[:, j, None]
        m = link[0]
        c = link[1:4]
        xx, yy, zz, xy, xz, yz = link[4:]
        I = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        f = m * a + np.cross(alpha, c) + np.cross(w, np.cross(w, c))
        n = alpha @ I + np.cross(w, w @ I) + np.cross(c, a)
        frames.append((R, p))
        wrenches.append((f, n))
    tau = np.zeros_like(q)
    f = n = np.zeros((len(q), 3))
    for j in range(q.shape[1] - 1, -1, -1):
        f = wrenches[j][0] + f
        n = wrenches[j][1] + n
        tau[:, j] = n[:, 2]
        R, p = frames[j]
        f = np.einsum("sij,sj->si", R, f)
        n = np.einsum("sij,sj->si", R, n) + np.cross(p, f)
    return tau


def turn(angles):
    """(3, 3), a rotation by roll, pitch and yaw about fixed axes."""
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(angle), np.sin(angle)) for angle in angles)
    yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return yaw @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]) @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])


def about_z(angle):
    """(sample, 3, 3), rotations by angles (sample,) rad."""
    c = np.cos(angle)
    s = np.sin(angle)
    zero = np.zeros_like(angle)
    return np.stack([c, -s, zero, s, c, zero, zero, zero, zero + 1], 1).reshape(-1, 3, 3)


def back(R, vectors):
    """Vectors (sample, 3) in the frames (sample, 3, 3) after a rotation."""
    return np.einsum("sji,sj->si", R, vectors)
