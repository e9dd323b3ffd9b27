"""Reduced recordings of arms that are no robots: random columns, waves of an angle, white noise of unit variance."""

import numpy as np

from lite6jax.effects.drivers import Driver
from lite6jax.estimation.noise import UNCORRELATED, NoiseModel
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import DriverValues
from lite6jax.fleet.pooling import Reduced
from lite6jax.fleet.population import Member, diagnose_population
from lite6jax.fleet.reduced import Heading, ReducedArm
from lite6jax.fleet.terms import Candidate, FleetComponent, PooledTerm, Tried, Varied
from lite6jax.workers import Workers

SAMPLES = 80
OPTIONS = EngineOptions()
NAMED = tuple(
    Candidate(key, key, site, "none", names, (1.0,) * len(names), (lower,) * len(names), (np.inf,) * len(names))
    for key, site, names, lower in (
        ("soft", "joint1", ("compliance_rad_per_Nm",), 0.0),
        ("bent", "link2", ("x_m", "y_m"), -np.inf),
        *((f"other{k}", "tool", ("scale",), -np.inf) for k in range(20)),
    )
)
LOAD, POSITION = Driver("gravity torque", 1), Driver("position", 3)
WAVES = Candidate(
    "waves:joint3", "joint_harmonic", "joint3", POSITION.phrase, ("sine_rad", "cosine_rad"), (1.0, 1.0),
    (-np.inf, -np.inf), (np.inf, np.inf),
)  # fmt: skip


def arm(rng, effects=(), noise=None, samples=SAMPLES, step=None):
    """A reduced recording; in it the effect "soft" is proportional to the load of joint 1.

    Args:
        rng: draws columns, angles and noise.
        effects: pairs of a term and its numbers.
        noise: added to the residual instead of white noise of unit variance, `(sample,)`.
        samples: of it, one row each.
        step: rad, of which the angles are multiples.
    """
    numbers = sum(len(candidate.names) for candidate in NAMED)
    columns = rng.normal(size=(numbers, samples))
    site, angle = rng.uniform(0.5, 1.5, (1, samples)), rng.uniform(-np.pi, np.pi, samples)
    if step is not None:
        angle = np.round(angle / step) * step
    varied = (
        DriverValues(LOAD, columns[0], frozenset({"joint1"})),
        DriverValues(POSITION, angle, frozenset({"joint3"})),
    )
    heading = Heading(
        about={"what": "poses", "arm": "none", "joints": 3, "rows": samples, "date": None, "verdict": "consistent"},
        found=(),
        candidates=NAMED,
        families=(WAVES,),
        places=(FleetComponent("joint1", "rz", "rad"), FleetComponent("joint3", "rz", "rad")),
        quantities=tuple(map(Varied.of, varied)),
    )
    made = ReducedArm(
        heading=heading,
        columns=columns,
        places=np.stack([np.ones((1, samples)), site]),
        values=np.stack([columns[0], angle]),
        run=np.array([np.zeros(samples, int), np.full(samples, samples - 1)]),
        noise=NoiseModel((UNCORRELATED,), np.zeros(1, int)),
        training=np.ones(samples, bool),
        basis=np.linalg.qr(rng.normal(size=(samples, 3)))[0].T,
        residual=rng.normal(size=samples) if noise is None else noise,
        blocks=(np.arange(20) * samples) // 20,
    )
    for term, values in effects:
        made.residual[:] -= np.asarray(values) @ made.columns_of(term)
    return made


def wave(order, size, phase):
    """A wave with its numbers."""
    return PooledTerm("waves:joint3", order), size * np.array([np.cos(phase), np.sin(phase)])


def stored(folder, arms):
    """The files of reduced recordings."""
    folder.mkdir(exist_ok=True)
    paths = [folder / f"{i:03d}.npz" for i in range(len(arms))]
    for path, one in zip(paths, arms, strict=True):
        path.write_bytes(one.to_bytes())
    return paths


def tried(arms, options=OPTIONS):
    """All that some arms are tested for."""
    return Tried([one.heading for one in arms], options)


def population(folder, arms, processes=0, options=OPTIONS):
    """The result for some arms."""
    members = [Member(f"arm{i}.csv", one.heading.about, one.heading.found) for i, one in enumerate(arms)]
    with Workers(processes=processes) as workers:
        recordings = Reduced(stored(folder, arms), options, workers)
        return diagnose_population("none", members, tried(arms, options), recordings)
