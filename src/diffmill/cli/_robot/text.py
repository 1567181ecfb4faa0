"""The description of a robot as lines of text."""

from collections.abc import Sequence

from .facts import JointFacts, ModeFacts, RobotFacts, StaticFacts


def robot_lines(facts: RobotFacts) -> list[str]:
    """Lines that `diffmill robot` prints.

    Args:
        facts: Facts of the robot at a pose.
    """
    width = 2 + max(len("joint"), *(len(row["name"]) for row in facts["joints"]))
    lines = [
        f"{facts['model']}: {len(facts['joints'])} joints, moving mass "
        f"{facts['mass_kg']:.1f} kg",
        f"{'joint':{width}}{'kind':18}{'position':>12}{'limits':>20}{'stiffness K':>21}"
        f"{'damping D':>21}",
        *(_joint_line(row, width) for row in facts["joints"]),
        f"tool: at {_triple(facts['tool_position_mm'], '.1f')} mm, axis "
        f"{_triple(facts['tool_axis'], '.3f')}, in base",
    ]
    if facts["statics"] is not None:
        lines += _static_lines(facts["statics"])
    if facts["modes"]:
        lines += _mode_lines(facts["modes"])
    return [*lines, *(f"note: {note}" for note in facts["notes"])]


def _joint_line(row: JointFacts, width: int) -> str:
    low, high = row["lower"], row["upper"]
    limits = f"{_or_none(low, 'none', '.4g')} to {_or_none(high, 'none', '.4g')}"
    stiffness = "rigid"
    if row["stiffness"] is not None:
        stiffness = f"{row['stiffness']:.4g} {row['stiffness_unit']}"
    damping = f"{row['damping']:.4g} {row['damping_unit']}"
    position = f"{row['position'] + 0.0:.1f} {row['unit']}"
    return (
        f"{row['name']:{width}}{row['kind']:18}{position:>12}{limits:>20}"
        f"{stiffness:>21}{damping:>21}"
    )


def _static_lines(statics: StaticFacts) -> list[str]:
    along = [
        f"{axis} {_or_none(value, 'rigid', '.3f')}"
        for axis, value in zip(
            "xyz", statics["stiffness_along_axes_N_per_um"], strict=True
        )
    ]
    lines = [
        f"stiffness of the tip along base axes [N/um]: {', '.join(along)}",
        "principal stiffness [N/um], direction in base:",
    ]
    for row in statics["principal_stiffness"]:
        value = _or_none(row["stiffness_N_per_um"], "rigid", ".3f")
        lines.append(f"  {value:>8}  {_triple(row['direction'], '.3f')}")
    lines.append(f"deflection of the tip under {statics['load_N']:g} N [mm]:")
    for axis, row in zip("xyz", statics["deflection_mm"], strict=True):
        lines.append(f"  along {axis}: {_triple(row, '.4f')}")
    lines.append(
        f"gravity sag, if the drives do not make up for it: "
        f"{_triple(statics['gravity_sag_mm'], '.3f')} mm, tilt "
        f"{_triple(statics['gravity_tilt_mrad'], '.3f')} mrad"
    )
    return lines


def _mode_lines(modes: Sequence[ModeFacts]) -> list[str]:
    lines = [
        "modes, motors locked: damped frequency, damping ratio and the share of the "
        "joints' springs in each:"
    ]
    for row in modes:
        shares = sorted(row["energy_shares"].items(), key=lambda item: -item[1])
        main = ", ".join(f"{name} {100 * s:.0f} %" for name, s in shares if s > 0.1)
        move = row["tool_direction"]
        along = "tool at rest" if move is None else f"tool along {_triple(move, '.2f')}"
        lines.append(
            f"  {row['frequency_Hz']:8.2f} Hz  damping "
            f"{100 * row['damping_ratio']:6.2f} %  {main}; {along}"
        )
    return lines


def _triple(values: Sequence[float], form: str) -> str:
    # Adding 0 after rounding takes the sign off a zero.
    digits = int(form[1])
    return f"({', '.join(f'{round(v, digits) + 0.0:{form}}' for v in values)})"


def _or_none(value: float | None, absent: str, form: str = "g") -> str:
    return absent if value is None else f"{value:{form}}"
