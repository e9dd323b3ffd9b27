"""Reduced recordings of arms that are no robots: random columns, waves of an angle, white noise of unit variance."""

from dataclasses import replace

import numpy as np

from lite6jax.distribution.batches import Workers
from lite6jax.estimation.noise import UNCORRELATED, NoiseModel
from lite6jax.populations.candidate import Candidate
from lite6jax.populations.evidence import Reduced
from lite6jax.populations.files import to_bytes
from lite6jax.populations.functions import Function, in_common
from lite6jax.populations.options import PoolingOptions
from lite6jax.populations.population import Member, diagnose_population
from lite6jax.populations.reduced import Found, PooledTerm, ReducedArm

SAMPLES = 80
OPTIONS = PoolingOptions()
NAMED = tuple(
    Candidate(key, key, site, "none", names, (1.0,) * len(names), (lower,) * len(names), (np.inf,) * len(names), rank)
    for key, site, names, lower, rank in (
        ("soft", "joint1", ("compliance_rad_per_Nm",), 0.0, 1),
        ("bent", "link2", ("x_m", "y_m"), -np.inf, 2),
        *((f"other{k}", "tool", ("scale",), -np.inf, 5) for k in range(20)),
    )
)
WAVES = Candidate(
    "waves:joint3", "joint_harmonic", "joint3", "position of joint 3", ("sine_rad", "cosine_rad"), (1.0, 1.0),
    (-np.inf, -np.inf), (np.inf, np.inf), 5,
)  # fmt: skip
CUBIC = Function(
    "joint1", "load", ("joint1",), ("rad",), ("load",), ((-1.0, 1.0),), products=((), (0,), (0, 0), (0, 0, 0))
)
SPLINE = Function("joint3", "position", ("joint3",), ("rad",), ("position",), ((-3.0, 3.0),), pieces=5)
WIDE = Function("tool", "load and position", ("joint1", "joint3"), ("m", "m"), ("load", "position"),
                ((-1.0, 1.0), (-3.0, 3.0)), products=((), (0,), (1,)))  # fmt: skip
FUNCTIONS = (CUBIC, SPLINE, WIDE)
CANDIDATES = {candidate.key: candidate for candidate in (*NAMED, WAVES)}


def arm(rng, effects=(), found=(), noise=None, samples=SAMPLES, step=None):
    """A reduced recording; in it the effect "soft" is proportional to the driver "load".

    Args:
        rng: draws columns, angles and noise.
        effects: pairs of a term and its numbers.
        found: terms that the recording shows alone, with p-values of 1e-9.
        noise: added to the residual instead of white noise of unit variance, `(sample,)`.
        samples: of it, one row each.
        step: rad, of which the angles are multiples.
    """
    numbers = sum(len(candidate.names) for candidate in NAMED)
    columns = rng.normal(size=(numbers, samples))
    sites, angles = rng.uniform(0.5, 1.5, (1, 1, samples)), rng.uniform(-np.pi, np.pi, (1, samples))
    if step is not None:
        angles = np.round(angles / step) * step
    drivers = {"load": columns[0].copy(), "position": angles[0]}
    made = ReducedArm(
        about={"what": "poses", "arm": "none", "joints": 3, "rows": samples, "date": None, "verdict": "consistent"},
        found=tuple(Found(term, term.key, 1e-9) for term in found),
        candidates=NAMED,
        columns=columns,
        families=(WAVES,),
        sites=sites,
        angles=angles,
        noise=NoiseModel((UNCORRELATED,), np.zeros(1, int)),
        training=np.ones(samples, bool),
        basis=np.linalg.qr(rng.normal(size=(samples, 3)))[0].T,
        residual=rng.normal(size=samples) if noise is None else noise,
        blocks=(np.arange(20) * samples) // 20,
        functions=tuple(replace(one, ranges=ranges(drivers, one)) for one in FUNCTIONS),
        places={"joint1": np.ones((1, samples)), "joint3": sites[0]},
        drivers=drivers,
    )
    for term, values in effects:
        made.residual[:] -= np.asarray(values) @ made.columns_of(term)
    return made


def ranges(drivers, function):
    """Of the drivers of a function in one recording."""
    return tuple((float(drivers[key].min()), float(drivers[key].max())) for key in function.drivers)


def wave(order, size, phase):
    """A wave with its numbers."""
    return PooledTerm("waves:joint3", order), size * np.array([np.cos(phase), np.sin(phase)])


def stored(folder, arms):
    """The files of reduced recordings."""
    folder.mkdir(exist_ok=True)
    paths = [folder / f"{i:03d}.npz" for i in range(len(arms))]
    for path, one in zip(paths, arms, strict=True):
        path.write_bytes(to_bytes(one))
    return paths


def population(folder, arms, dates=None, processes=0, candidates=CANDIDATES, options=OPTIONS):
    """The result for some arms."""
    functions = in_common(function for one in arms for function in one.functions)
    members = [Member(f"arm{i}.csv", one.about, one.found) for i, one in enumerate(arms)]
    with Workers(processes=processes) as workers:
        reduced = Reduced(stored(folder, arms), options, workers, functions)
        return diagnose_population(arms[0].about["arm"], members, range(len(arms)), candidates, reduced, dates)
