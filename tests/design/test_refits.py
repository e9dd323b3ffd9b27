"""The Cramér–Rao bound is what refits of simulated readings show, for every sensor; and the solver of record agrees."""

import numpy as np
import pytest
from scipy.stats import chi2

from lite6jax import fit_fleet
from lite6jax.arms.bundled import load_bundled
from lite6jax.arms.chains import hayati_fk
from lite6jax.design import identify
from lite6jax.design.identify import determine, refit
from lite6jax.design.information import experiment, plan_experiment
from lite6jax.design.sensor import Sensor
from lite6jax.errors import InputError
from tests.oracles.arms import random_positions
from tests.oracles.transforms import perturb_poses

LITE6 = load_bundled("lite6")
Q = random_positions(np.random.default_rng(0), 30, 6)
COUNT = 300


def check_spread(refits, low=1e-4):
    """Mean Mahalanobis distance and every variance inside the χ² bounds of so many refits."""
    determination = refits.determination
    free = determination.free
    assert refits.settled.all()
    errors = refits.errors[:, free]
    count, rank = errors.shape
    W = np.linalg.inv(determination.covariance[np.ix_(free, free)])
    total = float(np.sum((errors @ W) * errors))
    assert chi2.ppf(low, count * rank) < total < chi2.ppf(1 - low, count * rank)
    each = low / rank  # of as many variances, none may fall outside
    variances = count * refits.ratio**2
    assert (variances > chi2.ppf(each, count)).all()
    assert (variances < chi2.ppf(1 - each, count)).all()
    assert (refits.errors[:, ~free] == 0).all()


@pytest.mark.long
@pytest.mark.parametrize(
    "setup",
    [
        plan_experiment("lite6", "tracker"),
        plan_experiment("lite6", Sensor("pose", 2e-5, 1e-4, joint_noise=5e-5), tool=True),
        plan_experiment("lite6", Sensor("axis", 1e-5, direction=(1.0, 1.0, -1.0)), tool=True, tool_at=(0.05, 0.0, 0.1)),
        plan_experiment("lite6", Sensor("distance", 1e-6, center=(0.3, 0.2, 0.0)), frame=False),
    ],
    ids=["position", "pose", "axis", "distance"],
)
def test_refits_spread_as_predicted(setup):
    check_spread(refit(setup, Q, COUNT, seed=1))


def test_what_is_known_beforehand_counts():
    full = plan_experiment("lite6", "tracker_6d", chain="six_parameter", frame=False)
    sigma = np.array([2e-5 if unit == "m" else 5e-5 for unit in full.form.units])
    setup = experiment(LITE6, full.form, full.model, full.sensor, precision=1 / sigma**2)
    refits = refit(setup, Q[:8], COUNT, seed=1)
    assert refits.determination.free.all()
    check_spread(refits)


def test_the_fleet_fit_spreads_as_predicted():
    """The same bound met by the fit itself, on noise made in plain NumPy."""
    setup = plan_experiment("lite6", "tracker_6d", frame=False)
    predicted = determine(setup, Q).standard_deviation
    rng = np.random.default_rng(3)
    true = LITE6.hayati + rng.normal(0, 5e-4, 28)
    poses = np.asarray(hayati_fk(LITE6.form, true, Q))
    readings = np.stack([perturb_poses(rng, poses, 2e-5, 1e-4) for _ in range(200)])
    fits = fit_fleet(Q, readings, nominal=LITE6, noise=(2e-5, 1e-4))
    ratio2 = np.mean((fits.parameters - true) ** 2, 0) / predicted**2
    each = 1e-4 / 28
    assert (200 * ratio2 > chi2.ppf(each, 200)).all()
    assert (200 * ratio2 < chi2.ppf(1 - each, 200)).all()


def test_seeds():
    setup = plan_experiment("lite6", "tracker", frame=False)
    once, again, other = (refit(setup, Q, 10, seed=s).errors for s in (0, 0, 1))
    np.testing.assert_array_equal(once, again)
    assert (once[:, :4] != other[:, :4]).all()


def test_refits_have_the_same_bytes_for_any_number_of_processes(monkeypatch):
    monkeypatch.setattr(identify, "BATCH", 4)
    setup = plan_experiment("lite6", Sensor("pose", 2e-5, 1e-4, joint_noise=1e-5), frame=False)
    here, one, two = (refit(setup, Q[:12], 10, seed=2, processes=count) for count in (None, 1, 2))
    assert here.errors.shape == (10, 28)
    assert one.errors.tobytes() == two.errors.tobytes()
    assert here.settled.all()
    assert one.settled.all()
    np.testing.assert_allclose(here.errors, one.errors, rtol=0, atol=1e-6 * np.abs(here.errors).max())


def test_a_spread_needs_two():
    with pytest.raises(InputError, match="1 refits: a spread needs at least 2"):
        refit(plan_experiment("lite6"), Q, 1)
