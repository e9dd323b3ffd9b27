"""Rivals that learn what the geometry leaves without asking why: a Gaussian process and a neural network."""

import warnings
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.residual.view import Array, Correction, Fitted, View

_GP_TUNED, _GP_ROWS = 800, 3000
"""Rows by which a Gaussian process' kernel is chosen, and rows that it then keeps at most."""


def geometry_alone(seen: View) -> Fitted:
    """Nothing more."""
    return Fitted(lambda view: Correction(np.zeros_like(view.tool[1]), np.zeros_like(view.tool[1])), 0)


def features(view: View, angles: bool) -> Array:
    """What a black box is told of each row: joints (as they are, or as sines and cosines too), and all that varies."""
    q = view.recording.joint_position
    r = view.recording
    columns = [q, np.sin(q), np.cos(q)] if angles else [q]
    columns += [r.payload[:, None], r.direction_of_motion]
    columns += [part.reshape(len(q), -1) for part in (r.joint_temperature, r.ambient_temperature) if part is not None]
    return np.hstack(columns)


class _Scaled(NamedTuple):
    """Columns that vary, to mean zero and deviation one."""

    kept: NDArray[np.bool_]
    mean: Array
    size: Array

    def __call__(self, X: Array) -> Array:
        return (X[:, self.kept] - self.mean) / self.size


def _scaled(X: Array) -> _Scaled:
    kept = X.std(0) > 1e-9
    return _Scaled(kept, X[:, kept].mean(0), X[:, kept].std(0))


def gaussian_process(seen: View) -> Fitted:
    """The residual's three components over joints, payload, direction and temperature: one length a feature, noise."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    assert seen.missed is not None
    X, y = features(seen, angles=False), seen.missed
    inputs, size = _scaled(X), max(float(np.std(y)), 1e-12)
    X, y = inputs(X), y / size
    rng = np.random.default_rng(0)
    lengths: Any = np.ones(X.shape[1])  # one a feature
    kernel = ConstantKernel() * RBF(lengths, (0.05, 1e3)) + WhiteKernel(0.1, (1e-6, 10.0))
    chosen = rng.permutation(len(X))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        tuned = GaussianProcessRegressor(kernel, normalize_y=True, random_state=0)
        tuned.fit(X[chosen[:_GP_TUNED]], y[chosen[:_GP_TUNED]])
        kept: Any = chosen[:_GP_ROWS]
        as_it_is: Any = None
        process = GaussianProcessRegressor(tuned.kernel_, optimizer=as_it_is, normalize_y=True).fit(X[kept], y[kept])

    def correct(view: View) -> Correction:
        shift = size * np.asarray(process.predict(inputs(features(view, angles=False))))
        return Correction(shift, np.zeros_like(shift))

    return Fitted(correct, 3 * len(kept) + 2 + X.shape[1])


def neural_network(seen: View) -> Fitted:
    """Two layers of 64 over joints, their sines and cosines, payload, direction and temperature; stopped early."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.neural_network import MLPRegressor

    assert seen.missed is not None
    X, y = features(seen, angles=True), seen.missed
    inputs, size = _scaled(X), max(float(np.std(y)), 1e-12)
    net = MLPRegressor(
        hidden_layer_sizes=(64, 64),
        activation="tanh",
        alpha=1e-4,
        early_stopping=True,
        n_iter_no_change=25,
        max_iter=600,
        random_state=0,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        net.fit(inputs(X), y / size)

    def correct(view: View) -> Correction:
        shift = size * np.asarray(net.predict(inputs(features(view, angles=True))))
        return Correction(shift, np.zeros_like(shift))

    return Fitted(correct, sum(part.size for part in (*net.coefs_, *net.intercepts_)))
