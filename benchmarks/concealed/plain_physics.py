"""What an arm with hidden physics shows, in plain NumPy: every effect by its definition, gravity by its own statics.

Shares no code with the library. The catalogue's effects are those of its public table of definitions; those outside it
are the generator's own: two springs here, one that hardens and one that yields and remembers it, the rest in `outside`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.concealed.chain import GRAVITY, Array, Chain, Poses, about_z, rotation_from_rpy, rotation_from_vector
from benchmarks.concealed.outside import FAMILIES
from benchmarks.concealed.outside.family import Motion, Scene

TWIST = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
TILT = ("compliance_x_rad_per_Nm", "compliance_y_rad_per_Nm")
COORDINATES: dict[str, tuple[str, ...]] = {
    "joint_offset": ("offset_rad",),
    "joint_scale": ("scale",),
    "joint_compliance": ("compliance_rad_per_Nm",),
    "joint_harmonic": ("sine_rad", "cosine_rad"),
    "joint_backlash": ("gap_rad",),
    "joint_lag": ("lag_s",),
    "joint_coupling": ("coupling",),
    "link_compliance": TILT,
    "link_thermal_expansion": ("expansion_per_K",),
    "frame_offset": TWIST,
    "base_compliance": TILT,
    "base_drift": ("vx_m_per_s", "vy_m_per_s", "vz_m_per_s"),
    "tool_offset": TWIST,
    "measurement_scale": ("scale",),
    "time_offset": ("offset_s",),
    "payload_error": ("mass_kg",),
    **{name: (family.number,) for name, family in FAMILIES.items()},
}
"""The numbers of each effect in which it is linear (a clock's offset: nearly); a harmonic's are A cos φ and A sin φ."""
OUTSIDE = tuple(FAMILIES)  # those that the library's catalogue does not have

HARDENING = 4.0  # τ/T = x + HARDENING x³: at T the spring gives way by 0.54 of what its start promises
YIELD = 0.25  # in turns of x, where a second spring of stiffness 2 beside one of 0.5 begins to slip: at 0.6 T
_SUBSTEPS = 12


@dataclass(frozen=True)
class Hidden:
    """An effect at a site."""

    name: str  # a key of `COORDINATES`
    site: str  # jointN, linkN, links, base, tool, sensor, clock or payload
    values: tuple[float, ...]  # its numbers, one for each coordinate; a harmonic's order may be the third
    # what else belongs to its form: `order`, `source_joint`, `friction_Nm` of a backlash; of what is outside the
    # catalogue, whatever `outside.draw_form` draws
    fixed: Mapping[str, float] = field(default_factory=dict)

    @property
    def number(self) -> int:
        """Of the joint or link, counted from 1; 0 where the site is neither."""
        return int("".join(filter(str.isdecimal, self.site)) or 0)

    @property
    def linear(self) -> int:
        """How many of its numbers it is linear in: all but a harmonic's order."""
        return min(len(self.values), len(COORDINATES[self.name]))

    def sized(self, values: Array) -> "Hidden":
        """The same with other numbers."""
        return replace(self, values=tuple(map(float, values)))

    def scaled(self, factor: float) -> "Hidden":
        """The same effect so many times as large."""
        return self.sized(np.array([*(factor * v for v in self.values[: self.linear]), *self.values[self.linear :]]))


Effects = tuple[Hidden, ...]  # all that are hidden together


@dataclass(frozen=True, eq=False)
class Setup:
    """An arm and where it is seen from."""

    chain: Chain  # the arm as it is
    sensor: Array  # `(4, 4)` T_sensor_base
    tool: Array  # `(4, 4)` T_flange_tool
    payload_center: Array  # `(3,)` m in the flange's frame


def moments(chain: Chain, q: Array, payload: Array, payload_center: Array) -> tuple[Array, Array]:
    """Gravity's moments: `(sample, joint, 3)` about each frame's origin in its axes, `(sample, 3)` about the base's.

    A sum over the links outboard of each joint, one after the other: Σ m (c − o) × g.
    """
    R, p = chain.frames(q)
    centers = p + np.einsum("sjab,jb->sja", R, chain.center)
    carried = p[:, -1] + R[:, -1] @ payload_center
    moment = np.zeros(p.shape)
    for i in range(chain.dof):
        for k in range(i, chain.dof):
            moment[:, i] += chain.mass[k] * _pulled(centers[:, k] - p[:, i])
        moment[:, i] += payload[:, None] * _pulled(carried - p[:, i])
    base = np.einsum("j,sja->sa", chain.mass, _pulled(centers)) + payload[:, None] * _pulled(carried)
    return np.einsum("sjab,sja->sjb", R, moment), base


def _pulled(lever: Array) -> Array:
    """lever × g, `(…, 3)`."""
    x, y, z = GRAVITY
    return lever @ np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]]).T


def loaded(setup: Setup, motion: Motion, needed: bool = True) -> Motion:
    """The motion with gravity's moments; of zero where they are not `needed`."""
    samples, dof = motion.q.shape
    moment, base_moment = np.zeros((samples, dof, 3)), np.zeros((samples, 3))
    if needed:
        moment, base_moment = moments(setup.chain, motion.q, motion.payload, setup.payload_center)
    return replace(motion, moment=moment, base_moment=base_moment)


def poses(setup: Setup, hidden: Effects, motion: Motion) -> Poses:
    """What a sensor without noise would show."""
    chain = setup.chain
    for effect in hidden:
        if effect.name == "time_offset":
            motion = motion.later(effect.values[0])
        if effect.name == "payload_error":
            motion = replace(motion, payload=motion.payload + effect.values[0])
    samples, dof = motion.q.shape
    turned = np.zeros((samples, dof))
    link = np.zeros((samples, dof, 6))
    base, tool, sensor = np.zeros((samples, 6)), np.zeros((samples, 6)), np.zeros((samples, 6))
    stretch, scale = np.zeros((samples, dof)), 1.0
    motion = loaded(setup, motion, any(effect.name in _LOADED for effect in hidden))
    moment, base_moment = motion.moment, motion.base_moment
    image: list[Hidden] = []
    for effect in hidden:
        v, i = np.array(effect.values), effect.number - 1
        match effect.name:
            case "link_compliance":
                link[:, i, 3:5] += v * moment[:, i, :2]
            case "base_compliance":
                base[:, 3:5] += v * base_moment[:, :2]
            case "base_drift":
                base[:, :3] += v * motion.time[:, None]
            case "frame_offset":
                (base if i < 0 else link[:, i])[:] += v
            case "tool_offset":
                tool[:, : len(v)] += v
            case "measurement_scale":
                scale += v[0]
            case "link_thermal_expansion":
                grown = v[0] * (motion.temperature.mean(1) - 25.0)[:, None]
                stretch[:, slice(None) if i < 0 else slice(i + 1, i + 2)] += grown
            case "time_offset" | "payload_error":
                pass
            case name if name in FAMILIES and FAMILIES[name].place == "image":
                image.append(effect)
            case name if name in FAMILIES:
                moved = v[0] * _signal(effect, motion, setup)
                if effect.site.startswith("joint"):
                    turned[:, i] += moved
                else:
                    twist = {"base": base, "tool": tool, "sensor": sensor}.get(effect.site, link[:, i])
                    twist[:, int(effect.fixed["axis"])] += moved
            case _:
                turned[:, i] += _angle(effect, motion, moment[:, i, 2])

    R, p = rotation_from_vector(base[:, 3:]), base[:, :3]
    for i, row in enumerate(chain.rows):
        p = p + (R @ row[:3]) * (1 + stretch[:, i, None])
        R = R @ rotation_from_rpy(*row[3:]) @ about_z(motion.q[:, i] + turned[:, i])
        if link[:, i].any():
            p = p + np.einsum("sab,sb->sa", R, link[:, i, :3])
            R = R @ rotation_from_vector(link[:, i, 3:])
    p = p + np.einsum("sab,sb->sa", R, tool[:, :3])
    R = R @ rotation_from_vector(tool[:, 3:])
    p, R = p + R @ setup.tool[:3, 3], R @ setup.tool[:3, :3]
    p, R = p @ setup.sensor[:3, :3].T + setup.sensor[:3, 3], setup.sensor[:3, :3] @ R
    if sensor.any():
        turn = rotation_from_vector(sensor[:, 3:])
        p, R = sensor[:, :3] + np.einsum("sab,sb->sa", turn, p), turn @ R
    seen = p
    for effect in image:
        family = FAMILIES[effect.name]
        assert family.image is not None
        shift = family.image(seen.T).T
        if family.signal is not None:
            shift = shift * family.signal(Scene(effect.fixed, motion))[:, None]
        p = p + effect.values[0] * shift
    return R, scale * p


_LOADED = {"joint_compliance", "link_compliance", "base_compliance", "joint_backlash"} | {
    name for name, family in FAMILIES.items() if family.is_loaded
}


def _signal(effect: Hidden, motion: Motion, setup: Setup) -> Array:
    """What the number of a family outside the catalogue is multiplied by, `(sample,)`."""
    fixed = effect.fixed
    joint = int(fixed.get("joint", effect.number)) - 1
    if effect.name == "hardening_spring":
        return hardening(motion.moment[:, joint, 2] / fixed["torque_Nm"])
    if effect.name == "yielding_spring":
        load = _load_between(motion, joint, setup) / fixed["torque_Nm"]
        return yielding(load)[:: _SUBSTEPS if motion.curve is None else 1]
    signal = FAMILIES[effect.name].signal
    assert signal is not None
    return signal(Scene(fixed, motion))


def _angle(effect: Hidden, motion: Motion, torque: Array) -> Array:
    """What an effect of a joint adds to its encoder, `(sample,)` rad."""
    v, fixed, i = effect.values, effect.fixed, effect.number - 1
    q = motion.q[:, i]
    match effect.name:
        case "joint_offset":
            return np.full(len(q), v[0])
        case "joint_scale":
            return v[0] * q
        case "joint_compliance":
            return v[0] * torque
        case "joint_harmonic":
            order = v[2] if len(v) == 3 else fixed["order"]
            return v[0] * np.sin(order * q) + v[1] * np.cos(order * q)
        case "joint_backlash":
            if "friction_Nm" not in fixed:
                return -0.5 * v[0] * motion.direction[:, i]
            # gravity presses the gear to a flank unless friction carries the link over
            return 0.5 * v[0] * np.sign(torque - fixed["friction_Nm"] * motion.direction[:, i])
        case "joint_lag":
            return -v[0] * motion.dq[:, i]
        case "joint_coupling":
            return v[0] * motion.q[:, int(fixed["source_joint"]) - 1]
    raise KeyError(effect.name)


def hardening(load: Array) -> Array:
    """x of load = x + HARDENING x³, by Cardano's formula."""
    p, half = 1 / HARDENING, load / (2 * HARDENING)
    root = np.sqrt(half**2 + (p / 3) ** 3)
    return np.cbrt(half + root) + np.cbrt(half - root)


def yielding(load: Array) -> Array:
    """x under a sequence of loads: a spring of 0.5 beside one of 2 that slips where it is stretched by YIELD.

    Two springs side by side and a slider make a loop that closes on itself (G. Masing, 1926).
    """
    x, slipped = np.empty(len(load)), 0.0
    for k, now in enumerate(load):
        x[k] = (now + 2 * slipped) / 2.5
        if abs(x[k] - slipped) > YIELD:
            side = np.sign(x[k] - slipped)
            x[k] = (now - 2 * side * YIELD) / 0.5
            slipped = x[k] - side * YIELD
    return x


def _load_between(motion: Motion, joint: int, setup: Setup) -> Array:
    """The torque at every sample and, where the arm went from rest to rest, at steps of the way between."""
    if motion.curve is not None:
        return moments(setup.chain, motion.q, motion.payload, setup.payload_center)[0][:, joint, 2]
    share = np.arange(_SUBSTEPS)[:, None] / _SUBSTEPS
    way = [a + share * (b - a) for a, b in zip(motion.q[:-1], motion.q[1:], strict=True)]
    q = np.concatenate([*way, motion.q[-1:]])
    payload = np.concatenate([np.repeat(motion.payload[1:], _SUBSTEPS), motion.payload[-1:]])
    return moments(setup.chain, q, payload, setup.payload_center)[0][:, joint, 2]
