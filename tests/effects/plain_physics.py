"""Arms with physics in plain NumPy, sample by sample, sharing no code with the library: the oracle of its tests."""

import numpy as np
from plain_chain import origin_transform, product, rotate, shift
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

GRAVITY = np.array([0.3, -0.4, -9.7])  # an arm that does not stand upright


def simulated_motion(rng, dof, samples=(7, 6)):
    """A trajectory of several runs with everything that a recording may hold, sample first."""
    rate, phase = rng.uniform(0.5, 2, dof), rng.uniform(-np.pi, np.pi, dof)
    run = np.repeat(np.arange(len(samples)), samples)
    time = np.concatenate([5.0 * i + np.cumsum(rng.uniform(0.03, 0.08, count)) for i, count in enumerate(samples)])
    total = len(time)
    return {
        "joint_position": 2 * np.sin(np.outer(time, rate) + phase),
        "joint_velocity": 2 * rate * np.cos(np.outer(time, rate) + phase),
        "direction": np.sign(2 * rate * np.cos(np.outer(time, rate) + phase)),
        "time": time,
        "run": run,
        "joint_temperature": rng.uniform(20, 40, (total, dof)),
        "payload": rng.uniform(0, 1, total),
    }


def simulated_inertia(rng, dof):
    """Masses of every link, none of them at the joint's origin."""
    return {
        "mass": rng.uniform(0.2, 2, dof),
        "center_of_mass": rng.uniform(-0.2, 0.2, (dof, 3)),
        "payload_center": rng.uniform(-0.1, 0.1, 3),
        "gravity": GRAVITY,
    }


def rigid_frames(kinematics, q):
    """The frame after each joint's rotation, [4 × 4], of one sample."""
    frames, T = [], np.eye(4)
    for row, angle in zip(kinematics, q, strict=True):
        T = T @ origin_transform(row) @ rotate("z", angle)
        frames.append(T)
    return frames


def moment_about(origin, points, masses, gravity):
    """Gravity's moment about a point, in the axes of all these vectors."""
    return sum(np.cross(point - origin, mass * gravity) for point, mass in zip(points, masses, strict=True))


def gravity_moments(kinematics, q, payload, inertia):
    """(joint, 3) about each frame's origin in its axes, and (3,) about the base's origin, of one sample."""
    frames = rigid_frames(kinematics, q)
    points = [(T @ [*c, 1.0])[:3] for T, c in zip(frames, inertia["center_of_mass"], strict=True)]
    points.append((frames[-1] @ [*inertia["payload_center"], 1.0])[:3])
    masses = [*inertia["mass"], payload]
    g = inertia["gravity"]
    inside = [T[:3, :3].T @ moment_about(T[:3, 3], points[i:], masses[i:], g) for i, T in enumerate(frames)]
    return np.array(inside), moment_about(np.zeros(3), points, masses, g)


def moved(x=0.0, y=0.0, z=0.0, rx=0.0, ry=0.0, rz=0.0):
    """A translation and then a rotation by a rotation vector."""
    T = shift(x, y, z)
    T[:3, :3] = Rotation.from_rotvec([rx, ry, rz]).as_matrix()
    return T


def later(motion, offset):
    """The motion `offset` s later within each run, by SciPy's Hermite splines."""
    shifted = {name: value.copy() for name, value in motion.items()}
    for number in np.unique(motion["run"]):
        rows = motion["run"] == number
        t, q, dq = motion["time"][rows], motion["joint_position"][rows], motion["joint_velocity"][rows]
        spline = CubicHermiteSpline(t, q, dq)
        shifted["joint_position"][rows] = spline(t + offset)
        shifted["joint_velocity"][rows] = spline.derivative()(t + offset)
        before = np.clip(np.searchsorted(t, t + offset, side="right") - 1, 0, len(t) - 1)
        for name in ("payload", "joint_temperature"):
            shifted[name][rows] = motion[name][rows][before]
    shifted["direction"] = np.sign(shifted["joint_velocity"])
    return shifted


def predicted_poses(kinematics, T_sensor_base, T_flange_tool, motion, inertia, effects):
    """(sample, 4, 4) of an arm with effects, each (name, fields and parameters in one dict)."""
    dof = len(kinematics)
    for name, p in effects:
        if name == "time_offset":
            motion = later(motion, p["offset_s"])
        elif name == "payload_error":
            motion = {**motion, "payload": motion["payload"] + p["mass_kg"]}
    warmth = motion["joint_temperature"].mean(axis=1) - 25.0
    poses = []
    for k, q in enumerate(motion["joint_position"]):
        moments, base_moment = gravity_moments(kinematics, q, motion["payload"][k], inertia)
        extra = np.zeros(dof)
        growth = np.ones(dof)
        link = [np.zeros(6) for _ in range(dof)]
        base, tool, scale = np.zeros(6), np.zeros(6), 1.0
        for name, p in effects:
            i = p.get("joint", p.get("link", 0)) - 1
            if name == "joint_offset":
                extra[i] += p["offset_rad"]
            elif name == "joint_scale":
                extra[i] += p["scale"] * q[i]
            elif name == "joint_compliance":
                extra[i] += p["compliance_rad_per_Nm"] * moments[i, 2]
            elif name == "joint_harmonic":
                extra[i] += p["amplitude_rad"] * np.sin(p["order"] * q[i] + p["phase_rad"])
            elif name == "joint_backlash":
                extra[i] -= p["gap_rad"] / 2 * np.sign(motion["direction"][k, i])
            elif name == "joint_lag":
                extra[i] -= p["lag_s"] * motion["joint_velocity"][k, i]
            elif name == "joint_coupling":
                extra[i] += p["coupling"] * q[int(p["source_joint"]) - 1]
            elif name == "link_compliance":
                link[i][3] += p["compliance_x_rad_per_Nm"] * moments[i, 0]
                link[i][4] += p["compliance_y_rad_per_Nm"] * moments[i, 1]
            elif name == "link_thermal_expansion":
                grown = slice(None) if "link" not in p else p["link"]
                growth[grown] += p["expansion_per_K"] * warmth[k]
            elif name == "frame_offset":
                vector = np.array([p[key] for key in ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")])
                if "link" in p:
                    link[i] += vector
                else:
                    base += vector
            elif name == "base_compliance":
                base[3] += p["compliance_x_rad_per_Nm"] * base_moment[0]
                base[4] += p["compliance_y_rad_per_Nm"] * base_moment[1]
            elif name == "base_drift":
                base[:3] += np.array([p["vx_m_per_s"], p["vy_m_per_s"], p["vz_m_per_s"]]) * motion["time"][k]
            elif name == "tool_offset":
                keys = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
                tool += np.array([p.get(key, 0.0) for key in keys])
            elif name == "measurement_scale":
                scale += p["scale"]
            else:
                assert name in ("time_offset", "payload_error"), name
        T = T_sensor_base @ moved(*base)
        for i, row in enumerate(kinematics):
            grown = np.concatenate([row[:3] * growth[i], row[3:]])
            T = product(T, origin_transform(grown), rotate("z", q[i] + extra[i]), moved(*link[i]))
        T = T @ moved(*tool) @ T_flange_tool
        T[:3, 3] *= scale
        poses.append(T)
    return np.array(poses)
