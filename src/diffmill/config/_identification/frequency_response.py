"""Frequency responses from files."""

from typing import Literal

import numpy as np
from jaxtyping import Complex
from pydantic import Field

from ... import units as q
from ...identification import FrequencyResponse, ModeStudy
from ...io import Quantity, TableReader
from ...settings.fields import Frequency
from .._schema.machine import Direction
from .context import Context
from .fields import File
from .kind import IdentificationKind
from .modes import ModesTable, Pose, read_modes
from .robot import StudiedRobotTable

_FREQUENCY = Quantity(
    "frequency", r"f|freq\w*|frequenz", (q.FREQUENCY,), ("frequency",)
)
_PHASE = Quantity("phase", r"phase|arg\w*|angle|winkel", (q.ANGLE,), ("phase",))
_PARTS = {
    "real": r"re|real\w*( part)?|h_?re(al)?|realteil",
    "imaginary": r"im|imag\w*( part)?|h_?im(ag)?|imagin\w*",
    "magnitude": r"mag\w*|abs\w*|amplitude|betrag|h|modulus|\|h\|",
}
# Parts of a complex vector, whatever it is called.
_COMPLEX = {"real": r" real$", "imaginary": r" imaginary$"}
# Units of a response per unit of force, by what is measured.
_RESPONSES = {
    "receptance": q.RECEPTANCE,
    "mobility": q.MOBILITY,
    "accelerance": q.ACCELERANCE,
}


class FrequencyResponseTable(ModesTable):
    """An entry of `[[frequency_response]]`."""

    file: File = Field(description='file of a frequency response, such as "frf.csv"')
    quantity: Literal["receptance", "mobility", "accelerance"] = Field(
        default="receptance",
        description="what was measured per force: a displacement, a velocity or an "
        "acceleration",
    )
    lowest: Frequency | None = Field(
        default=None,
        description='lower end of the band that is fitted, such as "5 Hz"; that of the '
        "file if left out",
    )
    highest: Frequency | None = Field(
        default=None,
        description='upper end of the band that is fitted, such as "100 Hz"; that of '
        "the file if left out",
    )
    direction: Direction | None = Field(
        default=None,
        description="direction of hammer and sensor at the tool tip, such as "
        "[1, 0, 0], to write [[machine.modes]]; not written if left out",
    )


def _read(
    name: str,
    context: Context,
    *,
    frequency_response: list[FrequencyResponseTable] | None = None,
    robot: StudiedRobotTable | None = None,
) -> ModeStudy | None:
    """Study of frequency responses, or None with problems noted."""
    return read_modes(
        name,
        "frequency_response",
        robot,
        frequency_response,
        _frequency_response,
        context,
    )


def _frequency_response(
    reader: TableReader, table: FrequencyResponseTable, pose: Pose | None
) -> FrequencyResponse:
    """A frequency response, its lines in ascending order.

    Raises:
        RecordError: A column is missing, or lines are too few.
    """
    if table.direction is not None and not any(table.direction):
        reader.faults.append(
            f"direction: found {table.direction}, but a direction is required, "
            "such as [1, 0, 0]."
        )
    unit = (_RESPONSES[table.quantity],)
    parts = {
        key: Quantity(key, pattern, unit, ("response",), _COMPLEX.get(key, ""))
        for key, pattern in _PARTS.items()
    }
    reader.allow((_FREQUENCY, *parts.values(), _PHASE))
    f, H = reader.values(_FREQUENCY), _complex_values(reader, parts)
    if (f is None or H is None) and not reader.faults:
        reader.faults.append(
            "found no columns for frequency, and real and imaginary part (or "
            f"magnitude and phase), among {reader.listed()}; name them with `channels`."
        )
    reader.check()
    assert f is not None and H is not None
    good = np.isfinite(f) & np.isfinite(H) & (f > 0)
    order = np.argsort(f[good], kind="stable")
    f, H = f[good][order], H[good][order]
    band = (f >= (table.lowest or 0.0)) & (f <= (table.highest or np.inf))
    count = table.mode_count
    if band.sum() < 2 * count + 2:
        reader.faults.append(
            f"found {int(band.sum())} lines in the band, but at least "
            f"{2 * count + 2} are required for {count} modes."
        )
    reader.check()
    return FrequencyResponse(
        name=reader.name,
        frequency=f,
        response=H,
        quantity=table.quantity,
        is_fitted=band,
        mode_count=count,
        frequencies=table.guesses,
        q=pose,
        notes=tuple(reader.notes),
        direction=table.direction,
        channels=tuple(reader.read),
    )


def _complex_values(
    reader: TableReader, parts: dict[str, Quantity]
) -> Complex[np.ndarray, " line"] | None:
    """Response as real and imaginary part, or as magnitude and phase; None if absent.

    Args:
        reader: Receives the fault of a phase without a unit.
        parts: What the columns for the first three are.
    """
    real, imaginary = reader.values(parts["real"]), reader.values(parts["imaginary"])
    if real is not None and imaginary is not None:
        return real + 1j * imaginary
    size, column = reader.values(parts["magnitude"]), reader.find(_PHASE)
    phase = None if column is None else reader.in_si(_PHASE, column)
    if size is None or column is None or phase is None:
        return None
    if np.nanmax(np.abs(phase)) > 8 * np.pi and not reader.unit_of(_PHASE, column):
        reader.faults.append(
            "the phase has no unit and is larger than 8 pi: write its unit in "
            "the header, such as `phase_deg`."
        )
    return size * np.exp(1j * phase)


KIND = IdentificationKind(
    "frequency_response",
    required={"frequency_response": [FrequencyResponseTable]},
    optional={"robot": StudiedRobotTable},
    read=_read,
)
