"""Errors of files of measurements."""

from ..._messages import shown

_SHOWN_FAULTS = 20


class RecordError(ValueError):
    """A measured record that cannot be read, with everything wrong in it.

    Attributes:
        name: The file.
        faults: What is wrong; at most 20.
    """

    def __init__(self, name: str, faults: list[str]):
        self.name = name
        self.faults = tuple(shown(faults, _SHOWN_FAULTS))
        super().__init__("\n".join(f"{name}: {fault}" for fault in self.faults))
