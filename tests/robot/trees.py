"""Arms that nobody would build: random axes, sliding and turning joints, a fork."""

import numpy as np

import diffmill.robot as dr


def random_tree(rng, joint_count, *, is_forked):
    """Return a robot with joints of both kinds along random axes."""

    def link(index):
        root = rng.normal(size=(3, 3)) * 0.1
        inertia = root @ root.T + 0.05 * np.eye(3)
        joint = dr.PrismaticJoint if rng.random() < 0.3 else dr.RevoluteJoint
        return [
            dr.FixedTranslation(rng.normal(size=3) * 0.3),
            dr.FixedRotation(dr.rpy_matrix(*rng.normal(size=3))),
            joint(f"joint_{index}", rng.normal(size=3), stiffness=1e3),
            dr.RigidBody(rng.uniform(0.5, 3.0), rng.normal(size=3) * 0.1, inertia),
        ]

    links = [link(i) for i in range(joint_count)]
    chain = lambda part: [element for link in part for element in link]
    tip = dr.FixedTranslation((0.1, -0.2, 0.3))
    if not is_forked:
        return dr.build([*chain(links), tip], name="chain")
    third = joint_count // 3
    fork = dr.Fork((tuple(chain(links[third : 2 * third])), ()))
    trunk, rest = chain(links[:third]), chain(links[2 * third :])
    return dr.build([*trunk, fork, *rest, tip], name="tree")
