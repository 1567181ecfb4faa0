"""URDF to elements: the same tree as a robot file in TOML.

The reader is our own, on defusedxml: the parsers at hand bring a simulator or a
rendering stack with them, drop `mimic`, or do not say where a file is wrong. Joints
come depth-first, the children of a link in the order of their joints' names: the
order of Pinocchio, so joint vectors can be exchanged with it. `base` is the root link.
A parent link `world` that is not declared is taken as the root, as by Drake.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from .._model.elements import (
    AbstractElement,
    FixedRotation,
    FixedTranslation,
    Fork,
    PrismaticJoint,
    RevoluteJoint,
    RobotDescription,
    Tool,
)
from .errors import raise_faults
from .urdf_parser import UrdfJoint, UrdfLink, UrdfParser
from .urdf_xml import parse_xml

# Number of equal links that is found in real machines.
_COMMON_EQUAL_LINKS = 3
_Children = Mapping[str, Sequence[UrdfJoint]]


def read_urdf(data: bytes, file: str, tool: str | None) -> RobotDescription:
    """Robot of a URDF, its elements with one `Tool`.

    Args:
        data: The file's bytes.
        file: Name of the file, for messages.
        tool: Name of the link whose frame is the tool; None for the only leaf.

    Raises:
        RobotFileError: If anything is wrong.
    """
    parser = UrdfParser()
    try:
        root = parse_xml(data)
    except ValueError as error:
        raise_faults(file, [str(error)])
        raise
    parsed = parser.root(root)
    links, joints = parsed.links, parsed.joints
    if not (links or parser.faults):
        parser.faults.append("there is no link")
    # Parts without names or ends would give faults of the tree that are none.
    has_names = all(j.parent and j.child and j.name for j in joints)
    if links and has_names and all(link.name for link in links):
        # `world` needs no declaration where joints hang on it.
        is_declared = any(link.name == "world" for link in links)
        if not is_declared and any(joint.parent == "world" for joint in joints):
            links = [UrdfLink("world", None), *links]
        parser.faults.extend(_tree_faults(links, joints))
    raise_faults(file, parser.faults)
    children = {
        link.name: sorted(
            (j for j in joints if j.parent == link.name), key=lambda j: j.name
        )
        for link in links
    }
    leaves = [link.name for link in links if not children[link.name]]
    if tool is None and len(leaves) == 1:
        (tool,) = leaves
    if tool not in children:
        fault = (
            "several links carry no other, so one has to be named as the tool's"
            if tool is None
            else f"there is no link {tool!r} for the tool"
        )
        # The last one is a tool's as a rule: frames of the base stand before.
        name = next((leaf for leaf in leaves if "tool" in leaf.lower()), leaves[-1])
        how = f'by `tool` (in a job: [robot] tool = "{name}", else --tool {name})'
        raise_faults(file, [f"{fault}, {how}; the last links are {', '.join(leaves)}"])
    by_name = {link.name: link for link in links}
    start = _root(links, joints)[0]
    parser.notes.extend(_massless_notes(by_name, children, start))
    parser.notes.extend(_placeholder_notes(links))
    elements = _branch(by_name, children, start, str(tool))
    return RobotDescription(parsed.name, elements, parser.notes)


def _root(links: Sequence[UrdfLink], joints: Sequence[UrdfJoint]) -> list[str]:
    """Links that hang on no joint."""
    hanging = {joint.child for joint in joints}
    return [link.name for link in links if link.name not in hanging]


def _tree_faults(links: Sequence[UrdfLink], joints: Sequence[UrdfJoint]) -> list[str]:
    """Faults of links and joints that are not one tree with a moving joint."""
    faults = []
    for kind, parts in (("link", links), ("joint", joints)):
        names = [part.name for part in parts]
        for twice in sorted({n for n in names if names.count(n) > 1}):
            faults.append(f"the {kind} name {twice!r} occurs more than once")
    declared = {link.name for link in links}
    carriers: dict[str, list[str]] = {}
    for joint in joints:
        for role in ("parent", "child"):
            end = getattr(joint, role)
            if end not in declared:
                faults.append(f"{joint.place}: the {role} {end!r} is no link")
        carriers.setdefault(joint.child, []).append(joint.name)
    for child, above in carriers.items():
        if len(above) > 1:
            faults.append(
                f"link {child!r} hangs on several joints: {', '.join(above)}; only "
                "trees are read"
            )
    if not faults:
        faults.extend(_connection_faults(links, joints))
    if not any(joint.is_moving for joint in joints):
        faults.append(
            "there is no movable joint (revolute, continuous or prismatic): at least "
            "one is required"
        )
    return faults


def _connection_faults(
    links: Sequence[UrdfLink], joints: Sequence[UrdfJoint]
) -> list[str]:
    """Faults of links with at most one parent each that are not one tree."""
    roots = _root(links, joints)
    if len(roots) > 1:
        return [f"there must be one root link, but there are {', '.join(roots)}"]
    above = {joint.child: joint.parent for joint in joints}
    looping = []
    for link in links:
        name, steps = link.name, 0
        while name in above and steps <= len(links):
            name, steps = above[name], steps + 1
        if name in above:
            looping.append(link.name)
    return [f"the joints form a loop: {', '.join(looping)}"] if looping else []


def _branch(
    links: Mapping[str, UrdfLink], children: _Children, link: str, tool: str
) -> list[AbstractElement]:
    """Elements of a link and of all that it carries."""
    elements: list[AbstractElement] = []
    while True:
        body = links[link].body
        if body is not None:
            elements.append(body)
        if link == tool:
            elements.append(Tool(tool))
        joints = children[link]
        if len(joints) != 1:
            break
        elements.extend(_joint_elements(joints[0]))
        link = joints[0].child
    if joints:
        branches = [
            [*_joint_elements(j), *_branch(links, children, j.child, tool)]
            for j in joints
        ]
        elements.append(Fork(branches))
    return elements


def _joint_elements(joint: UrdfJoint) -> list[AbstractElement]:
    """Elements of one joint."""
    x, y, z = joint.position
    elements: list[AbstractElement] = [
        FixedTranslation((x, y, z)),
        FixedRotation(joint.rotation),
    ]
    if joint.is_moving:
        moving = PrismaticJoint if joint.kind == "prismatic" else RevoluteJoint
        elements.append(
            moving(
                joint.name,
                np.array(joint.axis),
                lower=joint.lower,
                upper=joint.upper,
                home=float(np.clip(0.0, joint.lower, joint.upper)),
                mimic=joint.mimic,
                speed=joint.speed,
            )
        )
    return elements


def _placeholder_notes(links: Sequence[UrdfLink]) -> list[str]:
    """Note on masses that are all the same, as in files meant for planning."""
    bodies = [link.body for link in links if link.body is not None]
    alike = {(float(b.mass), np.asarray(b.inertia).tobytes()) for b in bodies}
    if len(alike) > 1 or len(bodies) <= _COMMON_EQUAL_LINKS:
        return []
    return [f"all {len(bodies)} masses and inertias are the same: placeholders?"]


def _massless_notes(
    links: Mapping[str, UrdfLink], children: _Children, root: str
) -> list[str]:
    """Note on moving links without mass of their own.

    A link that is fixed to one with mass is a mere frame and needs none.
    """
    groups, queue = {}, [(root, root)]
    for link, head in queue:
        groups.setdefault(head, []).append(link)
        for j in children[link]:
            queue.append((j.child, j.child if j.is_moving else head))
    massless = [
        head
        for head, members in groups.items()
        if head != root and all(links[member].body is None for member in members)
    ]
    if not massless:
        return []
    return [f"moving links without <inertial>, taken as massless: {massless}"]
