"""Pictures of notebooks are the same in another font, and are not with another curve, point, bar or panel."""

import io
from functools import partial

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from docs.hooks.pictures import difference, in_few_colours

FONTS = {
    "as stored": {"font.family": "DejaVu Sans", "font.size": 10},
    "serif": {"font.family": "DejaVu Serif", "font.size": 10},
    "mono": {"font.family": "DejaVu Sans Mono", "font.size": 10},
    "smaller": {"font.family": "DejaVu Sans", "font.size": 8},
}


def drawn(font="as stored", height=1.0, line="C0", points=0, bars=(3.0, 5.0, 2.0), few=False):
    """A figure of three panels like those of the notebooks."""
    style = {"axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "grid.color": "#e4e4e4"}
    with mpl.rc_context(FONTS[font] | style):
        figure = Figure(figsize=(8, 3.5), layout="constrained")
        left, middle, right = figure.subplots(1, 3)
        x = np.linspace(-150, 150, 200)
        left.plot(x, 0.2 + height * 0.08 * np.sin(x / 40), line, linewidth=2, label="measured and predicted")
        left.plot(x, 0.1 + 0.0 * x, "black", linewidth=1.5)
        left.set(xlabel="joint 1 (deg)", ylabel="position error (mm)", ylim=(0, 0.4), title="before and after")
        left.legend(loc="upper left")
        at = np.random.default_rng(points).normal(size=(2, 120))
        middle.plot(*at, ".", color="C1", markersize=3)
        middle.set(xlabel="joint 2 (deg)", ylabel="residual (mm)", xlim=(-4, 4), ylim=(-4, 4))
        if few:
            right.remove()
        else:
            right.bar(range(3), bars, color="C2")
            right.set(xlabel="arm", ylabel="number of arms", ylim=(0, 8))
            right.annotate("a note", (0.1, 6.5))
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=100, bbox_inches="tight")
    return buffer.getvalue()


@pytest.fixture(scope="module")
def stored():
    return in_few_colours(drawn())


@pytest.mark.parametrize("font", FONTS)
def test_another_font_is_no_difference(stored, font):
    now = drawn(font)
    assert (in_few_colours(now) == stored) is (font == "as stored")
    assert difference(stored, now) == difference(now, stored) == ""


CHANGES = {
    "a curve higher by a twentieth of its panel": (partial(drawn, height=1.25), "panel 1 of 3 differs in"),
    "a curve upside down": (partial(drawn, height=-1.0), "panel 1 of 3 differs in"),
    "a curve of another colour": (partial(drawn, line="C3"), "panel 1 of 3 differs in"),
    "other points": (partial(drawn, points=1), "panel 2 of 3 differs in"),
    "a bar higher by a sixteenth of its panel": (partial(drawn, bars=(3.0, 5.5, 2.0)), "panel 3 of 3 differs in"),
    "a panel less": (partial(drawn, few=True), "3 panels were stored, and there are 2 now"),
}


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("font", ["as stored", "serif"])
def test_other_data_are_a_difference(stored, change, font):
    draw, said = CHANGES[change]
    assert difference(stored, draw(font)).startswith(said)
