"""Mutations of a text file: what typing, copying, cutting and encoding do to it."""

import random
import re
from collections.abc import Callable, Sequence

_TOKEN = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?|\w+|[^\s\w]")
_NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
_NUMBERS = (
    b"0 -0 1 -1 1e300 -1e300 1e-300 1e999 nan inf -inf 1,5 1. .5 -- 1e 0x10 1_000 "
    b"9E9 1e6 -1e6 123456789012345678901234567890 2147483648 0.1.2 1e-9 100000"
).split()
_BYTES = [
    *(bytes([i]) for i in b"\0\t\n\r\x0b\x1a\x1b \"'()[]{}<>%;:,=/\\$&@!#*\x7f\xff"),
    "é°µ\u2028\u202e\ufeff½Ⅷ一".encode(),
    *("é½Ⅷ٣\U0001f600"[i].encode() for i in range(5)),
]
# How often a line or an opening bracket is repeated to make a large or deep file.
_MANY = 1000

Mutation = Callable[[bytes, bytes, random.Random], bytes]


def mutant(seed: bytes, others: Sequence[bytes], draw: random.Random) -> bytes:
    """Return a file after one to four mutations.

    Args:
        seed: The sound file.
        others: Files of which parts are put in.
        draw: The source of chance.
    """
    data = seed
    for _ in range(draw.choice((1, 1, 1, 2, 2, 3, 4))):
        data = draw.choice(_MUTATIONS)(data, draw.choice(others), draw)
    return data


def _replaced(pattern: re.Pattern[bytes], new: Callable[[bytes], bytes]) -> Mutation:
    """Return the mutation that replaces one match of a pattern."""

    def mutate(data: bytes, other: bytes, draw: random.Random) -> bytes:
        found = list(pattern.finditer(data))
        if not found:
            return data
        place = draw.choice(found)
        return data[: place.start()] + new(place.group()) + data[place.end() :]

    return mutate


def _number(data: bytes, other: bytes, draw: random.Random) -> bytes:
    return _replaced(_NUMBER, lambda _: draw.choice(_NUMBERS))(data, other, draw)


def _sign(data: bytes, other: bytes, draw: random.Random) -> bytes:
    return _replaced(_NUMBER, lambda x: b"-" + x)(data, other, draw)


def _token(data: bytes, other: bytes, draw: random.Random) -> bytes:
    tokens = _TOKEN.findall(draw.choice((data, other))) or [b""]
    new = draw.choice(tokens)
    change = draw.choice(
        (lambda _: new, lambda x: x + b" " + new, lambda _: b"", lambda x: x + x)
    )
    return _replaced(_TOKEN, change)(data, other, draw)


def _case(data: bytes, other: bytes, draw: random.Random) -> bytes:
    return _replaced(_TOKEN, bytes.swapcase)(data, other, draw)


def _line(data: bytes, other: bytes, draw: random.Random) -> bytes:
    lines = data.split(b"\n")
    at, to = draw.randrange(len(lines)), draw.randrange(len(lines))
    change = draw.randrange(5)
    if change == 0:
        del lines[at]
    elif change == 1:
        lines.insert(to, lines[at])
    elif change == 2:
        lines[at], lines[to] = lines[to], lines[at]
    elif change == 3:
        lines.insert(at, draw.choice(other.split(b"\n")))
    else:
        lines[at] = lines[at] + lines[to]
    return b"\n".join(lines)


def _many(data: bytes, other: bytes, draw: random.Random) -> bytes:
    lines = data.split(b"\n")
    at = draw.randrange(len(lines))
    if draw.random() < 0.5:
        lines[at:at] = [lines[at]] * _MANY
    else:
        lines[at] += draw.choice((b"(", b"[", b"{", b"<", b"-", b"a.", b"1")) * _MANY
    return b"\n".join(lines)


def _byte(data: bytes, other: bytes, draw: random.Random) -> bytes:
    at = draw.randrange(len(data) + 1)
    change = draw.randrange(3)
    new = b"" if change == 0 else draw.choice(_BYTES)
    return data[:at] + new + data[at + (change < 2) :]


def _cut(data: bytes, other: bytes, draw: random.Random) -> bytes:
    at = draw.randrange(len(data) + 1)
    to = draw.randrange(len(other) + 1)
    return draw.choice((data[:at], data[at:], data[:at] + other[to:]))


def _encoded(data: bytes, other: bytes, draw: random.Random) -> bytes:
    text = data.decode("utf-8", "replace")
    return draw.choice(
        (
            text.encode("utf-16"),
            text.encode("utf-16-be"),
            b"\xef\xbb\xbf" + data,
            data.replace(b"\n", b"\r\n"),
            data.replace(b"\n", b"\r"),
            data.replace(b".", b","),
            data.upper(),
        )
    )


_MUTATIONS: tuple[Mutation, ...] = (
    *(_number, _number, _number, _sign, _token, _token, _token, _case),
    *(_line, _line, _line, _many, _byte, _byte, _cut, _encoded),
)
