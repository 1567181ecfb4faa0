"""The machine of a job that is given by its modes at the tool tip."""

import numpy as np

from ..._toml import JobError, read_toml
from ...robot import TipModes, rpy_matrix
from ...settings.tables import validated
from .._check.ranges import range_notes
from .._schema.machine import MachineTable, ModesFile, ModeTable
from .context import FileContext

# A mode of a smaller share of the tip's compliance needs no sub-steps of its own.
_SHARE = 0.05
# Of many modes none may have that share: then those count that are so near the largest.
_NEAR = 0.5


def read_machine(table: MachineTable, context: FileContext) -> TipModes | None:
    """Modes of a machine at the tool tip; None after a fault.

    Args:
        table: The `[machine]` table.
        context: The job file.
    """
    problems, before = context.problems, len(context.problems)
    if (table.modes is None) == (table.file is None):
        found = "nothing" if table.modes is None else "both"
        problems.append(
            f"[machine]: found {found} of modes and file, but exactly one is required: "
            "[[machine.modes]], or a file with them"
        )
        return None
    entries = table.modes
    if table.file is not None:
        entries = _from_file(table.file, context)
    if entries is None:
        return None
    for k, entry in enumerate(entries):
        entry.check(f"[machine] modes.{k}", problems)
    if len(problems) > before:
        return None
    to_work = np.asarray(rpy_matrix(*table.rpy), np.float64)
    modes = TipModes(
        np.array([entry.frequency for entry in entries]),
        np.array([entry.damping_ratio for entry in entries]),
        np.array([entry.shape() for entry in entries]) @ to_work.T,
    )
    carried = np.asarray(modes.participation, np.float64) * table.carries()[None]
    return TipModes(modes.frequencies, modes.damping_ratios, modes.shapes, carried)


def fastest_mode(modes: TipModes) -> float:
    """Highest frequency of a mode that a force deflects at the tip [Hz]."""
    frequencies = np.asarray(modes.frequencies, np.float64)
    gives = np.sum(np.asarray(modes.shapes) ** 2, axis=1) / frequencies**2
    least = min(_SHARE * gives.sum(), _NEAR * gives.max())
    return float(frequencies[gives > least].max())


def _from_file(name: str, context: FileContext) -> list[ModeTable] | None:
    """Modes of a file; None after a fault."""
    path = context.file(name, "[machine] file")
    if path is None:
        return None
    try:
        raw = read_toml(path).tables
    except JobError as error:
        context.problems.append(f"[machine] file: {error}")
        return None
    context.notes.extend(f"{name}: {note}" for note in range_notes(raw))
    found = validated(
        ModesFile, raw.get("machine", {}), f"{name}: [machine]", context.problems
    )
    return None if found is None else found.modes
