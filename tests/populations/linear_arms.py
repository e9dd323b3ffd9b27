"""Reduced recordings of arms that are no robots: random columns, waves of an angle, white noise of unit variance."""

import numpy as np

from lite6jax.estimation.noise import UNCORRELATED, NoiseModel
from lite6jax.populations.options import PoolingOptions
from lite6jax.populations.reduced import Candidate, Found, PooledTerm, ReducedArm

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
CANDIDATES = {candidate.key: candidate for candidate in (*NAMED, WAVES)}


def arm(rng, effects=(), found=(), noise=None, samples=SAMPLES):
    """A reduced recording.

    Args:
        rng: draws columns, angles and noise.
        effects: pairs of a term and its numbers.
        found: terms that the recording shows alone, with p-values of 1e-9.
        noise: added to the residual instead of white noise of unit variance, `(sample,)`.
        samples: of it, one row each.
    """
    numbers = sum(len(candidate.names) for candidate in NAMED)
    made = ReducedArm(
        about={"arm": "none", "joints": 3, "rows": samples, "date": None, "verdict": "consistent"},
        found=tuple(Found(term, term.key, 1e-9) for term in found),
        candidates=NAMED,
        columns=rng.normal(size=(numbers, samples)),
        families=(WAVES,),
        sites=rng.uniform(0.5, 1.5, (1, 1, samples)),
        angles=rng.uniform(-np.pi, np.pi, (1, samples)),
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
