"""What is wrong with a file of measurements."""

_SHOWN_FAULTS = 20


class RecordError(ValueError):
    """A measured record that cannot be read, with everything wrong in it.

    Attributes:
        name: The file.
        faults: What is wrong; at most 20.
    """

    def __init__(self, name: str, faults: list[str]):
        self.name = name
        self.faults = tuple(faults[:_SHOWN_FAULTS])
        lines = [f"{name}: {fault}" for fault in self.faults]
        if len(faults) > _SHOWN_FAULTS:
            lines.append(f"{name}: further faults are not listed.")
        super().__init__("\n".join(lines))
