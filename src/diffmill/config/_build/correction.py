"""`[correction]`: what of it follows from the rest of a job, or does not suit it."""

import dataclasses
import math

from ...cutter import AbstractCutter
from ...settings.correction import CorrectionSettings, ObjectiveSettings
from ...settings.simulation import ModeSettings

# What a corrected command may accelerate unless a job says otherwise, over the program.
_FACTOR = 2.0


def completed_correction(
    table: CorrectionSettings, *, is_recorded: bool
) -> CorrectionSettings:
    """Settings with the keys that a job leaves out.

    Args:
        table: The settings of the file, None for such keys.
        is_recorded: Whether the path is a recorded one. It need not start from rest
            and may hardly accelerate at all, so that a factor of it says nothing.
    """
    is_bound = math.isfinite(table.max_acceleration)
    holds_limits = table.method.holds_limits and table.command == "tip"
    follows = {
        # Who says which error does not count has said which one is allowed.
        "tolerance_band": table.tolerance,
        "max_steps": table.method.steps,
        "acceleration_factor": _FACTOR
        if holds_limits and not is_recorded and not is_bound
        else math.inf,
    }
    missing = {k: v for k, v in follows.items() if getattr(table, k) is None}
    return dataclasses.replace(table, **missing)


def check_correction(
    table: CorrectionSettings,
    cutter: AbstractCutter,
    is_upright: bool,
    problems: list[str],
    *,
    mode: ModeSettings,
) -> None:
    """Faults of settings beside the cutter, the path, the mode or other settings."""
    _check_segments(table, mode, problems)
    needs = table.objective.needs_surface
    others = ObjectiveSettings.each().values()
    allowed = ", ".join(f'"{one.name}"' for one in others if not one.needs_surface)
    for key, found, is_asked, instead in (
        ("objective", f'"{table.objective.name}"', needs, allowed),
        ("gouge", "a limit", math.isfinite(table.gouge), "none"),
        ("stay_in_cut", "true", table.stay_in_cut, "false"),
    ):
        if is_asked and not (cutter.is_plain and is_upright):
            problems.append(
                f"[correction] {key}: found {found}, which needs a flat cutter "
                f"along +z; allowed here: {instead}"
            )
    problems.extend(f"[correction] {fault}" for fault in table.objective.faults())
    problems.extend(f"[correction] {fault}" for fault in table.misplaced())


def _check_segments(
    table: CorrectionSettings, mode: ModeSettings, problems: list[str]
) -> None:
    """Faults of a horizon beside strategies of whole paths, or a longer overlap."""
    objective, method = table.objective, table.optimiser
    for beside, is_whole in (
        (f'objective = "{objective.name}"', objective.needs_whole_path),
        ("an uncertainty", table.uncertainty is not None),
        (f'method = "{method.name}"', method.needs_whole_path),
        (f'[simulation] mode = "{mode.name}"', mode.needs_whole_path),
    ):
        if table.horizon != "auto" and is_whole:
            problems.append(
                f"[correction] horizon: found {table.horizon} beside {beside}, which "
                'needs the whole path; only "auto" is allowed'
            )
    sizes = table.horizon, table.overlap
    if "auto" not in sizes and int(table.overlap) >= int(table.horizon):
        problems.append(
            f"[correction] overlap: found {table.overlap}, but less than the horizon, "
            f"{table.horizon}, is required"
        )
