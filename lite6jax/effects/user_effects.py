"""Effects that a user defines: reading and checking the Python file that holds them.

The file defines final subclasses of `JointEffect` or `Bending`, or of `JointTorque` or `TorqueEffect` where torques are
diagnosed, and a list `EFFECTS` of the candidates to test. All that it needs is exported by `lite6jax`:

```python
from dataclasses import dataclass
from typing import ClassVar, final

import jax.numpy as jnp

from lite6jax import Coordinate, JointEffect


@final
@dataclass(frozen=True)
class CableDrag(JointEffect):
    \"\"\"δq = d·tanh(q): a cable that pulls the joint back.\"\"\"

    name: ClassVar[str] = "cable_drag"
    quantities: ClassVar[tuple] = ("position",)
    numbers: ClassVar[tuple] = (Coordinate("drag_rad", "rad", 1e-4),)

    def angle(self, values, motion, loads):
        return values[0] * jnp.tanh(motion.joint_position[self.joint - 1])


EFFECTS = [CableDrag(joint) for joint in range(1, 7)]
```

An effect of a link, the base, the tool or the sensor says where it acts, and displaces that frame by a twist:

```python
from lite6jax import Bending, Coordinate, Deflection, place_at_joint, twist


@final
@dataclass(frozen=True)
class LinkSag(Bending):
    \"\"\"The frame of a link sinks by c times the payload.\"\"\"

    link: int

    name: ClassVar[str] = "link_sag"
    at: ClassVar[str] = "link"
    quantities: ClassVar[tuple] = ("payload",)
    numbers: ClassVar[tuple] = (Coordinate("sag_m_per_kg", "m/kg", 1e-4),)

    def deflect(self, values, motion, loads):
        sunk = twist(motion.samples, z=-values[0] * motion.payload)
        return Deflection(link=place_at_joint(motion.dof, self.link, sunk))
```

An effect on torques is evaluated in NumPy; `dynamics` has the motion, the joints' velocities and the rigid arm's
torques (`lite6jax.Dynamics`):

```python
from lite6jax import Coordinate, JointTorque


@final
@dataclass(frozen=True)
class AirDrag(JointTorque):
    \"\"\"τ += d·q̇·abs(q̇).\"\"\"

    name: ClassVar[str] = "air_drag"
    quantities: ClassVar[tuple] = ("velocity",)
    numbers: ClassVar[tuple] = (Coordinate("drag_Nm_s2_per_rad2", "Nm·s²/rad²", 0.01),)

    def at_joint(self, values, dynamics):
        speed = dynamics.velocity(self.joint)
        return values[0] * speed * abs(speed)
```

At a prismatic joint it is `AirDrag(3, of_slide=True)`, and a force: `quantities` and `numbers` are stated as of a
revolute joint, and take the units of a prismatic one by themselves. Where they depend on the fields of the effect,
define the properties `drivers` and `coordinates` instead, and `site` where `at` does not say it.
"""

import sys
import traceback
import types
from collections.abc import Callable, Sequence
from functools import singledispatch
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from lite6jax.effects.catalogue import POSE_EFFECTS, TORQUE_EFFECTS
from lite6jax.effects.deflection import Deflection, dense
from lite6jax.effects.dynamic import Dynamics, TorqueEffect
from lite6jax.effects.effect import Altering, Bending, Effect, Loading
from lite6jax.effects.motion import Motion, motion_of
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
        line = error.lineno if isinstance(error, SyntaxError) else None
        for entry in traceback.extract_tb(error.__traceback__):
            if entry.filename == str(path):
                line = entry.lineno
        raise InputError(
            f"{path}: line {line}: {type(error).__name__}: {_one_line(error)}; correct the file"
        ) from error
    effects = vars(module).get("EFFECTS")
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
    _, of_torques = by_domain([effect])
    built_in = TORQUE_EFFECTS if of_torques else POSE_EFFECTS
    if kind.name in built_in:
        return f"{kind.__name__} has the name of a built-in effect, {kind.name}; choose another"
    try:
        _check(effect)
    except InputError as error:
        return str(error)
    except Exception as error:
        return f"{effect!r} fails on a trial motion ({type(error).__name__}: {_one_line(error)}); correct it"
    return None


def _check(effect: Bending | Altering | TorqueEffect) -> None:
    """Evaluates an effect on a small motion that has every driver: shapes, at zero, and for proportionality."""
    names = [coordinate.name for coordinate in effect.coordinates]
    if not names or len(set(names)) != len(names):
        raise InputError(f"{effect.label} has the coordinates {names}; give at least one, with distinct names")
    if not effect.site:
        raise InputError(f'{type(effect).__name__} has no site; write at: ClassVar[str] = "base", or another site')
    dof = max(effect.joints_needed, 2)
    samples = 3
    q = np.linspace(0.1, 1.0, samples * dof).reshape(samples, dof)
    row = np.arange(1.0, samples + 1)
    motion = motion_of(
        q,
        joint_velocity=q,
        direction=np.sign(q),
        time=row,
        ambient_temperature=row,
        payload=row,
        measured_position=q[:, :1].repeat(3, 1),
    )
    evaluate, neutral = _evaluation(effect, motion)
    for name, changed in evaluate(np.zeros(effect.size)).items():
        if np.shape(changed) != np.shape(neutral[name]):
            raise InputError(
                f"{effect.label} gives {name} of shape {np.shape(changed)}; give {np.shape(neutral[name])}"
            )
        if not np.allclose(changed, neutral[name], rtol=0, atol=1e-12):
            raise InputError(f"{effect.label} changes {name} at zero; choose coordinates that change nothing at zero")
    if not effect.linear:
        return
    first_values, second_values = 1e-3 * np.random.default_rng(0).standard_normal((2, effect.size))
    parts = [evaluate(values).values() for values in (first_values, second_values, first_values + second_values)]
    for first, second, combined in zip(*parts, strict=True):
        if not np.allclose(first + second, combined, rtol=0, atol=1e-9 * max(float(np.abs(combined).max()), 1e-300)):
            raise InputError(
                f"{effect.label} is not proportional to its coordinates; write linear=False in the Coordinate that it "
                "is not proportional to"
            )


_Evaluation = tuple[Callable[[np.ndarray], dict[str, Any]], dict[str, Any]]
"""What depends on the values, by name, and what it is without an effect."""


@singledispatch
def _evaluation(effect: Any, motion: Motion) -> _Evaluation:
    """What an effect makes of a motion, by name, as a function of its values; and what it is without the effect."""
    raise NotImplementedError


@_evaluation.register
def _exerted(effect: TorqueEffect, motion: Motion) -> _Evaluation:
    dof = motion.dof
    moved = jax.tree.map(np.asarray, motion)
    q = moved.joint_position
    row = moved.time
    dynamics = Dynamics(
        motion=moved._replace(joint_acceleration=q),
        torque=q,
        links=np.ones((dof, 10)),
        payload_center=np.zeros(3),
        of_inertia=lambda numbers: np.asarray(numbers).sum(1, keepdims=True) * row,
        of_gravity=lambda gravity: np.sum(gravity) * q,
        gravity=np.array([0.0, 0.0, -9.81]),
    )
    return lambda values: {"torques": effect.torque(values, dynamics)}, {"torques": np.zeros((dof, motion.samples))}


@_evaluation.register
def _deflected(effect: Bending, motion: Motion) -> _Evaluation:
    dof = motion.dof
    samples = motion.samples
    loads = Loads(jnp.ones((dof, 3, samples)), jnp.ones((3, samples)), jnp.ones((3, samples)))
    bend = lambda values: dense(effect.deflect(jnp.asarray(values), motion, loads), dof, samples)._asdict()  # noqa: E731
    return bend, dense(Deflection(), dof, samples)._asdict()


@_evaluation.register
def _altered(effect: Altering, motion: Motion) -> _Evaluation:
    dof = motion.dof
    inertia = inertia_of(np.ones(dof), np.ones((dof, 3)))

    def alter(values: np.ndarray) -> dict[str, Any]:
        altered = effect.alter(jnp.asarray(values), motion)._asdict()
        if isinstance(effect, Loading):
            altered |= effect.alter_inertia(jnp.asarray(values), inertia)._asdict()
        return {name: value for name, value in altered.items() if neutral.get(name) is not None}

    neutral = {**motion._asdict(), **inertia._asdict(), "sliding": None}
    return alter, neutral
