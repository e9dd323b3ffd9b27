"""Draws the picture of the README: what a diagnosis takes off the error of a simulated arm, at poses it never saw."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import lite6jax

EFFECTS = ("joint_compliance:joint=2,compliance_rad_per_Nm=9e-5", "joint_backlash:joint=4,gap_rad=1e-3")
"""Those of the README."""
BEFORE, AFTER = "#D55E00", "#0072B2"  # distinguishable with colour blindness and in grey: M. Okabe, K. Ito, 2002


def main() -> None:
    """Simulates, diagnoses one half, predicts the other, draws."""
    arm = lite6jax.read_arm("lite6")
    measured, unseen = (lite6jax.simulate(arm, effects=EFFECTS, sensor="tracker", seed=seed) for seed in (0, 1))
    diagnosis = lite6jax.diagnose(measured)
    nominal = lite6jax.six_parameter_fk(arm.kinematics, unseen.joint_position)[:, :3, 3]
    predicted = lite6jax.predict(diagnosis.model, unseen)[:, :3, 3]
    assert unseen.position is not None
    before, after = (1e3 * np.linalg.norm(unseen.position - pose, axis=1) for pose in (nominal, predicted))
    noise = 1e3 * np.sqrt(3) * (unseen.settings.position_noise_m or 0)
    angle = np.rad2deg(unseen.joint_position[:, 1])

    plt.rcParams.update({"font.size": 13, "axes.spines.top": False, "axes.spines.right": False})
    figure, panel = plt.subplots(figsize=(9, 4), layout="constrained")
    for errors, colour, name in ((before, BEFORE, "before"), (after, AFTER, "after")):
        rms = np.sqrt(np.mean(errors**2))
        panel.plot(angle, errors, ".", color=colour, alpha=0.7, markeredgewidth=0, markersize=7)
        panel.plot([], [], "o", color=colour, label=f"{name}: {rms:.3f} mm RMS")
    panel.axhline(noise, color="black", linestyle=":", linewidth=1.5, label=f"noise: {noise:.3f} mm RMS")
    panel.set(xlabel="angle of joint 2 (deg)", ylabel="position error (mm)", ylim=(0, 1.2 * before.max()))
    effects = [finding.effect for finding in diagnosis.findings]
    found = " and ".join(f"{e.name.removeprefix('joint_')} of {e.site.replace('joint', 'joint ')}" for e in effects)
    panel.set_title(f"Found: {found}", loc="left", fontsize=14)
    panel.legend(frameon=False, loc="upper center", ncols=3, fontsize=11.5, columnspacing=1.0, handlelength=1.2)
    figure.savefig(Path(__file__).with_suffix(".png"), dpi=110)


if __name__ == "__main__":
    main()
