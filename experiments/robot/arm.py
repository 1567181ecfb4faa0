"""Serial arms of any length, and the same arm as URDF text for other programs."""

import numpy as np

import diffmill.robot as dr

# Entries of an inertia, as files name them.
UPPER = {
    "xx": (0, 0),
    "yy": (1, 1),
    "zz": (2, 2),
    "xy": (0, 1),
    "xz": (0, 2),
    "yz": (1, 2),
}


def serial_arm(joint_count: int) -> dr.Robot:
    """Return an arm whose axes alternate like an industrial robot's."""
    rng = np.random.default_rng(joint_count)
    elements = []
    for i in range(joint_count):
        axis = ((0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0))[i % 4]
        length = 0.8 / (1 + 0.3 * i)
        mass = 60.0 / (1 + i)
        thick = mass * length**2 * rng.uniform(0.05, 0.1, 3)
        elements += [
            dr.RevoluteJoint(f"joint_{i}", axis, stiffness=1e6, damping=1e3),
            dr.RigidBody(mass, (0.4 * length, 0.03, 0.1 * length), np.diag(thick)),
            dr.FixedTranslation((0.7 * length, 0.0, 0.7 * length)),
        ]
    return dr.build(elements, name=f"arm of {joint_count} joints")


def _numbers(values: np.ndarray) -> str:
    return " ".join(repr(float(x)) for x in np.ravel(values))


def _rpy(R: np.ndarray) -> np.ndarray:
    """Return roll, pitch and yaw of a rotation away from pitch = 90 degrees."""
    return np.array(
        [
            np.arctan2(R[2, 1], R[2, 2]),
            -np.arcsin(np.clip(R[2, 0], -1, 1)),
            np.arctan2(R[1, 0], R[0, 0]),
        ]
    )


def _rotation_to_rpy(R: np.ndarray) -> str:
    """Return the angles, also at pitch = +-90 degrees, where only one is free."""
    if abs(R[2, 0]) < 1 - 1e-12:
        return _numbers(_rpy(R))
    sign = -np.sign(R[2, 0])
    return _numbers(np.array([0.0, sign * np.pi / 2, np.arctan2(-R[0, 1], R[1, 1])]))


def urdf_of(robot: dr.Robot) -> str:
    """Return a serial robot of revolute joints as URDF."""
    parts = ['<robot name="arm"><link name="base"/>']
    for i in range(robot.joint_count):
        I = np.asarray(robot.link_inertias[i])
        inertia = " ".join(f'i{key}="{float(I[at])!r}"' for key, at in UPPER.items())
        R = np.asarray(robot.placement_rotations[i])
        parts.append(
            f'<link name="link_{i}"><inertial>'
            f'<origin xyz="{_numbers(np.asarray(robot.link_centers[i]))}"/>'
            f'<mass value="{float(robot.link_masses[i])!r}"/>'
            f"<inertia {inertia}/></inertial></link>"
            f'<joint name="joint_{i}" type="revolute">'
            f'<parent link="{f"link_{i - 1}" if i else "base"}"/>'
            f'<child link="link_{i}"/><axis xyz="0 0 1"/>'
            f'<origin xyz="{_numbers(np.asarray(robot.placement_positions[i]))}" '
            f'rpy="{_rotation_to_rpy(R)}"/>'
            '<limit lower="-10" upper="10" effort="1e6" velocity="100"/></joint>'
        )
    return "".join([*parts, "</robot>"])


def sdf_of(robot: dr.Robot) -> str:
    """Return a serial robot of revolute joints as SDF, on a base held by the world."""
    inertia = "".join(
        f"<i{key}>{value}</i{key}>"
        for key, value in zip(UPPER, (1, 1, 1, 0, 0, 0), strict=True)
    )
    parts = [
        '<sdf version="1.10"><model name="arm"><link name="base"><inertial>'
        f"<mass>1</mass><inertia>{inertia}</inertia></inertial></link>"
        '<joint name="held" type="fixed"><parent>world</parent><child>base</child>'
        "</joint>"
    ]
    for i in range(robot.joint_count):
        I = np.asarray(robot.link_inertias[i])
        inertia = "".join(f"<i{k}>{float(I[at])!r}</i{k}>" for k, at in UPPER.items())
        R, center = np.asarray(robot.placement_rotations[i]), robot.link_centers[i]
        parent = f"link_{i - 1}" if i else "base"
        parts.append(
            f'<link name="link_{i}"><pose relative_to="joint_{i}">0 0 0 0 0 0</pose>'
            f"<inertial><pose>{_numbers(np.asarray(center))} 0 0 0</pose>"
            f"<mass>{float(robot.link_masses[i])!r}</mass><inertia>{inertia}</inertia>"
            f'</inertial></link><joint name="joint_{i}" type="revolute">'
            f'<pose relative_to="{parent}">'
            f"{_numbers(np.asarray(robot.placement_positions[i]))} "
            f"{_rotation_to_rpy(R)}</pose><parent>{parent}</parent>"
            f"<child>link_{i}</child><axis><xyz>0 0 1</xyz>"
            "<limit><lower>-10</lower><upper>10</upper></limit></axis></joint>"
        )
    return "".join([*parts, "</model></sdf>"])
