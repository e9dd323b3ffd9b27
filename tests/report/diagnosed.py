"""Diagnoses of simulated arms without a search, for what a report shows; and a reader of its page."""

from dataclasses import replace
from html.parser import HTMLParser

import numpy as np

from lite6jax.arms.description import load_bundled
from lite6jax.arms.factory import write_factory
from lite6jax.diagnosis.diagnose import Diagnosis
from lite6jax.diagnosis.heldout import held_out_folds
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.result import Finding, HeldOut
from lite6jax.domains.pose.problem import pose_problem
from lite6jax.effects.catalogue import catalogue
from lite6jax.effects.kernels import kernel_of
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.serialization import parse_effect
from lite6jax.estimation.least_squares import fit
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import RecordingSettings
from lite6jax.report.statements import with_statements
from lite6jax.search.search import Selection
from lite6jax.search.state import Alternative, SelectedTerm, State
from lite6jax.simulation import simulate

LITE6 = load_bundled("lite6")
SAMPLES = 200
COMPLIANCE = "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5"
HARMONIC = "joint_harmonic:joint=1,order=2,amplitude_rad=4e-4,phase_rad=0.5"
WAVES = (3.0, 5.5, 9.0, 20.0, 33.0)
AMPLITUDES = np.array([3e-4, 0, 2e-4, 1e-4, 0, 1e-4, -2e-4, 0, 5e-5, 5e-5])
TURNED = 0.8 * 2 * np.pi
"""rad to either side: of a spectrum of this range the orders are 0.5, 1, 1.5 …"""
GAPS = (1.5, 44.0)
"""Log evidence that two rivals of each finding have less: one as good, one rejected."""


def recording_maker(folder):
    """Makes a recording with effects given as text, of a nominal arm whose geometry is known."""
    calibration = write_factory(LITE6.kinematics, folder / "arm.yaml")

    def make(*texts, motion="static", **given):
        effects = tuple(parse_effect(text)[0] for text in texts)
        settings = RecordingSettings(
            arm="lite6", motion=motion, factory_calibration=str(calibration), position_noise_m=2e-5
        )
        return simulate(LITE6, effects=texts, motion=motion, samples=SAMPLES, settings=settings, **given), effects

    return make


def found_without_search(problem, effects, alternatives, confounded=()):
    """The selection and the findings of a search that adds just these effects, each with `alternatives(effect)`."""
    engine = Options().engine
    baseline = fit(problem, Terms(), engine)
    fitted = fit(problem, Terms(effects), engine) if effects else baseline
    scores = score_test(problem, baseline, engine).score(effects) if effects else []
    tested, findings = [], []
    for effect, score, at in zip(effects, scores, fitted.terms.slices, strict=True):
        others = alternatives(effect)
        tested.append(SelectedTerm(effect, score.gain, p_value=1e-9, alternatives=others))
        findings.append(Finding(effect, fitted.values[at], fitted.covariance[at, at], 1e-9, score.gain, others))
    return Selection(problem, problem, State(baseline, fitted, tuple(tested)), confounded), tuple(findings)


def diagnosed(recording, effects, outliers=()):
    """The result of a search that adds just these effects: no search is run."""
    options = Options()
    problem = pose_problem(recording, LITE6, "exact")
    rivals = lambda effect: tuple(Alternative(effect, gap) for gap in GAPS)  # noqa: E731
    selection, findings = found_without_search(problem, effects, rivals, catalogue(6)[:2])
    wild = np.zeros(problem.samples, bool)
    wild[list(outliers)] = True
    sizes = [
        np.linalg.norm(problem.position_errors(f.nuisance, f.terms, f.values), axis=0)
        for f in (selection.state.baseline, selection.state.fit)
    ]
    errors = held_out(*(np.stack([size, np.zeros_like(size)]) for size in sizes))
    return Diagnosis(problem, selection, findings, errors, (), (), options, held_out_folds(problem, options), wild)


def held_out(before, after):
    """Errors `(group, sample)` on rows that were not used, of noise of unit size."""
    return HeldOut(before, after, before, after, np.ones(before.shape[1], bool))


def gear(joint):
    """The spectrum of a joint's position."""
    driver = f"position of joint {joint}"
    return Unnamed(f"joint{joint}", driver, -TURNED, TURNED, "spectrum", spread=1e-4, rolloff=(12.0, 2.0))


def of_waves(angle):
    """What the waves add at an angle, rad."""
    turned = np.multiply.outer(np.array(WAVES), angle)
    return AMPLITUDES[::2] @ np.sin(turned) + AMPLITUDES[1::2] @ np.cos(turned)


def wavy_arm(recorded):
    """The diagnosis of an arm whose first two joints err at five orders each, as a search of real arms finds it."""
    settings = recorded(COMPLIANCE)[0].settings
    effects = tuple(gear(joint) for joint in (1, 2))
    orders, given = kernel_of("spectrum").orders((-TURNED, TURNED)), []
    for effect in effects:
        values, of = np.zeros((len(orders), 2)), effect.covariance.deviations(effect.bounds, effect.rolloff)[::2, None]
        values[np.searchsorted(orders, np.array(WAVES) - 1e-9)] = AMPLITUDES.reshape(-1, 2)
        given.append((effect, (values / of).ravel()))
    recording = simulate(LITE6, effects=given, motion="static", samples=400, settings=settings)
    return diagnosed(recording, effects)


def documented(found, against=None):
    """The JSON document of any diagnosis, with its comparison with a reference where there is one."""
    document = found.to_dict()
    return with_statements(document if against is None else {**document, "against": against.to_dict()})


def with_rivals(found, *rivals):
    """The diagnosis with other rivals, each an effect and its gap, of its one finding."""
    (finding,), (tested,) = found.findings, found.selection.state.tested
    tested = replace(tested, alternatives=tuple(Alternative(*rival) for rival in rivals))
    selection = replace(found.selection, state=replace(found.selection.state, tested=(tested,)))
    finding = replace(finding, alternatives=tuple(Alternative(*rival) for rival in rivals))
    return replace(found, selection=selection, findings=(finding,))


class Reader(HTMLParser):
    """The tags with their attributes, and the text that a person sees."""

    def __init__(self, html):
        super().__init__()
        self.tags, self.open, self.text = [], [], ""
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "br", "!doctype"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        self.text += " " if tag in ("td", "th", "li", "strong") else ""

    def handle_data(self, data):
        if self.open and self.open[-1] != "style":
            self.text += data
