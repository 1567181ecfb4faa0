"""Frames of an APT program: where its points are, seen from the first of them."""

import re

import numpy as np
from jaxtyping import Float

from ....toolpath import Point
from ..expressions import NUMBER
from ..geometry import point_of
from .reader import Reader

# A frame has this at most between its axes and a right angle or a length of 1.
_TOLERANCE = 1e-3
_ROW = re.compile(rf"\s*\$\$\s*((?:{NUMBER}\s+){{3}}{NUMBER})\s*")
_COUNTS = {"MSYS": 9, "TRACUT": 12, "CATIA0": 12}

Matrix = Float[np.ndarray, "4 4"]


def catia_rows(rows: list[str], first: int) -> str:
    """Return the matrix of the comments behind $$*CATIA0 as numbers with commas.

    Args:
        rows: Lines of the program.
        first: Index of the line behind $$*CATIA0, with the name of the frame.
    """
    matches = [_ROW.fullmatch(row) for row in rows[first + 1 : first + 4]]
    return ",".join(",".join(match[1].split()) for match in matches if match)


class AptFrames:
    """Frames that a program states; `work` is that of the first motion.

    MSYS (NX) has origin, x and y of the frame of the points, TRACUT the three rows
    (a, b, c, d) that bring them into the frame above, and so has the comment $$*CATIA0
    of CATIA. Points of a frame that is stated behind a motion are brought into `work`.

    Attributes:
        change: From the frame of the points into `work` [m]; None where it is the same.
    """

    def __init__(self) -> None:
        self._stated: dict[str, Matrix] = {}
        self._work: Matrix | None = None
        self.change: Matrix | None = None

    def state(
        self, word: str, numbers: list[float], scale: float, line: int, reader: Reader
    ) -> bool:
        """Let a frame hold; True if it is another one than before.

        Args:
            word: MSYS, TRACUT or CATIA0.
            numbers: As written; none end a TRACUT.
            scale: Metres per unit of length.
            line: Line of the statement, for faults and notes.
            reader: Receives them.
        """
        if not numbers and word == "TRACUT":
            numbers = [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]
        frame = np.eye(4)
        if len(numbers) == _COUNTS[word] == 9:
            x, y = np.array(numbers[3:6]), np.array(numbers[6:])
            frame[:3] = np.stack([x, y, np.cross(x, y), numbers[:3]], axis=1)
        elif len(numbers) == _COUNTS[word]:
            frame[:3] = np.reshape(numbers, (3, 4))
        frame[:3, 3] *= scale
        R = frame[:3, :3]
        is_rotation = np.allclose(R.T @ R, np.eye(3), atol=_TOLERANCE)
        if len(numbers) != _COUNTS[word] or not is_rotation or np.linalg.det(R) < 0:
            message = f"needed are {_COUNTS[word]} numbers of a frame whose axes are "
            reader.refuse(line, word, message + "right-handed and of length 1.")
            return False
        if self._work is not None and word != "TRACUT" and word not in self._stated:
            message = "what moves before it is in a frame that nobody states."
            reader.refuse(line, word, message)
        before = self._stated.get(word, np.eye(4))
        self._stated[word] = frame
        total = self._total()
        if self._work is None:
            sentence = "is the frame of all motion, which is taken to be work"
            is_plain = np.array_equal(frame, np.eye(4))
            sentence = "changes no motion here" if is_plain else sentence
            reader.out.note(word, sentence, line)
        elif not np.array_equal(total, self._work):
            sentence = "another frame; its points are brought into that of the first"
            reader.out.note(word, f"{sentence} motion, work", line)
        self._compare(total)
        return not np.array_equal(before, frame)

    def _total(self) -> Matrix:
        """Frame of the points in that above all."""
        total = np.eye(4)
        for word in ("MSYS", "CATIA0", "TRACUT"):
            total = total @ self._stated.get(word, np.eye(4))
        return total

    def _compare(self, total: Matrix) -> None:
        """Set `change` to what brings points into the frame of the first motion."""
        self.change = None
        if self._work is not None and not np.array_equal(total, self._work):
            self.change = np.linalg.inv(self._work) @ total

    def use(self) -> None:
        """Take the frame in force for that of the first motion, if it is the first."""
        if self._work is None:
            self._work = self._total()

    def place(self, point: Point) -> Point:
        """Return a point [m] in `work`."""
        change = self.change
        if change is None:
            return point
        return point_of(change[:3, :3] @ np.array(point) + change[:3, 3])

    def direction(self, vector: Point) -> Point:
        """Return a direction in `work`."""
        change = self.change
        return vector if change is None else point_of(change[:3, :3] @ np.array(vector))
