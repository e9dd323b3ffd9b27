"""Arms with prismatic joints as URDF text: a linear axis under an arm, SCARAs, a column, a gantry."""

HALF = 1.5707963267948966
INERTIAL = (
    '<inertial><origin xyz="0.02 -0.03 0.05" rpy="0.1 0.2 0.3"/><mass value="2"/>'
    '<inertia ixx="0.02" ixy="0.001" ixz="0.002" iyy="0.03" iyz="-0.003" izz="0.04"/></inertial>'
)


def chain(*joints, name="arm"):
    """A URDF of links 0 … n in a row, of joints (P or R, "x y z", "roll pitch yaw", axis), and a fixed `tool`."""
    parts = ['<link name="l0"/>']
    for i, (kind, xyz, rpy, axis) in enumerate(joints):
        kind = {"P": "prismatic", "R": "revolute"}[kind]
        parts.append(
            f'<link name="l{i + 1}">{INERTIAL}</link><joint name="j{i + 1}" type="{kind}">'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><parent link="l{i}"/><child link="l{i + 1}"/><axis xyz="{axis}"/>'
            '<limit lower="-0.8" upper="0.9" effort="1" velocity="1"/></joint>'
        )
    last = f"l{len(joints)}"
    parts.append(
        '<link name="tool"/><joint name="weld" type="fixed"><origin xyz="0.01 0.02 0.1" rpy="0.1 0 0.2"/>'
        f'<parent link="{last}"/><child link="tool"/></joint>'
    )
    return f'<?xml version="1.0"?><robot name="{name}">{"".join(parts)}</robot>'


ARMS = {
    "rail": chain(  # a linear axis along y under an arm of six joints
        ("P", "0 0 0.3", "0 0 0", "0 1 0"),
        ("R", "0 0 0.2", "0 0 0", "0 0 1"),
        ("R", "0.05 0 0.1", "0 0 0", "0 1 0"),
        ("R", "0 0 0.4", "0 0 0", "0 1 0"),
        ("R", "0.05 0 0.1", "0 0 0", "1 0 0"),
        ("R", "0.3 0 0", "0 0 0", "0 1 0"),
        ("R", "0.08 0 0", "0 0 0", "1 0 0"),
    ),
    "scara": chain(  # the quill before the last axis, on that axis
        ("R", "0 0 0.4", "0 0 0", "0 0 1"),
        ("R", "0.3 0 0", "0 0 0", "0 0 1"),
        ("P", "0.25 0 0", "0 0 0", "0 0 -1"),
        ("R", "0 0 -0.1", "0 0 0", "0 0 -1"),
    ),
    "spline": chain(  # the quill after the last axis, on that axis
        ("R", "0 0 0.4", "0 0 0", "0 0 1"),
        ("R", "0.3 0 0", "0 0 0", "0 0 1"),
        ("R", "0.25 0 0", "0 0 0", "0 0 1"),
        ("P", "0 0 -0.1", "0 0 0", "0 0 -1"),
    ),
    "column": chain(  # a lift on whose axis the first revolute joint is
        ("P", "0 0 0.2", "0 0 0", "0 0 1"),
        ("R", "0 0 0.1", "0 0 0", "0 0 1"),
        ("R", "0.3 0 0", "0 0 0", "0 0 1"),
        ("R", "0.2 0 0.05", f"{HALF} 0 0", "0 0 1"),
    ),
    "gantry": chain(
        ("P", "0 0 0.1", "0 0 0", "1 0 0"), ("P", "0 0 0.2", "0 0 0", "0 1 0"), ("P", "0.1 0 0", "0 0 0", "0 0 1")
    ),
}
"""By name."""
