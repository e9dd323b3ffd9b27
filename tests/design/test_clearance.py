"""Capsules against closed forms and Pinocchio: distances of segments, frames, shapes of a URDF, and every refusal."""

import struct
from itertools import product

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from lite6jax.arms.arm import Arm
from lite6jax.arms.description import load_bundled
from lite6jax.arms.urdf import read_urdf
from lite6jax.design.clearance import (
    Capsule,
    chain_capsules,
    enclose_points,
    link_frames,
    segment_distance,
    self_collision,
    urdf_capsules,
)
from lite6jax.errors import InputError
from tests.oracles.arms import random_kinematics, random_positions
from tests.oracles.chains import six_parameter_poses


def distance_to_segment(point, p, q):
    d = q - p
    along = np.clip((point - p) @ d / (d @ d), 0, 1) if d.any() else 0.0
    return np.linalg.norm(point - p - along * d)


def distance_of_segments(p1, q1, p2, q2):
    """The least of the ends' distances and, where the common perpendicular meets both segments, of its length."""
    found = [distance_to_segment(p, p2, q2) for p in (p1, q1)] + [distance_to_segment(p, p1, q1) for p in (p2, q2)]
    d1, d2 = q1 - p1, q2 - p2
    across = np.cross(d1, d2)
    if np.linalg.norm(across) > 1e-9 * np.linalg.norm(d1) * np.linalg.norm(d2):
        s, t, _ = np.linalg.solve(np.stack([d1, -d2, across], 1), p2 - p1)
        if 0 <= s <= 1 and 0 <= t <= 1:
            found.append(abs((p2 - p1) @ across) / np.linalg.norm(across))
    return min(found)


def test_random_segments():
    rng = np.random.default_rng(0)
    ends = rng.uniform(-1, 1, (4, 3, 2000)) * rng.choice([1.0, 1e-3], (4, 1, 2000))
    found = np.asarray(segment_distance(*ends))
    np.testing.assert_allclose(found, [distance_of_segments(*case) for case in ends.transpose(2, 0, 1)], atol=1e-12)
    for case, value in zip(ends.transpose(2, 0, 1)[:20], found, strict=False):
        p1, q1, p2, q2 = case

        def square(st, p1=p1, q1=q1, p2=p2, q2=q2):
            return np.sum((p1 + st[0] * (q1 - p1) - p2 - st[1] * (q2 - p2)) ** 2)

        least = minimize(square, [0.5, 0.5], bounds=[(0, 1), (0, 1)], options={"ftol": 1e-15, "gtol": 1e-12})
        assert value**2 == pytest.approx(least.fun, abs=1e-7)


def test_points_parallels_and_crossings():
    o, x, y, z = np.zeros(3), *np.eye(3)
    cases = [
        ((o, o, o, o), 0.0),
        ((o, o, x, x), 1.0),
        ((o, o, x + y, x - y), 1.0),
        ((x + y, x - y, o, o), 1.0),
        ((o, x, o, x), 0.0),
        ((o, x, y, x + y), 1.0),
        ((o, x, x + y, y), 1.0),
        ((o, x, 3 * x, 2 * x), 1.0),
        ((o, x, 0.5 * x, 3 * x), 0.0),
        ((o, x, 2 * x + y, 3 * x + y), np.sqrt(2)),
        ((-x, x, -y, y), 0.0),
        ((-x, x, z - y, z + y), 1.0),
        ((o, x, 0.5 * x + y, 0.5 * x + 2 * y), 1.0),
    ]
    found = segment_distance(*np.stack([np.stack(case) for case, _ in cases], -1))
    np.testing.assert_allclose(found, [value for _, value in cases], atol=1e-15)


@given(st.floats(-12, 0), st.integers(0, 10**6))
def test_nearly_parallel_segments(exponent, seed):
    rng = np.random.default_rng(seed)
    p1, q1, shift = rng.uniform(-1, 1, (3, 3))
    ends = p1, q1, p1 + shift, q1 + shift + 10**exponent * rng.uniform(-1, 1, 3)
    found = float(segment_distance(*(end[:, None] for end in ends))[0])
    assert found == pytest.approx(distance_of_segments(*ends), rel=1e-9)


def test_frames_of_every_link():
    rng = np.random.default_rng(1)
    arm = Arm("any", random_kinematics(rng, 5), T_joint_flange=six_parameter_poses(random_kinematics(rng, 1), [[0]])[0])
    q = random_positions(rng, 7, 5)
    F = link_frames(arm, q)
    assert F.shape == (6, 3, 4, 7)
    for i in range(5):
        expected = six_parameter_poses(arm.kinematics[: i + 1], q[:, : i + 1])
        np.testing.assert_allclose(np.moveaxis(F[i], -1, 0), expected[:, :3], atol=1e-12)
    np.testing.assert_allclose(np.moveaxis(F[5], -1, 0), (expected @ arm.T_joint_flange)[:, :3], atol=1e-12)


def planar(lengths, limit=np.pi):
    """Joints about z; the links lie along x."""
    rows = np.zeros((len(lengths), 6))
    rows[1:, 0] = lengths[:-1]
    flange = np.eye(4)
    flange[0, 3] = lengths[-1]
    return Arm("planar", rows, joint_limits=[[-limit, limit]] * len(lengths), T_joint_flange=flange)


def test_a_folded_planar_arm():
    collision = self_collision(planar([1.0, 0.5, 1.0]), chain_capsules(planar([1.0, 0.5, 1.0]), radius=0.1))
    assert [(collision.capsules[i].name, collision.capsules[j].name) for i, j in collision.pairs] == [
        ("link3", "link1")
    ]
    right = np.pi / 2
    q = [[0, 0, 0], [0.7, right, right], [0, right, 0.5 * right], [0, right, right + np.arctan(0.5)]]
    expected = [0.5, 0.5, 0.5, 0.5 - np.sqrt(0.2)]
    np.testing.assert_allclose(collision.clearance(q), np.array(expected) - 0.2, atol=1e-12)


def test_many_poses_agree_with_one_at_a_time_in_plain_numpy():
    """Pairs that always overlap are disabled: link 4 has no length, so that links 3 and 5 of the wrist meet."""
    arm = load_bundled("lite6")
    collision = self_collision(arm)
    capsules = collision.capsules
    assert ("link3", "link5") in collision.disabled
    assert not {(capsules[j].name, capsules[i].name) for i, j in collision.pairs} & set(collision.disabled)
    assert all(abs(capsules[i].link - capsules[j].link) > 1 for i, j in collision.pairs)
    q = np.random.default_rng(3).uniform(*arm.joint_limits.T, (4100, 6))
    found = collision.clearance(q)
    assert found.shape == (4100,)
    for n in (0, 1, 2, 4095, 4096, 4099):
        moved = (six_parameter_poses(arm.kinematics[: i + 1], q[n : n + 1, : i + 1])[0] for i in range(6))
        frames = [np.eye(4), *moved]
        ends = [[frames[c.link][:3, :3] @ p + frames[c.link][:3, 3] for p in (c.start, c.end)] for c in capsules]
        apart = [
            distance_of_segments(*ends[i], *ends[j]) - capsules[i].radius - capsules[j].radius
            for i, j in collision.pairs
        ]
        assert found[n] == pytest.approx(min(apart), abs=1e-10)


def test_an_arm_too_short_to_meet_itself_is_always_clear():
    np.testing.assert_array_equal(self_collision(planar([1.0])).clearance(np.zeros((3, 1))), np.inf)


def test_default_radius_is_a_twentieth_of_the_reach_and_a_tool_lengthens_the_last_link():
    capsules = chain_capsules(planar([1.0, 0.5]), tool_point=[0.1, 0.0, 0.2])
    assert [(c.name, c.radius) for c in capsules] == [("link1", 0.075), ("link2", 0.075)]
    np.testing.assert_allclose(capsules[-1].end, [0.6, 0, 0.2])


def contains(capsule, points):
    start, end, radius = capsule
    return max(distance_to_segment(p, start, end) for p in points) <= radius + 1e-12


@pytest.mark.parametrize("size", [(1.0, 0.2, 0.3), (1.0, 1.0, 1.0), (0.1, 2.0, 0.1), (0.5, 0.5, 0.1)])
def test_a_box_is_enclosed_along_its_longest_side(size):
    corners = np.array(list(product((-0.5, 0.5), repeat=3))) * size
    start, end, radius = enclose_points(corners)
    assert contains((start, end, radius), corners)
    a, b, c = sorted(size)
    assert radius == pytest.approx(np.hypot(a, b) / 2)
    assert np.linalg.norm(end - start) == pytest.approx(c, abs=1e-9)


def test_any_cloud_is_enclosed():
    rng = np.random.default_rng(4)
    for shape in rng.uniform(0.01, 1, (30, 3)):
        points = rng.standard_normal((50, 3)) * shape + 1
        assert contains(enclose_points(points), points)
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 0]])
    assert contains(enclose_points(flat), flat)


JOINTS = (
    '<joint name="weld" type="fixed"><origin xyz="0.1 0 0.2" rpy="1 0 2"/><parent link="world"/><child link="base"/>'
    "</joint>"
    '<joint name="j1" type="revolute"><origin xyz="0 0 0.2" rpy="0.1 0.2 0.3"/><parent link="base"/><child link="a"/>'
    '<axis xyz="0 0 -1"/><limit lower="-2" upper="3" effort="1" velocity="1"/></joint>'
    '<joint name="cover" type="fixed"><origin xyz="0.05 0 0.1" rpy="0 1.2 0"/><parent link="a"/><child link="lid"/>'
    "</joint>"
    '<joint name="j2" type="revolute"><origin xyz="0.4 0.02 0"/><parent link="lid"/><child link="b"/>'
    '<axis xyz="1 -2 -3"/><limit lower="-2" upper="3" effort="1" velocity="1"/></joint>'
    '<joint name="j3" type="continuous"><origin xyz="0.3 0 0.1" rpy="1 0 0"/><parent link="b"/><child link="c"/>'
    '<axis xyz="0 1 0"/></joint>'
)
LINKS = ("world", "base", "a", "lid", "b", "c")
CYLINDER = '<cylinder radius="0.05" length="0.3"/>'


def shape(geometry, xyz="0 0 0", rpy="0 0 0"):
    return f'<collision><origin xyz="{xyz}" rpy="{rpy}"/><geometry>{geometry}</geometry></collision>'


def write_urdf(tmp_path, shapes):
    links = "".join(f'<link name="{name}">{shapes.get(name, "")}</link>' for name in LINKS)
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{links}{JOINTS}</robot>')
    return path


def test_urdf_shapes_stand_where_pinocchio_puts_their_links(tmp_path):
    place = {"xyz": "0.1 -0.2 0.05", "rpy": "0.4 0.5 -0.6"}
    path = write_urdf(tmp_path, {name: shape(CYLINDER, **place) for name in LINKS})
    capsules, arm = urdf_capsules(path), read_urdf(path)
    assert {c.name: c.link for c in capsules} == {"world": 0, "base": 0, "a": 1, "lid": 1, "b": 2, "c": 3}
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    offset = pin.SE3(pin.rpy.rpyToMatrix(0.4, 0.5, -0.6), np.array([0.1, -0.2, 0.05]))
    for q in np.random.default_rng(5).uniform(-2, 2, (5, 3)):
        configuration = np.array([q[0], q[1], np.cos(q[2]), np.sin(q[2])])
        pin.framesForwardKinematics(model, data, configuration)
        F = np.concatenate([np.eye(3, 4)[None], link_frames(arm, q[None])[..., 0]])
        for capsule in capsules:
            shaped = data.oMf[model.getFrameId(capsule.name)] * offset
            for ours, theirs in ((capsule.start, [0, 0, -0.15]), (capsule.end, [0, 0, 0.15])):
                expected = shaped.rotation @ theirs + shaped.translation
                T = F[capsule.link]
                np.testing.assert_allclose(T[:, :3] @ ours + T[:, 3], expected, atol=1e-12)
            assert capsule.radius == 0.05
    collision = self_collision(arm, capsules)
    assert len(collision.pairs) + len(collision.disabled) == 2 * 2 + 2 * 1
    assert np.isfinite(collision.clearance(np.zeros((2, 3)))).all()


TRIANGLES = np.random.default_rng(6).uniform(-1, 1, (20, 3, 3)).astype(np.float32) * np.float32([0.4, 0.1, 0.05])


def binary_stl(triangles):
    facets = b"".join(struct.pack("<12fH", 0, 0, 1, *facet.ravel(), 0) for facet in triangles)
    return b"solid but binary".ljust(80) + struct.pack("<I", len(triangles)) + facets


def ascii_stl(triangles):
    facet = "facet normal 0 0 1\n outer loop\n{}\n endloop\nendfacet\n"
    corners = ("\n".join("  vertex {!r} {!r} {!r}".format(*map(float, p)) for p in triangle) for triangle in triangles)
    return ("solid x\n" + "".join(facet.format(text) for text in corners) + "endsolid x\n").encode()


@pytest.mark.parametrize(
    ("filename", "place"),
    [
        ("link.stl", "link.stl"),
        ("meshes/link.STL", "meshes/link.STL"),
        ("package://arm_description/meshes/link.stl", "link.stl"),
        ("package://arm_description/meshes/link.stl", "meshes/link.stl"),
        ("package://arm_description/meshes/link.stl", "arm_description/meshes/link.stl"),
    ],
)
@pytest.mark.parametrize("content", [binary_stl, ascii_stl])
def test_meshes_are_enclosed(tmp_path, filename, place, content):
    (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / place).write_bytes(content(TRIANGLES))
    path = write_urdf(tmp_path, {"world": shape(f'<mesh filename="{filename}" scale="2 1 1"/>')})
    (capsule,) = urdf_capsules(path)
    assert contains((capsule.start, capsule.end, capsule.radius), TRIANGLES.reshape(-1, 3).astype(float) * [2, 1, 1])
    assert capsule.radius < 0.2


def test_a_sphere_is_a_capsule_without_length(tmp_path):
    (capsule,) = urdf_capsules(write_urdf(tmp_path, {"world": shape('<sphere radius="0.2"/>', xyz="1 2 3")}))
    np.testing.assert_array_equal([*capsule.start, *capsule.end, capsule.radius], [1, 2, 3, 1, 2, 3, 0.2])


@pytest.mark.parametrize(
    ("geometry", "words"),
    [
        ("", "link 'a': collision: its geometry is nothing; a box, cylinder, sphere or mesh is needed"),
        ("<cone/>", "its geometry is cone"),
        ('<box size="1 2"/>', "box size is '1 2'; write three numbers"),
        ('<box size="1 0 2"/>', "box size '1 0 2'; write three positive lengths"),
        ('<sphere radius="-1"/>', "sphere radius '-1'; write a positive length in m"),
        ('<cylinder length="1"/>', "cylinder radius None; write a positive length in m"),
        ('<cylinder radius="1" length="long"/>', "cylinder length 'long'; write a positive length in m"),
        (
            '<mesh filename="a.dae"/>',
            "mesh 'a.dae' is no STL file; convert it to STL, or use capsules around the chain",
        ),
        ('<mesh filename="package://x/a.stl"/>', "is not there; put a.stl beside the URDF, or use capsules"),
        ('<mesh filename="bad.stl"/>', "bad.stl: not an STL mesh with triangles; export it anew as binary STL"),
        ('<mesh filename="words.stl"/>', "words.stl: not an STL mesh with triangles"),
    ],
)
def test_refused_shapes(tmp_path, geometry, words):
    (tmp_path / "bad.stl").write_bytes(binary_stl(TRIANGLES)[:-7])
    (tmp_path / "words.stl").write_text("solid x\n vertex one two three\nendsolid")
    path = write_urdf(tmp_path, {"a": shape(geometry)})
    with pytest.raises(InputError) as caught:
        urdf_capsules(path)
    assert words in str(caught.value)
    assert str(caught.value).startswith(f"{path}: link 'a'")
    assert "\n" not in str(caught.value)


def test_refusals_without_shapes(tmp_path):
    with pytest.raises(InputError, match=r"no link of the chain has collision geometry; use capsules around the chain"):
        urdf_capsules(write_urdf(tmp_path, {}))
    for radius in (0.0, -1.0, np.nan):
        with pytest.raises(InputError, match=r"capsule radius .* m: give a positive length"):
            chain_capsules(planar([1.0]), radius)


def test_a_capsule_is_carried_by_its_link():
    """A sphere on the last link and one on the base, at a distance known from the arm's reach."""
    arm = planar([1.0, 1.0])
    spheres = [Capsule("post", 0, np.zeros(3), np.zeros(3), 0.1), Capsule("hand", 2, *np.eye(3)[[0, 0]], 0.2)]
    collision = self_collision(arm, spheres)
    angle = np.linspace(-3, 3, 9)
    found = collision.clearance(np.stack([0.3 * angle, angle], 1))
    np.testing.assert_allclose(found, 2 * np.abs(np.cos(angle / 2)) - 0.3, atol=1e-12)
