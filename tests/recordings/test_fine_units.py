"""Whole numbers of thousandths, as the kits of several arms give them: kinematics decide the unit, or it is asked."""

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from typed import flat, refused, run

from lite6jax.arms.description import load_bundled
from lite6jax.recordings import read_recording
from tests.oracles.arms import lite6_positions
from tests.oracles.chains import six_parameter_poses

LITE6 = load_bundled("lite6").kinematics
Q = lite6_positions(np.random.default_rng(3), 40)
POSES = six_parameter_poses(LITE6, Q)
ANGLES = Rotation.from_matrix(POSES[:, :3, :3]).as_euler("xyz", degrees=True)


def written(path, angle, length=None):
    """A table of whole numbers: joints, and poses where their length is given, so many in a degree and in a metre."""
    columns = {f"joint_{k + 1}": angle * np.rad2deg(Q[:, k]) for k in range(6)}
    if length is not None:
        columns |= {f"{axis}_axis": length * POSES[:, k, 3] for k, axis in enumerate("XYZ")}
        columns |= {f"R{axis}_axis": angle * ANGLES[:, k] for k, axis in enumerate("XYZ")}
    numbers = np.round(np.stack([*columns.values()], 1))
    np.savetxt(path, numbers, "%d", ",", header=",".join(columns), comments="")


@pytest.mark.parametrize(
    ("angle", "length", "units"),
    [
        (1e3, 1e6, ("mdeg", "um")),
        (1e2, 1e4, ("cdeg", "dmm")),
        (1e4, 1e6, ("1e-4deg", "um")),
        (1e3, 1e3, ("mdeg", "mm")),
    ],
)
def test_kinematics_decide_the_unit_of_whole_numbers(tmp_path, capsys, angle, length, units):
    path = tmp_path / "log.csv"
    written(path, angle, length)
    code, out, _ = run(capsys, "init", path, "--arm", "lite6", "--yes", width=200)
    assert code == 0
    columns = yaml.safe_load(path.with_suffix(".yaml").read_text())["columns"]
    assert (columns["joint_6"], columns["X_axis"]) == (f"q6_{units[0]}", f"x_{units[1]}")
    assert "in degrees" not in out
    recording = read_recording(path)
    np.testing.assert_allclose(recording.joint_position, Q, atol=np.deg2rad(0.6 / angle))
    np.testing.assert_allclose(recording.position, POSES[:, :3, 3], atol=0.6 / length)
    turned = Rotation.from_quat(recording.quaternion, scalar_first=True).as_matrix()
    np.testing.assert_allclose(turned, POSES[:, :3, :3], atol=4 * np.deg2rad(1 / angle))


def test_without_poses_the_unit_of_whole_numbers_is_asked_for(tmp_path, capsys):
    path = tmp_path / "log.csv"
    written(path, 1e3)
    said = refused(capsys, "init", path, "--yes")
    assert "are whole numbers beyond any turns in degrees" in said
    assert "--column joint_1=q1_mdeg" in said
    code, out, _ = run(capsys, "init", path, "--yes", "--arm", "lite6", width=200)
    assert code == 0
    assert "in 0.001° (assumed: whole numbers up to" in flat(out)
    ways = [part for part in said.split() if part.startswith("joint_") and "=" in part]
    options = [option for way in ways for option in ("--column", way)]
    assert run(capsys, "init", path, "--yes", "--force", *options)[0] == 0
    np.testing.assert_allclose(read_recording(path).joint_position, Q, atol=1e-5)


def test_a_table_without_names_is_read_in_thousandths(tmp_path, capsys):
    path = tmp_path / "log.csv"
    np.savetxt(path, np.round(np.column_stack([np.rad2deg(1e3 * Q), 1e6 * POSES[:, :3, 3]])), "%d", ",")
    names = [f"q{k}_mdeg" for k in range(1, 7)] + ["x_um", "y_um", "z_um"]
    assert run(capsys, "init", path, "--arm", "lite6", "--yes", "--names", ",".join(names))[0] == 0
    np.testing.assert_allclose(read_recording(path).position, POSES[:, :3, 3], atol=1e-6)


def test_a_unit_that_is_declared_wrongly_is_answered_by_a_command(tmp_path, capsys):
    path = tmp_path / "log.csv"
    written(path, 1e3, 1e6)
    assert run(capsys, "init", path, "--arm", "lite6", "--yes")[0] == 0
    sidecar = path.with_suffix(".yaml")
    sidecar.write_text(sidecar.read_text().replace("_mdeg", "_deg"))
    assert "lite6jax init FILE --arm NAME --force" in refused(capsys, "fit", path)
