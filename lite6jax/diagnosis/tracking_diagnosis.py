"""The diagnosis of how an arm follows its commands: screen, search, estimate finally, verify on blocks inside each run.

Errors are those of rollouts from the commands alone, from the first position of each run and without restarts.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, ClassVar, final

import numpy as np
from threadpoolctl import threadpool_limits

from lite6jax.arms.arm import Arm
from lite6jax.arms.simulator import Simulator
from lite6jax.array_types import Array, Integers, Mask
from lite6jax.calibration.source import declared_arm_of, with_calibration
from lite6jax.diagnosis.heldout import HeldOut, errors_of_folds, errors_of_refit, judge_by_folds, verify
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.result import AS_NOISE, STATISTICS, DomainDiagnosis
from lite6jax.domains.base import DomainName
from lite6jax.domains.tracking.entry import model_entry
from lite6jax.domains.tracking.growth import grown
from lite6jax.domains.tracking.peers import fit_peers
from lite6jax.domains.tracking.predict import DiagnosedServos
from lite6jax.domains.tracking.problem import (
    RolloutCache,
    TrackingProblem,
    along_rollout,
    diagnosed_servos,
    follows_as_described,
    tracking_problem,
    with_likely_grip,
)
from lite6jax.domains.tracking.ranges import run_ends
from lite6jax.domains.tracking.rows import COARSE, INEXACT
from lite6jax.domains.tracking.screening import screen_tracking
from lite6jax.domains.tracking.simulator import SimulatorComparison, compare_simulator, with_simulator
from lite6jax.domains.tracking.undetermined import undetermined
from lite6jax.effects.dynamic import BaseTilt, PayloadTorque, UnnamedInLoop
from lite6jax.effects.effect import Effect, Estimate
from lite6jax.effects.servo import RateLimit
from lite6jax.estimation.least_squares import fit, relinearise
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.terms import Terms
from lite6jax.estimation.thresholds import BETTER, CLOSE, EXCHANGES, LISTED, MARGIN
from lite6jax.progress import Stage, entered, followed, part
from lite6jax.recordings import Recording
from lite6jax.search.final_estimates import final_estimates
from lite6jax.search.search import Selection, Start, chance_of, confirmed, nearest_of, search, select
from lite6jax.search.select import Selector
from lite6jax.search.state import Alternative, SelectedTerm, State, fitted_again, refitted

_BLOCKS = 5
"""Of each run; every other one is held out of the fit that is judged. Each has slow and fast parts of the motion."""
_STARTS = 8
"""Linearisations from the grid to the numbers of unknown servos."""


@final
@dataclass(frozen=True, eq=False, repr=False)
class TrackingDiagnosis(DomainDiagnosis[TrackingProblem]):
    """The diagnosis of how an arm follows its commands.

    Attributes:
        peers: by name `(joint, sample)` rad, errors on held-out rows of what knows no arm: that joints are where they
            are commanded, there after a time, or a linear system of second order; and those of `simulator` in all rows.
        simulator: what MuJoCo makes of the commands, where a simulator was given; its arm and servos are the nominal
            ones.
    """

    domain: ClassVar[DomainName] = "tracking"

    peers: dict[str, Array] = field(default_factory=dict)
    simulator: SimulatorComparison | None = None

    @property
    def recording(self) -> Recording:
        """As it was screened, on an even grid."""
        return self.problem.data.recording

    @cached_property
    def over_noise(self) -> dict[str, float | None]:
        """RMS of held-out errors of each joint over the noise of its encoder with that of the rollout."""
        errors = (self.after / self.problem.sigma)[:, ~self.outliers]
        names = [f"joint{j}" for j in range(1, self.problem.rows + 1)]
        return dict(zip(names, np.sqrt(np.mean(errors**2, 1)).tolist(), strict=True))

    @cached_property
    def model(self) -> DiagnosedServos:
        """The arm with its servos and the effects found, as `read_model` gives it from a file."""
        problem = self.problem
        fit = self.fit
        readout = problem.readouts(fit.nuisance, fit.terms, fit.values)
        return diagnosed_servos(problem, problem.servo_at(fit.nuisance), fit.terms, fit.values, readout)

    @property
    def _leaves_noise(self) -> bool:
        most = self.most_over_noise
        return most is not None and most <= AS_NOISE

    @property
    def _noise(self) -> tuple[dict[str, Any], dict[str, Any]]:
        noise = self.problem.noise
        declared = noise.tolist() if self.problem.declared else None
        return {"joint_rad": declared}, {"joint_rad": (noise * self.fit.scale).tolist()}

    def _statistics(self, errors: Array, kept: Mask) -> dict[str, Any]:
        chosen = errors[:, kept]
        sizes = np.abs(chosen) if chosen.size else np.zeros((len(errors), 1))
        statistics: dict[str, Any] = {
            f"heldout_rollout_{name}_rad": float(of(sizes)) for name, of in STATISTICS.items()
        }
        by_joint = {
            "rms": np.sqrt(np.mean(sizes**2, 1)),
            "p95": np.percentile(sizes, 95, axis=1),
        }
        return statistics | {
            f"heldout_rollout_{name}_by_joint_rad": values.tolist() for name, values in by_joint.items()
        }

    @cached_property
    def _added(self) -> list[Array]:
        """`(joint, sample)` rad of each finding: rollouts with all of them less rollouts without it."""
        problem = self.problem
        fit = self.fit
        whole = problem.readouts(fit.nuisance, fit.terms, fit.values)[:, problem.chosen]
        added = []
        for finding in self.findings:
            kept = [term != finding.effect for term in fit.terms.terms]
            terms, values = fit.terms.part(fit.values, kept)
            added.append(whole - problem.readouts(fit.nuisance, terms, values)[:, problem.chosen])
        return added

    @cached_property
    def moves(self) -> tuple[dict[str, Any], ...]:
        """What each finding moves: RMS in rad over its joints, and these, from 1.

        Its joints are those that it moves by more than a tenth of what it moves the one that moves most.
        """
        moved = []
        for added in self._added:
            sizes = np.sqrt(np.mean(added[:, ~self.outliers] ** 2, 1))
            acts = sizes > 0.1 * sizes.max(initial=0.0)
            where = acts if acts.any() else np.ones_like(acts)
            size = float(np.sqrt(np.mean(sizes[where] ** 2)))
            moved.append({"moves_rms_rad": size, "joints": (1 + np.flatnonzero(where)).tolist()})
        return tuple(moved)

    def _peak_to_peak(self, k: int) -> dict[str, Estimate]:
        finding = self.findings[k]
        effect = finding.effect
        assert isinstance(effect, UnnamedInLoop)
        size = float(np.ptp(effect.at_joint(finding.values, self.problem.data.dynamics)))
        return {f"peak_to_peak{effect.coefficient.name}": Estimate(size, 0.0)}

    def _finding(self, k: int) -> dict[str, Any]:
        """As of any domain, and what of the loop a shift is added to, `component`."""
        entry = super()._finding(k)
        effect = self.findings[k].effect
        if isinstance(effect, UnnamedInLoop) and effect.component:
            entry["component"] = effect.component
        return entry

    def _distinction(self, k: int, effect: Effect) -> str:
        return "undecided"

    @property
    def _servos(self) -> list[dict[str, float]]:
        """The numbers of each joint's servo with the effects: stiffness, lag and sag; without masses over a factor.

        The lag is how far, in time, a joint at constant velocity is behind its command, friction and delay apart.
        """
        servo = self.model.model.servo
        lag = (servo.damping + servo.viscous - servo.feedforward) / servo.stiffness
        return [
            {
                "stiffness_Nm_per_rad": float(servo.stiffness[j]),
                "damping_Nm_s_per_rad": float(servo.damping[j]),
                "sag_rad_per_Nm": float(1 / servo.stiffness[j]),
                "lag_s": float(lag[j]),
                "delay_s": float(servo.delay[j]),
                "coulomb_Nm": float(servo.coulomb[j]),
                "inertia_kg_m2": float(servo.inertia[j]),
            }
            for j in range(self.problem.rows)
        ]

    def _own_parts(self) -> dict[str, Any]:
        problem = self.problem
        kept = ~self.outliers
        return {
            "servo": "declared" if problem.data.declared else "unknown",
            "masses": problem.data.has_masses,
            "undetermined": [reason.to_dict() for reason in undetermined(problem.data)],
            "servos": self._servos,
            "peers": {name: self._statistics(errors, kept) for name, errors in self.peers.items()},
            **({} if self.simulator is None else {"simulator": self.simulator.to_dict()}),
            "nuisance": {"numbers": len(problem.unknowns)},
            "model": model_entry(self.model, [finding.larger_covariance for finding in self.findings]),
        }

    def to_dict(self) -> dict[str, Any]:
        """The document `lite6jax/diagnosis/3`; faults of joints name these as `joints`."""
        document = super().to_dict()
        for key in ("data_faults", "ruled_out"):
            document[key] = [{**fault, "joints": fault["numbers"].get("joints", [])} for fault in document[key]]
        return document


# ------------------------------------------------------------------ blocks inside each run


def interleaved_folds(run: Integers) -> list[Mask]:
    """Two sets of samples `(sample,)`: every other one of five blocks inside each run, and the blocks between them.

    Whole runs would differ in their speeds and loads, so that a model of some says little of the others.
    """
    first = np.zeros(len(run), bool)
    for begin, end in zip(*run_ends(run), strict=True):
        edges = np.linspace(begin, end, _BLOCKS + 1).astype(int)
        for block in range(1, _BLOCKS, 2):
            first[edges[block] : edges[block + 1]] = True
    return [first, ~first]


def _peer_errors(problem: TrackingProblem, folds: Sequence[Mask]) -> dict[str, Array]:
    """`(joint, sample)` rad of each peer on rows that it was not fitted to."""
    data = problem.data
    command = np.asarray(data.recording.commanded_position).T
    errors: dict[str, Array] = {}
    for held in folds:
        peers = fit_peers(command, data.measured, data.recording.run, data.commands.period, problem.valid & ~held)
        for name, position in peers.items():
            of_peer = errors.setdefault(name, np.zeros_like(position))
            of_peer[:, held] = (position - data.measured)[:, held]
    return errors


# ------------------------------------------------------------------ the diagnosis


_OF_ALL_JOINTS = (PayloadTorque, BaseTilt)
"""Effects whose columns say least of their fits: each joint that they move moves others."""
_IDLE = 0.03
"""Share by which a nonparametric effect must lower the RMS error of some joint; else it is left out."""
_DISCREPANCY = 3e-3
"""Of what effects move a joint, RMS, by which their description may differ from the truth."""
_FOLLOWS = 1.7
"""Times the noise, within which a joint follows as described."""
_IN_LONG_STEPS = 0.01
"""Of how far a joint is behind its commands, RMS, by which rollouts in long steps may be wrong."""
_MOVES = 0.03
"""rad, the standard deviation of a joint that moves."""
_COMPARED = 0.2
"""`settled` of fits that are compared: a step of this length gains 0.02 of a log-likelihood."""
_ROUGHLY = 4
"""One in so many samples, in which names are looked for before the grip beside declared servos is known."""
_GRIPS_IN_TURN = 3
"""Times at most that the grip is sought beside the friction, and the friction is fitted beside the grip."""
_MEMORY = 0.3
"""s, `EngineOptions.longest_memory`: whitening by a longer one leaves velocities alone."""
_DAMPING = (1e-4, 1e-2, 1.0, 100.0)
"""`EngineOptions.damping`: derivatives are secants, and may be wrong by as much as they are."""


def _begun(problem: TrackingProblem, options: EngineOptions) -> TrackingProblem:
    """The problem of declared servos with the grip by which friction holds its joints.

    Where no joint follows as described, it is that beside the names that are found.
    """
    likely = along_rollout(with_likely_grip(problem), Terms(), np.zeros(0))
    if not problem.data.coupled or follows_as_described(likely):
        return likely
    fit = select(problem.thinned(_ROUGHLY), options, names_alone=True).state.fit
    return along_rollout(with_likely_grip(problem, fit.terms, fit.values), fit.terms, fit.values)


def _with_servos(problem: TrackingProblem, options: EngineOptions) -> Selection:
    """The numbers of unknown servos, and the names of joints that predict rows which they were not fitted to."""
    data = problem.data
    problem = relinearise(replace(problem, data=data.coarse, known=RolloutCache()), options, problem.valid, _STARTS)
    servos = grown(problem, interleaved_folds(problem.run), COARSE, data)
    return _fitted(servos.problem.relinearised(servos.nuisance), servos.terms, servos.values, options.rough)


def _fitted(problem: TrackingProblem, terms: Terms, values: Array, options: EngineOptions) -> Selection:
    """The selection of some terms, fitted from these numbers, each weighed beside the others.

    Noise is white: beside errors of the simulation, fits in autocorrelated noise trade what moves slowly for the rest.
    How likely chance explains as much is that of the noise as it is: the larger of the evidence's and of the test's by
    blocks.
    """
    baseline = fit(problem, Terms(), options, training=problem.valid)
    both = fit(problem, terms, options, values, training=problem.valid)
    selector = Selector(problem, options)
    named = tuple(SelectedTerm(term, cost=selector.scan.cost_of_name(term)) for term in terms.terms)
    state = selector.weighed(State(baseline, both, named))
    tested = tuple(
        replace(one, p_value=max(min(float(np.exp(-one.net)), 1.0), chance_of(selector, state, k)))
        for k, one in enumerate(state.tested)
    )
    nearest = None if tested else nearest_of(selector, replace(state, fit=selector.in_likeliest_noise(both)))
    return Selection(problem, problem, replace(state, tested=tested), nearest=nearest)


def _is_as_described(selection: Selection) -> bool:
    """Tells whether a joint that moves follows as described, but for noise: rollouts then describe the arm exactly."""
    problem = selection.problem
    assert isinstance(problem, TrackingProblem)
    errors = selection.state.fit.residuals.rows * problem.sigma
    size = np.sqrt(np.mean(errors[:, problem.valid] ** 2, 1))
    measured = problem.measured[:, problem.valid]
    moves = np.std(measured, 1) > _MOVES
    command = np.asarray(problem.data.recording.commanded_position).T[:, problem.chosen][:, problem.valid]
    behind = np.sqrt(np.mean((command - measured) ** 2, 1))
    return bool(np.any(moves & (size < np.maximum(_FOLLOWS * problem.noise, _IN_LONG_STEPS * behind))))


def _exactly(problem: TrackingProblem, named: Selection, options: EngineOptions) -> tuple[TrackingProblem, Start]:
    """The problem of unknown servos in short steps, with the grip that suits it, and what its search starts from.

    Beside the unknown servo that comes nearest to a joint with a limit, processes of any kind explain more than the
    limit does: names come first. They are those that were found in long steps, where these describe all joints in short
    ones too, and else those of a search of names alone. That is judged in the noise beside the servo that comes nearest
    without them: a stiff one beside a limit counts all that a softer servo does as well.

    What functions may depend on is along the rollout, as beside declared servos: loads along the measured motion hold
    the noise of its read-outs, and functions of them explain that noise.
    """
    rough = named.problem
    assert isinstance(rough, TrackingProblem)
    f = named.state.fit
    likely = with_likely_grip(relinearise(problem, options, problem.valid, _STARTS))
    described = _with_discrepancy(likely)
    exact = replace(rough.relinearised(f.nuisance), data=problem.data, known=RolloutCache())
    exact = with_likely_grip(exact, f.terms, f.values)
    judged = fit(replace(exact, data=described.data), f.terms, options.rough, f.values, training=problem.valid)
    if np.all(judged.scale < _FOLLOWS):
        exact = along_rollout(_with_discrepancy(exact), f.terms, f.values)
        again = fit(exact, f.terms, options.rough, f.values, training=problem.valid)
        # a servo that fits best without these names may be far from the one beside them
        refitted_names = replace(named, problem=exact, reference=exact, state=replace(named.state, fit=again))
        return exact, refitted_names.start._replace(nuisance=again.nuisance)
    named = select(described, options, names_alone=True)
    f = named.state.fit
    there = named.problem
    assert isinstance(there, TrackingProblem)
    gripped = with_likely_grip(there.relinearised(f.nuisance), f.terms, f.values)
    exact = _with_discrepancy(replace(likely, servo=likely.servo._replace(grip=gripped.servo.grip)))
    return along_rollout(exact, Terms(), np.zeros(0)), named.start


def _with_discrepancy(problem: TrackingProblem) -> TrackingProblem:
    """The problem of unknown servos with noise by which effects that move a joint far are described.

    Simulators switch limits and friction at their own steps: what such an effect moves they share to some thousandths.
    In noise that is far below, the rest would be taken for further physics.
    """
    residual = problem.residual(np.zeros(len(problem.unknowns)), Terms(), np.zeros(0)) * problem.sigma
    moved = np.sqrt(np.mean(residual[:, problem.valid] ** 2, 1))
    noise = np.hypot(problem.noise, _DISCREPANCY * moved)
    return replace(problem, data=replace(problem.data, noise=noise))


def _compared_by_rollouts(selection: Selection, options: EngineOptions) -> Selection:
    """The selection with the likeliest names by their own rollouts, and named alternatives as far behind as theirs are.

    The search knows alternatives by their columns, to first order. Rollouts of friction, play and limits are not
    linear: they may differ where their columns agree, and agree where these differ. Of a process the alternatives by
    rollouts are the same function elsewhere in the loop: a torque, a shift of the command or one of the read-out; and
    beside unknown servos, which take most of what a name moves, names.
    """
    problem = selection.problem
    assert isinstance(problem, TrackingProblem)
    # what each joint does to the others is small, and large beside what unknown servos leave of an effect
    of_all_joints = list[Effect]()
    if problem.unknowns:
        of_all_joints = [effect for effect in problem.candidates if isinstance(effect, _OF_ALL_JOINTS)]
    selector = Selector(replace(problem, coupled_columns=bool(problem.unknowns)), options.rough)
    state = selection.state
    exchanges = 0
    while True:
        weighed = selector.weighed(state)
        rivals = list[list[State]]()
        likelier = None
        for k, tested in enumerate(state.tested):
            if tested.term.nonparametric:
                of_names = selector.names_instead(weighed, k) if problem.unknowns else []
                rivals.append([*selector.elsewhere_in_loop(weighed, k), *of_names])
            else:
                rivals.append(selector.names_instead(weighed, k, of_all_joints))
            likeliest = max(rivals[k], key=lambda rival: rival.evidence, default=weighed)
            if exchanges < EXCHANGES and likeliest.evidence > weighed.evidence + BETTER:
                likelier = likeliest
                break
        if likelier is None:
            break
        state = selector.dropped(likelier)  # what stood for a part of it
        exchanges = exchanges + 1
    pairs = zip(state.tested, rivals, strict=True)
    compared = tuple(_with_alternatives(tested, weighed, of_term) for tested, of_term in pairs)
    selection = replace(selection, state=replace(state, tested=compared))
    return _without_negligible(confirmed(selection, options), options) if exchanges else selection


def _with_alternatives(tested: SelectedTerm, weighed: State, rivals: Sequence[State]) -> SelectedTerm:
    """A term of a state with those in its place that are nearly as likely by their rollouts.

    The data decide what is not distinguished: a name that explains as much is listed, however rare it is and however
    many numbers it has. Those by columns have the places on its list that are left.
    """
    by_columns = tested.alternatives[: max(LISTED - len(rivals), 0)]
    if not tested.term.nonparametric:
        # columns of processes say little: the likeliest stands for all
        by_columns = tuple(other for other in tested.alternatives if other.term.nonparametric)[:1]
    alternatives = list(by_columns)
    for rival in rivals:
        (term,) = (selected.term for selected in rival.tested if selected.term not in weighed.fit.terms.terms)
        gap = weighed.evidence - rival.evidence
        if not term.nonparametric:
            gap = min(gap, weighed.fit.gain_over(rival.fit))
        if gap < CLOSE:
            alternatives.append(Alternative(term, max(gap, 0.0)))
    nearest = sorted(alternatives, key=lambda alternative: alternative.gap)
    return replace(tested, alternatives=tuple(nearest[:LISTED]))


def _with_grip_of_friction(selection: Selection, options: EngineOptions) -> Selection:
    """The selection with the grip that its friction has at each joint, and its numbers beside that.

    A friction that lets its joint creep is estimated as smaller than it is where rollouts hold the joint.
    """
    for _ in range(_GRIPS_IN_TURN):
        problem = selection.problem
        assert isinstance(problem, TrackingProblem)
        state = selection.state
        f = state.fit
        if not problem.data.coupled:
            break
        gripped = problem.in_likeliest_grip(f.nuisance, f.terms, f.values, of_terms_alone=True)
        if gripped is problem:
            break
        again = fitted_again(gripped, gripped, state, f.training, options.rough)
        if again.fit.gain_over(f) < MARGIN:
            break
        selection = replace(selection, problem=gripped, reference=gripped, state=again)
    return selection


def _in_finer_steps(selection: Selection, options: EngineOptions) -> Selection:
    """The selection with the names that are worth their cost in rollouts of half the step, where a rate is limited.

    A limited rate ends within a step: what the longest steps miss of that looks like friction.
    """
    problem = selection.problem
    assert isinstance(problem, TrackingProblem)
    state = selection.state
    limited = any(isinstance(term, RateLimit) for term in state.fit.terms.terms)
    if not limited or len(state.tested) < 2 or not problem.data.coupled:
        return selection
    finer = replace(problem, data=problem.data.finer, known=RolloutCache())
    state = fitted_again(finer, finer, state, state.fit.training, options.rough)
    state = Selector(finer, options.rough).dropped(state)
    return replace(selection, problem=finer, reference=finer, state=state)


def _without_negligible(selection: Selection, options: EngineOptions) -> Selection:
    """The selection without effects that move no joint by more than rollouts, or descriptions of others, may be wrong.

    Beside unknown servos that counts which these cannot do. Nor has the selection nonparametric effects that hardly
    change any joint beside what is left there. Terms go one at a time: of two that can stand for each other one stays.
    """
    problem = selection.problem
    assert isinstance(problem, TrackingProblem)
    state = selection.state
    while True:
        without = _without_one_negligible(problem, state, options)
        if without is None:
            return replace(selection, state=state)
        state = without


def _without_one_negligible(problem: TrackingProblem, state: State, options: EngineOptions) -> State | None:
    """A state without the last effect that counts for nothing, fitted anew; None where each counts."""
    f = state.fit
    valid = problem.valid
    whole = problem.residual(f.nuisance, f.terms, f.values)
    remaining = np.mean(whole[:, valid] ** 2, 1)
    before = np.mean(state.baseline.residuals.rows[:, valid] ** 2, 1)
    for k, tested in reversed(list(enumerate(state.tested))):
        others = f.terms.part(f.values, [term != tested.term for term in f.terms.terms])
        change = (whole - problem.residual(f.nuisance, *others))[:, valid]
        moved = np.mean(change**2, 1)
        is_inexact = np.all(np.sqrt(moved) * problem.noise < INEXACT)
        is_idle = tested.term.nonparametric and np.max(moved / remaining) < (1 + _IDLE) ** 2 - 1
        if not (is_inexact or is_idle or problem.unknowns):
            continue
        # servos are fitted anew: their columns at an estimate say little of numbers far from there
        without = refitted(problem, state, [*state.tested[:k], *state.tested[k + 1 :]], options.rough)
        if is_inexact or is_idle:
            return without
        g = without.fit
        lost = (problem.residual(g.nuisance, g.terms, g.values) - whole)[:, valid]
        alone = f.terms.part(f.values, [term == tested.term for term in f.terms.terms])
        by_others = np.mean((whole - problem.residual(f.nuisance, *alone))[:, valid] ** 2, 1)
        described = _DISCREPANCY * np.sqrt(np.maximum(before, by_others))
        allowed = np.maximum(described, INEXACT / problem.noise)
        if np.all(np.sqrt(np.mean(lost**2, 1)) < allowed):
            return without
    return None


def _errors_of_refit(held: Mask, selection: Selection, options: EngineOptions) -> HeldOut:
    """The errors as of `errors_of_refit`, beginning at the loads of the selection.

    Folds are worked on side by side: each begins its rollouts where its own last one ended, not that of another fold.
    """
    problem = selection.problem
    assert isinstance(problem, TrackingProblem)
    alone = replace(problem, known=RolloutCache(loads=problem.known.loads))
    return errors_of_refit(held, replace(selection, problem=alone), options)


# A second thread gains little on matrices of this size, and costs many times as much where another job has a core.
@threadpool_limits.wrap(limits=1, user_api="blas")
def diagnose_tracking(
    recording: Recording,
    arm: Arm | None = None,
    *,
    simulator: Simulator | None = None,
    options: Options | None = None,
    progress: Callable[[Stage], object] | None = None,
) -> TrackingDiagnosis:
    """Locates, names, models and verifies why an arm does not follow its commands as its description says.

    Residuals are rollouts from the commands alone minus the measured joints. Effects are kept if rollouts with them,
    fitted to other blocks of each run, have smaller errors. Arguments are as of `diagnose`, but the simulator is read.

    Raises:
        InputError: no arm is declared, or as `screen_tracking`.
    """
    options = (options or Options()).of(recording.settings)
    # A rollout takes as long whether few or all of its samples are compared; and it is iterated until what is left
    # moves log-likelihoods by some hundredths, which shorter steps do not overcome.
    compared = replace(options.engine.compared, settled=_COMPARED)
    engine = replace(options.engine, first_samples=options.engine.most_samples, compared=compared)
    payload = 0.0
    if simulator is not None:
        arm = simulator.arm
        payload = float(np.max(recording.payload))
        recording = with_simulator(recording, simulator)
    with followed(progress):
        arm = with_calibration(arm or declared_arm_of(recording), recording)
        with part(0, 2):
            entered("screening")
            screened = screen_tracking(recording, arm)
            problem = tracking_problem(screened.data)
            problem = replace(problem, valid=problem.valid & ~screened.unusable)
            is_described = True
            if problem.unknowns:
                memory = _MEMORY / problem.data.commands.period
                engine = replace(engine, longest_memory=memory, damping=_DAMPING)
                entered("servos")
                selection = _with_servos(problem, engine)
                is_described = _is_as_described(selection)
                if is_described:
                    problem, start = _exactly(problem, selection, engine)
                    selection = search(problem, engine, start=start)
                else:
                    engine = replace(engine.rough, most_exact=0)  # no digit counts beside its errors
            else:
                selection = search(_begun(problem, engine), engine)
            entered("estimating")
            selection = _with_grip_of_friction(selection, engine)
            problem = selection.problem
            assert isinstance(problem, TrackingProblem)
            selection = _without_negligible(selection, engine)
            if is_described:  # names of other arms were chosen by what they predict, not by evidence
                selection = _in_finer_steps(_compared_by_rollouts(selection, engine), engine)
                problem = selection.problem
            selection = replace(selection, state=final_estimates(problem, selection.state, engine))
        folds = interleaved_folds(problem.run)
        held_out = partial(errors_of_folds, _errors_of_refit, (selection, engine), anywhere=False)
        verified = verify(selection, held_out(folds), folds, problem.valid, held_out, judge_by_folds)
        if not verified.findings:
            verified = verified._replace(errors=verified.errors.without_effects())
        problem = verified.selection.problem
        assert isinstance(problem, TrackingProblem)
        peers = _peer_errors(problem, folds)
        compared = None
        if simulator is not None:
            compared = compare_simulator(simulator, problem.data, payload)
            peers["simulator"] = compared.position - problem.data.measured
    return TrackingDiagnosis(
        problem=problem,
        faults=screened.found,
        ruled_out=screened.ruled_out,
        options=options,
        outliers=~problem.valid,
        peers=peers,
        simulator=compared,
        **verified._asdict(),
    )
