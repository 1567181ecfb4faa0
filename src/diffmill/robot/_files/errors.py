"""Errors and warnings of robot files: all faults at once."""

from collections.abc import Sequence

from ..._messages import shown


class RobotFileError(ValueError):
    """Raise when a robot file is faulty; the message lists every fault."""


class RobotFileWarning(UserWarning):
    """Warn of a robot file that is read, but not to be trusted in everything."""


def raise_faults(file: str, faults: Sequence[str]) -> None:
    """Raise one `RobotFileError` with all faults of a file; return if there is none."""
    if faults:
        count = f"{len(faults)} fault" + ("s" if len(faults) > 1 else "")
        raise RobotFileError(
            f"{file}: {count} in the robot description:\n"
            + "\n".join(f"  - {fault}" for fault in shown(faults))
        )
