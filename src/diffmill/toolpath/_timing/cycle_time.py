"""Where the time of a program goes: at its own speeds, and to each limit."""

import collections
from collections.abc import Iterable
from typing import NamedTuple

# Lines that are told apart.
_WORST_LINE_COUNT = 5


class Loss(NamedTuple):
    """Time that a limit adds to a line of the program.

    Attributes:
        line: Line of the program.
        cause: The limit.
        seconds: The added time [s].
    """

    line: int
    cause: str
    seconds: float


class CycleTime(NamedTuple):
    """Time that a program takes, and what makes it longer than its feeds do.

    Attributes:
        total: The whole [s].
        programmed: What it would take at the programmed feeds and the rapid feed, with
            the times and rests that it states [s].
        lost: What each limit adds [s], the most first: "acceleration" (speeding up and
            slowing down), "curves" (centripetal acceleration, rounded corners too),
            "jerk" (smoothing), "joint NAME". They add up to the rest.
        worst: Lines that lose the most time.
    """

    total: float
    programmed: float
    lost: tuple[tuple[str, float], ...]
    worst: tuple[Loss, ...]

    @classmethod
    def of_losses(cls, programmed: float, losses: Iterable[Loss]) -> "CycleTime":
        """Return the sum of what limits add.

        Args:
            programmed: Time without any [s].
            losses: What each limit adds, any number of times for each line.
        """
        lost: dict[str, float] = collections.defaultdict(float)
        lines: dict[tuple[int, str], float] = collections.defaultdict(float)
        for line, cause, seconds in losses:
            lost[cause] += seconds
            lines[line, cause] += seconds
        by_size = lambda item: -item[1]
        by_limit = sorted(((k, v) for k, v in lost.items() if v > 0), key=by_size)
        worst = sorted(lines.items(), key=by_size)[:_WORST_LINE_COUNT]
        return cls(
            total=programmed + sum(lost.values()),
            programmed=programmed,
            lost=tuple(by_limit),
            worst=tuple(
                Loss(*where, seconds) for where, seconds in worst if seconds > 0
            ),
        )
