"""A small job, of which a test writes the tables that it is about."""

import copy
import json
from collections.abc import Mapping
from typing import Any

# A short move beside the block.
PROGRAM = "G21 G17 G90 G94\nG0 X-9 Y4 Z1\nG1 X-8 F6000\nM2\n"
# A slot of 20 mm, one deep.
SLOT = "G21 G17 G90 G94\nG0 X-6 Y5 Z1\nG0 Z-1\nG1 X20 F3000\nG0 Z1\nM2\n"
SLOT_STOCK = {"stock.upper": ["20 mm", "10 mm", "0 mm"], "stock.spacing": "0.25 mm"}
# A cut into the side of the block.
CUTS = "G21 G17 G90 G94\nG0 X-5.2 Y3 Z1\nG0 Z-0.5\nG1 X-2 F3000\nG0 X-6\nM2\n"

# A spindle on turning springs, which the last link of the milling arm holds.
FLANGE_SPRING = """
[robot.flange_spring]
rotary_stiffness = ["2e6 N*m/rad", "3e6 N*m/rad", "4e6 N*m/rad"]
mass = "30 kg"
center_of_mass = ["0 mm", "0 mm", "170 mm"]
inertia = ["0.75 kg*m^2", "0.75 kg*m^2", "0.2 kg*m^2"]
"""
ARM = {
    "model": "reis_rv130_like",
    "work_in_base": {"position": ["1525 mm", "-5 mm", "936 mm"]},
}
TABLES = {
    "cutter": {"kind": "flat", "diameter": "10 mm", "teeth": 2},
    "spindle": {"speed": "8000 rpm"},
    "force": {"K_tc": "989.8 N/mm^2", "K_rc": "337.3 N/mm^2", "K_ac": "66.9 N/mm^2"},
    "stock": {
        "lower": ["0 mm", "0 mm", "-3 mm"],
        "upper": ["8 mm", "8 mm", "0 mm"],
        "spacing": "0.5 mm",
    },
    "program": {"file": "part.ngc"},
    "robot": {"rigid": True},
}


def small_job(cutter, *, program="part.ngc", more=""):
    """Return the text of a job with some lines of its cutter and more tables."""
    tables = {key: table for key, table in TABLES.items() if key != "cutter"}
    tables["program"] = {"file": program}
    return f"[cutter]\n{cutter}\n{toml(tables)}{more}\n"


def toml(tables: Mapping[str, Any]) -> str:
    """Text of tables; what is no table at the top stands before them."""
    own = {key: one for key, one in tables.items() if not isinstance(one, Mapping)}
    text = [f"{key} = {_value(one)}" for key, one in own.items()]
    for name, table in tables.items():
        if name not in own:
            text.append(f"[{name}]")
            text += [f"{key} = {_value(one)}" for key, one in table.items()]
    return "\n".join(text) + "\n"


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{k} = {_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    # JSON spells inf and nan otherwise.
    return str(float(value)) if isinstance(value, float) else json.dumps(value)


def arm_text(*elements: Mapping[str, Any], name: str = "arm") -> str:
    """Text of a robot file of some elements."""
    rows = [[f"{key} = {_value(one)}" for key, one in x.items()] for x in elements]
    parts = ["\n".join(["[[elements]]", *row]) for row in rows]
    return "\n".join([f'name = "{name}"', *parts]) + "\n"


def slide(name: str, axis: int, **keys: Any) -> dict[str, Any]:
    """A slide along an axis, of which 0 is x, with more keys."""
    way = [int(k == axis) for k in range(3)]
    return {"kind": "prismatic", "name": name, "axis": way, **keys}


def body(mass: str, **keys: Any) -> dict[str, Any]:
    """A body with moments of inertia of 1 kg m^2."""
    return {"kind": "body", "mass": mass, "inertia": 3 * ["1 kg*m^2"], **keys}


def job_text(*changes: Mapping[str, Any]) -> str:
    """Text of the small job with other values by key, such as "cutter.teeth".

    A key without a point sets a whole table; None leaves a key or a table out.
    """
    tables: dict[str, Any] = copy.deepcopy(TABLES)
    for key, value in [item for change in changes for item in change.items()]:
        *path, name = key.split(".")
        table = tables
        for part in path:
            table = table.setdefault(part, {})
        table[name] = copy.deepcopy(value)
        if value is None:
            del table[name]
    return toml(tables)


def write_job(folder, *changes: Mapping[str, Any], program: str = SLOT):
    """Write a small job with changes, and `part.ngc` beside it; return its path."""
    (folder / "part.ngc").write_text(program)
    (folder / "job.toml").write_text(job_text(*changes))
    return folder / "job.toml"


def problems_of(file, **options) -> tuple[str, ...]:
    """Return the faults of a job that is refused, by which nothing is written."""
    import pytest

    from diffmill import JobError, load_job

    before = sorted(file.parent.rglob("*"))
    with pytest.raises(JobError) as error:
        load_job(file, **options)
    assert sorted(file.parent.rglob("*")) == before
    assert str(file) in str(error.value)
    return error.value.problems
