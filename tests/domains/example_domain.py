"""A domain in one file: a mass on a spring and a damper. Force in, position out; it may be rubbed by friction.

m ẍ + d ẋ + k x + c sign ẋ = u(t), with the position in `q1_rad`, and the force in `tau1_Nm`, of a recording.
"""

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import ClassVar, NamedTuple

import numpy as np

from lite6jax.diagnosis.heldout import errors_of_folds, errors_of_refit, judge_by_folds, verify
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.result import AS_NOISE, DomainDiagnosis
from lite6jax.domains.base import Domain
from lite6jax.domains.entries import Document, ModelEntry, shared_fields
from lite6jax.domains.words import Words
from lite6jax.effects.effect import Coordinate, Effect, final_effect
from lite6jax.estimation.terms import Terms, join
from lite6jax.recordings import Recording, read_motion
from lite6jax.recordings.sequence import contiguous_blocks
from lite6jax.search.final_estimates import final_estimates
from lite6jax.search.search import search


@final_effect
class Rubbing(Effect):
    """A friction that has one size at every speed."""

    name: ClassVar[str] = "rubbing"
    domain: ClassVar[str] = "oscillators"
    at: ClassVar[str] = "joint"
    quantities: ClassVar[tuple[str, ...]] = ("velocity",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (Coordinate("friction_N", "N", 0.1, lower=0.0, upper=5.0),)

    joint: int = 1


@final_effect
class Softening(Effect):
    """A spring that is softer by a share."""

    name: ClassVar[str] = "softening"
    domain: ClassVar[str] = "oscillators"
    at: ClassVar[str] = "joint"
    quantities: ClassVar[tuple[str, ...]] = ("position",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (Coordinate("share", "1", 0.1, lower=-0.9, upper=0.9),)

    joint: int = 1


class Oscillator(NamedTuple):
    """Mass, kg, damping, N s/m, and stiffness, N/m."""

    mass: float = 1.0
    damping: float = 2.0
    stiffness: float = 40.0

    def rolled_out(self, time, force, terms=(), values=()):
        """`(sample,)` m, from rest."""
        numbers = {term.name: value for term, value in zip(terms, values, strict=True)}
        stiffness = self.stiffness * (1 - numbers.get("softening", 0.0))
        friction = numbers.get("rubbing", 0.0)
        h = float(np.median(np.diff(time)))
        x, v, path = 0.0, 0.0, []
        for u in force:
            path.append(x)
            pushed = v + h * (u - self.damping * v - stiffness * x) / self.mass
            v = np.sign(pushed) * max(abs(pushed) - h * friction / self.mass, 0.0)
            x += h * v
        return np.array(path)


@dataclass(frozen=True, eq=False)
class OscillatorProblem:
    """Rolled out less measured positions, over the noise; nothing of the oscillator is uncertain but the effects."""

    recording: Recording
    oscillator: Oscillator
    noise: float

    rows = 1
    groups = np.zeros(1, int)
    precision = offset = np.zeros(0)
    informative = np.zeros(0, bool)
    preset = (Terms(), np.zeros(0))
    declared = True
    floored = curved = False
    candidates = (Rubbing(), Softening())
    shaped = periodic = components = quantities = untestable = ()

    samples = property(lambda self: self.recording.samples)
    valid = property(lambda self: np.ones(self.samples, bool))
    run = property(lambda self: np.zeros(self.samples, int))
    every_run = property(lambda self: np.outer([0, self.samples - 1], np.ones(self.samples, int)))

    def _position(self, terms, values):
        return self.oscillator.rolled_out(self.recording.time, self.recording.joint_torque[:, 0], terms.terms, values)

    def residual(self, nuisance, terms, values):
        return (self._position(terms, values) - self.recording.joint_position[:, 0])[None] / self.noise

    def errors(self, nuisance, terms, values):
        rows = self.residual(nuisance, terms, values)
        return rows * self.noise, rows

    def columns(self, terms, values=None, beside=None):
        model = Terms(tuple(terms))
        at = np.zeros(model.size) if values is None else np.asarray(values, float)
        base = self._position(model, at)
        steps = 1e-3 * np.eye(model.size)
        changed = [(self._position(model, at + step) - base) / 1e-3 / self.noise for step in steps]
        return np.array(changed).reshape(model.size, 1, self.samples)

    def factored(self, term):
        return None

    def nuisance_columns(self, terms, values):
        return np.zeros((0, 1, self.samples))

    def limits(self, term):
        return [(number.lower, number.upper) for number in term.coordinates]

    def relinearised(self, nuisance, beside=None):
        return self

    def seen(self, functions):
        return functions

    def thinned(self, every):
        return self

    def inputs(self, terms):
        return ()

    def alternative(self, terms):
        return None


class ShownPosition(NamedTuple):
    """`(sample,)` m."""

    shown: np.ndarray


@dataclass(frozen=True, eq=False)
class DiagnosedOscillator:
    """An oscillator with the effects that were found."""

    oscillator: Oscillator
    terms: Terms
    values: np.ndarray
    uncertainty: None = None
    reference_temperature: float = 20.0

    dof = 1
    sliding = ()
    motion = "trajectory"
    joint_limits = None

    def read_motion(self, path):
        return read_motion(path, self)

    def predicted(self, motion, time_remedy="add time_s"):
        path = self.oscillator.rolled_out(motion.time, motion.joint_torque[:, 0], self.terms.terms, self.values)
        return ShownPosition(path)


class OscillatorEntry(ModelEntry, kw_only=True):
    """The model in a file."""

    oscillator: tuple[float, float, float]


class OscillatorDocument(Document[OscillatorEntry], kw_only=True):
    """What is read of a file."""

    catalogue: ClassVar = {kind.name: kind for kind in (Rubbing, Softening)}

    def restored(self, effects):
        terms, values = self.restored_effects(effects)
        return DiagnosedOscillator(Oscillator(*self.model.oscillator), Terms(terms), join(values))


WORDS = Words("positions", "position")
OSCILLATORS = Domain("oscillators", WORDS, lambda _: "read", OscillatorDocument, lambda log: False)


@dataclass(frozen=True, eq=False, repr=False)
class OscillatorDiagnosis(DomainDiagnosis[OscillatorProblem]):
    """The diagnosis of an oscillator."""

    domain: ClassVar[str] = "oscillators"

    recording = property(lambda self: self.problem.recording)
    moves = property(lambda self: ({},) * len(self.findings))
    _noise = property(lambda self: ({"position_m": self.problem.noise}, {"position_m": self.problem.noise}))
    _peak_to_peak = None  # of nonparametric effects, which there are none of
    _leaves_noise = property(lambda self: self.most_over_noise <= AS_NOISE)

    @cached_property
    def over_noise(self):
        return {"position": float(np.sqrt(np.mean(self.after**2)) / self.problem.noise)}

    @cached_property
    def model(self):
        return DiagnosedOscillator(self.problem.oscillator, self.fit.terms, self.fit.values)

    def _statistics(self, errors, kept):
        return {"heldout_position_rms_m": float(np.sqrt(np.mean(errors[:, kept] ** 2)))}

    def _own_parts(self):
        covariances = [finding.covariance for finding in self.findings]
        fields = shared_fields(self.model, self.fit.terms.pairs, covariances)
        own = {"arm": "oscillator", "kinematics": [[0.0] * 6], "oscillator": list(self.problem.oscillator)}
        return {"model": own | fields}


class OscillatorReport:
    """The report, of the document alone."""

    def with_statements(self, document):
        findings = []
        for finding in document["findings"]:
            ((name, estimate),) = finding["parameters"].items()
            statement = f"The mass has {finding['effect']}: {name} {estimate['value']:.3f} ± {estimate['std']:.1g}."
            findings.append({**finding, "statement": statement})
        return {**document, "findings": findings}

    def parts_of(self, document, files, details, pictures):
        sizes = [f"{1e3 * document[stage]['heldout_position_rms_m']:.3f}" for stage in ("before", "after")]
        statements = [finding["statement"] for finding in document["findings"]]
        return [
            ("", [("cause", (document["verdict"], f"The oscillator is {document['verdict']}."))]),
            ("Held-out errors", [("table", (["before (mm)", "after (mm)"], [sizes]))]),
            ("Findings", [("bullets", statements)]),
        ]


def diagnose_oscillator(recording, oscillator, noise):
    """Searched in all rows, and verified in fifths."""
    options = Options()
    problem = OscillatorProblem(recording, oscillator, noise)
    selection = search(problem, options.engine)
    selection = replace(selection, state=final_estimates(problem, selection.state, options.engine))
    folds = contiguous_blocks(problem.samples, 5)
    held_out = partial(errors_of_folds, errors_of_refit, (selection, options.engine), anywhere=False)
    verified = verify(selection, held_out(folds), folds, problem.valid, held_out, judge_by_folds)
    nothing = {"faults": (), "ruled_out": (), "outliers": ~problem.valid}
    return OscillatorDiagnosis(problem=problem, options=options, **nothing, **verified._asdict())
