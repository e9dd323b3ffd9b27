"""JAX is imported where it is first used: not by commands that compute nothing, and with the same results by others."""

import subprocess
import sys
from pathlib import Path

import pytest

from lite6jax.arms.description import load_bundled
from lite6jax.arms.factory import write_factory
from lite6jax.simulation import draw_calibration

ROOT = Path(__file__).resolve().parents[1]

RECORDING = "q1_rad,q2_rad,q3_rad,q4_rad,q5_rad,q6_rad\n" + "0.1,0.2,0.3,0.4,0.5,0.6\n" * 12


def in_a_new_process(code, *arguments):
    """What a program prints that imports nothing beforehand."""
    done = subprocess.run([sys.executable, "-c", code, *arguments], cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.splitlines()


@pytest.mark.parametrize(
    "command",
    [
        ["--help"],
        ["--version"],
        ["diagnose", "--help"],
        ["fit", "--help"],
        ["simulate", "--help"],
        ["arms"],
        ["arms", "--json"],
        ["effects"],
        ["effects", "--json"],
        ["init", "run.csv", "--yes"],
        ["init", "run.csv", "--json", "--force"],
        ["convert", "lite6", "arm.urdf"],
        ["convert", "ur10", "arm.xml"],
        ["fit", "no_such_file.yaml"],
        ["fleet", "no_such_folder", "--out", "fleet.parquet"],
    ],
    ids=" ".join,
)
def test_a_command_that_computes_nothing_imports_neither_jax_nor_pandas(tmp_path, command):
    (tmp_path / "run.csv").write_text(RECORDING)
    code = """
import contextlib, io, os, sys
from lite6jax.cli import program
os.chdir(sys.argv[1])
with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(out):
    code = program.main(sys.argv[2:])
computing = ["jax", "pandas"]
if sys.argv[-1] == "--help":
    computing += ["matplotlib", "optimistix", "scipy", "rich.table", "lite6jax.simulation.measurement"]
print(code, any(name in sys.modules for name in computing), len(out.getvalue()) > 10)
"""
    wrong = 2 if command[1:2] and command[1].startswith("no_such") else 0
    assert in_a_new_process(code, str(tmp_path), *command) == [f"{wrong} False True"]


def test_what_is_imported_lazily_is_executed_when_a_name_of_it_is_used():
    code = """
import sys
from lite6jax.deferred import import_lazily
with import_lazily():
    from lite6jax import recordings
    from lite6jax.calibration import source
    from lite6jax.recordings import settings as sidecar
    from lite6jax.arms import entries
print("numpy" in sys.modules, sidecar.__name__, sidecar.__file__[-11:])
print("YAML" in entries.__doc__)
print(sidecar.sidecar_path("run.csv"), recordings.recording_file("run.csv"), source.load_nominal("lite6").name)
print(sidecar is sys.modules["lite6jax.recordings.settings"] is recordings.settings)
from lite6jax.recordings.settings import sidecar_path
print(sidecar_path is sidecar.sidecar_path, type(sidecar).__name__)
for wrong in ("sidecar.nothing", "recordings.nothing"):
    try:
        eval(wrong)
    except AttributeError as error:
        print(error)
try:
    with import_lazily():
        from lite6jax.design import nothing
except ImportError as error:
    print(error.name)
from lite6jax.design import poses
print(poses.plan_poses.__name__)
"""
    assert in_a_new_process(code) == [
        "False lite6jax.recordings.settings settings.py",
        "True",
        "run.yaml run.csv lite6",
        "True",
        "True module",
        "module 'lite6jax.recordings.settings' has no attribute 'nothing'",
        "module 'lite6jax.recordings' has no attribute 'nothing'",
        "lite6jax.design",
        "plan_poses",
    ]


# ------------------------------------------------------------------ what a command that computes imports

ENGINE = (
    *("lite6jax.search", "lite6jax.domains", "lite6jax.diagnosis", "lite6jax.sensors.points", "lite6jax.estimation"),
    *("scipy.signal", "scipy.stats", "scipy.spatial", "scipy.optimize", "optimistix", "matplotlib", "equinox"),
)
"""What diagnoses, and the parts of libraries that take long: a command that fits a calibration needs none of them."""
LIGHT = (
    *("lite6jax.estimation", "lite6jax.estimation.robust", "lite6jax.estimation.thresholds"),
    "lite6jax.domains.pose",
)
"""Of them, what is a few numbers, or a few functions of NumPy, or a package that itself holds nothing."""


COMMANDS = (
    ("arms", 60),
    ("effects", 75),
    ("convert arm.yaml arm.urdf", 80),
    ("fit arm.yaml --out model.json", 96),
    ("compare arm.yaml other.yaml", 96),
    ("identify lite6", 125),
    ("sensitivity lite6", 125),
    ("design lite6 --out poses.csv", 125),
)
"""Commands that do not diagnose, and how many modules of the package each may execute."""
OF_POSES = ("scipy.spatial", "lite6jax.sensors.points", "lite6jax.domains.pose.inverse")
"""What studies of poses compute with: turns, what a sensor sees, and joints that reach a pose."""


@pytest.mark.parametrize(("command", "most"), COMMANDS, ids=lambda value: str(value).split(" ")[0])
def test_a_command_that_does_not_diagnose_imports_no_engine(tmp_path, command, most):
    for seed, name in enumerate(("arm.yaml", "other.yaml")):
        write_factory(draw_calibration(load_bundled("lite6"), seed), tmp_path / name)
    code = """
import contextlib, io, os, sys
from lite6jax.cli import program
os.chdir(sys.argv[1])
with contextlib.redirect_stdout(io.StringIO()):
    code = program.main(sys.argv[2:])
print(code)
executed = (name for name, module in sys.modules.items() if type(module).__name__ != "_LazyModule")
print(*executed, sep="\\n")
"""
    code, *executed = in_a_new_process(code, str(tmp_path), *command.split())
    assert code == "0"
    needed = OF_POSES if command.startswith(("identify", "sensitivity", "design")) else ()
    found = [name for name in executed if name.startswith(ENGINE) and name not in LIGHT]
    assert [name for name in found if not name.startswith(needed)] == []
    # a module more is a reason to look at what it imports
    assert sum(name.startswith("lite6jax") for name in executed) <= most
