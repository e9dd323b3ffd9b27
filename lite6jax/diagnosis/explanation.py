"""Faults that physics looks like: each is weighed against physics, with all that a search finds beside it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.domains.pose.load_model import searched
from lite6jax.domains.pose.problem import case_of
from lite6jax.domains.pose.screening.columns import TRUSTED
from lite6jax.domains.pose.screening.rows import Fault
from lite6jax.domains.pose.screening.screen import Examined, Mending, examine
from lite6jax.effects.effect import Effect
from lite6jax.estimation.noise import WHITE, Colour
from lite6jax.fitting.problem import Geometry
from lite6jax.recordings import FactoryUncertainty, Recording, require_samples
from lite6jax.search.backward import cost
from lite6jax.search.forward import Search, Selection

Array = NDArray[np.floating]

_UNCERTAINTIES = np.geomspace(1e-7, 1e-3, 81)
"""m and rad that a calibration may be off by: from a controller's last digit to what makes one arm another."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """What a recording shows, once some faults are taken for granted.

    Attributes:
        examined: the recording with these put right.
        search: of what is left.
        selection: the physics found.
        cost: log-likelihood that the faults must gain at least, for the numbers that were chosen for them.
    """

    examined: Examined
    search: Search
    selection: Selection
    cost: float = 0.0

    @property
    def numbers(self) -> float:
        """How many were measured."""
        return float(self.search.case.rows * self.selection.fitted.used.sum())

    @property
    def evidence(self) -> float:
        """Log-likelihood of the rows in noise of the size and the colour that it leaves, less all costs.

        Schwarz's approximation (Annals of Statistics 6, 1978), as between the effects of a search.
        """
        fitted = self.selection.fitted
        likely = fitted.log_likelihood(fitted.residual.scale)
        likely += self.search.case.rows * fitted.colour.log_volume(int(fitted.used.sum()))
        coloured = 0.0 if fitted.colour is WHITE else np.log(self.numbers)  # for how much remembers, and how long
        return float(likely - coloured - cost(self.selection.steps, self.numbers) - self.cost)

    @property
    def recording(self) -> Recording:
        """As it is searched."""
        return self.search.case.recording

    @property
    def words(self) -> str:
        """What physics it has."""
        return ", ".join(step.effect.label for step in self.selection.steps) or "no physics"


def explain(recording: Recording, arm: Arm | None, geometry: Geometry, effects: Sequence[Effect] = ()) -> Explanation:
    """The likelier of what faults and what physics make of a recording.

    Args:
        recording: measured poses.
        arm: the nominal arm; from the sidecar where not given.
        geometry: what is known of it, as in `fit`.
        effects: a user's own.

    Raises:
        InputError: as `examine` and `case_of`.
    """
    given = _Given(recording, arm, geometry, tuple(effects))
    best = given.explained(Mending())
    for weighed in (_jumps_weighed, _table_weighed, _calibration_weighed):
        best = weighed(best, given)
    return best


@dataclass(frozen=True, eq=False)
class _Given:
    """What is to be explained."""

    recording: Recording
    arm: Arm | None
    geometry: Geometry
    effects: tuple[Effect, ...]

    def examined(self, mending: Mending) -> Examined:
        """With these faults put right."""
        return examine(self.recording, self.arm, self.geometry, mending)

    def found(self, examined: Examined) -> Explanation:
        """By what a search finds then."""
        case = case_of(examined.recording, examined.arm, self.geometry)
        require_samples(examined.recording, len(case.unknown) + 1)
        search, selection = searched(case, self.effects)
        log_n = float(np.log(case.rows * selection.fitted.used.sum()))
        # six numbers are chosen for a jump, and its row
        price = _count(examined, "frame_jump") * (3 * log_n + np.log(case.samples))
        return Explanation(examined, search, selection, float(price))

    def explained(self, mending: Mending) -> Explanation:
        """By what a search finds once these faults are put right."""
        return self.found(self.examined(mending))


def _jumps_weighed(best: Explanation, given: _Given) -> Explanation:
    """With as many of the jumps put back as physics does not explain better."""
    count = _count(best.examined, "frame_jump")
    if not count:
        return best
    # a twist told beside all physics is vague, one told beside none takes some of it along
    bare = given.explained(Mending(beside_physics=False))
    fewer = [given.explained(Mending(jumps=k)) for k in range(count)]
    best, rival = max(best, bare, key=_evidence), max(fewer, key=_evidence)
    gap = best.evidence - rival.evidence
    if gap > 0:
        said = f" Without it the best explanation ({rival.words}) is less likely by {gap:.3g} of log-likelihood."
        return replace(best, examined=_said(best.examined, "frame_jump", said))
    rows = ", ".join(str(found.rows[0]) for found in best.examined.faults if found.fault == "frame_jump")
    ruled_out = Fault(
        "frame_jump",
        (),
        f"What looks like a jump of a frame at row {rows} is none: left as they are, the poses are likelier by "
        f"{-gap:.3g} of log-likelihood, with {rival.words}.",
    )
    return replace(rival, examined=replace(rival.examined, checked=(*rival.examined.checked, ruled_out)))


def _table_weighed(best: Explanation, given: _Given) -> Explanation:
    """With another nominal table than the file's, where that is likelier than physics; as it is, or fitted from there.

    A table that an examination doubts is weighed against physics; of one that it has decided on, and of the other, it
    is asked whether the data want it fitted.
    """
    file, doubted = given.recording.settings.factory_calibration, best.examined.doubted
    if file is None or (doubted is None and not _count(best.examined, "nominal_table")):
        return best
    taken = best.examined
    if doubted is not None:
        other = given.examined(taken.mending._replace(table=doubted))
        faults = (*taken.faults, *(found for found in other.faults if found.fault == "nominal_table"))
        checked = tuple(found for found in taken.checked if found.fault != "nominal_table")
        taken = replace(other, faults=faults, checked=checked)
    published = _published(taken, file, best.cost, given.effects)
    gap = published.evidence - best.evidence
    if doubted is not None:
        if gap <= TRUSTED:
            return best
        said = (
            f" The poses are likelier with it, by {gap:.3g} of log-likelihood, than the declared one with {best.words}."
        )
        taken = _said(taken, "nominal_table", said)
    if given.geometry != "declared":
        return replace(best, examined=taken)
    fitted = best if doubted is None else given.found(taken)
    more = len(fitted.search.case.unknown) - len(published.search.case.unknown)
    if fitted.evidence - 0.5 * more * np.log(fitted.numbers) > published.evidence:
        return replace(fitted, examined=_said(taken, "nominal_table", " The chain is fitted from there."))
    said = f" It is taken as published: a fitted chain is too little likelier for {more} numbers more."
    return replace(published, examined=replace(_said(taken, "nominal_table", said), recording=published.recording))


def _published(examined: Examined, file: str, price: float, effects: Sequence[Effect]) -> Explanation:
    """With the nominal table in place of the calibration file, and as exact as that was said to be."""
    settings = replace(examined.recording.settings, factory_calibration=file, factory_uncertainty=None)
    case = case_of(replace(examined.recording, settings=settings), examined.arm, "exact")
    rows = np.array([frames.row_from_transform(link) for link in examined.arm.links])
    search, selection = searched(replace(case, start=case.start._replace(geometry=rows.ravel())), effects)
    return Explanation(examined, search, selection, price)


def _calibration_weighed(best: Explanation, given: _Given) -> Explanation:
    """With a calibration of which every number is off by chance, where that is likelier than some physics.

    One frame that is off may have been bent; a file that is stale, or rounded, is off everywhere.
    """
    settings = best.examined.recording.settings
    exact = given.geometry == "declared" and settings.factory_calibration and not settings.factory_uncertainty
    if not exact or not best.selection.steps or _count(best.examined, "nominal_table"):
        return best
    # physics that is left out looks like noise that remembers, and so does a chain that is off, in a trajectory
    gain, sigma = max(_off(best, given.geometry, colour) for colour in {best.selection.fitted.colour, WHITE})
    if gain <= 0:
        return best
    uncertain = _uncertain(best.examined, sigma)
    rival = given.found(uncertain)
    # the chain's numbers are no longer chosen but integrated over; how far they are off is one number that is
    rival = replace(rival, cost=rival.cost + _occam(rival) + 0.5 * np.log(rival.numbers))
    gap = rival.evidence - best.evidence
    if gap <= TRUSTED:
        return best
    fault = Fault(
        "calibration_off",
        (),
        f"Every number of the calibration file is a little off, as of a rounded or an old one: by {1e3 * sigma:.2g} mm "
        f"and {1e3 * sigma:.2g} mrad. That is likelier, by {gap:.3g} of log-likelihood, than {best.words} with an "
        "exact file, and the chain is fitted within that; declare factory_uncertainty in the sidecar.",
    )
    return replace(rival, examined=replace(uncertain, faults=(*uncertain.faults, fault)))


def _off(best: Explanation, geometry: Geometry, colour: Colour) -> tuple[float, float]:
    """What a calibration that is off everywhere gains over the physics found, and by how much it is off (m and rad).

    To first order, in noise of a colour, with those of the effects beside it that are still needed; the size of the
    numbers is where their marginal likelihood is largest (D. MacKay, Bayesian Interpolation, Neural Computation 4,
    1992).
    """
    case, fitted, steps = best.search.case, best.selection.fitted, best.selection.steps
    chain = case_of(_uncertain(best.examined, 1.0).recording, best.examined.arm, geometry)
    effects = case.columns(fitted.physics.effects, fitted.values)
    groups = (case.nuisance, effects, chain.nuisance[chain.precision > 0], fitted.residual.rows[None])
    G = _products(best, np.concatenate(groups), colour)
    nuisance, shifts, moved, _ = np.split(np.arange(len(G)), np.cumsum([len(group) for group in groups])[:-1])

    def weighed(kept: tuple[int, ...]) -> tuple[float, float, float]:
        """Evidence with an exact file and without, and how far off it then is."""
        left = np.zeros(len(G))  # the residual, less what the other effects do
        left[-1], left[shifts] = 1.0, -fitted.values
        beside = [nuisance]
        for k in kept:
            beside.append(shifts[fitted.physics.slices[k]])
        seen = np.concatenate(beside)
        left[seen] = 0.0
        S = _without(G, seen)
        eigenvalues, V = np.linalg.eigh(S[np.ix_(moved, moved)])
        told, pulled = np.multiply.outer(_UNCERTAINTIES**2, np.maximum(eigenvalues, 0.0)), V.T @ (S[moved] @ left)
        gains = 0.5 * np.sum(_UNCERTAINTIES[:, None] ** 2 * pulled**2 / (1 + told) - np.log1p(told), 1)
        plain = -0.5 * float(left @ S @ left) - cost([steps[k] for k in kept], best.numbers)
        k = int(np.argmax(gains))
        return plain, plain + float(gains[k]) - 0.5 * np.log(best.numbers), float(_UNCERTAINTIES[k])

    kept = tuple(range(len(steps)))
    exact, off, sigma = weighed(kept)
    while kept:
        fewer = (tuple(other for other in kept if other != k) for k in kept)
        (least, size), rest = max((weighed(rest)[1:], rest) for rest in fewer)
        if least < off:
            break
        off, sigma, kept = least, size, rest
    return off - exact, sigma


def _occam(explanation: Explanation) -> float:
    """Half the logarithm of how many times narrower the data make what is known of the chain beforehand."""
    case, fitted = explanation.search.case, explanation.selection.fitted
    columns = np.concatenate([case.nuisance, case.columns(fitted.physics.effects, fitted.values)])
    G = _products(explanation, columns, fitted.colour)
    known = np.flatnonzero(case.precision)
    S = _without(G, np.setdiff1d(np.arange(len(G)), known))[np.ix_(known, known)]
    root = np.sqrt(case.precision[known])
    return 0.5 * float(np.linalg.slogdet(np.eye(len(known)) + S / np.outer(root, root))[1])


def _products(explanation: Explanation, columns: Array, colour: Colour) -> Array:
    """Of columns `(number, row, sample)` with each other, in noise of unit size, as far as samples count."""
    fitted = explanation.selection.fitted
    root = np.sqrt(np.where(fitted.used, fitted.residual.weight, 0.0)) / fitted.residual.scale
    flat = (colour.whitened(columns) * root).reshape(len(columns), -1)
    return flat @ flat.T


def _without(G: Array, known: NDArray[np.integer]) -> Array:
    """Products of what is left of columns when some of them are fitted: the Schur complement."""
    size = np.sqrt(np.maximum(np.diagonal(G), np.finfo(float).tiny))
    C = G / np.outer(size, size)
    inverse = np.linalg.pinv(C[np.ix_(known, known)], rcond=1e-12, hermitian=True)
    return (C - C[:, known] @ inverse @ C[known]) * np.outer(size, size)


def _uncertain(examined: Examined, sigma: float) -> Examined:
    """With a calibration known to `sigma` m and rad."""
    recording = examined.recording
    settings = replace(recording.settings, factory_uncertainty=FactoryUncertainty(sigma, sigma))
    return replace(examined, recording=replace(recording, settings=settings))


def _said(examined: Examined, fault: str, words: str) -> Examined:
    """With more words to a fault."""
    faults = (f._replace(statement=f.statement + words) if f.fault == fault else f for f in examined.faults)
    return replace(examined, faults=tuple(faults))


def _evidence(explanation: Explanation) -> float:
    return explanation.evidence


def _count(examined: Examined, fault: str) -> int:
    return sum(found.fault == fault for found in examined.faults)
