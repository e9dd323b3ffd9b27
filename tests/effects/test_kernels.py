"""Every kernel passes the same laws: those of covariances, of scaled drivers, of products, and beyond what was seen."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import BSpline

from lite6jax.effects import kernels
from lite6jax.effects.kernels import KERNELS, MODULATED, PIECES, SCALED, is_kernel, kernel_of, spline_basis
from lite6jax.effects.kernels import PAIRS as TRIED_PAIRS
from lite6jax.errors import InputError
from lite6jax.estimation.prior import PRIOR

BOUNDS = (-0.7, 2.1)
RNG = np.random.default_rng(3)
INSIDE = np.sort(RNG.uniform(*BOUNDS, 60))
STATIONARY = sorted(set(SCALED) - {"line"})
CLOSE = {"rough": 0.12, "fine": 0.13, "medium": 0.03, "line": 1e-12}
"""By how much the covariance of the few features may be off; of the others 0.02."""
PAIRS = ("line*line", "line*smooth", "rough*rough", "cubic*wave", "wave*medium")
each = pytest.mark.parametrize("kernel", KERNELS)


def scaled(values, bounds=BOUNDS):
    return 2 * (values - bounds[0]) / (bounds[1] - bounds[0]) - 1


def covariance(kernel, values, bounds=BOUNDS):
    """`(sample, sample)`, of the features."""
    phi = np.asarray(kernel_of(kernel).features(np.atleast_2d(values), bounds))
    return phi.T @ phi


def plainly(kernel, x, y):
    """The covariance of a kernel of scaled values, as its table says, and that of a constant."""
    d = np.abs(x[:, None] - y)
    of = {
        "line": x[:, None] * y,
        "cubic": 4 * np.exp(-(d**2) / 8),
        "rough": np.exp(-d),
        **{name: np.exp(-(d**2) / (2 * l**2)) for name, l in (("smooth", 0.7), ("medium", 0.3), ("fine", 0.13))},
    }
    return of[kernel] + 1


@each
def test_a_kernel_is_positive_semidefinite(kernel):
    C = covariance(kernel, RNG.permutation(np.append(INSIDE, [-3.0, 9.0])))
    assert np.linalg.eigvalsh(C).min() > -1e-9 * np.trace(C)


@each
def test_features_are_as_many_as_is_said(kernel):
    assert len(kernel_of(kernel).features(INSIDE[None], BOUNDS)) == kernel_of(kernel).size(BOUNDS)


@pytest.mark.parametrize("kernel", SCALED)
def test_few_features_have_the_covariance_of_the_table_and_a_constant(kernel):
    x = scaled(INSIDE)
    np.testing.assert_allclose(covariance(kernel, INSIDE), plainly(kernel, x, x), atol=CLOSE.get(kernel, 0.02))


def test_waves_and_spectra_are_covariances_of_the_difference_of_two_angles():
    d = INSIDE[:, None] - INSIDE
    waves = sum(np.cos(k * d) / k**2 for k in (1, 2, 3))
    np.testing.assert_allclose(covariance("wave", INSIDE), 1 + waves, atol=1e-12)
    turn, rolloff = (-np.pi, np.pi), (3.0, 2.0)
    phi = kernel_of("spectrum").features(INSIDE[None], turn, rolloff=rolloff)
    orders = 0.8 * np.arange(1, 76)  # 1.25 turns, in which the errors of a gear need not repeat
    spectra = sum(np.cos(k * d) / (1 + (k / 3.0) ** 2) for k in orders)
    np.testing.assert_allclose(phi.T @ phi, spectra, atol=1e-10)


@pytest.mark.parametrize("kernel", ["sine*line", "line*sine"])
def test_a_modulated_wave_is_a_wave_of_any_order_times_a_constant_and_a_line(kernel):
    order = 4.2
    other = np.sin(7 * INSIDE)
    values = np.stack([INSIDE, other] if kernel == "sine*line" else [other, INSIDE])
    bounds = (*BOUNDS, -2.0, 2.0) if kernel == "sine*line" else (-2.0, 2.0, *BOUNDS)
    phi = kernel_of(kernel).features(values, bounds, rolloff=(order,))
    assert len(phi) == kernel_of(kernel).size(bounds, (order,)) == 4
    d = INSIDE[:, None] - INSIDE
    np.testing.assert_allclose(phi.T @ phi, np.cos(order * d) * (1 + np.outer(other, other) / 4), atol=1e-10)
    assert not kernel_of(kernel).unknown(3 * values, bounds).any()


def test_what_repeats_is_a_covariance_of_the_difference_of_two_angles_with_any_period():
    order = 2 * np.pi / 0.8
    values = np.append(INSIDE, INSIDE + 0.8)
    phi = kernel_of("repeat").features(values[None], BOUNDS, rolloff=(order, 2.0))
    assert len(phi) == kernel_of("repeat").size(BOUNDS, (order, 2.0))
    d = INSIDE[:, None] - INSIDE
    wanted = sum(np.cos(k * order * d) / k**2 for k in range(1, 9))
    np.testing.assert_allclose(phi[:, :60].T @ phi[:, :60], wanted, atol=1e-10)
    np.testing.assert_allclose(phi[:, 60:], phi[:, :60], atol=1e-10)


@pytest.mark.parametrize("kernel", sorted(set(KERNELS) - {"spectrum", "repeat"}))
def test_every_kernel_contains_a_constant_of_unit_variance(kernel):
    """The coefficients by which the features add up to 1 are as likely as those of a unit constant."""
    phi = np.asarray(kernel_of(kernel).features(INSIDE[None], BOUNDS))
    w, *_ = np.linalg.lstsq(phi.T, np.ones(60), rcond=None)
    np.testing.assert_allclose(w @ phi, 1.0, atol=0.03)
    assert w @ w < 1.05


@pytest.mark.parametrize("kernel", [*SCALED, "play"])
def test_the_unit_and_the_zero_of_a_driver_do_not_matter(kernel):
    walk = np.cumsum(RNG.normal(size=40))
    bounds = walk.min(), walk.max()
    moved, its = 2.5 * walk - 40.0, tuple(2.5 * end - 40.0 for end in bounds)
    np.testing.assert_allclose(
        kernel_of(kernel).features(moved[None], its), kernel_of(kernel).features(walk[None], bounds), rtol=0, atol=1e-9
    )


@pytest.mark.parametrize("kernel", PAIRS)
def test_a_product_has_the_product_of_the_covariances(kernel):
    values = np.stack([INSIDE, RNG.uniform(-2, 3, 60)])
    bounds = (*BOUNDS, -2.0, 3.0)
    expected = 1.0
    for k, name in enumerate(kernel.split("*")):
        phi = (
            values[k]
            if name == "wave"
            else kernel_of(name).factor.root.T @ spline_basis(values[k], *bounds[2 * k : 2 * k + 2])
        )
        expected = expected * (covariance("wave", phi) if name == "wave" else phi.T @ phi)
    np.testing.assert_allclose(covariance(kernel, values, bounds), expected, atol=1e-9)
    assert is_kernel(kernel, 2)
    assert not is_kernel(kernel, 1)


@pytest.mark.parametrize("pieces", [1, 2, PIECES])
def test_the_splines_are_scipys_and_constant_beyond(pieces):
    lower, upper = BOUNDS
    x = np.linspace(lower, upper, 41)[:-1]
    step = (upper - lower) / pieces
    basis = np.asarray(spline_basis(jnp.asarray(x), lower, upper, pieces))
    knots = lower + step * np.arange(-3, pieces + 4)
    np.testing.assert_allclose(basis.T, BSpline.design_matrix(x, knots, 3).toarray(), rtol=0, atol=1e-13)
    ends = spline_basis(jnp.asarray([lower, upper]), lower, upper, pieces)
    np.testing.assert_array_equal(spline_basis(jnp.asarray([-9.0, 9.0]), lower, upper, pieces), ends)
    np.testing.assert_allclose(basis.sum(axis=0), 1, rtol=0, atol=1e-13)


@pytest.mark.parametrize("kernel", SCALED)
@pytest.mark.parametrize("in_product", [False, True])
def test_the_splines_of_a_driver_express_all_its_features(kernel, in_product):
    splines = (kernel_of(kernel).factor if in_product else kernel_of(kernel)).root.T @ spline_basis(INSIDE, *BOUNDS)
    if not in_product:
        np.testing.assert_allclose(kernel_of(kernel).features(INSIDE[None], BOUNDS), splines, rtol=0, atol=1e-9)
    traced = kernel_of(kernel).features(jnp.asarray(INSIDE)[None], BOUNDS)
    np.testing.assert_allclose(traced, kernel_of(kernel).features(INSIDE[None], BOUNDS), rtol=0, atol=1e-12)


# ------------------------------------------------------------------ beyond what was seen

SIGMA = 0.05
SEEN = np.linspace(*BOUNDS, 80)
TRUTH = 1.0 + np.sin(1.5 * SEEN) + SIGMA * RNG.normal(size=80)
FURTHER = BOUNDS[1] + 0.7 * (BOUNDS[1] - BOUNDS[0]) * np.linspace(0, 1, 15)


def predicted(kernel, at):
    """Mean and variance `(sample,)` by the features, with what they do not say."""
    phi, there = (np.asarray(kernel_of(kernel).features(x[None], BOUNDS)) for x in (SEEN, at))
    C = np.linalg.inv(phi @ phi.T / SIGMA**2 + np.eye(len(phi)))
    mean = there.T @ (C @ phi @ TRUTH) / SIGMA**2
    return mean, np.sum(there * (C @ there), 0) + kernel_of(kernel).unknown(at[None], BOUNDS)


@pytest.mark.parametrize("kernel", ["line", "smooth", "medium", "rough"])
@pytest.mark.parametrize("side", [1, -1])
def test_beyond_the_range_it_is_predicted_as_by_the_whole_gaussian_process(kernel, side):
    at = FURTHER if side > 0 else BOUNDS[0] + BOUNDS[1] - FURTHER
    x, u = scaled(SEEN), scaled(at)
    K, k = plainly(kernel, x, x) + SIGMA**2 * np.eye(80), plainly(kernel, u, x)
    mean, variance = predicted(kernel, at)
    np.testing.assert_allclose(mean, k @ np.linalg.solve(K, TRUTH), atol=0.1)
    whole = np.diagonal(plainly(kernel, u, u)) - np.sum(k * np.linalg.solve(K, k.T).T, 1)
    np.testing.assert_allclose(np.sqrt(variance), np.sqrt(whole), atol=0.1)


@pytest.mark.parametrize("kernel", STATIONARY)
def test_far_beyond_the_range_it_is_the_constant_with_the_variance_of_the_prior(kernel):
    """Of the whole process the constant alone is correlated with what was seen."""
    far = np.array([BOUNDS[1] + 9 * (BOUNDS[1] - BOUNDS[0])])
    mean, variance = predicted(kernel, far)
    x = scaled(SEEN)
    to_constant = np.linalg.solve(plainly(kernel, x, x) + SIGMA**2 * np.eye(80), np.ones(80))
    assert mean[0] == pytest.approx(to_constant @ TRUTH, abs=0.15)
    prior = 1 + (4 if kernel == "cubic" else 1)
    assert variance[0] == pytest.approx(prior - to_constant.sum(), rel=0.15)
    np.testing.assert_array_equal(predicted(kernel, 3 * far), (mean, variance))


@pytest.mark.parametrize("kernel", STATIONARY)
def test_what_is_unknown_grows_from_nothing_at_the_end_of_the_range(kernel):
    left = kernel_of(kernel).unknown(FURTHER[None], BOUNDS)
    assert left[0] == 0
    assert np.diff(left).min() > -1e-4
    assert left[-1] > 1e-3
    assert not kernel_of(kernel).unknown(INSIDE[None], BOUNDS).any()


@pytest.mark.parametrize("kernel", ["line", "wave", "spectrum", "repeat", "play", "line*line", "line*wave"])
def test_lines_go_on_and_functions_of_an_angle_are_known_everywhere(kernel):
    count = kernel.count("*") + 1
    assert not kernel_of(kernel).unknown(np.tile([-9.0, 0.3, 70.0], (count, 1)), BOUNDS * count).any()
    if kernel == "line":
        np.testing.assert_allclose(kernel_of(kernel).features(np.array([[9.1]]), BOUNDS)[1], scaled(9.1))


def test_of_a_product_each_driver_beyond_its_range_counts():
    bounds, inside = (*BOUNDS, -1.0, 1.0), np.array([[1.0], [0.5]])
    one, other, both = (
        kernel_of("smooth*smooth").unknown(inside + beyond, bounds)[0]
        for beyond in ([[2.0], [0]], [[0], [1.0]], [[2.0], [1.0]])
    )
    assert 0 < max(one, other) < both
    steep = kernel_of("line*smooth").unknown(np.array([[9.0, 0.0], [3.0, 3.0]]), bounds)
    assert steep[0] > 20 * steep[1]  # where the line is far, so is what is not known of its slope


# ------------------------------------------------------------------ what a search asks of them

ALL = [*map(kernel_of, KERNELS), *MODULATED, *map(kernel_of, TRIED_PAIRS)]


@pytest.mark.parametrize("kernel", ALL, ids=lambda kernel: kernel.name)
def test_a_kernel_is_priced_and_is_possible_with_all_numbers_that_are_tried(kernel):
    assert kernel_of(kernel.name) is kernel
    assert kernel.prior in PRIOR.probabilities
    bounds = BOUNDS * kernel.drivers
    searched = (1.0,) * (kernel.any_order or kernel.any_sample)
    for numbers in kernel.grid:
        rolloff = (*searched, *numbers)
        assert kernel.fault(bounds, rolloff) == ""
        if len(numbers) + len(searched):
            assert len(rolloff) == len(kernel.numbers)
        size = kernel.size(bounds, rolloff)
        assert len(kernel.features(np.tile(INSIDE, (kernel.drivers, 1)), bounds, rolloff=rolloff)) == size
        assert len(kernel.deviations(bounds, rolloff)) == size


def test_what_is_no_number_of_a_kernel_is_its_fault():
    for name, rolloff in (("smooth", (1.0,)), ("smooth*line", (1.0,)), ("spectrum", (0.0, 2.0)), ("spectrum", (3.0,)),
                          ("step", ()), ("step", (9.0,)), ("sine*line", (-1.0,)), ("sine*line", ())):  # fmt: skip
        kernel = kernel_of(name)
        assert str(rolloff) in kernel.fault(BOUNDS * kernel.drivers, rolloff)


@pytest.mark.parametrize("name", ["sine", "play*line", "line*wander", "sine*smooth", "line*line*line", "", "curve"])
def test_a_name_that_is_no_kernel_is_refused(name):
    assert not any(is_kernel(name, drivers) for drivers in (1, 2, 3))
    with pytest.raises(InputError, match="no kernel is called"):
        kernel_of(name)


def test_only_what_another_kernel_does_not_describe_stands_beside_it():
    """At one site: one curve and one spectrum of its gear; what repeats beside curves, what wanders beside all."""
    names = ("smooth", "play", "line*line", "spectrum", "repeat", "wander")
    hidden = {(a, b) for a in names for b in names if kernel_of(a).hides(kernel_of(b))}
    curves = names[:3]
    own = {("spectrum", "spectrum"), ("repeat", "repeat"), ("repeat", "spectrum"), ("wander", "wander")}
    assert hidden == {(a, b) for a in curves for b in curves} | own


def test_the_documentation_has_every_kernel():
    assert all(f"\n| {kernel.name} | {kernel.formula} | " in kernels.__doc__ for kernel in map(kernel_of, KERNELS))
