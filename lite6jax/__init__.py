"""The public names. Importing the package enables 64-bit floats in JAX: fits here reach 1e-13 m."""

import jax

jax.config.update("jax_enable_x64", True)

from lite6jax.arms.arm import Arm  # noqa: E402
from lite6jax.arms.chains import HayatiForm, hayati_fk, six_parameter_fk  # noqa: E402
from lite6jax.arms.convert import hayati_to_six_parameter, six_parameter_to_hayati  # noqa: E402
from lite6jax.arms.files import read_arm, read_factory, write_factory  # noqa: E402
from lite6jax.errors import InputError  # noqa: E402
from lite6jax.fitting.fit import fit  # noqa: E402
from lite6jax.fitting.fleet import fit_fleet, fit_fleet_calibrations  # noqa: E402
from lite6jax.fitting.solution import FleetSolution, Result, Solution  # noqa: E402
from lite6jax.identifiability.identify import identify, identify_recording  # noqa: E402
from lite6jax.identifiability.information import Experiment, plan_experiment  # noqa: E402
from lite6jax.identifiability.planning import plan_poses  # noqa: E402
from lite6jax.identifiability.sensitivity import global_sensitivity, sensitivity  # noqa: E402
from lite6jax.identifiability.sensor import Sensor  # noqa: E402
from lite6jax.recordings import Recording, read_recording, write_recording  # noqa: E402

__all__ = [
    "Arm",
    "Experiment",
    "FleetSolution",
    "HayatiForm",
    "InputError",
    "Recording",
    "Result",
    "Sensor",
    "Solution",
    "fit",
    "fit_fleet",
    "fit_fleet_calibrations",
    "global_sensitivity",
    "hayati_fk",
    "hayati_to_six_parameter",
    "identify",
    "identify_recording",
    "plan_experiment",
    "plan_poses",
    "read_arm",
    "read_factory",
    "read_recording",
    "sensitivity",
    "six_parameter_fk",
    "six_parameter_to_hayati",
    "write_factory",
    "write_recording",
]
