"""How fast a motion runs: feed per minute or revolution, or its duration."""

from typing import NamedTuple

from ..limits import LARGEST_FEED, SHORTEST_DURATION
from .blocks import Block
from .state import State


class Pace(NamedTuple):
    """Feed [m/s] or duration [s] of a motion; both None where a fault hides them."""

    feed: float | None = None
    duration: float | None = None


def set_feed(block: Block, state: State) -> None:
    """Apply G93, G94, G95 and F."""
    mode = block.g.get("feed mode")
    if mode is not None:
        if mode != 930:
            # As LinuxCNC has it: a feed given before G94 or G95 is void.
            state.feed = None
        state.feed_mode = mode
    word = block.values.get("F")
    if word is None:
        return
    block.used.add("F")
    if word.number < 0:
        block.refuse(word.text, "a feed must be positive.")
        state.feed = float("nan")
    elif state.feed_mode != 930:
        # The standard executes F before G20 and G21: a change of units in the same
        # line does not apply to it.
        feed = word.number * state.scale
        if feed > LARGEST_FEED * 6e4:
            message = f"a feed is {LARGEST_FEED * 6e4:g} mm/min at most."
            block.refuse(word.text, message)
            feed = float("nan")
        state.feed = feed / 60 if state.feed_mode == 940 else feed


def find_pace(block: Block, state: State) -> Pace:
    """Return the pace of a feed motion."""
    if state.feed_mode == 930:
        return _inverse_time(block)
    word = block.values.get("F")
    if state.feed is None and state.setup.feed is not None:
        return Pace(state.setup.feed)
    if state.feed is None:
        message = "there is no feed; needed is an F above 0 in this line or before it"
        message += " (after any G94 or G95), or a feed for the whole program."
        block.refuse(motion_text(block), message)
        # Of the moves behind it nobody needs to be told the same.
        state.feed = float("nan")
        return Pace()
    if state.feed == 0:
        message = "the feed is 0; needed is an F above 0."
        shown = motion_text(block) if word is None else word.text
        block.refuse(shown, message)
        return Pace()
    if state.feed_mode == 940:
        return Pace(state.feed * 1e-3)
    if state.spindle_rpm == 0:
        message = "a feed per revolution (G95) needs an S above 0 before it."
        block.refuse(motion_text(block), message)
        return Pace()
    return Pace(state.feed * 1e-3 * state.spindle_rpm / 60)


def _inverse_time(block: Block) -> Pace:
    """Return the duration of a motion in inverse time."""
    word = block.values.get("F")
    if word is None or word.number == 0:
        message = "a motion in inverse time (G93) needs an F above 0 in its line."
        shown = motion_text(block) if word is None else word.text
        block.refuse(shown, message)
        return Pace()
    duration = 60 / word.number
    if 0 < duration < SHORTEST_DURATION:
        message = f"a move lasts at least {SHORTEST_DURATION:g} s (F is 60 s / t)."
        block.refuse(word.text, message)
        return Pace()
    return Pace(duration=duration)


def motion_text(block: Block) -> str:
    """Return the word that asks for a motion, as written."""
    if "motion" in block.texts:
        return block.texts["motion"]
    return next((block.values[k].text for k in "XYZIJKR" if k in block.values), "")
