"""Recordings of arms with known physics, from the plain generator: what a diagnosis is asked to find again."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.concealed.trials import draw
from lite6jax.arms.description import load_bundled
from lite6jax.arms.factory import write_factory
from lite6jax.domains.pose.linearisation import linearised
from lite6jax.effects.serialization import parse_effect
from lite6jax.estimation.least_squares import fit
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import Recording, RecordingSettings, read_recording
from lite6jax.recordings.settings import FactoryUncertainty
from lite6jax.search.search import reviewed, select
from tests.oracles.arms import perturbed
from tests.oracles.effects import predicted_poses
from tests.oracles.transforms import perturb_poses, quaternions

OPTIONS = EngineOptions()
NO_TERMS = Terms()
LITE6 = load_bundled("lite6")
NOISE = (2e-5, 1e-4)
"""m and rad per axis: a laser tracker with a six-dimensional probe."""
PAYLOAD_COM = (0.02, -0.01, 0.04)
GRAVITY = (0.0, 0.0, -9.81)


def drawn(folder, seed, trial, sealed=False):
    """The recording of a concealed trial; its files are written into the folder."""
    for name, text in draw(seed, trial, sealed).files.items():
        (folder / name).write_text(text)
    return read_recording(folder / "recording.csv")


def static_motion(seed=0, samples=160):
    """Poses all over the ranges with changing loads, in an arm that warms up; times 8 s apart."""
    rng = np.random.default_rng(seed)
    lower, upper = np.maximum(LITE6.joint_limits[:, 0], -np.pi), np.minimum(LITE6.joint_limits[:, 1], np.pi)
    q = rng.uniform(lower, upper, (samples, 6))
    rise = 18 * (1 - np.exp(-np.arange(samples) / (samples / 3)))
    return {
        "joint_position": q,
        "joint_velocity": np.zeros_like(q),
        "direction": np.sign(np.diff(q, axis=0, prepend=0.0)),
        "time": 8.0 * np.arange(samples),
        "run": np.zeros(samples, int),
        "joint_temperature": 22 + rise[:, None] + rng.uniform(-1, 1, (samples, 6)),
        "payload": rng.choice([0.0, 0.4, 0.9], samples),
    }


def moving_motion(seed=0, samples=400):
    """Two runs at 50 Hz of joints that swing at two rates each."""
    rng = np.random.default_rng(seed)
    run = np.repeat([0, 1], samples // 2)
    time = 0.02 * np.arange(samples) + 3.0 * run
    rate, phase = rng.uniform(0.6, 2.4, (2, 6)), rng.uniform(-np.pi, np.pi, (2, 6))
    size = np.array([[0.9], [0.4]])
    angle = np.multiply.outer(time, rate) + phase
    q = np.sum(size * np.sin(angle), 1) + np.array([0, 0, 1.2, 0, 0, 0])
    dq = np.sum(size * rate * np.cos(angle), 1)
    return {
        "joint_position": q,
        "joint_velocity": dq,
        "direction": np.sign(dq),
        "time": time,
        "run": run,
        "joint_temperature": np.full((samples, 6), 25.0) + rng.uniform(0, 5, (samples, 6)),
        "payload": np.zeros(samples),
    }


def plain_effect(text):
    """The name and the parameters, as the plain generator takes them, of an effect's text form."""
    name, _, rest = text.partition(":")
    written = dict(item.split("=") for item in rest.split(",") if item)
    values = {key: float(value) for key, value in written.items() if key not in ("turned", "cross", "shift")}
    for key in {"joint", "link"} & set(values):
        values[key] = int(values[key])
    return name, values


@dataclass(frozen=True, eq=False)
class Made:
    """An arm as it was made and set up, with physics.

    Attributes:
        folder: where its factory calibration may be written.
        effects: in text form.
        seed: of the arm as made and of its set-up.
        geometry: whether the sidecar declares the arm's own: "exact", "prior" (each number off by a standard deviation)
            or "free".
        frame: whether the sensor stands somewhere unknown.
        tool: whether the measured point does.
        orientation: whether orientations are measured.
        inertial: the declared uncertainty of masses, relative to them.
        payload: that of the payload in kg.
    """

    folder: object
    effects: tuple[str, ...] = ()
    seed: int = 0
    geometry: str = "exact"
    frame: bool = False
    tool: bool = False
    orientation: bool = True
    inertial: float = 0.0
    payload: float = 0.0

    @cached_property
    def kinematics(self):
        return perturbed(np.random.default_rng(100 + self.seed), LITE6.kinematics)

    @cached_property
    def T_sensor_base(self):
        return _somewhere(200 + self.seed, 1.0) if self.frame else np.eye(4)

    @cached_property
    def T_flange_tool(self):
        return _somewhere(300 + self.seed, 0.06) if self.tool else np.eye(4)

    def inertia(self):
        return {
            "mass": LITE6.mass,
            "center_of_mass": LITE6.center_of_mass,
            "payload_center": np.array(PAYLOAD_COM),
            "gravity": np.array(GRAVITY),
        }

    def poses(self, motion, bump=None):
        """(sample, 4, 4) without noise; `bump` (joint, a function of its position) is physics without a name."""
        if bump is not None:
            joint, curve = bump
            q = motion["joint_position"].copy()
            q[:, joint - 1] += curve(q[:, joint - 1])
            motion = {**motion, "joint_position": q}
        effects = [plain_effect(text) for text in self.effects]
        return predicted_poses(self.kinematics, self.T_sensor_base, self.T_flange_tool, motion, self.inertia(), effects)

    def settings(self, motion="static"):
        uncertainty = None
        declared = None
        if self.geometry != "free":
            off = np.zeros_like(self.kinematics)
            if self.geometry == "prior":
                off = 5e-5 * np.random.default_rng(400 + self.seed).standard_normal(off.shape)
                uncertainty = FactoryUncertainty(5e-5, 5e-5)
            declared = self.folder / f"factory_{self.geometry}_{self.seed}.yaml"
            if not declared.exists():
                write_factory(self.kinematics + off, declared)
            declared = str(declared)
        return RecordingSettings(
            arm="lite6",
            motion=motion,
            pose_frame="unknown" if self.frame else "base",
            tool="unknown" if self.tool else "none",
            factory_calibration=declared,
            factory_uncertainty=uncertainty,
            position_noise_m=NOISE[0],
            orientation_noise_rad=NOISE[1] if self.orientation else None,
            payload_com_m=PAYLOAD_COM,
            inertial_uncertainty=self.inertial,
            payload_uncertainty_kg=self.payload,
        )

    def recording(self, motion, noise=NOISE, seed=0, bump=None, poses=None):
        """What the sensor made of it."""
        poses = self.poses(motion, bump) if poses is None else poses
        if noise is not None:
            poses = perturb_poses(np.random.default_rng(500 + seed), poses, *noise)
        moving = bool(motion["joint_velocity"].any())
        return Recording.from_arrays(
            motion["joint_position"],
            position=poses[:, :3, 3],
            quaternion=quaternions(poses) if self.orientation else None,
            time=motion["time"],
            joint_velocity=motion["joint_velocity"] if moving else None,
            joint_temperature=motion["joint_temperature"],
            payload=motion["payload"],
            run=motion["run"],
            settings=self.settings("trajectory" if moving else "static"),
            source=str(self.folder / "run.csv"),
        )


def with_effects(made, *effects):
    """The same arm with other physics."""
    return replace(made, effects=effects)


def truth(text):
    """The library's effect of a text form, and its parameters by the names of reports."""
    effect, values = parse_effect(text)
    return effect, {name: estimate.value for name, estimate in effect.reported(values).items()}


def fitted_to(problem, terms=NO_TERMS, values=None, nuisance=None, training=None, exact=False):
    """The engine's fit at the documented options."""
    return fit(problem, terms, OPTIONS, values, nuisance, training, exact=exact)


def searched(problem, training=None):
    """The search of a problem that is not linearised yet, at the documented options."""
    late, reference = linearised(problem, OPTIONS, training)
    return reviewed(select(late, OPTIONS, training, reference), OPTIONS)


def found(selection):
    """(effect, site) of each finding of a search, sorted."""
    return sorted((tested.term.name, tested.term.site) for tested in selection.state.tested)


def estimates(selection, name, site):
    """The parameters of the finding of this name and site."""
    fitted = selection.state.fit
    for effect, part in fitted.terms.pairs:
        if (effect.name, effect.site) == (name, site):
            return effect.reported(fitted.values[part], fitted.covariance[part, part])
    raise AssertionError(f"no {name} at {site} among {found(selection)}")


def check_values(selection, text, within=4.0, sharp=0.1):
    """Every parameter within `within` standard deviations of the truth, and these a small part of the largest."""
    effect, wanted = truth(text)
    got = estimates(selection, effect.name, effect.site)
    assert set(got) == set(wanted)
    sizes = {}
    for name in got:
        if name not in ("order", "source_joint", "phase_rad"):
            unit = name.rsplit("_", 1)[-1]
            sizes[unit] = max(sizes.get(unit, 0.0), abs(wanted[name]))
    for name, (value, std) in got.items():
        off = value - wanted[name]
        if name == "phase_rad":
            assert abs(np.angle(np.exp(1j * off))) <= within * std
            assert std < 2 * sharp
        elif name in ("order", "source_joint"):
            assert abs(off) < 0.05, (name, value)
        else:
            assert abs(off) <= within * std, (name, value, std, wanted[name])
            size = sizes[name.rsplit("_", 1)[-1]]
            assert size == 0 or std < sharp * size, (name, value, std, wanted[name])


def _somewhere(seed, distance):
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rng.uniform(-1.5, 1.5, 3)).as_matrix()
    T[:3, 3] = distance * rng.uniform(-1, 1, 3)
    return T
