"""Options of `diffmill feed`."""

import dataclasses
from typing import Annotated

import tyro


@dataclasses.dataclass(frozen=True)
class FeedRequest:
    """Request of a feed study.

    Attributes:
        overrides: Factors of the feed of the whole program.
        weights: Weights of the time, for overrides along the path; may be empty.
        correct: True to correct the program at each of the factors too.
        tolerance: Largest contour error, with its unit, for the fastest feed that keeps
            it; None for the table of the factors.
        max_force: Largest force of that feed, with its unit, or None.
        max_power: Largest power of the spindle, likewise.
        along: Knots of an override of that feed that varies along the path; 0 for one.
    """

    overrides: Annotated[
        tuple[float, ...],
        tyro.conf.arg(help="Factors of the feed of the whole program to simulate."),
    ] = (0.5, 0.75, 1.0, 1.25, 1.5)
    weights: Annotated[
        tuple[float, ...],
        tyro.conf.arg(
            help="Weights of the time against the error: for each the feed along the "
            "path is tuned and written as a path and a program. May be empty."
        ),
    ] = (0.3, 0.1, 0.03)
    correct: Annotated[
        bool, tyro.conf.arg(help="Also correct the program at every override.")
    ] = False
    tolerance: Annotated[
        str | None,
        tyro.conf.arg(
            help='Find the fastest feed within this contour error, such as "0.1 mm", '
            "and the drives."
        ),
    ] = None
    max_force: Annotated[
        str | None,
        tyro.conf.arg(help='With --tolerance: largest force, such as "300 N".'),
    ] = None
    max_power: Annotated[
        str | None,
        tyro.conf.arg(
            help='With --tolerance: largest power of the spindle, such as "4 kW".'
        ),
    ] = None
    along: Annotated[
        int,
        tyro.conf.arg(
            help="With --tolerance: knots of an override that varies along the path, "
            "such as 20; 0 for one override of the whole program."
        ),
    ] = 0
