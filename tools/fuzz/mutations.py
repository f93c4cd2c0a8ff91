"""Damage to bytes, and values that may break their reader."""

from __future__ import annotations

import copy
import random
import sys
from typing import Any

NASTY_TEXTS = (
    *("2020-13-45", "2020-02-30T25:61:00Z", "=", "<<", '!!null "x"', "!!python/object:os.system x"),
    *(
        "!!binary x",
        "!!set {a}",
        "!!omap [a]",
        "!x y",
        "0x",
        "0b",
        "0o8",
        "010",
        "1_000",
        "1:30:00",
    ),
    *("1" * 5000, "-" + "9" * 400, "1e999", "1e-999", "1e308", "5e-324", "-0.0", ".nan", ".inf"),
    *("-.inf", "NaN", "Infinity", "0", "-1", "9223372036854775808", "18446744073709551616", "1e9"),
    *("~", "null", "yes", "no", "on", "off", "True", "y", '""', "''", "[]", "{}", "- -", "? :"),
    *("*a", "&a x", "&a [*a]", "[[[[[[[[[[[[[[[[[[[[[[[[[", "{a: {b: ", '"', "'", "|", ">-\n  x"),
    *(
        '"a\\0b"',
        "~nouser/x",
        "~",
        "/dev/zero",
        "/dev/stdin",
        "/proc/self/mem",
        "/",
        ".",
        "\\",
        "%",
    ),
    *("a" * 300, "/" * 5000, "x" * 70000, "\x07", "\u2028", "\ufeff", "ä", "\U0001f480", "@", "`"),
    *("1e-9", "1e9", "100000", "1000000000", "0.1", "3.5", "[1, 2]", "[1, 2, 3]", "[1e300, 0, 0]"),
    *("[.nan, 0, 0]", "{1: 2}", "{null: 1}", "{[1]: 2}", "{a: 1, a: 2}", "{kind: box}", "%YAML 9"),
)
"""Scalars and other texts that may occur in YAML."""

NASTY_VALUES: tuple[Any, ...] = (
    *(
        None,
        True,
        False,
        "",
        "x",
        "~nouser/x",
        "a\0b",
        "/dev/zero",
        "/",
        "bone",
        "commanded",
        "1e-3",
    ),
    *(
        0,
        1,
        2,
        -1,
        7,
        100,
        1000,
        4096,
        10**5,
        10**6,
        10**9,
        2**31,
        2**63,
        2**64,
        10**400,
        -(10**40),
    ),
    *(0.0, -0.0, 1e-9, 1e-3, 0.1, 0.5, 1.5, 1e3, 1e6, 1e9, 1e154, 1e308, 5e-324, -1e308),
    *(float("inf"), float("-inf"), float("nan"), [], {}, [[]], [None], [0, 0, 0], [1e308] * 3),
    *([1, 2], [1e-9, 1, 1], ["a", "b"], {"kind": "x"}, {"a": {"b": {"c": 1}}}, {"": 1}, [{}] * 3),
    [1] * 1000,
)
"""Python values that may break their reader."""

_INTERESTING = (
    b"\0",
    b"\xff",
    b"\xff" * 4,
    b"\0" * 8,
    b"\x7f",
    b"\x80",
    b"\n",
    b"\r",
    b"\xef\xbb\xbf",
)


def broken(rng: random.Random, data: bytes, times: int = 3) -> tuple[bytes, str]:
    """Return bytes with one to ``times`` damages, and a description of the damages."""
    told: list[str] = []
    for _ in range(rng.randint(1, times)):
        size = len(data)
        at = rng.randrange(size + 1)
        length = min(int(rng.expovariate(0.1)) + 1, max(size - at, 0))
        match rng.choice(
            ("flip", "flip", "cut", "head", "out", "twice", "set", "put", "move", "zero")
        ):
            case "flip" if at < size:
                bit = 1 << rng.randrange(8)
                data = data[:at] + bytes([data[at] ^ bit]) + data[at + 1 :]
                told.append(f"bit {bit:#x} of byte {at} flipped")
            case "cut":
                data = data[:at]
                told.append(f"cut at {at}")
            case "head" if rng.random() < 0.3:
                data = data[at:]
                told.append(f"begins at {at}")
            case "out":
                data = data[:at] + data[at + length :]
                told.append(f"{length} bytes at {at} gone")
            case "twice":
                data = data[: at + length] + data[at:]
                told.append(f"{length} bytes at {at} twice")
            case "set":
                new = rng.choice(_INTERESTING)
                data = data[:at] + new + data[at + len(new) :]
                told.append(f"{new!r} over {at}")
            case "put":
                new = rng.choice(_INTERESTING)
                data = data[:at] + new + data[at:]
                told.append(f"{new!r} at {at}")
            case "move":
                other = rng.randrange(size + 1)
                piece, left = data[at : at + length], data[:at] + data[at + length :]
                data = left[:other] + piece + left[other:]
                told.append(f"{length} bytes from {at} to {other}")
            case "zero":
                data = data[:at] + bytes(length) + data[at + length :]
                told.append(f"{length} bytes at {at} zero")
            case _:
                told.append("nothing")
    return data, ", ".join(told)


def nasty(rng: random.Random) -> Any:
    """Return a copy of one of ``NASTY_VALUES``."""
    return copy.deepcopy(rng.choice(NASTY_VALUES))


def number_near(rng: random.Random, value: float) -> int | float:
    """Return a number, often near a valid one, that may break its reader."""
    pick = rng.random()
    if abs(value) > sys.float_info.max:  # an integer beyond the range of floats
        return -value if pick < 0.5 else value + 1
    if pick < 0.3:
        return value * rng.choice((-1, 0, 2, 0.5, 10, 1e3, 1e6, 1e12, 1e-3, 1e-9))
    if pick < 0.5:
        return value + rng.choice((-1, 1, 0.5, 1e-9, -1e-9))
    if pick < 0.7:
        return rng.uniform(-10, 1000)
    return rng.choice([v for v in NASTY_VALUES if isinstance(v, int | float)])
