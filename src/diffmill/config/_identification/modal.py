"""Ring-downs and frequency responses from files."""

import pathlib

import numpy as np

from ... import units as q
from ...io import (
    TIME_NAMES,
    RecordError,
    Table,
    check_keys,
    column_of,
    read_table,
    timeline,
)
from ...robot import Robot
from .._build.program import file_in_folder
from .force_records import LARGEST_RECORD
from .robot import joint_positions
from .schema import FrequencyResponseTable, RingDownTable
from .tasks import FrequencyResponse, RingDown

_SIGNAL = (
    r"signal|displacement|acceleration|velocity|amplitude|weg|beschleunigung|"
    r"[xyzadv]|acc\w*|disp\w*"
)
_FREQUENCY = r"f|freq\w*|frequenz"
_REAL = r"re|real\w*( part)?|h_?re(al)?|realteil"
_IMAGINARY = r"im|imag\w*( part)?|h_?im(ag)?|imagin\w*"
_MAGNITUDE = r"mag\w*|abs\w*|amplitude|betrag|h|modulus|\|h\|"
_PHASE = r"phase|arg\w*|angle|winkel"
# Units of a response per unit of force, by what is measured.
_RESPONSES = {
    "receptance": q.RECEPTANCE,
    "mobility": q.MOBILITY,
    "accelerance": q.ACCELERANCE,
}
# Lines of a fit at least, beyond two per mode.
_LEAST_SAMPLES = 20


def read_ring_down(
    table: RingDownTable,
    place: str,
    robot: Robot | None,
    folder: pathlib.Path,
    problems: list[str],
    *,
    allow_outside: bool,
) -> RingDown | None:
    """Return a free vibration, or None with problems noted.

    Args:
        table: Its checked entry.
        place: What a line calls the entry.
        robot: The robot, or None.
        folder: Folder of the file.
        problems: Receives what is wrong.
        allow_outside: Whether the file may lie outside that folder.
    """
    pose = joint_positions(table.joint_positions, robot, place, problems)
    found = _table(table.file, place, folder, problems, allow_outside)
    if found is None:
        return None
    faults: list[str] = []
    notes = list(found.notes)
    wanted = dict(table.channels or {})
    check_keys("channel", wanted, ("time", "signal"), faults)
    # Modes do not depend on the size of the signal.
    check_keys("unit of", table.units, ("time",), faults)
    unit = table.units.get("time")
    time = column_of(found, "time", (q.TIME,), TIME_NAMES, wanted, faults, notes, unit)
    if "signal" not in wanted and len(found.columns) == 1 + (time is not None):
        # The only other column needs no name.
        wanted["signal"] = len(found.columns)
    signal = column_of(found, "signal", (), _SIGNAL, wanted, faults, notes)
    if signal is None and not faults:
        names = ", ".join(f"`{column.name}`" for column in found.columns)
        faults.append(f"found no column for signal among {names}; name it.")
    line = None
    if not faults and signal is not None:
        rate = table.rate or found.rate
        line = timeline(time, np.isfinite(signal), rate, faults, notes)
    if line is not None and signal is not None and not faults:
        t, y = np.asarray(line.time, np.float64), signal[line.rows]
        first = t[int(np.argmax(np.abs(y - np.median(y))))]
        start = first if table.start is None else table.start
        stop = t[-1] if table.stop is None else table.stop
        if table.start is None:
            notes.append(f"The ring-down begins at its largest value, {start:.4g} s.")
        keep = (t >= start) & (t <= stop)
        if keep.sum() >= _LEAST_SAMPLES:
            t, y = t[keep], y[keep] - y[keep].mean()
            count = len(table.frequencies or ()) or table.modes or 1
            guess = np.sort(np.array(table.frequencies or [], np.float64))
            if t.size > 4 * count:
                rest = (guess if guess.size else None, pose, tuple(notes))
                return RingDown(table.file, t, y, count, *rest)
            faults.append(
                f"found {t.size} samples, but more than {4 * count} are required for "
                f"{count} modes."
            )
        else:
            faults.append(
                f"found {int(keep.sum())} samples from {start:g} to {stop:g} s, but at "
                f"least {_LEAST_SAMPLES} are required."
            )
    problems.extend(f"{place} file: {table.file}: {fault}" for fault in faults)
    return None


def read_frequency_response(
    table: FrequencyResponseTable,
    place: str,
    robot: Robot | None,
    folder: pathlib.Path,
    problems: list[str],
    *,
    allow_outside: bool,
) -> FrequencyResponse | None:
    """Return a frequency response, or None with problems noted.

    Args:
        table: Its checked entry.
        place: What a line calls the entry.
        robot: The robot, or None.
        folder: Folder of the file.
        problems: Receives what is wrong.
        allow_outside: Whether the file may lie outside that folder.
    """
    pose = joint_positions(table.joint_positions, robot, place, problems)
    found = _table(table.file, place, folder, problems, allow_outside)
    if found is None:
        return None
    faults: list[str] = []
    notes = list(found.notes)
    both = _response(found, table, faults, notes)
    if both is not None and not faults:
        f, H = both
        good = np.isfinite(f) & np.isfinite(H) & (f > 0)
        order = np.argsort(f[good], kind="stable")
        f, H = f[good][order], H[good][order]
        band = (f >= (table.lowest or 0.0)) & (f <= (table.highest or np.inf))
        count = len(table.frequencies or ()) or table.modes or 1
        if band.sum() < 2 * count + 2:
            faults.append(
                f"found {int(band.sum())} lines in the band, but at least "
                f"{2 * count + 2} are required for {count} modes."
            )
        guess = np.sort(np.array(table.frequencies or [], np.float64))
        if not faults:
            rest = (count, guess if guess.size else None, pose, tuple(notes))
            return FrequencyResponse(table.file, f, H, table.quantity, band, *rest)
    problems.extend(f"{place} file: {table.file}: {fault}" for fault in faults)
    return None


def _table(
    name: str,
    place: str,
    folder: pathlib.Path,
    problems: list[str],
    allow_outside: bool,
) -> Table | None:
    """Return the columns of a file, or None with a problem noted."""
    path = file_in_folder(
        name,
        f"{place} file",
        folder,
        problems,
        allow_outside=allow_outside,
        largest=LARGEST_RECORD,
    )
    if path is None:
        return None
    try:
        return read_table(path)
    except (RecordError, OSError) as error:
        lines = error.faults if isinstance(error, RecordError) else (str(error),)
        problems.extend(f"{place} file: {name}: {line}" for line in lines)
        return None


def _response(
    found: Table,
    table: FrequencyResponseTable,
    faults: list[str],
    notes: list[str],
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return frequencies [Hz] and the complex response in SI units."""
    wanted = dict(table.channels or {})
    keys = ("frequency", "real", "imaginary", "magnitude", "phase")
    check_keys("channel", wanted, keys, faults)
    check_keys("unit of", table.units, ("frequency", "response", "phase"), faults)
    kind = _RESPONSES[table.quantity]

    def get(key: str, kinds: tuple[q.QuantityKind, ...], pattern: str):
        unit = table.units.get("response" if kinds == (kind,) else key)
        return column_of(found, key, kinds, pattern, wanted, faults, notes, unit)

    f = get("frequency", (q.FREQUENCY,), _FREQUENCY)
    real, imaginary = get("real", (kind,), _REAL), get("imaginary", (kind,), _IMAGINARY)
    if f is not None and real is not None and imaginary is not None:
        return f, real + 1j * imaginary
    size = get("magnitude", (kind,), _MAGNITUDE)
    phase = get("phase", (q.ANGLE,), _PHASE)
    if f is not None and size is not None and phase is not None:
        if np.nanmax(np.abs(phase)) > 8 * np.pi and "phase" in " ".join(notes):
            faults.append(
                "the phase has no unit and is larger than 8 pi: write its unit in the "
                "header, such as `phase_deg`."
            )
        return f, size * np.exp(1j * phase)
    if not faults:
        names = ", ".join(f"`{column.name}`" for column in found.columns)
        faults.append(
            "found no columns for frequency, and real and imaginary part (or "
            f"magnitude and phase), among {names}; name them with `channels`."
        )
    return None
