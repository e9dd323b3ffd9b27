"""Effects that a user defines: reading and checking the Python file that holds them.

The file defines final subclasses of `JointEffect` or `Bending`, or of `JointTorque` or `TorqueEffect` where torques are
diagnosed, and a list `EFFECTS` of the candidates to test. All that it needs is exported by `lite6jax`:

```python
from dataclasses import dataclass
from typing import ClassVar, final

import jax.numpy as jnp

from lite6jax import Coordinate, Driver, JointEffect


@final
@dataclass(frozen=True)
class CableDrag(JointEffect):
    \"\"\"δq = d·tanh(q): a cable that pulls the joint back.\"\"\"

    name: ClassVar[str] = "cable_drag"

    @property
    def coordinates(self):
        return (Coordinate("drag_rad", "rad", 1e-4),)

    @property
    def drivers(self):
        return (Driver("position", self.joint),)

    def angle(self, values, motion, loads):
        return values[0] * jnp.tanh(motion.joint_position[self.joint - 1])


EFFECTS = [CableDrag(joint) for joint in range(1, 7)]
```

An effect of a link, the base, the tool or the sensor says where it acts, and displaces that frame by a twist:

```python
from lite6jax import Bending, Coordinate, Deflection, Driver, place_at_joint, twist


@final
@dataclass(frozen=True)
class LinkSag(Bending):
    \"\"\"The frame of a link sinks by c times the payload.\"\"\"

    link: int

    name: ClassVar[str] = "link_sag"

    @property
    def site(self):
        return f"link{self.link}"

    @property
    def coordinates(self):
        return (Coordinate("sag_m_per_kg", "m/kg", 1e-4),)

    @property
    def drivers(self):
        return (Driver("payload"),)

    def deflect(self, values, motion, loads):
        sunk = twist(motion.samples, z=-values[0] * motion.payload)
        return Deflection(link=place_at_joint(motion.dof, self.link, sunk))
```

An effect on torques is evaluated in NumPy; `dynamics` has the motion, the joints' velocities and the rigid arm's
torques (`lite6jax.Dynamics`):

```python
from lite6jax import Coordinate, Driver, JointTorque


@final
@dataclass(frozen=True)
class AirDrag(JointTorque):
    \"\"\"τ += d·q̇·abs(q̇).\"\"\"

    name: ClassVar[str] = "air_drag"

    @property
    def coordinates(self):
        return (Coordinate("drag_Nm_s2_per_rad2", "Nm·s²/rad²", 0.01),)

    @property
    def drivers(self):
        return (Driver("velocity", self.joint),)

    def at_joint(self, values, dynamics):
        speed = dynamics.velocity(self.joint)
        return values[0] * speed * abs(speed)
```

At a prismatic joint it is `AirDrag(3, of_slide=True)`, and a force. `self.number(…)` in place of `Coordinate(…)` and
`self.own_driver("velocity")` then take the units of the joint by themselves.
"""

import sys
import traceback
import types
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from lite6jax.effects.catalogue import BUILT_IN
from lite6jax.effects.deflection import Deflection, dense
from lite6jax.effects.dynamic.catalogue import BUILT_IN as TORQUES
from lite6jax.effects.dynamic.torque_effect import Dynamics, TorqueEffect
from lite6jax.effects.effect import Altering, Bending, Effect, Loading
from lite6jax.effects.motion import Motion, Sliding, motion_of
from lite6jax.effects.statics import Loads, inertia_of
from lite6jax.errors import InputError, require_type
from lite6jax.storage import read_text

SIZE_LIMIT = 1 << 20
"""The largest size of a file of effects, bytes."""


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """The list `EFFECTS` of a user's Python file; the docstring of this module shows one. Executes the file.

    Raises:
        InputError: the file raises (the message gives the line) or has no list, or an entry is not an instance of a
            final and frozen effect, has the name of a built-in effect, or gives a deflection or torques of wrong shape
            or that do not vanish at zero.
    """
    path = Path(path)
    text = read_text(path, SIZE_LIMIT)
    module = types.ModuleType(f"lite6jax_effects_{path.stem}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # dataclasses and type hints look their module up there
    try:
        exec(compile(text, str(path), "exec"), module.__dict__)
    except Exception as error:
        line = getattr(error, "lineno", None)
        for entry in traceback.extract_tb(error.__traceback__):
            line = entry.lineno if entry.filename == str(path) else line
        raise InputError(
            f"{path}: line {line}: {type(error).__name__}: {_one_line(error)}; correct the file"
        ) from error
    effects = getattr(module, "EFFECTS", None)
    if not isinstance(effects, list | tuple) or not effects:
        raise InputError(f"{path}: has no list EFFECTS; end it with EFFECTS = [MyEffect(joint=1), …]")
    for index, effect in enumerate(effects):
        reason = _fault(effect)
        if reason:
            raise InputError(f"{path}: EFFECTS[{index}]: {reason}")
    return tuple(effects)


def require_effects(effects: object) -> None:
    """Refuses what is no list of effects.

    Raises:
        InputError: as said.
    """
    require_type("effects", effects, list | tuple, "a list of effects; lite6jax.load_effects reads a file of them")
    for place, effect in enumerate(effects):  # type: ignore[arg-type]
        require_type(f"effects[{place}]", effect, Effect, "an effect, such as an instance of your class")


def by_domain(effects: Sequence[Effect]) -> tuple[tuple[Effect, ...], tuple[TorqueEffect, ...]]:
    """Effects on poses, and effects on torques."""
    kinematic = tuple(effect for effect in effects if not isinstance(effect, TorqueEffect))
    return kinematic, tuple(effect for effect in effects if isinstance(effect, TorqueEffect))


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _fault(effect: Any) -> str | None:
    """The reason why an entry of `EFFECTS` is not a valid effect, with the remedy; or None."""
    if isinstance(effect, type):
        return f"is the class {effect.__name__}; give an instance, such as {effect.__name__}(joint=1)"
    kind = type(effect)
    if not isinstance(effect, Bending | Altering | TorqueEffect):
        return f"{effect!r} is not an effect; derive its class from JointEffect or Bending, or JointTorque of torques"
    if not getattr(kind, "__final__", False):
        return f"{kind.__name__} is not final; write @final above the class"
    if kind.__hash__ is None or "__eq__" not in kind.__dict__ or not kind.__dataclass_params__.frozen:  # type: ignore[attr-defined]
        return f"{kind.__name__} is not frozen; write @dataclass(frozen=True) above the class"
    if not isinstance(getattr(kind, "name", None), str):
        return f'{kind.__name__} has no name; write name: ClassVar[str] = "…" in the class'
    if kind.name in (TORQUES if isinstance(effect, TorqueEffect) else BUILT_IN):
        return f"{kind.__name__} has the name of a built-in effect, {kind.name}; choose another"
    try:
        _check_names(effect)
        if isinstance(effect, TorqueEffect):
            _check_torque(effect)
        else:
            _check_at_zero(effect)
    except InputError as error:
        return str(error)
    except Exception as error:
        return f"{effect!r} fails on a trial motion ({type(error).__name__}: {_one_line(error)}); correct it"
    return None


def _check_names(effect: Effect) -> None:
    names = [coordinate.name for coordinate in effect.coordinates]
    if not names or len(set(names)) != len(names):
        raise InputError(f"{effect.label} has the coordinates {names}; give at least one, with distinct names")


def _check_torque(effect: TorqueEffect) -> None:
    """Evaluates an effect on torques on a small motion that has every driver, at zero and for proportionality."""
    dof, samples = max(effect.joints_needed, 2), 3
    row = np.arange(1.0, samples + 1)
    q = np.linspace(0.1, 1.0, samples * dof).reshape(dof, samples)
    motion = motion_of(q.T, joint_velocity=q.T, time=row, ambient_temperature=row, payload=row)
    moved = jax.tree.map(np.asarray, motion)._replace(joint_acceleration=q, direction=np.sign(q))
    dynamics = Dynamics(
        motion=moved,
        torque=q,
        links=np.ones((dof, 10)),
        payload_center=np.zeros(3),
        of_inertia=lambda numbers: np.asarray(numbers).sum(1, keepdims=True) * row,
        of_gravity=lambda gravity: np.sum(gravity) * q,
        gravity=np.array([0.0, 0.0, -9.81]),
    )
    one, other = 1e-3 * np.random.default_rng(0).standard_normal((2, effect.size))
    zero, *parts = [effect.torque(values, dynamics) for values in (np.zeros(effect.size), one, other, one + other)]
    if np.shape(zero) != (dof, samples):
        raise InputError(f"{effect.label} gives torques of shape {np.shape(zero)}; give {(dof, samples)}")
    if not np.allclose(zero, 0.0, rtol=0, atol=1e-12):
        raise InputError(f"{effect.label} gives torques at zero; choose coordinates that change nothing at zero")
    scale = max(float(np.abs(parts[2]).max()), 1e-300)
    if effect.linear and not np.allclose(parts[0] + parts[1], parts[2], rtol=0, atol=1e-9 * scale):
        raise InputError(_not_linear(effect))


def _not_linear(effect: Effect) -> str:
    return (
        f"{effect.label} is not proportional to its coordinates; write linear=False in the Coordinate that it is not "
        "proportional to"
    )


def _check_at_zero(effect: Bending | Altering) -> None:
    """Evaluates an effect at zero on a small motion that has every driver."""
    dof, samples = max(effect.joints_needed, 2), 3
    q = np.linspace(0.1, 1.0, samples * dof).reshape(samples, dof)
    row = np.arange(float(samples))
    motion = motion_of(
        q,
        joint_velocity=q,
        direction=np.sign(q),
        time=row,
        ambient_temperature=row,
        payload=row,
        measured_position=q[:, :1].repeat(3, 1),
    )
    loads = Loads(jnp.ones((dof, 3, samples)), jnp.ones((3, samples)), jnp.ones((3, samples)))
    zero = jnp.zeros(effect.size)
    if isinstance(effect, Altering):
        expected, found = motion, effect.alter(zero, motion)
    else:
        expected, found = dense(Deflection(), dof, samples), dense(effect.deflect(zero, motion, loads), dof, samples)
    fields = list(zip(expected._fields, expected, found, strict=True))
    if isinstance(effect, Loading):
        inertia = inertia_of(np.ones(dof), np.ones((dof, 3)))
        fields += zip(inertia._fields, inertia, effect.alter_inertia(zero, inertia), strict=True)
    for name, plain, value in fields:
        if plain is None or value is None or isinstance(plain, Sliding) or isinstance(value, Sliding):
            continue
        if jnp.shape(value) != jnp.shape(plain):
            raise InputError(f"{effect.label} gives {name} of shape {jnp.shape(value)}; give {jnp.shape(plain)}")
        if not np.allclose(value, plain, rtol=0, atol=1e-12):
            raise InputError(f"{effect.label} changes {name} at zero; choose coordinates that change nothing at zero")
    if isinstance(effect, Bending) and effect.linear:
        _check_linear(effect, motion, loads)


def _check_linear(effect: Bending, motion: Motion, loads: Loads) -> None:
    """Compares the deflection by a sum of values with the sum of deflections: a search relies on `linear`."""
    one, other = 1e-3 * np.random.default_rng(0).standard_normal((2, effect.size))
    parts = [effect.deflect(jnp.asarray(values), motion, loads) for values in (one, other, one + other)]
    for first, second, both in zip(*(dense(part, motion.dof, motion.samples) for part in parts), strict=True):
        if not np.allclose(first + second, both, rtol=0, atol=1e-9 * max(float(jnp.abs(both).max()), 1e-300)):
            raise InputError(_not_linear(effect))
