"""The nominal arm: its chain, limits, inertia, friction and flange by design; and the units of its joints.

Whatever is known of a revolute joint's coordinate q and of the torque τ of its motor holds for the coordinate and the
force of a prismatic joint: only the units differ. Everything that names a unit, or compares with a threshold that has
one, asks here.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.arms import chains, frames
from lite6jax.arms.dh import six_parameter_to_hayati
from lite6jax.arms.frames import sample_joints as sample_joints
from lite6jax.array_types import Array, Mask
from lite6jax.errors import InputError
from lite6jax.fields import field_values

LEVER = 0.1
"""m, the lever at which a prismatic joint's thresholds, typical sizes and bounds are those of a revolute joint: by a
pinion, a pulley or a link of that length a rotation becomes a shift in arms of the usual size. 0.02 rad is then 2 mm,
and 1 Nm is 10 N. Units do not depend on it, and estimates do only in so far as a threshold decides."""

_OF_SLIDE = {"Nm": ("N", -1), "rad": ("m", 1), "kg·m²": ("kg", -2), "inertia_kg_m2": ("mass_kg", -2)}
"""Of a revolute joint's unit, that of a prismatic joint and the power of the lever by which its sizes differ."""
_WORD = re.compile(rf"(?<![A-Za-z])(?:{'|'.join(_OF_SLIDE)})(?![A-Za-z])")


def joint_unit(text: str, slides: bool) -> str:
    """A unit of a revolute joint, or a name that contains one, as that of a joint that is prismatic where it `slides`.

    Nm·s/rad is N·s/m, and `viscous_Nm_s_per_rad` is `viscous_N_s_per_m`.
    """
    if slides:
        return _WORD.sub(lambda match: _OF_SLIDE[match.group()][0], text)
    return text


def joint_size(value: float, unit: str, slides: bool) -> float:
    """A size in a unit of a revolute joint, as one of a joint that is prismatic where it `slides`, by `LEVER`."""
    if not slides:
        return value
    above, *below = unit.split("/")
    powers = [sum(_OF_SLIDE[word][1] for word in _WORD.findall(part)) for part in (above, "/".join(below))]
    return value * LEVER ** (powers[0] - powers[1])


def joint_sizes(value: float, unit: str, slides: ArrayLike | bool) -> Array:
    """A size for each joint: `joint_size` of `slides` `(joint,)`."""
    return np.where(np.asarray(slides, bool), joint_size(value, unit, True), value)


def as_revolute(values: ArrayLike, unit: str, slides: ArrayLike | bool) -> Array:
    """Values `(joint, …)` of joints divided by what one `unit` of a revolute joint is of each, for a common threshold.

    They are in `unit`, such as `rad/s`, of revolute joints, and in its counterpart of those that slide; `slides` is
    `(joint,)`, or one bool for all.
    """
    values = np.asarray(values, float)
    sizes = joint_sizes(1.0, unit, slides)
    return values / sizes.reshape(sizes.shape + (1,) * (values.ndim - sizes.ndim))


def by_kind(name: str, values: Array, slides: ArrayLike, statistic: Callable[[Array], float]) -> dict[str, float]:
    """A statistic of the values `(joint, …)` of revolute joints, and of those of prismatic joints, by its name.

    The two have no common unit: `name` has that of a revolute joint, such as `moves_rms_Nm`.
    """
    of_slide = np.asarray(slides, bool)
    return {
        joint_unit(name, kind): float(statistic(values[of_slide == kind]))
        for kind in (False, True)
        if (of_slide == kind).any()
    }


# ------------------------------------------------------------------ the arm


# A published DH table and the six parameters beside it may be rounded differently (the vendor's ROS file has 1.5708).
_DH_EXACT = 1e-9
_DH_AGREES = 1e-4

JOINT_TERMS = {
    "viscous_friction": "viscous friction",
    "coulomb_friction": "Coulomb friction",
    "rotor_inertia": "rotor inertia",
    "spring_stiffness": "spring stiffness",
}
"""What an arm may know of each joint's drive, in words."""
DRIVE_FIELDS = (*JOINT_TERMS, "spring_rest")
"""The fields of an arm's drives, `(joint,)` each."""


@dataclass(frozen=True, eq=False)
class Arm:
    """A serial arm of revolute and prismatic joints, in SI units; every array is float64 and read-only.

    Flange: `T_base_flange = prod_i Trans(x, y, z) Rz(yaw) Ry(pitch) Rx(roll) Rz(q_i) @ T_joint_flange`, with `Tz(q_i)`
    for a prismatic joint. Its units are m for rad, N for N·m and kg for kg·m².

    Attributes:
        name: one printable line.
        kinematics: (joint, 6) nominal x y z roll pitch yaw of each joint's frame in the previous one, m and rad.
        joint_limits: (joint, 2) lower and upper, rad; None for +-2 pi, and +-1 m of a prismatic joint.
        T_joint_flange: (4, 4) from the frame after the last joint to the flange; None for the identity.
        mass: (joint,) kg, of the link after joint i; None if unknown.
        center_of_mass: (joint, 3) m, in the frame after joint i's motion; given together with `mass`.
        inertia: (joint, 3, 3) kg·m², of the link after joint i about its centre of mass, in the axes of the frame after
            the joint's motion; None if unknown.
        viscous_friction: (joint,) N·m·s/rad, of the joint; None if unknown.
        coulomb_friction: (joint,) N·m; None if unknown.
        rotor_inertia: (joint,) kg·m², of the motor's rotor and gear, reflected to the joint; None if unknown.
        spring_stiffness: (joint,) N·m/rad, of what pulls the joint towards `spring_rest`; None if unknown.
        spring_rest: (joint,) rad; given together with `spring_stiffness`.
        dh: (joint, 4) the published standard DH table, theta_off d a alpha in rad and m, or None. It describes the same
            chain without `T_joint_flange`, and determines the branch (theta, sign of alpha) of the Hayati parameters.
        source: the origin of the numbers.
        sliding: the prismatic joints, counted from 0, in order.
        endless: the joints that turn without end, counted from 0; their `joint_limits` are a range to plan within.
        joint_names: (joint,) as a URDF or an MJCF calls them; empty where they have no names of their own.

    Raises:
        InputError: an array of the wrong shape, a number that is not finite, limits in the wrong order, a negative
            mass, friction, rotor inertia or stiffness, an inertia tensor that no body has or that has no mass beside
            it, a flange that is not a rigid transform, a DH table of another chain than `kinematics` or of an arm with
            prismatic joints, or a prismatic joint that is not there.
    """

    name: str
    kinematics: Array
    joint_limits: Array = None  # pyright: ignore[reportAssignmentType]  # filled in below
    T_joint_flange: Array = None  # pyright: ignore[reportAssignmentType]
    mass: Array | None = None
    center_of_mass: Array | None = None
    dh: Array | None = None
    source: str = ""
    inertia: Array | None = None
    viscous_friction: Array | None = None
    coulomb_friction: Array | None = None
    rotor_inertia: Array | None = None
    spring_stiffness: Array | None = None
    spring_rest: Array | None = None
    sliding: tuple[int, ...] = ()
    joint_names: tuple[str, ...] = ()
    endless: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        self._require(self.name and self.name.isprintable(), "the name must be one printable line; write another")
        self._require(self.source.isprintable(), "the source must be one printable line; write it without line breaks")
        joints = len(np.atleast_1d(np.asarray(self.kinematics, object)))
        self._require(joints > 0, "has no joint; give one row x y z roll pitch yaw per joint")
        self._store("kinematics", self.kinematics, (joints, 6))
        self._require(
            list(self.sliding) == [i for i in range(joints) if i in self.sliding],
            f"sliding is {self.sliding}; give prismatic joints in order, from 0 to {joints - 1}",
        )
        object.__setattr__(self, "sliding", tuple(self.sliding))
        revolute = set(range(joints)) - set(self.sliding)
        self._require(set(self.endless) <= revolute, f"endless is {self.endless}; give revolute joints, counted from 0")
        name_count = len(self.joint_names)
        self._require(name_count in (0, joints), f"has {name_count} joint_names for {joints} joints; name each")
        widest = np.where(self.slides, 1.0, 2 * np.pi)
        joint_limits = np.column_stack([-widest, widest]) if self.joint_limits is None else self.joint_limits
        flange = np.eye(4) if self.T_joint_flange is None else self.T_joint_flange
        paired = (self.mass is None) == (self.center_of_mass is None)
        self._require(paired, "mass and center_of_mass belong together; give both or neither")
        paired = (self.spring_stiffness is None) == (self.spring_rest is None)
        self._require(paired, "spring_stiffness and spring_rest belong together; give both or neither")
        self._require(
            self.inertia is None or self.mass is not None,
            "inertia needs the links' masses; give mass and center_of_mass too",
        )
        self._store("T_joint_flange", flange, (4, 4))
        self._store("joint_limits", joint_limits, (joints, 2))
        if self.center_of_mass is not None:
            self._store("center_of_mass", self.center_of_mass, (joints, 3))
        if self.dh is not None:
            self._store("dh", self.dh, (joints, 4))
        if self.inertia is not None:
            self._store("inertia", self.inertia, (joints, 3, 3))
        if self.mass is not None:
            self._store("mass", self.mass, (joints,))
        for field, values in self.drives.items():
            self._store(field, values, (joints,))
        for i, ((lower, upper), unit) in enumerate(zip(self.joint_limits, self.joint_units, strict=True), 1):
            limits = f"joint{i}'s limits {lower:g} … {upper:g} {unit}"
            self._require(lower < upper, f"{limits} are empty; write lower, upper")
        T = self.T_joint_flange
        self._require(
            frames.is_rotation(T[:3, :3]), "T_joint_flange does not hold a rotation; correct its upper left 3 × 3"
        )
        self._require(np.array_equal(T[3], [0.0, 0.0, 0.0, 1.0]), "T_joint_flange's last row must be 0 0 0 1")
        for i in [] if self.mass is None else np.flatnonzero(self.mass < 0)[:1]:
            self._require(False, f"link{i + 1}'s mass is negative; correct it")
        drives = self.drives
        for field, term in JOINT_TERMS.items():
            for i in np.flatnonzero(drives.get(field, np.zeros(0)) < 0)[:1]:
                self._require(False, f"joint{i + 1}'s {term} is negative; correct it")
        for i, tensor in enumerate([] if self.inertia is None else self.inertia, 1):
            wrong = frames.defect(tensor)
            self._require(not wrong, f"link{i}'s inertia {wrong}; correct it, or leave out all inertia")
        self._require(
            self.dh is None or not self.sliding, "a DH table is of revolute joints, and it has others; leave dh out"
        )
        self._require(
            self._dh_distance <= _DH_AGREES,
            f"its DH table is another chain than its kinematics (they differ by {self._dh_distance:.2g} m or rad);"
            " correct one or leave dh out",
        )

    def _require(self, fine: object, message: str) -> None:
        if not fine:
            raise InputError(f"arm {self.name!r}: {message}")

    def _store(self, field: str, numbers: object, shape: tuple[int, ...]) -> None:
        try:
            value = np.array(numbers, np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(f"arm {self.name!r}: {field} is not an array of numbers of shape {shape}") from error
        self._require(value.shape == shape, f"{field} has the shape {value.shape}; it must be {shape}")
        self._require(np.isfinite(value).all(), f"{field} has a number that is not finite; correct it")
        value.flags.writeable = False
        object.__setattr__(self, field, value)

    @property
    def drives(self) -> dict[str, Array]:
        """What is known of the joints' friction, rotors and springs, `(joint,)` each, by the fields `DRIVE_FIELDS`."""
        values = (
            self.viscous_friction,
            self.coulomb_friction,
            self.rotor_inertia,
            self.spring_stiffness,
            self.spring_rest,
        )
        return {field: value for field, value in zip(DRIVE_FIELDS, values, strict=True) if value is not None}

    @property
    def possible_positions(self) -> Array:
        """`(joint, 2)`, lowest and highest position that a reading may have: infinite of a joint without end."""
        limits = np.array(self.joint_limits)
        limits[list(self.endless)] = (-np.inf, np.inf)
        return limits

    @property
    def dof(self) -> int:
        """The number of joints."""
        return len(self.kinematics)

    def __getstate__(self) -> dict[str, object]:
        """The fields alone: a pickle does not depend on what has been computed of an arm."""
        return field_values(self)

    @cached_property
    def slides(self) -> Mask:
        """(joint,) which joints are prismatic."""
        return np.isin(np.arange(self.dof), self.sliding)

    @property
    def joint_units(self) -> tuple[str, ...]:
        """`rad`, or `m` of a prismatic joint, for each."""
        return tuple("m" if slides else "rad" for slides in self.slides)

    @property
    def reach(self) -> float:
        """m; an upper bound of the distance of the flange from the origin of the base."""
        offsets = np.vstack([self.kinematics[:, :3], self.T_joint_flange[:3, 3]])
        return float(
            np.linalg.norm(offsets, axis=1).sum() + np.abs(self.joint_limits[self.slides]).max(1, initial=0.0).sum()
        )

    @cached_property
    def links(self) -> Array:
        """(joint, 4, 4) the fixed transform before each joint's motion."""
        return frames.transform_from_row(self.kinematics)

    @cached_property
    def form(self) -> chains.HayatiForm:
        """The Hayati form of this arm, by its nominally parallel axes."""
        return chains.hayati_form_of(self.kinematics, self.sliding)

    @cached_property
    def hayati(self) -> Array:
        """(size,) the nominal Hayati parameters in the order of `form`, without `T_joint_flange`.

        They are those of the published DH table if it describes exactly the same chain; else they are converted in
        closed form, on the branch of the table if there is one.
        """
        published = None
        if self.dh is not None and not self.dh[list(self.form.parallel), 1].any():
            links = np.zeros((self.dof, len(chains.LINK)))
            links[:, chains.DH_COLUMNS] = self.dh
            published = self.form.pack(np.zeros(len(chains.BASE)), links)
            if self._dh_distance <= _DH_EXACT:
                return published
        return six_parameter_to_hayati(self.form, self.kinematics, published)

    @cached_property
    def _dh_distance(self) -> float:
        """The largest difference of an entry of the flange pose between DH table and six parameters, or 0."""
        if self.dh is None:
            return 0.0
        q = sample_joints(self.dof)
        links, after = frames.links_from_dh(self.dh)
        return float(np.abs(frames.chain(links, q) @ after - frames.chain(self.links, q)).max())
