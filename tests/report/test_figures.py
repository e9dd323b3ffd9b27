"""Figures say what was measured, in words and units, and are written whole."""

import numpy as np
import pytest
from matplotlib.image import imread

from lite6jax import fit
from lite6jax.arms.description import load_bundled
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.calibration.fleet import compare
from lite6jax.errors import InputError
from lite6jax.report import figures
from tests.oracles.arms import perturbed

LITE6 = load_bundled("lite6")


@pytest.fixture(scope="module")
def solution():
    return fit(perturbed(np.random.default_rng(0), LITE6.kinematics), "lite6")


@pytest.fixture(scope="module")
def comparison():
    rng = np.random.default_rng(1)
    arms = [perturbed(rng, LITE6.kinematics) for _ in range(3)]
    return compare([FactoryCalibration(k, LITE6, np.eye(4), f"folder/arm{i}.yaml") for i, k in enumerate(arms)])


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_a_panel_for_each_joint(solution):
    figure = figures.error_by_joint(solution, "arm.yaml")
    assert [panel.get_xlabel() for panel in figure.axes] == [f"joint {i} (deg)" for i in range(1, 7)]
    assert figure.axes[0].get_ylabel() == figure.axes[3].get_ylabel() == "position error (mm)"
    assert figure.get_suptitle() == "arm.yaml"
    before, after = legend(figure)
    rms, most = 1e3 * solution.nominal_errors.position_rms, 1e3 * solution.nominal_errors.position.max()
    assert before == f"nominal: {rms:.3g} mm RMS, {most:.3g} mm at most"
    assert after.startswith("fitted, on fresh samples: ")
    for joint, panel in enumerate(figure.axes):
        dots, medians = panel.lines[:2]
        np.testing.assert_allclose(dots.get_xdata(), np.rad2deg(solution.nominal_errors.joint_position[:, joint]))
        np.testing.assert_allclose(dots.get_ydata(), 1e3 * solution.nominal_errors.position)
        x, y = medians.get_xdata(), medians.get_ydata()
        near = np.abs(dots.get_xdata() - x[7]) < (x[1] - x[0]) / 2
        assert y[7] == pytest.approx(np.median(dots.get_ydata()[near]))


def test_the_distances_between_arms(comparison):
    panel, bar = figures.distance_between(comparison).axes
    assert bar.get_ylabel() == "largest distance of the flanges (mm)"
    table = np.asarray(panel.images[0].get_array())
    np.testing.assert_allclose(table[1:, 1:], 1e3 * comparison.between)
    np.testing.assert_allclose(table[0, 1:], 1e3 * comparison.from_nominal.max(1))
    assert f"{table[1, 2]:.2f}" in [text.get_text() for text in panel.texts]


def test_written_whole_and_the_same_again(tmp_path, solution):
    drawn = {"one": figures.error_by_joint(solution, "arm.yaml")}
    paths = figures.save(drawn, tmp_path)
    assert [path.name for path in paths] == ["one.png", "one.svg"]
    image = imread(paths[0])
    assert image.shape[1] == 12 * 120
    assert image[..., :3].min() < 0.2 < 0.99 < image[..., :3].max()
    first = [path.read_bytes() for path in paths]
    again = {"one": figures.error_by_joint(solution, "arm.yaml")}
    assert [path.read_bytes() for path in figures.save(again, tmp_path, overwrite=True)] == first
    with pytest.raises(InputError, match=r"one\.png: exists already; choose another name or add --force"):
        figures.check_names(tmp_path, ["one"])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.png", "one.svg"]
