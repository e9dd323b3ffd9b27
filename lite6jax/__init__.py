"""The public names. Importing the package enables 64-bit floats in JAX: fits here reach 1e-13 m.

A name's module is imported when the name is first used, so that a program waits only for what it needs. To add a name,
add it to `_NAMES` and, for type checkers, to the imports above it; `tests/test_public_names.py` compares the two.
"""

import os
import sys

from lite6jax import results

TYPE_CHECKING = False  # as of `typing`, which takes longer to import than the rest of this module
if TYPE_CHECKING:
    # isort: off
    from lite6jax.arms.arm import Arm as Arm
    from lite6jax.arms.chains import (
        HayatiForm as HayatiForm,
        hayati_fk as hayati_fk,
        six_parameter_fk as six_parameter_fk,
    )
    from lite6jax.arms.dh import (
        hayati_to_six_parameter as hayati_to_six_parameter,
        six_parameter_to_hayati as six_parameter_to_hayati,
    )
    from lite6jax.arms.dynamics import inverse_dynamics as inverse_dynamics, link_parameters as link_parameters
    from lite6jax.arms.files import read_arm as read_arm, read_factory as read_factory, write_factory as write_factory
    from lite6jax.diagnosis.diagnose import Diagnosis as Diagnosis, diagnose as diagnose
    from lite6jax.diagnosis.options import Options as Options
    from lite6jax.diagnosis.torque_diagnosis import TorqueDiagnosis as TorqueDiagnosis
    from lite6jax.domains.pose.compensate import compensate as compensate
    from lite6jax.domains.pose.fit import fit as fit
    from lite6jax.diagnosis.document import read_model as read_model
    from lite6jax.domains.pose.registration import register as register, register_model as register_model
    from lite6jax.domains.predict import predict as predict, predicted as predicted
    from lite6jax.effects.deflection import (
        Deflection as Deflection,
        place_at_joint as place_at_joint,
        twist as twist,
    )
    from lite6jax.effects.drivers import Driver as Driver
    from lite6jax.effects.dynamic import (
        Dynamics as Dynamics,
        JointTorque as JointTorque,
        TorqueEffect as TorqueEffect,
    )
    from lite6jax.effects.effect import (
        Bending as Bending,
        Coordinate as Coordinate,
        Effect as Effect,
        JointEffect as JointEffect,
    )
    from lite6jax.effects.motion import Motion as Motion
    from lite6jax.effects.statics import Loads as Loads
    from lite6jax.effects.user_effects import load_effects as load_effects
    from lite6jax.errors import InputError as InputError
    from lite6jax.estimation.options import EngineOptions as EngineOptions
    from lite6jax.calibration.fleet import (
        FleetSolution as FleetSolution,
        fit_fleet as fit_fleet,
        fit_fleet_calibrations as fit_fleet_calibrations,
    )
    from lite6jax.calibration.quality import Result as Result
    from lite6jax.calibration.solution import Solution as Solution
    from lite6jax.design.candidates import (
        above_floor as above_floor,
        all_pass as all_pass,
        candidates as candidates,
        clear_of_itself as clear_of_itself,
        link_frames as link_frames,
        self_collision as self_collision,
    )
    from lite6jax.design.identify import (
        identify as identify,
        identify_recording as identify_recording,
        sensitivity as sensitivity,
    )
    from lite6jax.design.information import Experiment as Experiment, plan_experiment as plan_experiment
    from lite6jax.design.poses import plan_poses as plan_poses
    from lite6jax.recordings import (
        Recording as Recording,
        RecordingSettings as RecordingSettings,
        join_recordings as join_recordings,
        read_recording as read_recording,
        write_recording as write_recording,
    )
    from lite6jax.sensors.sensor import Sensor as Sensor
    from lite6jax.sensors.usual import plan_sensor as plan_sensor
    from lite6jax.simulation import (
        UndeclaredNoise as UndeclaredNoise,
        draw_calibration as draw_calibration,
        draw_sensor_frame as draw_sensor_frame,
        simulate as simulate,
    )

_NAMES = {
    "lite6jax.arms.arm": ("Arm",),
    "lite6jax.arms.chains": ("HayatiForm", "hayati_fk", "six_parameter_fk"),
    "lite6jax.arms.dh": ("hayati_to_six_parameter", "six_parameter_to_hayati"),
    "lite6jax.arms.dynamics": ("inverse_dynamics", "link_parameters"),
    "lite6jax.arms.files": ("read_arm", "read_factory", "write_factory"),
    "lite6jax.diagnosis.diagnose": ("Diagnosis", "diagnose"),
    "lite6jax.diagnosis.options": ("Options",),
    "lite6jax.diagnosis.torque_diagnosis": ("TorqueDiagnosis",),
    "lite6jax.domains.pose.compensate": ("compensate",),
    "lite6jax.diagnosis.document": ("read_model",),
    "lite6jax.domains.pose.registration": ("register", "register_model"),
    "lite6jax.domains.predict": ("predict", "predicted"),
    "lite6jax.effects.deflection": ("Deflection", "place_at_joint", "twist"),
    "lite6jax.effects.drivers": ("Driver",),
    "lite6jax.effects.dynamic": ("Dynamics", "JointTorque", "TorqueEffect"),
    "lite6jax.effects.effect": ("Bending", "Coordinate", "Effect", "JointEffect"),
    "lite6jax.effects.motion": ("Motion",),
    "lite6jax.effects.statics": ("Loads",),
    "lite6jax.effects.user_effects": ("load_effects",),
    "lite6jax.errors": ("InputError",),
    "lite6jax.estimation.options": ("EngineOptions",),
    "lite6jax.domains.pose.fit": ("fit",),
    "lite6jax.calibration.fleet": ("FleetSolution", "fit_fleet", "fit_fleet_calibrations"),
    "lite6jax.calibration.quality": ("Result",),
    "lite6jax.calibration.solution": ("Solution",),
    "lite6jax.design.candidates": (
        *("above_floor", "all_pass", "candidates", "clear_of_itself", "link_frames", "self_collision"),
    ),
    "lite6jax.design.identify": ("identify", "identify_recording", "sensitivity"),
    "lite6jax.design.information": ("Experiment", "plan_experiment"),
    "lite6jax.design.poses": ("plan_poses",),
    "lite6jax.recordings": ("Recording", "RecordingSettings", "join_recordings", "read_recording", "write_recording"),
    "lite6jax.sensors.sensor": ("Sensor",),
    "lite6jax.sensors.usual": ("plan_sensor",),
    "lite6jax.simulation": ("UndeclaredNoise", "draw_calibration", "draw_sensor_frame", "simulate"),
}
"""The public names of each module."""
_MODULES = {name: module for module, names in _NAMES.items() for name in names}
__all__ = [*_MODULES]  # pyright: ignore[reportUnsupportedDunderAll]
results.reporting = "lite6jax.report.results"

_SMALL_LOOPS = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=262144"
"""On a CPU a loop whose step handles less than these bytes is one compiled function: a rollout takes a quarter of the
time that it takes where XLA starts each operation of each step by itself."""
_flags = os.environ.get("XLA_FLAGS", "")
if "xla_backend_extra_options" not in _flags:  # read when JAX first computes; a program may have its own
    os.environ["XLA_FLAGS"] = f"{_flags} {_SMALL_LOOPS}".strip()

if "jax" in sys.modules:
    sys.modules["jax"].config.update("jax_enable_x64", True)
else:  # JAX reads it when it is first imported, which takes half a second: a program first has its signals to set up
    os.environ["JAX_ENABLE_X64"] = "true"


def __getattr__(name: str) -> object:
    from importlib import import_module

    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    _keep_compiled_code()
    value = globals()[name] = getattr(import_module(_MODULES[name]), name)
    return value


def _keep_compiled_code() -> None:
    """Keeps what is compiled between processes from the first public name on, as commands do.

    A program that has a folder of its own (`jax_compilation_cache_dir`) keeps it, and one that says
    `jax_enable_compilation_cache=False` keeps nothing.
    """
    from lite6jax.calibration import compiled

    compiled.keep_compiled_code()


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULES})
