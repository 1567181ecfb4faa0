"""Axes beside those of the arm: a track under it, a table under the work."""

from collections.abc import Mapping

from .reader import Reader

# As controllers write an axis that is not there, and above.
_UNUSED = 8.9e9
# Two places of an axis are one [mm or deg].
_SAME_PLACE = 1e-6


class ExternalAxes:
    """Places of the external axes in the motions of a program.

    Work and robot stand where they are for a whole program. So each axis is to stand
    still; where it does, a note says so.
    """

    def __init__(self) -> None:
        self._places: dict[str, float] = {}
        self._has_moved = False

    def take(self, stated: Mapping[str, float], line: int, reader: Reader) -> None:
        """Use the places of a motion [mm or deg]: they are those of the first."""
        used = {name: at for name, at in stated.items() if abs(at) < _UNUSED}
        for name, at in used.items():
            # Inline forms of KUKA write 0 for an axis that is not there.
            if self._has_moved and name not in self._places and at != 0:
                message = "motions before this line do not state where this axis is."
                reader.refuse(line, name, message)
            before = self._places.setdefault(name, at)
            if abs(at - before) > _SAME_PLACE:
                message = (
                    f"the external axis goes from {before:g} to {at:g}, and takes the "
                    "robot or the work with it; it has to stand still."
                )
                reader.refuse(line, name, message)
        self._has_moved = True
        if used:
            sentence = "stand still, so that the work is at one place in the base"
            reader.out.note("external axes", sentence, line)
