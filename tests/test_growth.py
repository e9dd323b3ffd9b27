"""Fitted exponents: those of known laws are found inside their intervals, and the figure is drawn."""

import numpy as np
import pytest

from benchmarks import growth

SIZES = (100, 300, 1000, 3000, 10_000)


@pytest.mark.parametrize(("constant", "exponent"), [(0.0, 1.0), (0.5, 1.0), (0.02, 2.0), (0.0, 1.5)])
def test_the_exponent_of_a_known_law_is_inside_its_interval(constant, exponent):
    rng = np.random.default_rng(4)
    seconds = (constant + (np.array(SIZES) / 1000) ** exponent) * np.exp(0.02 * rng.standard_normal(len(SIZES)))
    found = growth.fitted("work", SIZES, seconds, start=constant > 0)
    assert abs(found.exponent - exponent) <= found.interval
    assert 0 < found.interval < 0.5
    million = constant + 1000.0**exponent
    assert found.at(1e6) == pytest.approx(million, rel=0.6)


def test_an_exponent_takes_four_sizes():
    with pytest.raises(ValueError, match="work: 3 sizes; give 4 or more"):
        growth.fitted("work", (1, 2, 3), (1, 2, 3))


def test_the_figure_shows_every_law(tmp_path):
    laws = [growth.fitted(of, SIZES, np.array(SIZES) * 1e-3 * (k + 1)) for k, of in enumerate(("files", "joints"))]
    growth.draw(laws, tmp_path / "growth.png")
    assert (tmp_path / "growth.png").stat().st_size > 5000
