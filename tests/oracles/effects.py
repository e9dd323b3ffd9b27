"""Poses of arms with effects in plain NumPy, over all samples of a motion."""

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from tests.oracles.gravity import gravity_moments, payload_moments
from tests.oracles.transforms import displacement, origin_transform, rotate

TWIST = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")


def random_motion(rng, dof, samples=(7, 6)):
    """A trajectory of several runs with everything that a recording may hold, sample first."""
    rate, phase = rng.uniform(0.5, 2, dof), rng.uniform(-np.pi, np.pi, dof)
    run = np.repeat(np.arange(len(samples)), samples)
    time = np.concatenate([5.0 * i + np.cumsum(rng.uniform(0.03, 0.08, count)) for i, count in enumerate(samples)])
    total = len(time)
    velocity = 2 * rate * np.cos(np.outer(time, rate) + phase)
    return {
        "joint_position": 2 * np.sin(np.outer(time, rate) + phase),
        "joint_velocity": velocity,
        "direction": np.sign(velocity),
        "time": time,
        "run": run,
        "joint_temperature": rng.uniform(20, 40, (total, dof)),
        "payload": rng.uniform(0, 1, total),
    }


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


def play(torque, width, run):
    """What follows `torque` and stays behind by `width` at most, from rest at each run's first sample."""
    held, followed = 0.0, []
    for k, now in enumerate(torque):
        if k and run[k] != run[k - 1]:
            held = 0.0
        if held > now + width:
            held = now + width
        elif held < now - width:
            held = now - width
        followed.append(held)
    return np.array(followed)


def predicted_poses(kinematics, T_sensor_base, T_flange_tool, motion, inertia, effects):
    """(sample, 4, 4) of an arm with effects, each (name, fields and parameters in one dict)."""
    for name, p in effects:
        if name == "time_offset":
            motion = later(motion, p["offset_s"])
        elif name == "payload_error":
            motion = {**motion, "payload": motion["payload"] + p["mass_kg"]}
        elif name == "payload_com":
            elsewhere = [p[key] for key in TWIST[:3]]
            inertia = {**inertia, "payload_center": inertia["payload_center"] + np.array(elsewhere)}
        elif name == "gravity_direction":
            turned = displacement([0, 0, 0, p["tilt_x_rad"], p["tilt_y_rad"], 0])[:3, :3]
            inertia = {**inertia, "gravity": turned @ inertia["gravity"]}
    q, dof = motion["joint_position"], len(kinematics)
    each_warmth = motion["joint_temperature"] - 25.0
    warmth = each_warmth.mean(axis=1)
    moments, base_moment = gravity_moments(kinematics, q, motion["payload"], inertia)
    extra, scale = np.zeros_like(q), 1.0
    growth, link = np.ones(q.shape), np.zeros((dof, len(q), 6))
    base, tool, sensor = np.zeros((3, len(q), 6))
    before = np.zeros((dof, len(q), 6))
    sensor_velocity = ("vx_m_per_s", "vy_m_per_s", "vz_m_per_s", "wx_rad_per_s", "wy_rad_per_s", "wz_rad_per_s")
    for name, p in effects:
        i = p.get("joint", p.get("link", 0)) - 1
        if name == "joint_offset":
            extra[:, i] += p["offset_rad"]
        elif name == "joint_scale":
            extra[:, i] += p["scale"] * q[:, i]
        elif name == "joint_compliance":
            extra[:, i] += p["compliance_rad_per_Nm"] * moments[:, i, 2]
        elif name == "joint_harmonic":
            extra[:, i] += p["amplitude_rad"] * np.sin(p["order"] * q[:, i] + p["phase_rad"])
        elif name == "joint_backlash" and "friction_torque_Nm" in p:
            pressed = moments[:, i, 2] - p["friction_torque_Nm"] * motion["direction"][:, i]
            extra[:, i] += p["gap_rad"] / 2 * np.sign(pressed)
        elif name == "joint_windup":
            wound = play(moments[:, i, 2], p["friction_torque_Nm"], motion["run"])
            extra[:, i] += p["compliance_rad_per_Nm"] * wound
        elif name == "joint_thermal_offset":
            extra[:, i] += p["offset_rad_per_K"] * each_warmth[:, i]
        elif name == "joint_warm_up":
            extra[:, i] += p["amplitude_rad"] * (1 - np.exp(-motion["time"] / p["time_constant_s"]))
        elif name == "axis_wobble":
            for n in (1, 2):
                for axis, column in (("x", 3), ("y", 4)):
                    before[i, :, column] += p[f"{axis}_cosine{n}_rad"] * np.cos(n * q[:, i])
                    before[i, :, column] += p[f"{axis}_sine{n}_rad"] * np.sin(n * q[:, i])
        elif name == "tool_compliance":
            about = payload_moments(kinematics, q, motion["payload"], inertia)
            tool[:, 3] += p["compliance_x_rad_per_Nm"] * about[:, 0]
            tool[:, 4] += p["compliance_y_rad_per_Nm"] * about[:, 1]
        elif name == "sensor_drift":
            sensor += np.outer(motion["time"], [p[key] for key in sensor_velocity])
        elif name == "joint_backlash":
            extra[:, i] -= p["gap_rad"] / 2 * np.sign(motion["direction"][:, i])
        elif name == "joint_lag":
            extra[:, i] -= p["lag_s"] * motion["joint_velocity"][:, i]
        elif name == "joint_coupling":
            extra[:, i] += p["coupling"] * q[:, int(p["source_joint"]) - 1]
        elif name == "link_compliance":
            link[i, :, 3] += p["compliance_x_rad_per_Nm"] * moments[:, i, 0]
            link[i, :, 4] += p["compliance_y_rad_per_Nm"] * moments[:, i, 1]
        elif name == "link_thermal_expansion":
            grown = slice(None) if "link" not in p else slice(p["link"], p["link"] + 1)
            growth[:, grown] += p["expansion_per_K"] * warmth[:, None]
        elif name == "frame_offset":
            (link[i] if "link" in p else base)[:] += [p[key] for key in TWIST]
        elif name == "base_compliance":
            base[:, 3] += p["compliance_x_rad_per_Nm"] * base_moment[:, 0]
            base[:, 4] += p["compliance_y_rad_per_Nm"] * base_moment[:, 1]
            base[:, 3] += p.get("compliance_xy_rad_per_Nm", 0) * base_moment[:, 1]
            base[:, 4] += p.get("compliance_xy_rad_per_Nm", 0) * base_moment[:, 0]
            for along, to in enumerate("xy"):
                for about, of in enumerate("xy"):
                    base[:, along] += p.get(f"shift_{to}{of}_m_per_Nm", 0) * base_moment[:, about]
        elif name == "base_drift":
            base[:, :3] += np.outer(motion["time"], [p["vx_m_per_s"], p["vy_m_per_s"], p["vz_m_per_s"]])
        elif name == "tool_offset":
            tool += [p.get(key, 0.0) for key in TWIST]
        elif name == "measurement_scale":
            scale += p["scale"]
        else:
            assert name in ("time_offset", "payload_error", "payload_com", "gravity_direction"), name
    T = displacement(sensor) @ T_sensor_base @ displacement(base)
    for i, row in enumerate(kinematics):
        grown = np.broadcast_to(row, (len(q), 6)).copy()
        grown[:, :3] *= growth[:, i, None]
        T = T @ origin_transform(grown) @ displacement(before[i])
        T = T @ rotate("z", q[:, i] + extra[:, i]) @ displacement(link[i])
    T = T @ displacement(tool) @ T_flange_tool
    T[:, :3, 3] *= scale
    return T
