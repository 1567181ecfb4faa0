"""Links and joints of a URDF, checked one by one; all faults are collected.

The parser reads name, version, links with their inertials, and joints with origin,
axis, limits and mimic; it checks effort, damping and friction, but the dynamics here
have none of them. It passes over everything else: visuals and collisions,
transmissions, extensions of simulators. A misspelled name of an element that it reads
is a fault, and a limit that seems to have another unit is a note.
"""

import dataclasses
import difflib
import math
import re

import numpy as np
from jaxtyping import Float

from .._algebra.rotations import rpy_matrix
from .._model.elements import (
    Mimic,
    RigidBody,
    inertia_fault,
    is_direction,
    triangle_fault,
)
from .urdf_xml import Node

_MOVING = ("revolute", "continuous", "prismatic")
# Three numbers that are zero, and the axis of a joint that names none.
_ORIGIN, _AXIS = "0 0 0", "1 0 0"
_INERTIA = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
# Plain decimal numbers: Python alone would read underscores too.
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?inf", re.ASCII)

# Elements within each element, read or passed over, then their attributes.
_ELEMENTS = {
    "robot": ("link", "joint", "material", "transmission", "gazebo"),
    "link": ("inertial", "visual", "collision", "sensor", "contact", "gazebo"),
    "inertial": ("origin", "mass", "inertia"),
    "joint": (
        *("origin", "parent", "child", "axis", "limit", "mimic", "dynamics"),
        *("calibration", "safety_controller", "gazebo"),
    ),
}
_ATTRIBUTES = {
    "origin": ("xyz", "rpy", "quat_xyzw"),
    "mass": ("value",),
    "inertia": _INERTIA,
    "joint": ("name", "type"),
    "parent": ("link",),
    "child": ("link",),
    "axis": ("xyz",),
    "limit": ("lower", "upper", "effort", "velocity"),
    "mimic": ("joint", "multiplier", "offset"),
}
# Names that are so much alike are one of them misspelt.
_ALIKE = 0.7
# Beyond these no arm is: turns of a joint [rad], lengths [m], radii of gyration [m].
_MANY_TURNS, _LONG, _WIDE, _NARROW = 20.0, 20.0, 5.0, 1e-4

# Largest angle of a frame [rad], rounded up.
_WHOLE_TURN = 6.2832

# Beyond it, products of masses and lengths overflow.
_TOO_LARGE = 1e60


_FAR = "{} m away: is it in millimetres?"


@dataclasses.dataclass
class UrdfLink:
    """A link and its mass, if it has one."""

    name: str
    body: RigidBody | None


@dataclasses.dataclass
class UrdfJoint:
    """A joint: frame of the child in the parent's, and its motion there."""

    name: str
    place: str
    kind: str
    parent: str
    child: str
    position: tuple[float, ...]
    rotation: Float[np.ndarray, "3 3"]
    axis: tuple[float, ...]
    lower: float
    upper: float
    mimic: Mimic | None
    speed: float = math.inf

    @property
    def is_moving(self) -> bool:
        """True if the joint is not fixed."""
        return self.kind != "fixed"


@dataclasses.dataclass
class UrdfRobot:
    """Links and joints of a parsed file; none after a fault of the whole."""

    name: str = ""
    links: list[UrdfLink] = dataclasses.field(default_factory=list)
    joints: list[UrdfJoint] = dataclasses.field(default_factory=list)


@dataclasses.dataclass
class UrdfOrigin:
    """Position [m] and rotation of a frame in another."""

    position: tuple[float, ...]
    rotation: Float[np.ndarray, "3 3"]


@dataclasses.dataclass
class UrdfParser:
    """Faults and notes found so far."""

    faults: list[str] = dataclasses.field(default_factory=list)
    notes: list[str] = dataclasses.field(default_factory=list)

    def root(self, root: Node) -> UrdfRobot:
        """Robot of a parsed file."""
        if root.tag.endswith(":robot"):
            prefix = root.tag.removesuffix("robot")
            self.faults.append(
                f"line {root.line}: the elements carry the namespace prefix "
                f"{prefix!r}, which URDF does not have: take it off every element"
            )
            return UrdfRobot()
        if root.tag != "robot":
            self.faults.append(
                f"line {root.line}: the root element must be <robot>, but is "
                f"<{root.tag}>: only URDF is read"
            )
            return UrdfRobot()
        if any(node.tag.startswith("xacro:") for node in root.children):
            self.faults.append("contains xacro macros: expand them with xacro first")
            return UrdfRobot()
        place = f"line {root.line}, robot"
        self.check_names(root)
        version = root.attributes.get("version", "1.0")
        if version not in ("1.0", "1.1", "1.2"):
            self.fault(place, "version", "1.0, 1.1 or 1.2", version)
        name = self.text(root, "name", place)
        links = [self.link(node) for node in root.all("link")]
        joints = [self.joint(node) for node in root.all("joint")]
        return UrdfRobot(name, links, joints)

    def check_names(self, node: Node) -> None:
        """Note elements and attributes that are misspelt ones, here and below."""
        known = _ATTRIBUTES.get(node.tag, ())
        for name in node.attributes:
            self.check_name(node, f"attribute {name}", name, known)
        for child in node.children:
            elements = _ELEMENTS.get(node.tag, ())
            self.check_name(child, f"element <{child.tag}>", child.tag, elements)
            if child.tag in _ELEMENTS or node.tag in ("inertial", "joint"):
                self.check_names(child)

    def check_name(
        self, node: Node, what: str, name: str, known: tuple[str, ...]
    ) -> None:
        """Note a misspelled name: unknown, but like a known one."""
        if name in known:
            return
        # Vendors add to the attributes: beside the right one it is no slip.
        known = tuple(other for other in known if other not in node.attributes)
        alike = difflib.get_close_matches(name, known, n=1, cutoff=_ALIKE)
        if alike:
            self.faults.append(
                f"line {node.line}: {what} of <{node.tag}> is not known; is it "
                f"{alike[0]!r}?"
                if what.startswith("attribute")
                else f"line {node.line}: {what} is not known; is it <{alike[0]}>?"
            )

    def link(self, node: Node) -> UrdfLink:
        """Link of a node."""
        name = self.text(node, "name", f"line {node.line}, link")
        inertial = node.first("inertial")
        place = f"line {node.line}, link {name!r}"
        body = None if inertial is None else self.body(inertial, place)
        return UrdfLink(name, body)

    def body(self, node: Node, place: str) -> RigidBody | None:
        """Link's mass; None for one without."""
        origin = self.origin(node, f"{place}, inertial")
        position, R = origin.position, origin.rotation
        parts = {tag: node.first(tag) for tag in ("mass", "inertia")}
        for tag, part in parts.items():
            if part is None:
                self.faults.append(f"{place}, inertial: <{tag}> is missing")
        mass = self.number(parts["mass"], "value", f"{place}, mass")
        if mass < 0.0:
            self.fault(f"{place}, mass", "value", "not negative", str(mass))
        xx, yy, zz, xy, xz, yz = (
            self.number(parts["inertia"], key, f"{place}, inertia") for key in _INERTIA
        )
        inertia = R @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ R.T
        inertia = (inertia + inertia.T) / 2
        if mass == 0.0 and not inertia.any():
            return None
        wrong = inertia_fault(inertia) or triangle_fault(inertia)
        if wrong:
            self.notes.append(f"{place}: the inertia should be {wrong.rstrip('.')}")
        self.check_size(mass, inertia, position, place)
        return RigidBody(max(mass, 0.0), position, inertia, is_possible=not wrong)

    def check_size(
        self,
        mass: float,
        inertia: Float[np.ndarray, "3 3"],
        center: tuple[float, ...],
        place: str,
    ) -> None:
        """Note a body that is as large or small as none is in the unit of a URDF."""
        if max(map(abs, center)) > _LONG:
            self.notes.append(f"{place}: the centre of mass is {_FAR.format(center)}")
        largest = float(np.trace(inertia)) / 2
        if not (mass > 0.0 and largest > 0.0):
            return
        radius = math.sqrt(largest / mass)
        if not _NARROW < radius < _WIDE:
            self.notes.append(
                f"{place}: the inertia is that of {mass:g} kg at a radius of "
                f"{radius:.3g} m: is it in kg m^2?"
            )

    def joint(self, node: Node) -> UrdfJoint:
        """Joint of a node."""
        name = self.text(node, "name", f"line {node.line}, joint")
        place = f"line {node.line}, joint {name!r}"
        kind = self.text(node, "type", place)
        if kind not in (*_MOVING, "fixed", ""):
            allowed = "revolute, continuous, prismatic or fixed"
            self.fault(place, "type", allowed, kind)
        origin = self.origin(node, place)
        if max(map(abs, origin.position)) > _LONG:
            self.notes.append(f"{place}: the origin is {_FAR.format(origin.position)}")
        axis = self.numbers(node.first("axis"), "xyz", f"{place}, axis", _AXIS)
        if kind in _MOVING and not is_direction(axis):
            self.fault(f"{place}, axis", "xyz", "not zero", " ".join(map(str, axis)))
        lower, upper = self.limits(node, kind, place)
        self.numbers_if_there(node.first("dynamics"), ("damping", "friction"), place)
        return UrdfJoint(
            name=name,
            place=place,
            kind=kind,
            parent=self.end(node, "parent", place),
            child=self.end(node, "child", place),
            position=origin.position,
            rotation=origin.rotation,
            axis=axis,
            lower=lower,
            upper=upper,
            mimic=self.mimic(node, place),
            speed=self.speed(node, place),
        )

    def end(self, node: Node, tag: str, place: str) -> str:
        """Link at one end of a joint."""
        part = node.first(tag)
        if part is None:
            self.faults.append(f"{place}: <{tag}> is missing")
            return ""
        return self.text(part, "link", f"{place}, {tag}")

    def limits(self, node: Node, kind: str, place: str) -> tuple[float, float]:
        """Limits: none if the file has none, one left out is 0.

        ROS demands <limit> with effort and velocity; kinematics and dynamics need
        neither, and files without them are about.
        """
        limit = node.first("limit")
        place = f"{place}, limit"
        self.numbers_if_there(limit, ("effort",), place)
        keys = {"lower", "upper"} & set(() if limit is None else limit.attributes)
        if kind in ("continuous", "fixed") or not keys:
            self.numbers_if_there(limit, ("lower", "upper"), place)
            return -math.inf, math.inf
        lower, upper = (
            self.number(limit, key, place, "0", is_finite=False)
            for key in ("lower", "upper")
        )
        if lower > upper:
            self.faults.append(
                f"{place}: lower must not be above upper, but is {lower} above {upper}"
            )
            return -math.inf, math.inf
        if lower == upper and math.isinf(lower):
            self.faults.append(
                f"{place}: lower and upper must leave a finite position between them, "
                f"but are both {lower}"
            )
        self.check_range(kind, lower, upper, place)
        return lower, upper

    def speed(self, node: Node, place: str) -> float:
        """Fastest motion [rad/s or m/s]; files that do not know it say 0 or nothing."""
        limit = node.first("limit")
        if limit is None or "velocity" not in limit.attributes:
            return math.inf
        key, where = "velocity", f"{place}, limit"
        fastest = self.number(limit, key, where, is_finite=False)
        if fastest < 0:
            self.faults.append(f"{where}: {key} must not be negative, but is {fastest}")
        return fastest if fastest > 0 else math.inf

    def check_range(self, kind: str, lower: float, upper: float, place: str) -> None:
        """Note limits that are as far apart as none are in the unit of a URDF, or 0."""
        if lower == upper and math.isfinite(lower):
            self.notes.append(
                f"{place}: {lower:g} to {upper:g} leaves the joint no motion: were the "
                "limits not filled in?"
            )
        farthest = max((abs(x) for x in (lower, upper) if math.isfinite(x)), default=0)
        if kind == "revolute" and farthest > _MANY_TURNS:
            self.notes.append(
                f"{place}: {lower:g} to {upper:g} rad is more than three turns: is it "
                "in degrees?"
            )
        if kind == "prismatic" and farthest > _LONG:
            self.notes.append(
                f"{place}: {lower:g} to {upper:g} m is very long: is it in millimetres?"
            )

    def mimic(self, node: Node, place: str) -> Mimic | None:
        """Joint that a joint follows, if any."""
        mimic = node.first("mimic")
        if mimic is None:
            return None
        place = f"{place}, mimic"
        name = self.text(mimic, "joint", place)
        multiplier = self.number(mimic, "multiplier", place, "1")
        return Mimic(name, multiplier, self.number(mimic, "offset", place, "0"))

    def origin(self, node: Node, place: str) -> UrdfOrigin:
        """Frame of an <origin>, that of the parent if it is not there."""
        origin = node.first("origin")
        place = f"{place}, origin"
        position = self.numbers(origin, "xyz", place, _ORIGIN)
        if origin is not None and "quat_xyzw" in origin.attributes:
            if "rpy" in origin.attributes:
                self.faults.append(f"{place}: has both rpy and quat_xyzw")
            return UrdfOrigin(position, self.quaternion(origin, place))
        rpy = self.numbers(origin, "rpy", place, _ORIGIN)
        if max(map(abs, rpy)) > _WHOLE_TURN:
            found = " ".join(f"{angle:g}" for angle in rpy)
            self.notes.append(
                f"{place}: rpy {found} rad is more than a turn: is it in degrees?"
            )
        return UrdfOrigin(position, rpy_matrix(*rpy))

    def quaternion(self, origin: Node, place: str) -> Float[np.ndarray, "3 3"]:
        """Rotation of a quaternion (URDF 1.1)."""
        values = self.numbers(origin, "quat_xyzw", place, "0 0 0 1")
        norm = math.hypot(*values)
        if not norm > 0.0:
            self.fault(place, "quat_xyzw", "not zero", origin.attributes["quat_xyzw"])
            return np.eye(3)
        *v, w = np.array(values) / norm
        skew = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
        return np.eye(3) + 2 * w * skew + 2 * skew @ skew

    def text(self, node: Node, key: str, place: str) -> str:
        """Required attribute."""
        text = node.attributes.get(key, "")
        if not text:
            self.faults.append(f"{place}: attribute {key} is missing or empty")
        return text

    def number(
        self,
        node: Node | None,
        key: str,
        place: str,
        default: str | None = None,
        *,
        is_finite: bool = True,
    ) -> float:
        """Attribute that is one number; required without a default."""
        if node is None:
            return float(default or 0.0)
        text = node.attributes.get(key, default)
        if text is None:
            self.faults.append(f"{place}: attribute {key} is missing")
            return 0.0
        is_good = _NUMBER.fullmatch(text.strip()) is not None
        if not is_good or (is_finite and not abs(float(text)) < _TOO_LARGE):
            self.fault(place, key, "a finite number" if is_finite else "a number", text)
            return 0.0
        return float(text)

    def numbers(
        self, node: Node | None, key: str, place: str, default: str
    ) -> tuple[float, ...]:
        """Attribute that is as many finite numbers as its default."""
        text = default if node is None else node.attributes.get(key, default)
        usual = tuple(map(float, default.split()))
        words = text.split()
        is_good = len(words) == len(usual) and all(map(_NUMBER.fullmatch, words))
        values = tuple(map(float, words)) if is_good else (math.inf,)
        if not all(abs(value) < _TOO_LARGE for value in values):
            self.fault(place, key, f"{len(usual)} finite numbers", text)
            return usual
        return values

    def numbers_if_there(
        self, node: Node | None, keys: tuple[str, ...], place: str
    ) -> None:
        """Check attributes that are not used."""
        for key in keys:
            self.number(node, key, place, "0", is_finite=False)

    def fault(self, place: str, key: str, allowed: str, found: str) -> None:
        """Note that an attribute's value is not what is allowed."""
        self.faults.append(f"{place}: {key} must be {allowed}, but is {found!r}")
