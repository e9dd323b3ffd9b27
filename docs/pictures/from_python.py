"""Draws the pictures of the README's part for Python: runs its `python` blocks, and draws their results."""

import re
from pathlib import Path
from typing import Any

import jax
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

import lite6jax
from docs.hooks.pictures import in_few_colours

HERE = Path(__file__).parent
README = HERE.parents[1] / "README.md"
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
BEFORE, AFTER = "#D55E00", "#0072B2"  # as in before_and_after.py


def run_readme() -> dict[str, Any]:
    """The names that the README's `python` blocks give a value, in the order in which they stand."""
    names: dict[str, Any] = {}
    for block in BLOCK.findall(README.read_text(encoding="utf-8")):
        exec(compile(block, "README.md", "exec"), names)
    return names


def draw_fleet(names: dict[str, Any]) -> Figure:
    """The share of arms whose flange is off by no more than a distance, before and after their fits."""
    fleet, chains, nominal = names["fleet"], names["chains"], names["arm"]
    q = lite6jax.candidates(nominal, 200, seed=1).joint_position  # not those of the fit
    true = jax.vmap(lite6jax.six_parameter_fk, (0, None))(chains, q)[..., :3, 3]
    tabulated = lite6jax.six_parameter_fk(nominal.kinematics, q)[..., :3, 3]
    fitted = jax.vmap(lambda row: lite6jax.hayati_fk(fleet.form.chain, row, q))(fleet.parameters)[..., :3, 3]
    figure, panel = plt.subplots(figsize=(9, 3.4), layout="constrained")
    share = 100 * np.arange(1, len(chains) + 1) / len(chains)
    for positions, colour, style, name in ((tabulated, BEFORE, "--", "nominal"), (fitted, AFTER, "-", "fitted")):
        rms = 1e3 * np.sqrt(np.mean(np.sum(np.asarray(true - positions) ** 2, -1), 1))
        panel.semilogx(np.sort(rms), share, style, color=colour, label=f"{name}: median {np.median(rms):.2g} mm")
    panel.set(xlabel="position error of an arm, RMS at 200 other poses (mm)", ylabel="arms (%)", ylim=(0, 100))
    panel.set_title(f"{len(chains)} arms, {names['q'].shape[0]} poses each", loc="left")
    panel.legend(frameon=False, loc="center")
    return figure


def main() -> None:
    """Runs, draws, saves."""
    names = run_readme()
    plt.rcParams.update({"font.size": 13, "axes.spines.top": False, "axes.spines.right": False})
    pictures = {"fleet": draw_fleet(names)}
    pictures["error_by_joint"] = names["solution"].plot()["error_by_joint"]
    pictures["deviations"] = names["known"].plot()["deviations"]
    pictures["sensitivity"] = names["sensitivities"].plot()["workspace"]
    for name, figure in pictures.items():
        path = HERE / f"from_python_{name}.png"
        figure.savefig(path, dpi=80)
        path.write_bytes(in_few_colours(path.read_bytes()))


if __name__ == "__main__":
    main()
