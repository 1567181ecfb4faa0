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


_SPEED = _Range("0.01 mm/s", "5 m/s", q.SPEED)
_ACCELERATION = _Range("0.001 m/s^2", "100 m/s^2", q.ACCELERATION)
_DELAY = _Range("0 s", "2 s", q.TIME)
_MODE = _Range("0.1 Hz", "50 kHz", q.FREQUENCY)
_PLACE = _Range("0 m", "20 m", q.LENGTH)
_REACH = _Range("0 m", "3 m", q.LENGTH)
_LENGTH = _Range("0.1 mm", "1 m", q.LENGTH)
_WIDTH = _Range("0.05 mm", "300 mm", q.LENGTH)
_OFFSET = _Range("0 mm", "20 mm", q.LENGTH)
_ERROR = _Range("0 mm", "2 mm", q.LENGTH)
_TURN = _Range("0 deg", "360 deg", q.ANGLE)
_LINEAR = _Range("1 N/mm", "100000 N/um", q.LINEAR_STIFFNESS)
_ROTARY = _Range("100 N*m/rad", "1e11 N*m/rad", q.ROTARY_STIFFNESS)
_DAMPING = _Range("0 N*s/m", "1e7 N*s/m", q.LINEAR_DAMPING)
_ROTARY_DAMPING = _Range("0 N*m*s/rad", "1e7 N*m*s/rad", q.ROTARY_DAMPING)
_MASS = _Range("0.1 g", "100000 kg", q.MASS)
_INERTIA = _Range("1e-9 kg*m^2", "1e6 kg*m^2", q.INERTIA)
# By the key of the job; of a key that may have several units each has its range.
_USUAL: dict[str, tuple[_Range, ...]] = {
    "cutter.diameter": (_WIDTH,),
    "cutter.corner_radius": (_Range("0.01 mm", "100 mm", q.LENGTH),),
    "cutter.flute_length": (_WIDTH,),
    "cutter.helix_angle": (_Range("0 deg", "65 deg", q.ANGLE),),
    "cutter.runout": (_Range("0 mm", "0.2 mm", q.LENGTH),),
    "cutter.overhang": (_LENGTH,),
    "cutter.holder.diameter": (_LENGTH,),
    "cutter.holder.upper_diameter": (_LENGTH,),
    "cutter.holder.length": (_LENGTH,),
    "spindle.speed": (_Range("20 rpm", "200000 rpm", q.ANGULAR_SPEED),),
    "force.K_c": (_Range("0 N/mm^2", "50000 N/mm^2", q.PRESSURE),),
    "force.K_e": (_Range("0 N/mm", "1000 N/mm", q.EDGE_FORCE),),
    "stock.lower": (_PLACE,),
    "stock.upper": (_PLACE,),
    "stock.spacing": (_Range("1 um", "20 mm", q.LENGTH),),
    "program.feed": (_SPEED,),
    "program.rapid_feed": (_SPEED,),
    "program.acceleration": (_ACCELERATION,),
    "program.corner_tolerance": (_Range("0 mm", "10 mm", q.LENGTH),),
    "program.smoothing": (_Range("0 s", "5 s", q.TIME),),
    "program.jerk": (_Range("0.01 m/s^3", "1e5 m/s^3", q.JERK),),
    "program.joint_ramp": (_Range("0 s", "5 s", q.TIME),),
    "robot.joint_stiffness": (_ROTARY, _LINEAR),
    "robot.joint_damping": (_ROTARY_DAMPING, _DAMPING),
    "robot.work_in_base.position": (_PLACE,),
    "robot.work_in_base.rpy": (_TURN,),
    "robot.tool_in_flange.position": (_REACH,),
    "robot.tool_in_flange.rpy": (_TURN,),
    "robot.flange_spring.linear_stiffness": (_LINEAR,),
    "robot.flange_spring.rotary_stiffness": (_ROTARY,),
    "robot.flange_spring.mass": (_MASS,),
    "robot.flange_spring.center_of_mass": (_REACH,),
    "robot.flange_spring.inertia": (_INERTIA,),
    "robot.bending_tool.overhang": (_LENGTH,),
    "robot.bending_tool.shank_diameter": (_WIDTH,),
    "robot.bending_tool.young_modulus": (_Range("10 GPa", "1200 GPa", q.MODULUS),),
    "robot.bending_tool.density": (_Range("1 g/cm^3", "25 g/cm^3", q.DENSITY),),
    "machine.modes.frequency": (_MODE,),
    "machine.modes.stiffness": (_LINEAR,),
    "machine.modes.mass": (_MASS,),
    "machine.rpy": (_TURN,),
    "controller.interpolation_cycle": (_DELAY,),
    "controller.moving_average": (_DELAY,),
    "controller.dead_time": (_DELAY,),
    "controller.shaper.frequency": (_MODE,),
    "controller.low_pass": (_MODE,),
    "controller.bandwidth": (_MODE,),
    "simulation.element_height": (_Range("1 um", "50 mm", q.LENGTH),),
    "correction.tolerance": (_ERROR,),
    "correction.tolerance_band": (_ERROR,),
    "correction.knot_spacing": (_Range("0.1 ms", "2 s", q.TIME),),
    "correction.max_offset": (_OFFSET,),
    "correction.max_velocity": (_SPEED,),
    "correction.max_acceleration": (_ACCELERATION,),
    "correction.gouge": (_ERROR,),
    "correction.start_spread": (_ERROR,),
    "correction.uncertainty.delay": (_DELAY,),
    "output.tolerance": (_ERROR,),
    "output.stream_cycle": (_Range("0 s", "1 s", q.TIME),),
    "output.max_step": (_OFFSET,),
}
# Of plain numbers.
_USUAL_NUMBERS: dict[str, tuple[float, float]] = {
    "cutter.teeth": (1, 24),
    "machine.modes.damping_ratio": (0, 0.5),
    "robot.flange_spring.damping_ratio": (0, 0.5),
    "robot.bending_tool.damping_ratio": (0, 0.5),
    "controller.damping_ratio": (0.05, 5),
    "controller.shaper.damping_ratio": (0, 0.5),
    "correction.acceleration_factor": (1, 100),
    "correction.wall_weight": (1e-6, 1e6),
    "correction.floor_weight": (1e-6, 1e6),
    "correction.weight.value": (1e-6, 1e6),
}


def range_notes(raw: Mapping[str, object]) -> Iterator[str]:
    """Yield a note for each value of a job that is far from any machine's.

    Args:
        raw: The parsed TOML; faults in it are told elsewhere.
    """
    for place, key, value in _leaves(raw, "", ""):
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
    """Return the ranges of a key; coefficients of all laws are of two kinds."""
    table, _, name = key.partition(".")
    name = name.removeprefix("bottom.")
    if table == "force" and name.startswith("K_"):
        key = "force.K_e" if name.endswith("e") else "force.K_c"
    return _USUAL.get(key, ())


def _leaves(value: object, place: str, key: str) -> Iterator[tuple[str, str, object]]:
    """Yield the values of a table with their place and their key."""
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
    """Return the range of a quantity that it is outside of."""
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
    """Return the range of a plain number that it is outside of."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return None
    least, most = _USUAL_NUMBERS.get(key, (-math.inf, math.inf))
    # Zero leaves something out, infinite stands for no limit.
    is_usual = value == 0 or math.isinf(value) or least <= value <= most
    return None if is_usual else (f"{least:g}", f"{most:g}")
