"""Logs of commands and measured joints of a simulated arm: its servos, a motion of commands, and effects on following.

The rollouts are those of a diagnosis, from rest at the first command of each run.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.arms.arm import Arm
from lite6jax.arms.files import read_arm
from lite6jax.array_types import Array, Integers
from lite6jax.domains.tracking.coupling import Bodies
from lite6jax.domains.tracking.predict import DiagnosedServos, describe_servos
from lite6jax.effects.catalogue import TRACKING_EFFECTS
from lite6jax.effects.effect import Effect, Estimate
from lite6jax.effects.serialization import parse_effect
from lite6jax.errors import InputError
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import Recording, RecordingSettings
from lite6jax.recordings.settings import ServoSettings
from lite6jax.simulation.motions import SINES, SPEED, check_size, joint_ranges, make_generator, place_samples, visit

SAMPLES = 2000
"""Where no number is given."""
STEP_S = 0.01
"""s, from sample to sample, likewise."""
FEWEST = 100
"""Samples of a run: it has sines, trapezoids and steps."""
NAMED = {name: kind for name, kind in TRACKING_EFFECTS.items() if name != "unnamed"}
"""The classes of effects that may be simulated, by name."""
_FREQUENCIES = (0.1, 2.0)
"""Hz, of the sines."""
_SHARE = 0.5
"""Of each joint's range, that commands stay within."""
_RAMP = 0.15
"""Share of the sines' time in which they grow from nothing, and in which they fade."""
_REST = 0.1
"""Share of the sines' time at rest before them."""
_ACCELERATION = 8.0
"""rad/s², of trapezoids."""
_DWELL = 0.4
"""s, of a trapezoid's rest and of a step."""
_STEPS = 0.1
"""rad, of the largest step about its middle."""
_NATURAL = 2 * np.pi * 6.0
"""rad/s, of a joint on its servo, where the servo is not given."""
_LEAST = 0.05
"""Of the stiffest servo's stiffness, that others have at least."""
_LAG = 0.02
"""s, damping over stiffness at least."""
_DAMPED = 0.7
"""Damping ratio."""


def draw_commands(
    arm: Arm, samples: int = SAMPLES, *, runs: int = 1, step: float = STEP_S, speed: float = SPEED, seed: int = 0
) -> tuple[Array, Array, Integers]:
    """Random commands: in each run sines of several frequencies, then trapezoids with rests, then steps.

    Commands stay within the middle half of each joint's range. Each run begins with a rest.

    Args:
        arm: its joints' limits.
        samples: of all runs together, which are of equal length.
        runs: how many; the time goes on from one to the next.
        step: s from sample to sample.
        speed: rad/s, that no joint exceeds but in steps.
        seed: of the random numbers.

    Returns:
        `(sample,)` s, `(sample, joint)` rad, and `(sample,)` numbers of runs.

    Raises:
        InputError: prismatic joints, too few samples, or a number out of its range.
    """
    if arm.sliding:
        raise InputError(f"{arm.name}: has prismatic joints, whose commands are not simulated; choose another arm")
    check_size(samples, runs, FEWEST, step, speed)
    rng = make_generator(seed, "motion")
    run, time, since_start = place_samples(samples, runs, step)
    parts = [_draw_run(arm, since_start[run == number], speed, rng) for number in range(runs)]
    return time, np.concatenate(parts), run


def _draw_run(arm: Arm, time: Array, speed: float, rng: np.random.Generator) -> Array:
    """`(sample, joint)` rad of one run at times `(sample,)` s from zero."""
    center, half = joint_ranges(arm)
    half = _SHARE * half
    third = (time[-1] + time[1]) / 3
    of_sines = time < third
    of_trapezoids = (time >= third) & (time < 2 * third)
    first = center + 0.5 * half * rng.uniform(-1, 1, arm.dof)
    sines = first + _draw_sines(0.5 * half, time[of_sines] / third, third, speed, rng)
    places = center + half * rng.uniform(-1, 1, (20, arm.dof))
    path = visit(np.vstack([first, places]), _DWELL, speed, _ACCELERATION)
    trapezoids = path.at(time[of_trapezoids] - third)[0]
    middle = trapezoids[-1]
    number = ((time[time >= 2 * third] - 2 * third) / _DWELL).astype(int)
    size = np.minimum(_STEPS, 0.5 * half)
    aims = middle + size * rng.uniform(-1, 1, (number[-1] + 1, arm.dof))
    aims = np.clip(aims, center - half, center + half)
    return np.vstack([sines, trapezoids, aims[number]])


def _draw_sines(half: Array, share: Array, duration: float, speed: float, rng: np.random.Generator) -> Array:
    """Sines `(sample, joint)` rad within half a range that grow from rest and fade, at shares of a duration in s."""
    low, high = np.log(_FREQUENCIES)
    rate = 2 * np.pi * np.exp(rng.uniform(low, high, (SINES, len(half))))
    amplitude = rng.uniform(0.2, 1.0, rate.shape) / rate
    phase = rng.uniform(-np.pi, np.pi, rate.shape)
    wave = (amplitude * np.sin(share[:, None, None] * duration * rate + phase)).sum(1)
    grown = np.clip((share - _REST) / _RAMP, 0.0, 1.0) * np.clip((1 - share) / _RAMP, 0.0, 1.0)
    sines = (grown**2 * (3 - 2 * grown))[:, None] * wave
    fastest = np.abs(np.diff(sines, axis=0)).max(0) / (duration * (share[1] - share[0]))
    return sines * np.minimum(half / np.abs(sines).max(0), speed / fastest)


def usual_servo(arm: Arm) -> ServoSettings:
    """Servos as stiff as inertia asks for: joints swing with about 6 Hz, damped, and lag by 20 ms or more.

    Raises:
        InputError: the arm has no masses.
    """
    if arm.mass is None:
        raise InputError(f"{arm.name}: has no masses, without which no rollout is simulated; give mass_kg of each link")
    bodies = Bodies.of_arm(arm, 0.0, np.zeros(3), np.zeros(3))
    middle = joint_ranges(arm)[0]
    rotors = 0.0 if arm.rotor_inertia is None else arm.rotor_inertia
    inertia = bodies.masses(middle[:, None])[:, 0] + rotors
    stiffness = inertia * _NATURAL**2
    stiffness = np.maximum(stiffness, _LEAST * stiffness.max())
    damping = np.maximum(2 * _DAMPED * np.sqrt(stiffness * inertia), _LAG * stiffness)
    rounded = [tuple(float(f"{value:.3g}") for value in values) for values in (stiffness, damping)]
    return ServoSettings(stiffness_Nm_per_rad=rounded[0], damping_Nm_s_per_rad=rounded[1])


@final
@dataclass(frozen=True, eq=False)
class TrackingSimulation:
    """A simulated log of commands, and what is true of it.

    Attributes:
        recording: as encoders show it; its settings declare the servos and the noise.
        model: the arm with its servos and the effects.
    """

    recording: Recording
    model: DiagnosedServos

    @property
    def reported(self) -> list[tuple[Effect, dict[str, Estimate]]]:
        """The effects, each with its parameters."""
        values = self.model.values
        return [
            (effect, effect.reported(values[part], np.zeros((effect.size, effect.size))))
            for effect, part in self.model.terms.pairs
            if isinstance(effect, Effect)
        ]

    @cached_property
    def moved(self) -> Array:
        """`(joint,)` rad RMS, by which the effects move the joints."""
        plain = replace(self.model, terms=Terms(), values=np.zeros(0))
        log = self.recording
        assert log.time is not None
        assert log.commanded_position is not None
        followed = self.model.predict(log.time, log.commanded_position, log.run).position
        followed_without = plain.predict(log.time, log.commanded_position, log.run).position
        return np.sqrt(np.mean((followed - followed_without) ** 2, 0))


def simulate_tracking(
    arm: Arm | str,
    command: ArrayLike | None = None,
    *,
    effects: Iterable[str | tuple[Effect, ArrayLike]] = (),
    time: ArrayLike | None = None,
    run: ArrayLike | None = None,
    samples: int = SAMPLES,
    runs: int = 1,
    step: float = STEP_S,
    speed: float = SPEED,
    servo: ServoSettings | None = None,
    servo_known: bool = True,
    payload: float = 0.0,
    joint_noise: float = 0.0,
    joint_quantum: float = 0.0,
    settings: RecordingSettings | None = None,
    seed: int = 0,
) -> TrackingSimulation:
    """A log of an arm that follows commands with chosen effects, as `lite6jax simulate --tracking` writes one.

    Args:
        arm: with masses, or what `read_arm` takes.
        command: `(sample, joint)` rad; drawn as by `draw_commands` where not given.
        effects: beyond the arm and its servos, each as text, such as `command_delay:joint=2,delay_s=0.01`, or as an
            effect with its `(coordinate,)` values.
        time: `(sample,)` s, of given commands; every `step` where not given.
        run: `(sample,)`, of given commands; one run where not given.
        samples: how many are drawn.
        runs: in how many runs.
        step: s from sample to sample.
        speed: rad/s, that no drawn command exceeds but in steps.
        servo: as `usual_servo` where not given.
        servo_known: whether the recording declares it.
        payload: kg at the flange.
        joint_noise: rad, one sigma of the encoders.
        joint_quantum: rad, to which read-outs are rounded after that; zero rounds nothing.
        settings: the arm, gravity and the payload's centre; the arm's name and the defaults where not given.
        seed: of the random numbers.

    Raises:
        InputError: an arm without masses or with prismatic joints; an unknown effect, one without numbers or of a joint
            that the arm does not have; commands of another shape, or a number out of its range.
    """
    if isinstance(arm, str):
        arm = read_arm(arm)
    usual = usual_servo(arm)
    for name, value in (("payload", payload), ("joint_noise", joint_noise), ("joint_quantum", joint_quantum)):
        if not 0 <= value < np.inf:
            raise InputError(f"simulation: {name} is {value}; give 0 or more")
    if command is None:
        times, commands, numbers = draw_commands(arm, samples, runs=runs, step=step, speed=speed, seed=seed)
    else:
        commands = np.asarray(command, float)
        times = step * np.arange(len(commands)) if time is None else np.asarray(time, float)
        numbers = np.zeros(len(commands), int) if run is None else np.asarray(run)
    declared = replace(
        settings or RecordingSettings(arm=arm.name),
        joint_source="measured",
        motion="trajectory",
        joint_noise_rad=joint_noise,
        servo=servo or usual,
    ).for_joints(arm.dof, "simulation")
    model = servos_with_effects(arm, effects, declared, payload)
    position = model.predict(times, commands, numbers).position
    position = position + joint_noise * make_generator(seed, "joints").standard_normal(position.shape)
    if joint_quantum:
        position = joint_quantum * np.round(position / joint_quantum)
    recording = Recording.assembled(
        position,
        time=times,
        commanded_position=commands,
        payload=np.full(len(times), payload),
        run=numbers,
        settings=declared if servo_known else replace(declared, servo="unknown"),
        source="simulation",
    )
    return TrackingSimulation(recording, model)


def servos_with_effects(
    arm: Arm, effects: Iterable[str | tuple[Effect, ArrayLike]], settings: RecordingSettings, payload: float = 0.0
) -> DiagnosedServos:
    """An arm with its servos and chosen effects on how it follows commands.

    Args:
        arm: with masses.
        effects: as of `simulate_tracking`.
        settings: with declared servos, gravity and the payload's centre.
        payload: kg at the flange.

    Raises:
        InputError: servos that are not declared, or effects as of `simulate_tracking`.
    """
    terms, values = _terms_of(effects, arm)
    return describe_servos(arm, settings, payload, terms, values)


def _terms_of(effects: Iterable[str | tuple[Effect, ArrayLike]], arm: Arm) -> tuple[Terms, Array]:
    """The effects, and their numbers one after the other."""
    parsed: list[tuple[Effect, Array]] = []
    for stated_effect in effects:
        effect, values = parse_effect(stated_effect, NAMED) if isinstance(stated_effect, str) else stated_effect
        if effect.joints_needed > arm.dof:
            raise InputError(f"{effect.label}: is of a joint that {arm.name} does not have; it has {arm.dof}")
        parsed.append((effect, np.asarray(values, float)))
    kinds: Sequence[Effect] = [effect for effect, _ in parsed]
    for number, effect in enumerate(kinds):
        if effect in kinds[:number]:
            raise InputError(f"{effect.label}: is given twice; keep one")
    numbers = [values for _, values in parsed]
    return Terms(tuple(kinds)), np.concatenate(numbers) if numbers else np.zeros(0)
