"""Faults of the data: found, located, corrected; and none where there is only physics."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis.recorded import LITE6, Made, moving_motion, plain_effect, static_motion, with_effects
from scipy.spatial.transform import Rotation

from lite6jax.arms.description import load_bundled
from lite6jax.arms.factory import write_factory
from lite6jax.domains.pose.problem import pose_problem
from lite6jax.domains.pose.rigid_arm import rigid_arm
from lite6jax.domains.pose.screening.projection import Projected, estimated, physics_columns
from lite6jax.domains.pose.screening.screen import SCREENS, screen
from lite6jax.domains.pose.screening.screened import Corrections
from lite6jax.domains.pose.screening.thresholds import MOST_FITTED
from lite6jax.estimation.least_squares import fit
from lite6jax.estimation.options import DEFAULTS
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import Recording, RecordingSettings, read_recording
from tests.oracles.arms import perturbed
from tests.oracles.chains import six_parameter_poses
from tests.oracles.effects import predicted_poses
from tests.oracles.transforms import perturb_poses

SHARED = Path(__file__).resolve().parents[3] / "../shared"
PHYSICS = {
    "nothing": (),
    "compliance": ("joint_compliance:joint=2,compliance_rad_per_Nm=9e-5",),
    "harmonic": ("joint_harmonic:joint=1,order=2,amplitude_rad=6e-4,phase_rad=0.7",),
    "gear": ("joint_harmonic:joint=3,order=101,amplitude_rad=3e-4,phase_rad=0.2",),
    "backlash": ("joint_backlash:joint=4,gap_rad=3e-4",),
    "drift": ("base_drift:vx_m_per_s=2e-7,vy_m_per_s=1e-7,vz_m_per_s=-1e-7",),
    "tool": ("tool_offset:x_m=0.001,y_m=0,z_m=0.004",),
    "thermal": ("link_thermal_expansion:expansion_per_K=2.3e-5",),
    "base": ("base_compliance:compliance_x_rad_per_Nm=3e-5,compliance_y_rad_per_Nm=1e-5",),
    "clock": ("time_offset:offset_s=0.012",),
}
ASKED = [
    *((name, "exact") for name in PHYSICS),
    *((name, "free") for name in ("nothing", "compliance", "thermal", "clock")),
]
SETUPS = {"exact": {}, "free": {"geometry": "free", "frame": True, "tool": True}}
TURN = Rotation.from_rotvec([1e-3, 5e-4, -1e-3])
SHIFT = np.array([1e-3, -0.5e-3, 0.3e-3])


def reversed_joints(*joints):
    """Any set of reversed joints is one hypothesis."""
    at = np.array(joints) - 1
    return lambda q: q.__setitem__((slice(None), at), -q[:, at]), [("mirrored_joint", {"joint": j}) for j in joints]


def coupled(sign):
    """A pendant shows joint 3 against the horizontal: q3 = column ± q2."""
    found = {"joint": 3, "added_joint": 2, "factor": sign}
    return lambda q: q.__setitem__((slice(None), 2), q[:, 2] - sign * q[:, 1]), [("coupled_joint", found)]


CHANGES = {
    "swapped": (lambda q: q.__setitem__((slice(None), [1, 2]), q[:, [2, 1]]), [("swapped_joints", {"joints": [2, 3]})]),
    "mirrored": reversed_joints(4),
    "three mirrored": reversed_joints(1, 2, 4),
    "four mirrored": reversed_joints(2, 3, 4, 5),
    "others mirrored": reversed_joints(1, 3, 4, 6),
    "added": coupled(1.0),
    "subtracted": coupled(-1.0),
    "degrees": (
        lambda q: q.__setitem__((slice(None), 2), np.rad2deg(q[:, 2])),
        [("joint_unit", {"joint": 3, "unit": "deg"})],
    ),
    "quarter": (
        lambda q: q.__setitem__((slice(None), 1), q[:, 1] + np.pi / 2),
        [("joint_turns", {"joint": 2, "added_rad": -np.pi / 2})],
    ),
    # the axis of a joint drawn the other way round, and its zero elsewhere
    "zero and sign": (
        lambda q: q.__setitem__((slice(None), 1), np.pi / 2 - q[:, 1]),
        [("mirrored_joint", {"joint": 2}), ("joint_turns", {"joint": 2})],
    ),
}
"""A change of columns, and the faults with their numbers."""
FREE = ("mirrored", "three mirrored", "added", "degrees", "zero and sign")
KNOWN = ("swapped", "mirrored", "four mirrored", "others mirrored", "subtracted", "degrees", "quarter")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("arm")


@pytest.fixture(scope="module")
def still():
    return static_motion(21, 160)


@pytest.fixture(scope="module")
def moving():
    return moving_motion(22, 300)


@pytest.fixture(scope="module")
def good(folder, still):
    """A good static recording of a known arm."""
    return Made(folder, seed=2).recording(still)


@pytest.fixture(scope="module")
def seven():
    """A good recording of an arm of seven joints in an unknown frame, whose geometry is not known."""
    arm = load_bundled("xarm7")
    rng = np.random.default_rng(5)
    low, high = np.maximum(arm.joint_limits[:, 0], -np.pi), np.minimum(arm.joint_limits[:, 1], np.pi)
    q = rng.uniform(low, high, (150, 7))
    poses = six_parameter_poses(perturbed(rng, arm.kinematics), q) @ arm.T_joint_flange
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = Rotation.from_rotvec([0.1, -0.05, 1.0]).as_matrix(), (1.5, -0.7, 0.2)
    poses = perturb_poses(rng, frame @ poses, 2e-5, 1e-4)
    return Recording.from_arrays(
        q,
        position=poses[:, :3, 3],
        quaternion=np.roll(Rotation.from_matrix(poses[:, :3, :3]).as_quat(), 1, 1),
        time=8.0 * np.arange(len(q)),
        settings=RecordingSettings(
            arm="xarm7", motion="static", tool="none", position_noise_m=2e-5, orientation_noise_rad=1e-4
        ),
    )


def names(screened):
    return [fault.code for fault in screened.found]


def only(screened, name):
    """The one fault, which must have this name."""
    assert names(screened) == [name]
    return screened.found[0]


def ruled_out(screened, name):
    """The numbers that rule a fault out."""
    return next(fault.numbers for fault in screened.ruled_out if fault.code == name)


def joints_changed(recording, change):
    q = recording.joint_position.copy()
    change(q)
    return replace(recording, joint_position=q)


def bumped(recording, k):
    """Poses from sample k on, as after a knock at the sensor."""
    position, quaternion = recording.position.copy(), recording.quaternion
    position[k:] = TURN.apply(position[k:]) + SHIFT
    if quaternion is not None:
        quaternion = quaternion.copy()
        quaternion[k:] = np.roll((TURN * Rotation.from_quat(np.roll(quaternion[k:], -1, 1))).as_quat(), 1, 1)
    return replace(recording, position=position, quaternion=quaternion)


def moves_of(q):
    return np.diff(q, axis=0, prepend=0.0)


def read_early(made, motion, rest):
    """A recording whose poses are those of the joints and `rest` (sample, joint) beyond."""
    ahead = {**motion, "joint_position": motion["joint_position"] + rest}
    return made.recording(motion, poses=made.poses(ahead))


class TestGoodRecordings:
    @pytest.mark.parametrize(("physics", "setup"), ASKED)
    def test_physics_is_no_fault(self, folder, still, moving, physics, setup):
        made = Made(folder, PHYSICS[physics], seed=3, orientation=setup == "exact", **SETUPS[setup])
        for motion in (still, moving) if physics != "clock" else (moving,):
            recording = made.recording(motion)
            screened = screen(recording)
            assert screened.found == ()
            np.testing.assert_array_equal(screened.recording.position, recording.position)
            assert {"time_order", "swapped_joints", "frame_jump", "unsettled_readouts"} <= {
                fault.code for fault in screened.ruled_out
            }

    def test_few_rows(self, folder):
        screened = screen(Made(folder, seed=2, orientation=False).recording(static_motion(21, 40)))
        assert screened.found == ()
        assert ruled_out(screened, "frame_jump") == {"reason": "too_few_rows", "samples": 40}
        assert ruled_out(screened, "unsettled_readouts") == {"reason": "too_few_rows", "samples": 40}

    @pytest.mark.skipif(not (SHARED / "real/ur10").exists(), reason="the real recordings are not here")
    def test_a_real_arm(self):
        assert screen(read_recording(SHARED / "real/ur10/ur10_series_b.csv")).found == ()

    @pytest.mark.parametrize("setup", SETUPS)
    def test_the_fit_is_that_of_the_case(self, folder, still, setup):
        recording = Made(folder, PHYSICS["compliance"], seed=6, **SETUPS[setup]).recording(still)
        fitted = rigid_arm(recording).fitted(MOST_FITTED)
        problem = pose_problem(recording)
        other = fit(problem, Terms(), DEFAULTS)
        assert fitted.scale == pytest.approx(float(other.scale[0]), rel=0.02)
        np.testing.assert_allclose(
            fitted.distance,
            np.linalg.norm(problem.position_errors(other.nuisance, Terms(), np.zeros(0)), axis=0),
            atol=4e-5,
        )

    def test_physics_columns_span_the_catalogue(self, folder, still):
        """What plain effects do to plain poses lies in the span of the columns."""
        made = Made(folder, seed=7, orientation=False)
        arm = rigid_arm(made.recording(still, noise=None))
        projected = Projected(arm, physics_columns(arm))
        for name in ("compliance", "harmonic", "backlash", "drift", "tool", "thermal", "base"):
            bent = with_effects(made, *PHYSICS[name]).recording(still, noise=None)
            there = rigid_arm(bent).residuals[None]
            left = np.linalg.norm(projected.without(there)) / np.linalg.norm(there * projected.weight)
            assert left < 0.02, (name, left)


class TestRows:
    def test_out_of_order(self, good):
        order = np.arange(good.samples)
        order[[10, 11, 12]] = 12, 10, 11
        screened = screen(good.select(order))
        fault = only(screened, "time_order")
        assert fault.rows == (11, 12)
        assert fault.numbers == {"largest_step_back_s": pytest.approx(16)}
        np.testing.assert_array_equal(screened.recording.time, good.time)
        np.testing.assert_array_equal(screened.recording.direction_of_motion, good.direction_of_motion)

    def test_repeated(self, good):
        rows = np.insert(np.arange(good.samples), [5, 80], [4, 20])
        twice = good.select(rows)
        twice = replace(twice, row=np.arange(1, len(rows) + 1), time=8.0 * np.arange(len(rows)))
        screened = screen(twice)
        fault = only(screened, "repeated_rows")
        assert fault.rows == (6, 82)
        assert fault.numbers == {"first_rows": [5, 22]}
        np.testing.assert_array_equal(screened.recording.position, good.position)

    def test_a_pose_visited_again_is_no_repeat(self, folder, still):
        q = still["joint_position"].copy()
        q[100:110] = q[:10]
        screened = screen(Made(folder, seed=2).recording({**still, "joint_position": q}))
        assert screened.found == ()

    @pytest.mark.parametrize("factor", [1000.0, 1e-3])
    def test_millimetres(self, folder, still, factor):
        recording = Made(folder, seed=8, **SETUPS["free"]).recording(still)
        position = recording.position.copy()
        position[[3, 60, 61]] *= factor
        screened = screen(replace(recording, position=position))
        assert only(screened, "position_unit").rows == (4, 61, 62)
        np.testing.assert_allclose(screened.recording.position, recording.position)


class TestColumns:
    @pytest.mark.parametrize(
        ("change", "setup"), [*((change, "exact") for change in KNOWN), *((change, "free") for change in FREE)]
    )
    def test_a_wrong_column(self, folder, still, change, setup):
        recording = Made(folder, PHYSICS["compliance"], seed=9, **SETUPS[setup]).recording(still)
        edit, faults = CHANGES[change]
        screened = screen(joints_changed(recording, edit))
        for fault, (name, numbers) in zip(screened.found, faults, strict=True):
            assert fault.code == name
            assert numbers.items() <= fault.numbers.items()
        off = 0.0 if {name for name, _ in faults} == {"mirrored_joint"} else 1e-12
        np.testing.assert_allclose(screened.recording.joint_position, recording.joint_position, rtol=0, atol=off)

    def test_in_motion(self, folder, moving):
        """Positions only, one bundled table, nothing known of the frames; velocities go with the joints."""
        recording = Made(folder, seed=9, orientation=False, **SETUPS["free"]).recording(moving)
        order = [0, 2, 1, 3, 4, 5]
        swapped = replace(
            recording,
            joint_position=recording.joint_position[:, order],
            joint_velocity=recording.joint_velocity[:, order],
            direction_of_motion=recording.direction_of_motion[:, order],
        )
        screened = screen(swapped)
        only(screened, "swapped_joints")
        for name in ("joint_position", "joint_velocity", "direction_of_motion"):
            np.testing.assert_array_equal(getattr(screened.recording, name), getattr(recording, name))

    def test_indistinguishable_corrections_are_named(self, folder, still):
        """A frame upside down and joint 2 half a turn away make of joint 1 its mirror image."""
        recording = Made(folder, seed=9, geometry="free", frame=True).recording(still)
        screened = screen(joints_changed(recording, lambda q: q.__setitem__((slice(None), 0), -q[:, 0])))
        fault = only(screened, "mirrored_joint")
        (other,) = fault.numbers["alternatives"]
        assert [(part["fault"], part["joint"], abs(part["added_rad"])) for part in other] == [("joint_turns", 2, np.pi)]

    @pytest.mark.parametrize(
        ("edit", "convention"),
        [
            (lambda q: q * [1, -1, -1, -1], "inverted"),
            (lambda q: np.roll(q, -1, 1), "scalar_last"),
        ],
    )
    def test_orientations(self, seven, edit, convention):
        screened = screen(replace(seven, quaternion=edit(seven.quaternion)))
        assert only(screened, "orientation_convention").numbers["convention"] == convention
        np.testing.assert_allclose(screened.recording.quaternion, seven.quaternion, atol=1e-12)

    def test_what_nothing_explains_is_not_read_otherwise(self, good):
        rng = np.random.default_rng(0)
        screened = screen(replace(good, joint_position=rng.permutation(good.joint_position)))
        numbers = only(screened, "unexplained").numbers
        assert min(numbers["best_alternative_m"], numbers["fitted_error_m"]) > 0.05 * LITE6.reach
        np.testing.assert_array_equal(screened.recording.position, good.position)

    def test_zeros_of_any_angle(self, folder, still):
        """Several zeros at once are estimated, but for those that a free frame and tool take up."""
        recording = Made(folder, seed=9, **SETUPS["free"]).recording(still)
        off = np.deg2rad([0, 12.0, -25.0, 0, 70.0, 0])
        screened = screen(replace(recording, joint_position=recording.joint_position - off))
        assert {fault.code for fault in screened.found} == {"joint_turns"}
        found = {fault.numbers["joint"]: fault.numbers["added_rad"] for fault in screened.found}
        assert found.keys() == {2, 3, 5}
        np.testing.assert_allclose([found[2], found[3], found[5]], off[[1, 2, 4]], atol=0.03)

    def test_inverted_poses(self, seven):
        """A camera on the flange that sees a board."""
        R = Rotation.from_quat(np.roll(seven.quaternion, -1, 1))
        inverse = replace(seven, position=-R.inv().apply(seven.position), quaternion=seven.quaternion * [1, -1, -1, -1])
        screened = screen(inverse)
        only(screened, "inverted_poses")
        np.testing.assert_allclose(screened.recording.position, seven.position, atol=1e-12)

    @pytest.mark.parametrize("orientation", [True, False])
    def test_a_left_handed_sensor(self, folder, still, orientation):
        recording = Made(folder, seed=9, orientation=orientation, **SETUPS["free"]).recording(still)
        quaternion = recording.quaternion
        if quaternion is not None:  # a reflection in x: rotations about y and z are the other way round
            quaternion = quaternion * [1, 1, -1, -1]
            quaternion *= np.sign(quaternion[:, :1])
        screened = screen(replace(recording, position=recording.position * [-1, 1, 1], quaternion=quaternion))
        only(screened, "mirrored_sensor")

    def test_exchanged_axes_of_a_declared_frame(self, folder, still):
        recording = Made(folder, seed=9, orientation=False).recording(still)
        screened = screen(replace(recording, position=recording.position[:, [1, 0, 2]]))
        assert only(screened, "mirrored_sensor").numbers["axes"] == "xy"
        np.testing.assert_array_equal(screened.recording.position, recording.position)

    def test_a_frame_that_is_not_the_declared_one(self, good):
        """base_link of Universal Robots is their base turned by half a turn about z."""
        turned = replace(good, position=good.position * [-1, -1, 1], quaternion=None)
        screened = screen(turned)
        numbers = only(screened, "declared_frame").numbers
        np.testing.assert_allclose(np.abs(numbers["rotation_rad"]), [0, 0, np.pi], atol=2e-3)
        assert screened.recording.settings.pose_frame == "unknown"
        assert numbers["alternatives"] == []  # half a turn of joint 1 turns about the axis that this arm really has

    def test_a_tool_that_is_not_the_declared_one(self, good):
        R = Rotation.from_quat(np.roll(good.quaternion, -1, 1))
        tool = [0.0, 0.03, 0.12]
        screened = screen(replace(good, position=good.position + R.apply(tool)))
        np.testing.assert_allclose(only(screened, "declared_tool").numbers["translation_m"], tool, atol=2e-4)
        assert screened.recording.settings.tool == "unknown"

    def test_one_point_says_nothing_of_scale_or_signs(self, good):
        touched = replace(good, position=np.zeros_like(good.position), quaternion=None)
        screened = screen(touched)
        assert screened.found == ()
        assert ruled_out(screened, "mirrored_joint")["one_point"]

    def test_poses_that_a_controller_computed(self, still):
        """The nominal table reproduces them to the rounding of their columns; those of a tracker it does not."""
        q = np.round(still["joint_position"], 6)
        poses = np.round(six_parameter_poses(LITE6.kinematics, q)[:, :3, 3], 6)
        settings = {"arm": "lite6", "pose_frame": "base", "tool": "none", "motion": "static"}
        computed = Recording.from_arrays(q, poses, pose_source="laser_tracker", **settings)
        assert "computed_pose" in names(screen(computed))
        declared = Recording.from_arrays(q, poses, pose_source="controller_fk", **settings)
        assert ruled_out(screen(declared), "computed_pose") == {"reason": "declared"}
        measured = poses + np.random.default_rng(0).normal(0, 1e-5, poses.shape)
        assert "computed_pose" not in names(screen(Recording.from_arrays(q, measured, **settings)))

    def test_turns_are_removed_only_where_the_motion_is_continuous(self, moving):
        """Poses far apart jump by half a turn and more, with and without times."""
        rng = np.random.default_rng(3)
        q = rng.uniform(-3.0, 3.0, moving["joint_position"].shape) * [1, 0.7, 0.4, 1, 0.6, 1] + [0, 0, 1.5, 0, 0, 0]
        poses = six_parameter_poses(LITE6.kinematics, q)[:, :3, 3] + rng.normal(0, 2e-5, (len(q), 3))
        for time in (moving["time"], None):
            jumping = Recording.from_arrays(q, poses, time=time, arm="lite6", motion="trajectory", tool="none")
            assert "joint_turns" not in names(screen(jumping))

    def test_whole_turns(self, good, folder, moving):
        some = joints_changed(good, lambda q: q.__setitem__(([4, 9], 1), q[[4, 9], 1] + 2 * np.pi))
        screened = screen(some)
        assert only(screened, "joint_turns").rows == (5, 10)
        np.testing.assert_allclose(screened.recording.joint_position, good.joint_position, atol=1e-12)
        made = Made(folder, seed=2)
        wide = {**moving, "joint_position": moving["joint_position"] + [3.0, 0, 0, 0, 0, 0]}
        smooth = made.recording(wide)
        wrapped = joints_changed(
            smooth, lambda q: q.__setitem__((slice(None), 0), (q[:, 0] + np.pi) % (2 * np.pi) - np.pi)
        )
        screened = screen(wrapped)
        only(screened, "joint_turns")
        turns = (screened.recording.joint_position - smooth.joint_position) / (2 * np.pi)
        np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
        assert np.abs(np.diff(screened.recording.joint_position[:150], axis=0)).max() < 0.2


class TestNominalTable:
    @pytest.mark.parametrize(("declared", "true"), [("lite6", "lite6_ros"), ("lite6_ros", "lite6")])
    def test_a_published_table_given_as_the_arms_own(self, folder, still, declared, true):
        arms = {name: load_bundled(name) for name in (declared, true)}
        path = folder / f"as_{declared}.yaml"
        write_factory(arms[declared].kinematics, path, overwrite=True)
        made = Made(folder, (*PHYSICS["compliance"], *PHYSICS["tool"]), seed=5)
        effects = [plain_effect(text) for text in made.effects]
        poses = predicted_poses(arms[true].kinematics, np.eye(4), np.eye(4), still, made.inertia(), effects)
        recording = made.recording(still, poses=poses)
        recording = replace(recording, settings=replace(recording.settings, factory_calibration=str(path)))
        screened = screen(recording)
        numbers = only(screened, "nominal_table").numbers
        assert (numbers["declared"], numbers["table"], numbers["used"]) == (declared, true, "instead_of_file")
        assert abs(numbers["share"] - 1) < 0.1 + 4 * numbers["share_std"]
        assert screened.arm.name == screened.recording.settings.arm == true
        assert screened.recording.settings.factory_calibration is None
        asked = screen(recording, geometry="exact")
        assert only(asked, "nominal_table").numbers["used"] == "none"
        assert asked.recording.settings.factory_calibration == str(path)
        right = made.recording(still, poses=poses)
        other = folder / f"is_{true}.yaml"
        write_factory(arms[true].kinematics, other, overwrite=True)
        right = replace(right, settings=replace(right.settings, factory_calibration=str(other)))
        assert screen(right).found == ()

    def test_where_the_chain_is_fitted(self, folder, still):
        made = Made(folder, seed=5, geometry="free", frame=True)
        chain = load_bundled("lite6_ros").kinematics
        poses = made.T_sensor_base @ six_parameter_poses(chain, still["joint_position"])
        screened = screen(made.recording(still, poses=poses))
        only(screened, "nominal_table")
        assert screened.arm.name == "lite6_ros"
        own = screen(made.recording(still))
        assert own.found == ()
        numbers = ruled_out(own, "nominal_table")
        assert (numbers["reason"], numbers["fitted"]) == ("declared_fits", True)

    def test_where_the_frame_is_known(self, folder, still):
        """A fitted chain moves the base too; the other table is compared from where the base is said to be."""
        made = Made(folder, seed=5, geometry="free")
        poses = six_parameter_poses(load_bundled("lite6_ros").kinematics, still["joint_position"])
        only(screen(made.recording(still, poses=poses)), "nominal_table")

    def test_where_there_is_no_other(self, seven, good):
        assert ruled_out(screen(seven), "nominal_table") == {"reason": "single_table", "declared": "xarm7"}
        assert ruled_out(screen(good), "nominal_table") == {"reason": "own_chain", "declared": "lite6"}


class TestCommandedJoints:
    @pytest.mark.parametrize("grid", [np.deg2rad(0.01), np.deg2rad(0.5), 1e-4, 1e-3])
    def test_round_numbers(self, folder, still, grid):
        q = np.round(still["joint_position"] / grid) * grid
        made = Made(folder, seed=2)
        recording = made.recording({**still, "joint_position": q})
        screened = screen(replace(recording, joint_position=np.round(q, 6)))
        only(screened, "commanded_joints")
        declared = replace(recording, settings=replace(recording.settings, joint_source="commanded"))
        screened = screen(declared)
        assert screened.found == ()
        assert ruled_out(screened, "commanded_joints") == {"reason": "declared"}


class TestUnsettledReadouts:
    @pytest.mark.parametrize(
        ("share", "physics", "setup"),
        [(1e-4, "backlash", "free"), (1e-2, "backlash", "exact")],
    )
    def test_a_share_of_each_move(self, folder, still, physics, share, setup):
        made = Made(folder, PHYSICS[physics], seed=11, **SETUPS[setup])
        rest = share * moves_of(still["joint_position"])
        screened = screen(read_early(made, still, rest))
        fault = only(screened, "unsettled_readouts")
        assert (fault.numbers["shape"], fault.numbers["all_joints"]) == ("move", True)
        assert fault.numbers["rest"] == pytest.approx(share, rel=0.1, abs=4 * fault.numbers["rest_std"])
        off = screened.recording.joint_position - still["joint_position"] - rest
        assert np.abs(off).max() < 2e-5 + 3e-3 * share
        # what backlash does is still there
        left = rigid_arm(screened.recording).fitted(MOST_FITTED)
        sizes, stds = estimated(
            left, physics_columns(left, skip=("direction",)), left.joints * still["direction"].T[:, None]
        )
        truth = np.array([0, 0, 0, -1.5e-4 if physics == "backlash" else 0, 0, 0])
        seen = stds < 5e-5
        assert seen[3]
        assert np.all(np.abs(sizes - truth)[seen] < 4.5 * stds[seen])

    def test_one_joint(self, folder, still):
        rest = moves_of(still["joint_position"]) * [0, 0, 2e-4, 0, 0, 0]
        screened = screen(read_early(Made(folder, seed=12), still, rest))
        assert only(screened, "unsettled_readouts").numbers["joints"] == [3]
        np.testing.assert_allclose(screened.recording.joint_position, still["joint_position"] + rest, rtol=0, atol=4e-5)

    def test_the_same_angle(self, folder, still):
        rest = 2e-4 * np.sign(moves_of(still["joint_position"]))
        screened = screen(read_early(Made(folder, seed=12), still, rest))
        numbers = only(screened, "unsettled_readouts").numbers
        assert (numbers["shape"], numbers["all_joints"]) == ("constant", True)
        np.testing.assert_allclose(screened.recording.joint_position, still["joint_position"] + rest, rtol=0, atol=2e-5)

    def test_by_the_recorded_velocity(self, folder, still):
        speed = np.random.default_rng(3).uniform(-0.02, 0.02, still["joint_position"].shape)
        recording = read_early(Made(folder, seed=12), still, 0.01 * speed)
        screened = screen(replace(recording, joint_velocity=speed))
        assert only(screened, "unsettled_readouts").numbers["shape"] == "velocity"
        np.testing.assert_allclose(
            screened.recording.joint_position, still["joint_position"] + 0.01 * speed, rtol=0, atol=1e-5
        )

    def test_poses_in_an_orderly_sequence(self, folder):
        """A wrist that sweeps in steps comes from below where a sweep begins only: its direction tells its position."""
        motion = static_motion(4, 160)
        q = motion["joint_position"]
        q[:, 4] = np.tile(np.linspace(1.5, -1.5, 10), 16)
        q[:, :4] = np.repeat(q[::10, :4], 10, 0)
        motion["direction"] = np.sign(moves_of(q))
        made = Made(folder, seed=12)
        recording = made.recording(motion, bump=(5, lambda q: 3e-3 * np.exp(-(((q - 1.5) / 0.2) ** 2))))
        assert screen(recording).found == ()

    def test_what_the_next_move_tells_as_well(self, folder):
        """The order of the poses says where they are, beyond any one joint: nothing can be said, and that is said."""
        motion = static_motion(4, 160)
        q = motion["joint_position"]
        made = Made(folder, seed=12)
        rest = 1e-3 * (moves_of(q) - moves_of(q[::-1])[::-1] * 0.9)
        screened = screen(read_early(made, motion, rest))
        assert screened.found == ()
        assert ruled_out(screened, "unsettled_readouts")["reason"] == "ordered_poses"


class TestFrameJump:
    @pytest.mark.parametrize("orientation", [True, False])
    @pytest.mark.parametrize("setup", SETUPS)
    def test_at_rest(self, folder, still, setup, orientation):
        made = Made(folder, PHYSICS["compliance"], seed=13, orientation=orientation, **SETUPS[setup])
        recording = made.recording(still)
        screened = screen(bumped(recording, 61))
        fault = only(screened, "frame_jump")
        assert fault.rows == tuple(range(62, 161))
        assert (fault.numbers["row"], fault.numbers["part"]) == (62, "base")
        assert np.abs(screened.recording.position - recording.position).max() < 8e-5

    @pytest.mark.parametrize("setup", SETUPS)
    def test_in_motion(self, folder, moving, setup):
        recording = Made(folder, PHYSICS["compliance"], seed=13, **SETUPS[setup]).recording(moving)
        screened = screen(bumped(recording, 101))
        assert only(screened, "frame_jump").rows[0] == 102
        assert np.abs(screened.recording.position - recording.position).max() < 4e-4

    def test_left_as_it_is(self, good):
        recording = bumped(good, 61)
        screened = screen(recording, corrections=Corrections(jumps=0))
        assert screened.found == ()
        np.testing.assert_array_equal(screened.recording.position, recording.position)

    def test_a_knock_of_centimetres(self, folder, still):
        recording = Made(folder, seed=13, **SETUPS["free"]).recording(still)
        far = bumped(recording, 110)
        far.position[110:] += 0.03
        screened = screen(far)
        assert only(screened, "frame_jump").rows[0] == 111
        assert np.abs(screened.recording.position - recording.position).max() < 1e-4

    def test_a_tool_that_slipped(self, folder, still):
        made = Made(folder, seed=13)
        poses = made.poses(still)
        slipped = poses.copy()
        slipped[90:, :3, 3] += poses[90:, :3, :3] @ [2e-4, -1e-4, 3e-4]
        recording = made.recording(still, poses=slipped)
        screened = screen(recording)
        fault = only(screened, "frame_jump")
        assert fault.rows[0] == 91
        assert fault.numbers["part"] == "tool"
        seen = ~np.isin(np.arange(len(poses)), np.arange(100, 130))
        for corrected in (screened.recording, screen(recording.select(seen)).transferred(recording)):
            assert np.abs(corrected.position - made.recording(still).position).max() < 4e-5

    def test_between_runs(self, folder):
        recording = Made(folder, seed=13).recording(moving_motion(22, 400))
        screened = screen(bumped(recording, 200))
        assert {"row": 201, "run": 1}.items() <= only(screened, "frame_jump").numbers.items()

    def test_a_drift_is_no_jump(self, folder, still):
        text = "base_drift:vx_m_per_s=1e-6,vy_m_per_s=-5e-7,vz_m_per_s=3e-7"
        for setup in SETUPS.values():
            assert screen(Made(folder, (text,), seed=13, **setup).recording(still)).found == ()


def test_a_zero_that_a_fitted_chain_takes_up_is_said(tmp_path):
    """A zero 150 mrad off misses grossly with the nominal chain; a fitted one meets the poses as recorded."""
    far = ("joint_offset:joint=3,offset_rad=0.15",)
    made = Made(tmp_path, far, seed=8, geometry="free", frame=True, tool=True, orientation=False)
    screened = screen(made.recording(moving_motion(8, 200)))
    (fault,) = screened.found
    assert (fault.code, fault.numbers["joint"]) == ("joint_turns", 3)
    assert abs(fault.numbers["added_rad"]) == pytest.approx(0.15, abs=0.01)


class TestRegistry:
    def test_each_code_is_screened_for_in_one_order(self):
        order = [code for entry in SCREENS for code in entry.codes]
        assert order.index("time_order") < order.index("swapped_joints") < order.index("frame_jump")
        needs = [entry.needs for entry in SCREENS]
        assert "recording" not in needs[needs.index("arm") :]  # what needs no arm comes first
        assert needs.index("arm") < needs.index("fit")

    def test_numbers_are_plain_json(self, good):
        for screened in (screen(good), screen(bumped(good, 61))):
            for fault in (*screened.found, *screened.ruled_out):
                assert json.loads(json.dumps(fault.to_dict(), allow_nan=False)) == fault.to_dict()


class TestTransfer:
    """What was corrected in some rows is corrected the same way in the others, as for rows held out of a fit."""

    def test_columns_and_a_jump(self, good):
        wrong = bumped(joints_changed(good, CHANGES["swapped"][0]), 61)
        seen = np.ones(good.samples, bool)
        seen[100:130] = False
        screened = screen(wrong.select(seen))
        assert names(screened) == ["swapped_joints", "frame_jump"]
        whole = screened.transferred(wrong)
        np.testing.assert_allclose(whole.joint_position, good.joint_position, atol=1e-12)
        assert np.abs(whole.position - good.position)[~seen].max() < 8e-5

    def test_unsettled_readouts(self, folder, still):
        rest = 1e-2 * moves_of(still["joint_position"])
        recording = read_early(Made(folder, seed=11), still, rest)
        seen = np.arange(recording.samples) < 120
        whole = screen(recording.select(seen)).transferred(recording)
        np.testing.assert_allclose(whole.joint_position, still["joint_position"] + rest, rtol=0, atol=8e-5)

    def test_whole_turns(self, good):
        wrong = joints_changed(good, lambda q: q.__setitem__(([4, 9, 150], 1), q[[4, 9, 150], 1] + 2 * np.pi))
        whole = screen(wrong.select(np.arange(good.samples) < 120)).transferred(wrong)
        np.testing.assert_allclose(whole.joint_position, good.joint_position, atol=1e-12)
