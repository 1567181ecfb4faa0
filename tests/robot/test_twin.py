"""Trees of all kinds of joints against MuJoCo, built from the same numbers."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import diffmill.robot as dr

# Its names are made at run time: a type checker does not see them.
mujoco: Any = pytest.importorskip("mujoco")

# Parent and kind of each joint: two roots, a fork, sliders, the tool on joint 6.
TREE = [
    (-1, "revolute"),
    (0, "revolute"),
    (1, "prismatic"),
    (2, "revolute"),
    (1, "revolute"),
    (4, "prismatic"),
    (3, "revolute"),
    (-1, "revolute"),
]


def random_parts(seed):
    """Return one dictionary of random numbers per joint of the tree."""
    rng = np.random.default_rng(seed)
    parts = []
    for parent, kind in TREE:
        root = rng.normal(size=(3, 3)) * 0.3
        parts.append(
            {
                "parent": parent,
                "kind": kind,
                "position": rng.normal(size=3) * 0.5,
                "rpy": rng.uniform(-np.pi, np.pi, 3),
                "axis": rng.normal(size=3),
                "mass": rng.uniform(1.0, 20.0),
                "center": rng.normal(size=3) * 0.2,
                # Of points at random places: always that of a real body.
                "inertia": np.trace(root @ root.T) * np.eye(3) - root @ root.T,
            }
        )
    return parts


def children_of(parts, parent):
    return [k for k, part in enumerate(parts) if part["parent"] == parent]


def as_elements(parts, k):
    """Return the elements from joint k outwards; the tool hangs on joint 6."""
    part = parts[k]
    joint = dr.RevoluteJoint if part["kind"] == "revolute" else dr.PrismaticJoint
    elements = [
        dr.FixedTranslation(part["position"]),
        dr.FixedRotation(dr.rpy_matrix(*part["rpy"])),
        joint(f"joint_{k}", part["axis"]),
        dr.RigidBody(part["mass"], part["center"], part["inertia"]),
    ]
    if k == 6:
        elements.append(dr.Tool("tip", (0.1, -0.2, 0.3), dr.rpy_matrix(0.4, 0.5, 0.6)))
    elements.append(dr.Fork([as_elements(parts, c) for c in children_of(parts, k)]))
    return elements


def as_mjcf(parts, k):
    """Return the same as MJCF."""
    part = parts[k]
    text = lambda values: " ".join(repr(float(v)) for v in np.ravel(values))
    I = part["inertia"]
    kind = "hinge" if part["kind"] == "revolute" else "slide"
    moments = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]
    site = ""
    if k == 6:
        site = '<site name="tip" pos="0.1 -0.2 0.3" euler="0.4 0.5 0.6"/>'
    return (
        f'<body pos="{text(part["position"])}" euler="{text(part["rpy"])}">'
        f'<joint name="joint_{k}" type="{kind}" axis="{text(part["axis"])}"/>'
        f'<inertial pos="{text(part["center"])}" mass="{part["mass"]!r}" '
        f'fullinertia="{text(moments)}"/>{site}'
        + "".join(as_mjcf(parts, c) for c in children_of(parts, k))
        + "</body>"
    )


@pytest.fixture(scope="module", params=[1, 2])
def twins(request):
    """The same tree twice, and where each joint of one is in the other."""
    parts = random_parts(request.param)
    roots = children_of(parts, -1)
    robot = dr.build([dr.Fork([as_elements(parts, k) for k in roots])])
    # Capital letters: turns about fixed axes, which is this project's rpy.
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian" eulerseq="XYZ"/>'
        '<option gravity="0 0 -9.81"/><worldbody>'
        + "".join(as_mjcf(parts, k) for k in roots)
        + "</worldbody></mujoco>"
    )
    order = [model.joint(name).dofadr[0] for name in robot.joint_names]
    return robot, model, np.array(order)


@pytest.mark.parametrize("seed", range(3))
def test_all_terms_agree(twins, seed):
    robot, model, order = twins
    rng = np.random.default_rng(100 + seed)
    q, qd, qdd = rng.normal(size=(3, robot.joint_count))
    wrench = rng.normal(size=6) * 30
    data = mujoco.MjData(model)
    data.qpos[order], data.qvel[order] = q, qd
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    for column, unit in zip(M, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, column, unit)
    J = np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, J[:3], J[3:], model.site("tip").id)
    site = data.site("tip")

    T = np.asarray(dr.forward_kinematics(robot, q))
    assert_allclose(T[:3, 3], site.xpos, atol=1e-9)
    assert_allclose(T[:3, :3], site.xmat.reshape(3, 3), atol=1e-9)
    assert_allclose(dr.jacobian(robot, q), J[:, order], atol=1e-9)
    M = M[np.ix_(order, order)]
    scale = np.abs(M).max()
    assert_allclose(dr.mass_matrix(robot, q), M, atol=1e-9 * scale)
    bias = data.qfrc_bias[order]
    assert_allclose(
        dr.ArmTerms.of_state(robot, q, qd).bias_forces, bias, atol=1e-9 * scale
    )
    tau = M @ qdd + bias - J[:, order].T @ wrench
    found = dr.inverse_dynamics(robot, q, qd, qdd, wrench)
    assert_allclose(found, tau, atol=1e-8 * scale)
    data.qvel[:] = 0.0
    mujoco.mj_forward(model, data)
    assert_allclose(
        dr.gravity_forces(robot, q), data.qfrc_bias[order], atol=1e-9 * scale
    )
