"""Notes on values outside the range of machines that are about: a slip of a unit."""

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from ... import units as q


class _Range(NamedTuple):
    """Usual sizes of a quantity, in units that people write; zero is one of them."""

    least: str
    most: str
    kind: q.QuantityKind


_SPEED = _Range("0.01 mm/s", "2 m/s", q.SPEED)
_FAST = _Range("1 mm/s", "5 m/s", q.SPEED)
_ACCELERATION = _Range("0.01 m/s^2", "30 m/s^2", q.ACCELERATION)
_RAMP = _Range("0.1 ms", "5 s", q.TIME)
_DELAY = _Range("0.1 ms", "0.5 s", q.TIME)
_CYCLE = _Range("0.1 ms", "0.2 s", q.TIME)
_MODE = _Range("0.5 Hz", "20 kHz", q.FREQUENCY)
_SERVO = _Range("0.1 Hz", "1 kHz", q.FREQUENCY)
_PLACE = _Range("0 m", "20 m", q.LENGTH)
_BLOCK = _Range("0 m", "5 m", q.LENGTH)
_REACH = _Range("0 m", "3 m", q.LENGTH)
_LENGTH = _Range("0.1 mm", "1 m", q.LENGTH)
_WIDTH = _Range("0.05 mm", "300 mm", q.LENGTH)
_OFFSET = _Range("2 um", "20 mm", q.LENGTH)
_ERROR = _Range("0.01 um", "2 mm", q.LENGTH)
_RUNOUT = _Range("0.01 um", "0.2 mm", q.LENGTH)
_SMALL_TURN = _Range("0.1 urad", "20 mrad", q.ANGLE)
_SLOPE = _Range("0.01 deg", "65 deg", q.ANGLE)
_TURN = _Range("0 deg", "360 deg", q.ANGLE)
_WARP = _Range("0 deg", "3 deg", q.ANGLE)
_LINEAR = _Range("10 N/mm", "20000 N/um", q.LINEAR_STIFFNESS)
_ROTARY = _Range("100 N*m/rad", "1e9 N*m/rad", q.ROTARY_STIFFNESS)
_DAMPING = _Range("1 N*s/m", "1e7 N*s/m", q.LINEAR_DAMPING)
_ROTARY_DAMPING = _Range("0.01 N*m*s/rad", "1e6 N*m*s/rad", q.ROTARY_DAMPING)
# By the key of the job; of a key that may have several units each has its range.
_USUAL: dict[str, tuple[_Range, ...]] = {
    "cutter.diameter": (_WIDTH,),
    "cutter.corner_radius": (_Range("0.01 mm", "100 mm", q.LENGTH),),
    "cutter.flute_length": (_WIDTH,),
    "cutter.helix_angle": (_SLOPE,),
    "cutter.runout": (_RUNOUT,),
    "cutter.runout_angle": (_TURN,),
    "cutter.dish_angle": (_SLOPE,),
    "cutter.overhang": (_LENGTH,),
    "cutter.holder.diameter": (_LENGTH,),
    "cutter.holder.upper_diameter": (_LENGTH,),
    "cutter.holder.length": (_LENGTH,),
    "spindle.speed": (_Range("20 rpm", "200000 rpm", q.ANGULAR_SPEED),),
    "force.K_tc": (_Range("10 N/mm^2", "50000 N/mm^2", q.PRESSURE),),
    "force.K_c": (_Range("0.1 N/mm^2", "50000 N/mm^2", q.PRESSURE),),
    "force.K_e": (_Range("0.01 N/mm", "150 N/mm", q.EDGE_FORCE),),
    "force.reference_thickness": (_Range("1 um", "10 mm", q.LENGTH),),
    "force.least_thickness": (_Range("0.001 um", "0.1 mm", q.LENGTH),),
    "stock.lower": (_BLOCK,),
    "stock.upper": (_BLOCK,),
    "stock.spacing": (_Range("2 um", "20 mm", q.LENGTH),),
    "program.feed": (_SPEED,),
    "program.rapid_feed": (_FAST,),
    "program.acceleration": (_ACCELERATION,),
    "program.corner_tolerance": (_Range("0.1 um", "10 mm", q.LENGTH),),
    "program.smoothing": (_RAMP,),
    "program.jerk": (_Range("0.01 m/s^3", "1e5 m/s^3", q.JERK),),
    "program.joint_ramp": (_RAMP,),
    "program.offsets": (_PLACE,),
    "program.tool_lengths": (_REACH,),
    "program.tool_radii": (_REACH,),
    "program.machine_zero": (_PLACE,),
    "program.reference_point": (_PLACE,),
    "program.second_reference_point": (_PLACE,),
    "robot.joint_stiffness": (_ROTARY, _LINEAR),
    "robot.joint_damping": (_ROTARY_DAMPING, _DAMPING),
    "robot.work_in_base.position": (_PLACE,),
    "robot.work_in_base.rpy": (_TURN,),
    "robot.tool_in_flange.position": (_REACH,),
    "robot.tool_in_flange.rpy": (_TURN,),
    "robot.calibration.displacement": (_Range("0 m", "20 mm", q.LENGTH),),
    "robot.calibration.rotation": (_WARP,),
    "robot.calibration.joint_offsets": (_WARP, _Range("0 m", "50 mm", q.LENGTH)),
    "robot.calibration.waves": (_Range("0 rad", "5 mrad", q.ANGLE),),
    "robot.calibration.wave_period": (_Range("0.5 deg", "360 deg", q.ANGLE),),
    "robot.calibration.tool": (_REACH,),
    "robot.flange_spring.linear_stiffness": (
        _Range("1 N/um", "20000 N/um", q.LINEAR_STIFFNESS),
    ),
    "robot.flange_spring.rotary_stiffness": (
        _Range("1e4 N*m/rad", "1e9 N*m/rad", q.ROTARY_STIFFNESS),
    ),
    "robot.flange_spring.mass": (_Range("0.1 kg", "2000 kg", q.MASS),),
    "robot.flange_spring.center_of_mass": (_Range("0 m", "1 m", q.LENGTH),),
    "robot.flange_spring.inertia": (_Range("1e-5 kg*m^2", "1000 kg*m^2", q.INERTIA),),
    "robot.bending_tool.overhang": (_LENGTH,),
    "robot.bending_tool.shank_diameter": (_WIDTH,),
    "robot.bending_tool.young_modulus": (_Range("100 GPa", "1200 GPa", q.MODULUS),),
    "robot.bending_tool.density": (_Range("1 g/cm^3", "25 g/cm^3", q.DENSITY),),
    "machine.modes.frequency": (_MODE,),
    "machine.modes.stiffness": (_LINEAR,),
    "machine.modes.mass": (_Range("0.1 g", "100000 kg", q.MASS),),
    "machine.rpy": (_TURN,),
    "controller.interpolation_cycle": (_CYCLE,),
    "controller.moving_average": (_RAMP,),
    "controller.dead_time": (_DELAY,),
    "controller.shaper.frequency": (_MODE,),
    "controller.low_pass": (_SERVO,),
    "controller.bandwidth": (_SERVO,),
    "simulation.axial_depth": (_Range("2 um", "300 mm", q.LENGTH),),
    "simulation.element_height": (_Range("2 um", "50 mm", q.LENGTH),),
    "correction.tolerance": (_ERROR,),
    "correction.tolerance_band": (_Range("0.1 um", "2 mm", q.LENGTH),),
    "correction.knot_spacing": (_Range("0.1 ms", "2 s", q.TIME),),
    "correction.max_offset": (_OFFSET,),
    "correction.max_velocity": (_FAST,),
    "correction.max_acceleration": (_ACCELERATION,),
    "correction.gouge": (_ERROR,),
    "correction.start_spread": (_ERROR,),
    "correction.uncertainty.delay": (_DELAY,),
    "output.tolerance": (_Range("1e-6 um", "0.2 mm", q.LENGTH),),
    "output.stream_cycle": (_CYCLE,),
    "output.max_step": (_Range("0.1 um", "20 mm", q.LENGTH),),
}
_DAMPING_RATIO, _WEIGHT, _SPREAD = (1e-4, 0.3), (1e-2, 100), (1e-3, 0.9)
# Of plain numbers.
_USUAL_NUMBERS: dict[str, tuple[float, float]] = {
    "cutter.teeth": (1, 24),
    "force.m_t": (0.01, 0.8),
    "force.m_r": (0.01, 0.8),
    "force.m_a": (0.01, 0.8),
    "machine.modes.damping_ratio": _DAMPING_RATIO,
    "robot.flange_spring.damping_ratio": _DAMPING_RATIO,
    "robot.bending_tool.damping_ratio": _DAMPING_RATIO,
    "robot.bending_tool.flute_share": (0.4, 1),
    "controller.damping_ratio": (0.05, 5),
    "controller.shaper.damping_ratio": _DAMPING_RATIO,
    "simulation.angles": (1, 10_000),
    "simulation.substeps": (1, 200),
    "correction.acceleration_factor": (1, 100),
    "correction.wall_weight": _WEIGHT,
    "correction.floor_weight": _WEIGHT,
    "correction.weight.value": _WEIGHT,
}
# Of machine errors, in every table that states them.
_ERROR_TABLES = ("simulation.scatter", "correction.uncertainty", "truth")
_USUAL |= {
    f"{table}.{key}": (usual,)
    for table in _ERROR_TABLES
    for key, usual in (
        ("links", _OFFSET),
        ("link_angles", _SMALL_TURN),
        ("backlash", _SMALL_TURN),
        ("friction", _SMALL_TURN),
        ("presliding", _SMALL_TURN),
        ("registration", _ERROR),
        ("registration_angles", _SMALL_TURN),
        ("runout", _RUNOUT),
    )
}
_USUAL_NUMBERS |= {
    f"{table}.{key}": _SPREAD
    for table in _ERROR_TABLES
    for key in ("stiffness", "damping", "force", "bandwidth")
}
# Of which zero is unusual, too: what swings ends to swing.
_NEVER_ZERO = (
    "machine.modes.damping_ratio",
    "robot.flange_spring.damping_ratio",
    "robot.bending_tool.damping_ratio",
)
# Whose keys the user names.
_OF_NAMES = ("program.offsets", "program.tool_lengths", "program.tool_radii")
# Coefficients that push the tool away from what it cuts, or rub.
_POSITIVE = ("K_rc", "K_te", "K_re", "K_rc11")


def range_notes(raw: Mapping[str, object]) -> Iterator[str]:
    """Notes, one for each value of a job that is far from any machine's.

    Args:
        raw: The parsed TOML; faults in it are told elsewhere.
    """
    for place, key, value in _leaves(raw, "", ""):
        table, _, name = key.partition(".")
        is_positive = table == "force" and name.removeprefix("bottom.") in _POSITIVE
        if is_positive and isinstance(value, str) and value.lstrip().startswith("-"):
            yield f"{place}: found {value!r}; below 0 is unusual: is its sign meant?"
        if isinstance(value, str):
            found = _outside(value, _usual(key))
        else:
            found = _number_outside(value, key)
        if found is not None:
            least, most = found
            yield (
                f"{place}: found {value!r}; {least} to {most} are usual: are number "
                "and unit what is meant?"
            )


def _usual(key: str) -> tuple[_Range, ...]:
    """Usual ranges of a key; coefficients of all laws are of two kinds."""
    for names in _OF_NAMES:
        key = names if key.startswith(f"{names}.") else key
    table, _, name = key.partition(".")
    if table == "force":
        name = name.removeprefix("bottom.").removesuffix("11")
        if name.startswith("K_") and name != "K_tc":
            name = "K_e" if name.endswith("e") else "K_c"
        key = f"force.{name}"
    return _USUAL.get(key, ())


def _leaves(value: object, place: str, key: str) -> Iterator[tuple[str, str, object]]:
    """Values of a table with their place and their key."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            where = f"{place} {name}" if place else f"[{name}]"
            yield from _leaves(inner, where, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list):
        for inner in value:
            yield from _leaves(inner, place, key)
    else:
        yield place, key, value


def _outside(text: str, ranges: tuple[_Range, ...]) -> tuple[str, str] | None:
    """Usual range of a quantity outside of it, else None."""
    for usual in ranges:
        try:
            size = abs(q.quantity(text, usual.kind))
        except ValueError:
            # Of another dimension, or a fault that is told elsewhere.
            continue
        least, most = (q.quantity(x, usual.kind) for x in (usual.least, usual.most))
        return None if size == 0 or least <= size <= most else usual[:2]
    return None


def _number_outside(value: object, key: str) -> tuple[str, str] | None:
    """Usual range of a plain number outside of it, else None."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return None
    key = key.replace("force.bottom.", "force.")
    least, most = _USUAL_NUMBERS.get(key, (-math.inf, math.inf))
    # Zero leaves something out, infinite stands for no limit.
    is_left_out = value == 0 and key not in _NEVER_ZERO
    is_usual = is_left_out or math.isinf(value) or least <= value <= most
    return None if is_usual else (f"{least:g}", f"{most:g}")
