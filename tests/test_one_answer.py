"""Which is wrong: frame, tool, poses, columns or the arm? `init`, `check`, `fit` and `diagnose` give one answer."""

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from typed import flat, refused, run

from lite6jax.arms.description import load_bundled
from tests.oracles.arms import lite6_positions, perturbed
from tests.oracles.chains import six_parameter_poses
from tests.oracles.transforms import perturb_poses

LITE6 = load_bundled("lite6").kinematics
RIGHT = {"pose_frame": "base", "tool": "none", "position_noise_m": 2e-5, "orientation_noise_rad": 1e-4}


@pytest.fixture(scope="module")
def measured():
    rng = np.random.default_rng(14)
    q = lite6_positions(rng, 70)
    return q, perturb_poses(rng, six_parameter_poses(perturbed(rng, LITE6), q), 2e-5, 1e-4)


def table(path, q, poses, settings=RIGHT):
    """A table by the recording's own names, and its sidecar."""
    quaternion = np.roll(Rotation.from_matrix(poses[:, :3, :3]).as_quat(), 1, 1)
    names = [*(f"q{k + 1}_rad" for k in range(6)), "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"]
    rows = np.hstack([q, poses[:, :3, 3], quaternion])
    path.write_text("\n".join([",".join(names), *(",".join(f"{x:.9f}" for x in row) for row in rows)]) + "\n")
    path.with_suffix(".yaml").write_text(
        yaml.safe_dump({"recording": {"arm": "lite6", "motion": "static", **settings}})
    )
    return path


def inverted(q, poses):
    return q, np.linalg.inv(poses)


def left_handed(q, poses):
    M = np.diag([1.0, -1.0, 1.0, 1.0])
    return q, M @ poses @ M


def in_base_link(q, poses):
    turned = np.diag([-1.0, -1.0, 1.0, 1.0])
    return q, turned @ poses


def with_a_tool(q, poses):
    tool = np.eye(4)
    tool[:3, 3] = 0.0, 0.02, 0.15
    return q, poses @ tool


def with_three_signs(q, poses):
    return q * [-1, 1, -1, 1, -1, 1], poses


def against_the_horizontal(q, poses):
    return np.column_stack([q[:, :2], q[:, 2] - q[:, 1], q[:, 3:]]), poses


KINDS = [
    (inverted, {"pose_frame": "unknown", "tool": "unknown"}, "The poses are inverted"),
    (left_handed, {"pose_frame": "unknown", "tool": "unknown"}, "The axes of the sensor are left-handed"),
    (in_base_link, {}, "deg about z in it, as base_link and base of Universal Robots are to each other"),
    (with_a_tool, {}, "The tool is not the one that is declared"),
    (with_three_signs, {}, "Joint 5 has its sign reversed"),
    (against_the_horizontal, {}, "Joint 3 is coupled to joint 2 in its column: q3 = column + q2"),
]


@pytest.mark.parametrize(("change", "declared", "said"), KINDS, ids=[kind[0].__name__ for kind in KINDS])
def test_check_names_what_is_wrong(capsys, tmp_path, measured, change, declared, said):
    code, out, _ = run(capsys, "check", table(tmp_path / "run.csv", *change(*measured), RIGHT | declared), width=300)
    assert code == 0
    assert said in flat(out)
    assert "Nothing is missing" not in flat(out)


def test_the_commands_agree(capsys, tmp_path, measured):
    said = "Joint 3 is coupled to joint 2 in its column: q3 = column + q2"
    path = table(tmp_path / "run.csv", *against_the_horizontal(*measured))
    for command in (("fit", path), ("diagnose", path, "--quick", "--out", tmp_path / "d.json")):
        code, out, _ = run(capsys, *command, width=300)
        assert code == 0
        assert said in flat(out), command[0]
    given = [f"--set={key}={value}" for key, value in RIGHT.items()]
    code, out, _ = run(capsys, "init", path, "--arm", "lite6", "--yes", "--force", *given, width=300)
    assert code == 0
    assert said in flat(out)
    assert "its nominal kinematics miss the poses by" in flat(out)


def test_another_arm_is_named(capsys, tmp_path):
    rng = np.random.default_rng(6)
    ur5e = load_bundled("ur5e")
    q = lite6_positions(rng, 60)
    poses = perturb_poses(
        rng, six_parameter_poses(perturbed(rng, ur5e.kinematics), q) @ ur5e.T_joint_flange, 2e-5, 1e-4
    )
    path = table(tmp_path / "run.csv", q, poses, RIGHT | {"arm": "ur10e"})
    code, out, _ = run(capsys, "check", path, width=300)
    assert code == 0
    assert "The poses are not those of a ur10e" in flat(out)
    assert "calibration error" not in flat(out)
    for command in ("fit", "diagnose"):
        assert "but of a ur5e" in refused(capsys, command, path)


def test_what_is_not_decided_is_not_applied(capsys, tmp_path, measured):
    """Joints 4 and 6 turn about one axis while joint 5 rests at zero, against each other: one of two signs is wrong."""
    q, _ = measured
    q = q.copy()
    q[:, 4], q[:, 3] = 0.0, 0.5 * q[:, 3]
    q[:, 5] = -q[:, 3]
    if np.ptp(six_parameter_poses(LITE6, q * [0, 0, 0, 1, 1, 1])[:, 0, 0]) > 1e-6:
        q[:, 5] = q[:, 3]  # the two axes point against each other
    poses = perturb_poses(np.random.default_rng(5), six_parameter_poses(LITE6, q), 2e-5, 1e-4)
    path = table(tmp_path / "run.csv", q * [1, 1, 1, 1, 1, -1], poses)
    before = path.read_bytes(), path.with_suffix(".yaml").read_bytes()
    code, out, _ = run(capsys, "check", path, width=300)
    assert code == 0
    assert "Nothing was corrected. Find out which it is" in flat(out)
    for command in ("fit", "diagnose"):
        assert "for one of several reasons that fit alike; see them with `lite6jax check`" in refused(
            capsys, command, path
        )
    assert (path.read_bytes(), path.with_suffix(".yaml").read_bytes()) == before
