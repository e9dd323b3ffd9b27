"""What a fit found, as the seed's JSON table."""

from pathlib import Path

import numpy as np

from lite6jax.arms.chains import HayatiForm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.arms.forms import hayati_of
from lite6jax.arms.table import write_table
from lite6jax.fitting.solution import Solution


def write_solution(solution: Solution, path: str | Path, overwrite: bool = False) -> Path:
    """Writes the fitted arm's Hayati parameters; sensor frame and tool, which are not the arm's, stay out of it.

    How the fit ended, whether it describes the data and its error on data not fitted are written beside the table.

    A six-parameter chain, near a factory calibration, is converted in closed form.

    Raises:
        InputError: as `write_table` and `hayati_of`.
    """
    form, parameters = solution.form.chain, solution.parameters
    if not isinstance(form, HayatiForm):
        arm = solution.arm
        chain = FactoryCalibration(parameters.reshape(-1, 6), arm, arm.T_joint_flange, str(path))
        form, parameters = arm.form, hayati_of(chain)
    error = solution.checked.position_rms
    fit = {
        "result": solution.result.name.lower(),
        "quality": solution.quality.verdict,
        "checked_position_rms_m": error if np.isfinite(error) else None,
    }
    return write_table(form, np.asarray(parameters), path, overwrite, fit)
