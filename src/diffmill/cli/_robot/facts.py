"""Facts about a robot at a pose, with units in the keys, as JSON."""

from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Complex, Float

    from ...robot import Robot

    # jaxtyping checks what it can see; at run time nothing of the kind is imported.
    JointPositions = Float[np.ndarray, " joint"]
    ComplexShape = Complex[np.ndarray, " 3"]
else:
    JointPositions = ComplexShape = Any

_LOAD_N = 100.0
# A damper of this share of the others is none.
_UNDAMPED_SHARE = 1e-3


class JointFacts(TypedDict):
    """A joint: degrees and N m/rad, or millimetres and N/m; None for what is absent."""

    name: str
    kind: str
    unit: str
    position: float
    lower: float | None
    upper: float | None
    stiffness: float | None
    stiffness_unit: str
    damping: float
    damping_unit: str


class PrincipalStiffness(TypedDict):
    """Stiffness of the tip, None where it is rigid, along a direction in the base."""

    stiffness_N_per_um: float | None
    direction: list[float]


class StaticFacts(TypedDict):
    """Stiffness, deflection and sag of the tool's tip."""

    stiffness_along_axes_N_per_um: list[float | None]
    principal_stiffness: list[PrincipalStiffness]
    load_N: float
    deflection_mm: list[list[float]]
    gravity_sag_mm: list[float]
    gravity_tilt_mrad: list[float]


class ModeFacts(TypedDict):
    """A mode that rings, and how the tool moves in it; None where it is at rest."""

    frequency_Hz: float
    damping_ratio: float
    energy_shares: dict[str, float]
    tool_direction: list[float] | None


class RobotFacts(TypedDict):
    """A robot; `statics` and `modes` are None where no joint has a spring."""

    model: str
    joints: list[JointFacts]
    mass_kg: float
    tool_position_mm: list[float]
    tool_axis: list[float]
    statics: StaticFacts | None
    modes: list[ModeFacts] | None
    notes: list[str]


def robot_facts(robot: "Robot", q: "JointPositions") -> RobotFacts:
    """Facts about a robot at a pose, with units in the keys.

    Args:
        robot: The robot.
        q: Joint positions [rad or m], shape (joint,).
    """
    from ...robot import forward_kinematics

    T = np.asarray(forward_kinematics(robot, q))
    K = np.asarray(robot.joint_stiffness)
    is_soft = bool(np.isfinite(K).any())
    notes: list[str] = []
    modes = None
    if is_soft:
        try:
            modes = _modes(robot, q)
        except ValueError as error:
            notes.append(str(error))
    overdamped = int(np.isfinite(K).sum()) - len(modes or [])
    if modes is not None and overdamped:
        notes.append(
            f"modes that do not oscillate, so strong are their dampers: {overdamped}"
        )
    if np.isinf(K).all():
        notes.append(
            "no joint has a spring, so nothing bends; give the joints stiffness and "
            "damping in a robot file, in a file for --drives, or in a job with drives, "
            "joint_stiffness and joint_damping"
        )
    elif np.isinf(K).any():
        rigid = [n for n, k in zip(robot.joint_names, K, strict=True) if np.isinf(k)]
        notes.append(f"joints without a spring, taken as rigid: {', '.join(rigid)}")
    notes += _damping_notes(robot)
    return {
        "model": robot.name,
        "joints": _joints(robot, q),
        "mass_kg": float(np.sum(np.asarray(robot.link_masses))),
        "tool_position_mm": (1e3 * T[:3, 3]).tolist(),
        "tool_axis": T[:3, 2].tolist(),
        "statics": _statics(robot, q) if is_soft else None,
        "modes": modes,
        "notes": notes,
    }


def _damping_notes(robot: "Robot") -> list[str]:
    """Note for each joint that is hardly damped beside others of its kind."""
    D, notes = np.asarray(robot.joint_damping, float), []
    kinds = np.array(robot.joint_kinds)
    is_soft = np.isfinite(np.asarray(robot.joint_stiffness)) & ~np.asarray(
        robot.is_virtual
    )
    for k in np.flatnonzero(is_soft):
        others = D[is_soft & (kinds == kinds[k]) & (np.arange(len(D)) != k)]
        if others.size and 0 < D[k] < _UNDAMPED_SHARE * np.median(others):
            unit = "N s/m" if kinds[k] == "prismatic" else "N m s/rad"
            notes.append(
                f"{robot.joint_names[k]} is practically undamped: {D[k]:.3g} {unit} "
                f"beside {others.min():.4g} to {others.max():.4g} of the others"
            )
    return notes


def _joints(robot: "Robot", q: "JointPositions") -> list[JointFacts]:
    """Row per joint: degrees and N m/rad, or millimetres and N/m."""
    rows: list[JointFacts] = []
    for k, (name, kind) in enumerate(
        zip(robot.joint_names, robot.joint_kinds, strict=True)
    ):
        slides = kind == "prismatic"
        scale, unit = (1e3, "mm") if slides else (180.0 / np.pi, "deg")
        rows.append(
            {
                "name": name,
                "kind": f"virtual {kind}" if robot.is_virtual[k] else kind,
                "unit": unit,
                "position": float(q[k]) * scale,
                "lower": _finite(float(robot.joint_lower[k]) * scale),
                "upper": _finite(float(robot.joint_upper[k]) * scale),
                "stiffness": _finite(float(robot.joint_stiffness[k])),
                "stiffness_unit": "N/m" if slides else "N m/rad",
                "damping": float(robot.joint_damping[k]),
                "damping_unit": "N s/m" if slides else "N m s/rad",
            }
        )
    return rows


def _finite(value: float) -> float | None:
    """Value as JSON can hold it: None for infinity."""
    return value if np.isfinite(value) else None


def _statics(robot: "Robot", q: "JointPositions") -> StaticFacts:
    """Stiffness, deflection and sag of the tool's tip."""
    from ...robot import cartesian_compliance, gravity_sag, static_deflection

    C = np.asarray(cartesian_compliance(robot, q))[:3, :3]
    softness, directions = np.linalg.eigh(C)
    is_soft = softness > 1e-12 * softness[-1]
    principal = [
        PrincipalStiffness(
            stiffness_N_per_um=1e-6 / s if soft else None,
            direction=(d * np.sign(d[np.argmax(np.abs(d))])).tolist(),
        )
        for s, d, soft in zip(softness, directions.T, is_soft, strict=True)
    ][::-1]
    along = np.diag(C)
    deflection = [
        1e3 * np.asarray(static_deflection(robot, q, _LOAD_N * np.eye(6)[i])[:3])
        for i in range(3)
    ]
    sag = np.asarray(gravity_sag(robot, q))
    return {
        "stiffness_along_axes_N_per_um": [
            1e-6 / s if s > 1e-12 * softness[-1] else None for s in along
        ],
        "principal_stiffness": principal,
        "load_N": _LOAD_N,
        "deflection_mm": [row.tolist() for row in deflection],
        "gravity_sag_mm": (1e3 * sag[:3]).tolist(),
        "gravity_tilt_mrad": (1e3 * sag[3:]).tolist(),
    }


def _modes(robot: "Robot", q: "JointPositions") -> list[ModeFacts]:
    """Frequency, damping and shape of every mode that rings."""
    from ...robot import damped_modes

    modes = damped_modes(robot, q)
    return [
        {
            "frequency_Hz": float(frequency),
            # Rounding may put an undamped mode below 0.
            "damping_ratio": max(float(ratio), 0.0),
            "energy_shares": dict(zip(robot.joint_names, shares.tolist(), strict=True)),
            "tool_direction": _direction(shape[:3]),
        }
        for frequency, ratio, shares, shape in zip(
            modes.frequencies,
            modes.damping_ratios,
            modes.energy_shares,
            modes.tool_shapes,
            strict=True,
        )
    ]


def _direction(shape: "ComplexShape") -> list[float] | None:
    """Direction of the largest motion in a cycle, None without motion."""
    # Turned by this phase, the real part is the longer half axis of the ellipse.
    move = (shape * np.exp(-0.5j * np.angle(np.sum(shape**2)))).real
    size = float(np.linalg.norm(move))
    if not size > 0.0:
        return None
    # The greatest entry is positive.
    return (move / size * np.sign(move[np.argmax(np.abs(move))])).tolist()
