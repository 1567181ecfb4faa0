"""Free vibrations from files."""

import numpy as np
from pydantic import Field

from ...identification import ModeStudy, RingDown
from ...io import Quantity, TableReader
from ...settings.fields import Frequency, Time
from .context import Context
from .fields import File
from .kind import IdentificationKind
from .modes import ModesTable, Pose, read_modes
from .robot import StudiedRobotTable

_SIGNAL = Quantity(
    "signal",
    r"signal|displacement|acceleration|velocity|amplitude|weg|beschleunigung|"
    r"[xyzadv]|acc\w*|disp\w*",
)
# Samples of a fit at least, beyond four per mode.
_LEAST_SAMPLES = 20


class RingDownTable(ModesTable):
    """An entry of `[[ring_down]]`."""

    file: File = Field(description='file of a free vibration, such as "hit1.csv"')
    rate: Frequency | None = Field(
        default=None,
        description='samples per time, such as "10 kHz"; required if neither a time '
        "column nor the header has it",
    )
    start: Time | None = Field(
        default=None,
        description='where the vibration begins, such as "0.1 s"; at its largest value '
        "if left out",
    )
    stop: Time | None = Field(
        default=None,
        description='where the vibration ends, such as "1.5 s"; with the file if left '
        "out",
    )


def _read(
    name: str,
    context: Context,
    *,
    ring_down: list[RingDownTable] | None = None,
    robot: StudiedRobotTable | None = None,
) -> ModeStudy | None:
    """Study of free vibrations, or None with problems noted."""
    return read_modes(name, "ring_down", robot, ring_down, _ring_down, context)


def _ring_down(
    reader: TableReader, table: RingDownTable, pose: Pose | None
) -> RingDown:
    """A free vibration.

    Raises:
        RecordError: A column is missing, or samples are too few.
    """
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
    count = table.mode_count
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
        frequencies=table.guesses,
        q=pose,
        notes=tuple(reader.notes),
        channels=tuple(reader.read),
    )


KIND = IdentificationKind(
    "ring_down",
    required={"ring_down": [RingDownTable]},
    optional={"robot": StudiedRobotTable},
    read=_read,
)
