"""Data faults weighed against physics: of both, the more likely explanation of a recording.

This is the one orchestrator above screening and search. Screening corrects what is plainly a fault. A frame jump,
joints that were read before they settled, a constant of distances, another nominal table and a calibration file whose
numbers all have errors resemble physics: each is accepted only where it is more likely than the physics found without
it; the last two, and a constant that the screening left open, by the cost of their prior probability.
"""

from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import final

import numpy as np

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.array_types import Array, Mask
from lite6jax.calibration.problem import Geometry
from lite6jax.diagnosis.fault_alternative import FaultAlternative, missing_effects
from lite6jax.diagnosis.options import Options
from lite6jax.domains.pose.linearisation import linearised, search_load_model
from lite6jax.domains.pose.problem import PoseProblem, pose_problem
from lite6jax.domains.pose.screening.screen import price, screen
from lite6jax.domains.pose.screening.screened import Corrections, ScreenedPoses
from lite6jax.effects.deflection import place_of
from lite6jax.effects.effect import Effect
from lite6jax.effects.kernels import remembers
from lite6jax.estimation.noise import NoiseModel, white_noise
from lite6jax.estimation.projection import schur_complement
from lite6jax.estimation.thresholds import CLOSE
from lite6jax.progress import entered
from lite6jax.recordings import FactoryUncertainty, Recording, require_samples
from lite6jax.recordings.fault import DataFault
from lite6jax.search.search import NO_TERMS, Selection, Start, reviewed, supported

_evidence = attrgetter("evidence")
_UNCERTAINTIES = np.geomspace(1e-7, 1e-3, 81)
"""Standard deviations, m and rad, of the errors of a calibration: from a controller's last digit to another arm."""


@final
@dataclass(frozen=True)
class Decisions:
    """What has been decided between faults and physics, and which physics was found.

    Attributes:
        corrections: which of the faults that physics resembles are corrected.
        published: the calibration file in whose place a nominal table is held exactly, or None.
        sigma: standard deviation, m and rad, of the errors of all numbers of the calibration; None where it is exact.
        physics: the terms, of which those are kept that the rows support; searched where None.
        accelerated: whether the loads of these terms have inertial forces.
    """

    corrections: Corrections = field(default_factory=Corrections)
    published: str | None = None
    sigma: float | None = None
    physics: Start | None = None
    accelerated: bool = False


@final
@dataclass(frozen=True, eq=False)
class Explanation:
    """What a recording shows, once some of its faults are corrected.

    Attributes:
        screened: the recording with these faults corrected; of the training rows.
        selection: the physics found in what is left.
        price: log-likelihood that the corrections must gain, for their probabilities and estimated quantities.
        decisions: between faults and physics.
        alternatives: faults that explain nearly as much as some of the physics, in its place.
    """

    screened: ScreenedPoses
    selection: Selection
    price: float
    decisions: Decisions
    alternatives: tuple[FaultAlternative, ...] = ()

    @property
    def problem(self) -> PoseProblem:
        """The problem that was searched."""
        assert isinstance(self.selection.problem, PoseProblem)
        return self.selection.problem

    @property
    def readings(self) -> float:
        """How many numbers were measured."""
        return float(self.problem.rows * self.selection.state.fit.training.sum())

    @property
    def evidence(self) -> float:
        """Log evidence in the noise that is left, less what the choices of physics, noise model and faults cost."""
        return float(self.selection.evidence - self.price)

    @property
    def final_decisions(self) -> Decisions:
        """The decisions, with the frame jumps that were corrected and the physics that was found."""
        numbers = [fault.numbers for fault in self.screened.found if fault.code == "frame_jump"]
        jumps = tuple((int(n["row"]), str(n["part"])) for n in numbers)
        corrections = replace(self.decisions.corrections, known_jumps=jumps)
        accelerated = self.problem.motion.joint_acceleration is not None
        return replace(self.decisions, corrections=corrections, physics=self.selection.start, accelerated=accelerated)

    @property
    def physics(self) -> list[Effect]:
        """The effects it has."""
        return [term for term in self.selection.state.fit.terms.terms if isinstance(term, Effect)]

    @property
    def labels(self) -> list[str]:
        """The labels of these."""
        return [effect.label for effect in self.physics]

    def with_alternative(self, with_fault: "Explanation", fault: DataFault, gap: float) -> "Explanation":
        """The same, with a fault as an alternative of the physics that an explanation with this fault does without.

        Args:
            with_fault: the likeliest explanation with the fault.
            fault: with the numbers that are said of it.
            gap: by how much that explanation is less likely; from six nats on the fault is no alternative.
        """
        replaced = tuple(missing_effects(self.physics, with_fault.physics))
        if gap >= CLOSE or not replaced:
            return self
        together_with = tuple(missing_effects(with_fault.physics, self.physics))
        alternative = FaultAlternative(fault, gap, replaced, together_with)
        return replace(self, alternatives=(*self.alternatives, alternative))


@final
@dataclass(frozen=True, eq=False)
class Case:
    """What is to be explained.

    Attributes:
        recording: measured poses.
        arm: the nominal arm; from the sidecar where not given.
        geometry: what is known of it, as in `fit`.
        options: thresholds.
        effects: a user's own candidates.
        factory: the arm's calibration; from the sidecar where not given.
        training: `(sample,)` bool, the rows that may be used; all where not given. Screening, clock, linearisation and
            search use no other.
    """

    recording: Recording
    arm: Arm | None
    geometry: Geometry
    options: Options
    effects: tuple[Effect, ...] = ()
    factory: FactoryCalibration | None = None
    training: Mask | None = None

    def screened(self, corrections: Corrections) -> ScreenedPoses:
        """With these faults corrected, from the training rows."""
        entered("screening")
        used = self.recording if self.training is None else self.recording.select(self.training)
        return screen(used, self.arm, self.geometry, self.options.prior, corrections, self.factory)

    def problem(self, screened: ScreenedPoses, geometry: Geometry | None = None) -> PoseProblem:
        """The problem of all rows, with the corrections that the training rows support; not linearised yet."""
        recording = screened.recording if self.training is None else screened.transferred(self.recording)
        jumps = [(int(f.numbers["row"]), str(f.numbers["part"])) for f in screened.found if f.code == "frame_jump"]
        return pose_problem(recording, screened.arm, geometry or self.geometry, self.effects, screened.factory, jumps)

    def prepared(self, screened: ScreenedPoses, decisions: Decisions) -> tuple[ScreenedPoses, PoseProblem]:
        """The screened recording and its problem under these decisions."""
        if decisions.sigma is not None:
            screened = _uncertain(screened, decisions.sigma)
        if decisions.published is None:
            return screened, self.problem(screened)
        # the nominal table in place of the calibration file, held exactly as the file's was
        assert screened.arm is not None
        rows = np.array([frames.row_from_transform(link) for link in screened.arm.links])
        file = {"factory_calibration": decisions.published, "factory_uncertainty": None}
        recording = replace(screened.recording, settings=replace(screened.recording.settings, **file))
        screened = replace(screened, data=recording)
        problem = self.problem(screened, "exact")
        return screened, replace(problem, start=problem.start._replace(geometry=rows.ravel()))  # type: ignore[arg-type]

    def search(self, screened: ScreenedPoses, decisions: Decisions) -> Explanation:
        """With the physics that a search finds under these decisions, or that they name and the rows support."""
        screened, problem = self.prepared(screened, decisions)
        training = self.training
        engine = self.options.engine
        require_samples(screened.recording, problem.undeclared + 1)
        entered("linearising")
        at_offset, reference = linearised(problem, engine, training)
        physics = decisions.physics
        if screened.count("computed_pose"):  # what is left is rounding, which no physics made
            physics = NO_TERMS
        if physics is None:
            selection = search_load_model(at_offset, reference, engine, training)
        else:
            at_offset = at_offset.with_loads(decisions.accelerated)
            reference = reference.with_loads(decisions.accelerated)
            rows = problem.valid if training is None else training
            selection = supported(at_offset, physics, engine, rows, reference)
        readings = float(problem.rows * selection.state.fit.training.sum())
        return Explanation(screened, selection, price(screened, readings, problem.samples), decisions)

    def explanation(self, decisions: Decisions) -> Explanation:
        """With the faults corrected that these decisions name, and the physics found then."""
        return self.search(self.screened(decisions.corrections), decisions)


def explain(case: Case, decisions: Decisions | None = None) -> Explanation:
    """The most likely explanation of a recording by data faults and physics.

    Faults and physics are weighed here, and alternatives of terms determined, where no decisions are given.

    Raises:
        InputError: as `screen` and `pose_problem`.
    """
    explanation = case.explanation(decisions or Decisions())
    if decisions is None:
        for weighed in (_jumps_weighed, _settling_weighed, _constant_weighed, _table_weighed, _calibration_weighed):
            earlier = explanation.alternatives
            explanation = weighed(explanation, case)
            alternatives = tuple(dict.fromkeys((*earlier, *explanation.alternatives)))
            explanation = replace(explanation, alternatives=alternatives)
        explanation = replace(explanation, selection=reviewed(explanation.selection, case.options.engine))
    return _with_wandering(explanation)


def _with_wandering(explanation: Explanation) -> Explanation:
    """With a fault that names the read-outs which the search found to wander by themselves."""
    wandering = explanation.selection.wandering
    if not wandering:
        return explanation
    problem = explanation.problem
    memories = [problem.memory_of(effect) for effect in problem.wandering]
    fault = DataFault("wandering_readout", (), {
        "joints": [place_of(effect.where)[1] for effect in problem.wandering],
        "std_rad": [effect.spread for effect in problem.wandering],
        "memory_samples": [memory.samples for memory in memories],
        "remembers": [remembers(effect.rolloff, problem.samples) for effect in problem.wandering],
        "memory_s": None if problem.motion.time is None else [memory.seconds for memory in memories],
        "log_likelihood_gap": [selected_term.gain for selected_term in wandering],
    })  # fmt: skip
    return replace(explanation, screened=replace(explanation.screened, found=(*explanation.screened.found, fault)))


def _jumps_weighed(explanation: Explanation, case: Case) -> Explanation:
    """The likeliest of: all jumps corrected, the same estimated without physics, and fewer of them corrected."""
    count = explanation.screened.count("frame_jump")
    if not count:
        return explanation
    # a twist estimated beside all physics has a large variance, and one estimated beside none is biased by physics
    bare = case.explanation(Decisions(Corrections(beside_physics=False)))
    fewer = [case.explanation(Decisions(Corrections(jumps=k))) for k in range(count)]
    explanation = max(explanation, bare, key=_evidence)
    rival = max(fewer, key=_evidence)
    rows = [fault.rows[0] for fault in explanation.screened.found if fault.code == "frame_jump"]
    return _likelier(explanation, rival, "frame_jump", candidate_rows=rows)


def _settling_weighed(explanation: Explanation, case: Case) -> Explanation:
    """With the joint positions as recorded, where physics explains the poses better than joints read before they stood.

    In few poses an effect that is not modelled can look like such remaining motion. To correct it makes an error that
    physics must undo, for example by a backlash of twice the size.
    """
    if not explanation.screened.count("unsettled_readouts"):
        return explanation
    corrections = replace(explanation.decisions.corrections, settling=False)
    rival = case.explanation(replace(explanation.decisions, corrections=corrections))
    return _likelier(explanation, rival, "unsettled_readouts")


def _constant_weighed(explanation: Explanation, case: Case) -> Explanation:
    """With or without a constant of the distances, whichever is likelier with the physics found beside it.

    A constant that the screening left open is tried where physics was found, which may be it.
    """
    readings = case.recording.touches
    if readings is None or readings.kind != "distance" or case.recording.settings.distance_offset == "unknown":
        return explanation
    screened = bool(explanation.screened.count("distance_offset"))
    if not screened and not explanation.selection.state.tested:
        return _with_constant(explanation, False)
    corrections = replace(explanation.decisions.corrections, constant=not screened)
    rival = case.explanation(replace(explanation.decisions, corrections=corrections))
    if screened:
        explanation = _likelier(explanation, rival, "distance_offset")
    else:
        gap = explanation.evidence - rival.evidence
        if gap < 0:
            explanation = _likelier(rival, explanation, "distance_offset")
        else:
            constant = _fault_of(rival, "distance_offset")
            explanation = explanation.with_alternative(rival, constant, gap)
    return _with_constant(explanation, bool(explanation.screened.count("distance_offset")))


def _with_constant(explanation: Explanation, constant: bool) -> Explanation:
    """With the decision on a constant of the distances, for the folds."""
    corrections = replace(explanation.decisions.corrections, constant=constant)
    return replace(explanation, decisions=replace(explanation.decisions, corrections=corrections))


def _likelier(explanation: Explanation, rival: Explanation, code: str, **numbers: object) -> Explanation:
    """The explanation with a fault, or the one by physics in its place with the fault ruled out."""
    gap = explanation.evidence - rival.evidence
    if gap > 0:
        more = {"log_likelihood_gap": gap, "rival_terms": rival.labels}
        return replace(explanation, screened=_with_numbers(explanation.screened, code, more))
    rival = rival.with_alternative(explanation, _fault_of(explanation, code).with_numbers(**numbers), -gap)
    numbers = {"reason": "physics", **numbers, "log_likelihood_gap": -gap, "rival_terms": rival.labels}
    ruled_out = (*rival.screened.ruled_out, DataFault(code, (), numbers))
    return replace(rival, screened=replace(rival.screened, ruled_out=ruled_out))


def _fault_of(explanation: Explanation, code: str) -> DataFault:
    """The first fault of a code that an explanation has."""
    return next(fault for fault in explanation.screened.found if fault.code == code)


def _table_weighed(explanation: Explanation, case: Case) -> Explanation:
    """With another nominal table than the file's, where that is more likely than physics: as published, or fitted.

    A table that the screening leaves open is first compared with physics. Once a table is accepted, the chain is either
    held as published or fitted from there.
    """
    file = case.recording.settings.factory_calibration
    likelier = explanation.screened.likelier_table
    if file is None or (likelier is None and not explanation.screened.count("nominal_table")):
        return explanation
    used = explanation.screened
    if likelier is not None:
        rescreened = case.screened(replace(used.corrections, table=likelier))
        faults = (*used.found, *(fault for fault in rescreened.found if fault.code == "nominal_table"))
        ruled_out = tuple(fault for fault in used.ruled_out if fault.code != "nominal_table")
        used = replace(rescreened, found=faults, ruled_out=ruled_out)
    published = case.search(used, Decisions(used.corrections, published=file))
    gap = published.evidence - explanation.evidence
    more: dict[str, object] = {}
    if likelier is not None:
        if gap <= 0:
            return explanation.with_alternative(published, _fault_of(published, "nominal_table"), -gap)
        more = {"log_likelihood_gap": gap, "rival_terms": explanation.labels}
    if case.geometry != "declared":
        return replace(explanation, screened=_with_numbers(used, "nominal_table", more))
    fitted = explanation if likelier is None else case.search(used, Decisions(used.corrections))
    numbers = len(fitted.problem.frames) - len(published.problem.frames)
    if fitted.evidence - 0.5 * numbers * np.log(fitted.readings) > published.evidence:
        return replace(fitted, screened=_with_numbers(used, "nominal_table", more | {"chain": "fitted"}))
    more |= {"chain": "as_published", "numbers_more": numbers}
    recording = published.screened.recording
    return replace(published, screened=replace(_with_numbers(used, "nominal_table", more), data=recording))


def _calibration_weighed(explanation: Explanation, case: Case) -> Explanation:
    """With a calibration whose numbers all have random errors, where that is more likely than some physics.

    An error of one frame may be a bent link; a file that is stale, or rounded, has errors everywhere. Of the two the
    likelier is claimed, each at its prior; where they are not distinguished, the other is its alternative.
    """
    settings = explanation.screened.recording.settings
    exact = case.geometry == "declared" and settings.factory_calibration and not settings.factory_uncertainty
    if not exact or not explanation.selection.state.tested or explanation.screened.count("nominal_table"):
        return explanation
    # physics that is not modelled resembles autocorrelated noise, and so do a chain's errors, in a trajectory
    fit = explanation.selection.state.fit
    models = [fit.noise] if fit.noise.white else [fit.noise, white_noise(explanation.problem.groups)]
    odds, sigma = max(_odds_of_uncertainty(explanation, case, model) for model in models)
    cost = case.options.prior.cost("calibration_off")
    # errors of the least size say nothing of the residuals: that file is the exact one, at a cost
    if sigma <= _UNCERTAINTIES[0] or odds - cost <= -CLOSE:
        return explanation
    rival = case.search(explanation.screened, replace(explanation.decisions, sigma=sigma))
    # the chain's numbers are integrated over; their common size is one number that was chosen
    of_size = 0.5 * float(np.log(rival.readings))
    rival = replace(rival, price=rival.price + cost + _log_volume_ratio(rival) + of_size)
    gap = rival.evidence - explanation.evidence
    if gap <= -CLOSE:
        return explanation
    size = {"sigma_m": sigma, "sigma_rad": sigma}
    numbers = {**size, "log_likelihood_gap": gap, "rival_terms": explanation.labels}
    if gap <= 0:
        explanation = explanation.with_alternative(rival, DataFault("calibration_off", (), size), -gap)
        numbers |= {"reason": "physics", "log_likelihood_gap": -gap}
        ruled_out = DataFault("calibration_off", (), numbers)
        return replace(
            explanation, screened=replace(explanation.screened, ruled_out=(*explanation.screened.ruled_out, ruled_out))
        )
    fault = DataFault("calibration_off", (), numbers)
    return replace(rival, screened=replace(rival.screened, found=(*rival.screened.found, fault)))


def _odds_of_uncertainty(explanation: Explanation, case: Case, noise: NoiseModel) -> tuple[float, float]:
    """Log odds of an uncertain calibration over the physics found, and its standard deviation (m and rad).

    To first order, in one noise model, with as many of the effects beside it as make the largest odds; the standard
    deviation maximises the marginal likelihood (D. MacKay, Bayesian Interpolation, Neural Computation 4, 1992).
    """
    problem = explanation.problem
    fit = explanation.selection.state.fit
    tested = explanation.selection.state.tested
    chain = case.problem(_uncertain(explanation.screened, 1.0))
    terms = fit.terms.terms
    effects = problem.columns(terms, fit.values)
    uncertain = np.flatnonzero(chain.precision[: len(chain.frames)])
    precision = np.array([1 / number.spread**2 for term in terms for number in term.coordinates])
    groups = (problem.frame_columns, effects, chain.frame_columns[uncertain], fit.residuals.rows[None])
    G = _products(explanation, np.concatenate(groups), noise)
    nuisance, shifts, moved, _ = np.split(np.arange(len(G)), np.cumsum([len(group) for group in groups])[:-1])
    of_nuisance = problem.precision[: len(nuisance)]
    displaced = of_nuisance * (problem.offset + fit.nuisance)[: len(nuisance)]
    G[nuisance, nuisance] += of_nuisance
    G[nuisance, -1] += displaced
    G[-1, nuisance] += displaced

    def weighed(kept_terms: tuple[int, ...]) -> tuple[float, float, float]:
        """Log evidence with an exact file, with an uncertain one, and the standard deviation of the latter."""
        combination = np.zeros(len(G))  # the residual, less what the other effects do
        combination[-1], combination[shifts] = 1.0, -fit.values
        numbers = np.concatenate([np.zeros(0, int), *(shifts[fit.terms.slices[k]] for k in kept_terms)])
        fitted = np.concatenate([nuisance, numbers])
        combination[fitted] = 0.0
        # processes are integrated over under their priors, about zero: the residual is without their estimate
        estimate = fit.values[numbers - shifts[:1]]
        of_prior = precision[numbers - shifts[:1]]
        with_priors = G.copy()
        with_priors[numbers, numbers] += of_prior
        with_priors[numbers, -1] += of_prior * estimate
        with_priors[-1, numbers] += of_prior * estimate
        with_priors[-1, -1] += estimate @ (of_prior * estimate)
        S = schur_complement(with_priors, fitted)
        eigenvalues, V = np.linalg.eigh(S[np.ix_(moved, moved)])
        ratio = np.multiply.outer(_UNCERTAINTIES**2, np.maximum(eigenvalues, 0.0))
        pulled = V.T @ (S[moved] @ combination)
        gains = 0.5 * np.sum(_UNCERTAINTIES[:, None] ** 2 * pulled**2 / (1 + ratio) - np.log1p(ratio), 1)
        length = sum(tested[k].cost + tested[k].volume for k in kept_terms)
        plain = -0.5 * float(combination @ S @ combination) - length
        k = int(np.argmax(gains))
        return plain, plain + float(gains[k]) - 0.5 * float(np.log(explanation.readings)), float(_UNCERTAINTIES[k])

    kept = tuple(range(len(terms)))
    exact, off, sigma = weighed(kept)
    likeliest = off - exact, sigma
    while kept:
        fewer = (tuple(index for index in kept if index != k) for k in kept)
        (off, sigma), kept = max((weighed(subset)[1:], subset) for subset in fewer)
        likeliest = max(likeliest, (off - exact, sigma))
    return likeliest


def _log_volume_ratio(explanation: Explanation) -> float:
    """Half the log determinant of the prior covariance of the chain's numbers over that of the posterior."""
    problem = explanation.problem
    fit = explanation.selection.state.fit
    columns = np.concatenate([problem.frame_columns, problem.columns(fit.terms.terms, fit.values)])
    G = _products(explanation, columns, fit.noise)
    uncertain = np.flatnonzero(problem.precision[: len(problem.frames)])
    S = schur_complement(G, np.setdiff1d(np.arange(len(G)), uncertain))[np.ix_(uncertain, uncertain)]
    root = np.sqrt(problem.precision[uncertain])
    return 0.5 * float(np.linalg.slogdet(np.eye(len(uncertain)) + S / np.outer(root, root))[1])


def _products(explanation: Explanation, columns: Array, noise: NoiseModel) -> Array:
    """Products of columns `(number, row, sample)` in noise of unit size, of the training rows with their weights."""
    fit = explanation.selection.state.fit
    root = np.sqrt(np.where(fit.training, fit.residuals.row_weight, 0.0))
    flat = (noise.whitened(columns) * root).reshape(len(columns), -1)
    return flat @ flat.T


def _uncertain(screened: ScreenedPoses, sigma: float) -> ScreenedPoses:
    """With a calibration known to `sigma` m and rad."""
    settings = replace(screened.recording.settings, factory_uncertainty=FactoryUncertainty(sigma, sigma))
    return replace(screened, data=replace(screened.recording, settings=settings))


def _with_numbers(screened: ScreenedPoses, code: str, numbers: dict[str, object]) -> ScreenedPoses:
    """With more numbers for the faults of one code."""
    faults = tuple(f.with_numbers(**numbers) if f.code == code else f for f in screened.found)
    return replace(screened, found=faults)
