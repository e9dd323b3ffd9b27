"""The ladder of friction terms, which a diagnosis of real torques is compared with."""

import numpy as np
import pytest
from domains.torque.moved import hidden, recorded

from benchmarks.ladder import STEPS, LowPass, climbed, half_of, main, rms


def halves(recording, low):
    early = np.arange(recording.samples) < recording.samples // 2
    return [half_of(recording.select(rows), low.rate, low) for rows in (early, ~early)]


@pytest.mark.long
@pytest.mark.parametrize(
    ("effect", "joint", "step"),
    [
        (hidden("viscous_friction", "joint2", viscous_Nm_s_per_rad=2.0), 2, 1),
        (hidden("joint_spring", "joint3", stiffness_Nm_per_rad=3.0, rest_rad=0.2), 3, 2),
    ],
)
def test_each_step_explains_what_it_is_made_for(effect, joint, step):
    (recording, arm), low = recorded([effect]), LowPass(50.0, 10.0)
    train, test = halves(recording, low)
    gravity = recording.settings.gravity_m_per_s2
    errors = {name: rms(off, test)[joint - 1] for name, off in climbed(arm, train, test, gravity, low)}
    assert errors[STEPS[step - 1]] > 10 * errors[STEPS[step]]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["missing.csv"], "missing.csv"), (["missing.csv", "--cut", "0"], "give a frequency above zero")],
)
def test_what_cannot_be_compared_is_said_in_a_line(arguments, message, capsys):
    try:
        code = main(arguments)
    except SystemExit as stopped:
        code = stopped.code
    assert code == 2
    assert message in capsys.readouterr().err
