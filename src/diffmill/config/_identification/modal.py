"""Ring-downs and frequency responses from files."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ... import units as q
from ...identification import FrequencyResponse, RingDown
from ...io import Quantity, TableReader
from ...robot import Robot
from .context import Context
from .robot import joint_positions
from .schema import FrequencyResponseTable, RingDownTable

_SIGNAL = Quantity(
    "signal",
    r"signal|displacement|acceleration|velocity|amplitude|weg|beschleunigung|"
    r"[xyzadv]|acc\w*|disp\w*",
)
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
# Samples of a fit at least, beyond four per mode.
_LEAST_SAMPLES = 20


def read_ring_down(
    table: RingDownTable, place: str, robot: Robot | None, context: Context
) -> RingDown | None:
    """Return a free vibration, or None with problems noted.

    Args:
        table: Its checked entry.
        place: What a line calls the entry.
        robot: The robot, or None.
        context: Folder and problems.
    """
    pose = joint_positions(table.joint_positions, robot, place, context.problems)
    return context.read(table, place, _ring_down(table, pose))


def _ring_down(
    table: RingDownTable, pose: np.ndarray | None
) -> Callable[[TableReader], RingDown]:
    def build(reader: TableReader) -> RingDown:
        # Modes do not depend on the size of the signal.
        reader.allow((reader.TIME, _SIGNAL))
        clock = reader.find(reader.TIME)
        time = None if clock is None else reader.in_si(reader.TIME, clock)
        columns = enumerate(reader.table.columns, 1)
        others = [place for place, column in columns if column is not clock]
        if "signal" not in reader.channels and len(others) == 1:
            # The only other column needs no name.
            reader.channels["signal"] = others[0]
        signal = reader.values(_SIGNAL)
        if signal is None and not reader.faults:
            reader.faults.append(
                f"found no column for signal among {reader.listed()}; name it."
            )
        reader.check()
        assert signal is not None
        rate = table.rate or reader.table.rate
        line = reader.timeline(time, np.isfinite(signal), rate)
        reader.check()
        assert line is not None
        t, y = np.asarray(line.time, np.float64), signal[line.rows]
        first = t[int(np.argmax(np.abs(y - np.median(y))))]
        start = first if table.start is None else table.start
        stop = t[-1] if table.stop is None else table.stop
        if table.start is None:
            reader.notes.append(
                f"The ring-down begins at its largest value, {start:.4g} s."
            )
        keep = (t >= start) & (t <= stop)
        count = _mode_count(table)
        least = max(_LEAST_SAMPLES, 4 * count + 1)
        if keep.sum() < least:
            reader.faults.append(
                f"found {int(keep.sum())} samples from {start:g} to {stop:g} s, but at "
                f"least {least} are required for {count} modes."
            )
        reader.check()
        return RingDown(
            name=reader.name,
            time=t[keep],
            signal=y[keep] - y[keep].mean(),
            mode_count=count,
            frequencies=_guesses(table),
            q=pose,
            notes=tuple(reader.notes),
            channels=tuple(reader.read),
        )

    return build


def read_frequency_response(
    table: FrequencyResponseTable, place: str, robot: Robot | None, context: Context
) -> FrequencyResponse | None:
    """Return a frequency response, or None with problems noted.

    Args:
        table: Its checked entry.
        place: What a line calls the entry.
        robot: The robot, or None.
        context: Folder and problems.
    """
    pose = joint_positions(table.joint_positions, robot, place, context.problems)
    return context.read(table, place, _frequency_response(table, pose))


def _frequency_response(
    table: FrequencyResponseTable, pose: np.ndarray | None
) -> Callable[[TableReader], FrequencyResponse]:
    def build(reader: TableReader) -> FrequencyResponse:
        if table.direction is not None and not any(table.direction):
            reader.faults.append(
                f"direction: found {table.direction}, but a direction is required, "
                "such as [1, 0, 0]."
            )
        found = _response(reader, _RESPONSES[table.quantity])
        f, H = found.frequency, found.response
        good = np.isfinite(f) & np.isfinite(H) & (f > 0)
        order = np.argsort(f[good], kind="stable")
        f, H = f[good][order], H[good][order]
        band = (f >= (table.lowest or 0.0)) & (f <= (table.highest or np.inf))
        count = _mode_count(table)
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
            frequencies=_guesses(table),
            q=pose,
            notes=tuple(reader.notes),
            direction=table.direction,
            channels=tuple(reader.read),
        )

    return build


def _mode_count(table: RingDownTable | FrequencyResponseTable) -> int:
    return len(table.frequencies or ()) or table.modes or 1


def _guesses(table: RingDownTable | FrequencyResponseTable) -> np.ndarray | None:
    """Return the frequencies that the user gives [Hz], ascending, or None."""
    return np.sort(np.array(table.frequencies)) if table.frequencies else None


class _Response(NamedTuple):
    """Frequencies [Hz], and the complex response in SI units, shape (line,) each."""

    frequency: np.ndarray
    response: np.ndarray


def _response(reader: TableReader, kind: q.QuantityKind) -> _Response:
    """Return the response that a table holds.

    Raises:
        RecordError: There are no columns for it.
    """
    parts = {
        key: Quantity(key, pattern, (kind,), ("response",), _COMPLEX.get(key, ""))
        for key, pattern in _PARTS.items()
    }
    reader.allow((_FREQUENCY, *parts.values(), _PHASE))
    f = reader.values(_FREQUENCY)
    real, imaginary = reader.values(parts["real"]), reader.values(parts["imaginary"])
    H = None
    if real is not None and imaginary is not None:
        H = real + 1j * imaginary
    elif f is not None:
        size, column = reader.values(parts["magnitude"]), reader.find(_PHASE)
        phase = None if column is None else reader.in_si(_PHASE, column)
        if size is not None and column is not None and phase is not None:
            has_unit = bool(reader.unit_of(_PHASE, column))
            if np.nanmax(np.abs(phase)) > 8 * np.pi and not has_unit:
                reader.faults.append(
                    "the phase has no unit and is larger than 8 pi: write its unit in "
                    "the header, such as `phase_deg`."
                )
            H = size * np.exp(1j * phase)
    if (f is None or H is None) and not reader.faults:
        reader.faults.append(
            "found no columns for frequency, and real and imaginary part (or "
            f"magnitude and phase), among {reader.listed()}; name them with `channels`."
        )
    reader.check()
    assert f is not None and H is not None
    return _Response(f, H)
