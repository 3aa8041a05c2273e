"""Random choices of a case, and values that readers may not expect.

A case is a function of (kind, seed, index): the draws do not depend on the code under test (as
those of hypothesis do, which takes constants from it), so that a finding stays reproducible after
it is mended.
"""

from __future__ import annotations

import random
from typing import Any


class Raw(str):
    """Text that stands in a JSON file as it is, such as 1e999."""


class CaseRng(random.Random):
    """The choices of one case; `steps` tells them to a reader."""

    def __init__(self, kind: str, seed: int, index: int) -> None:
        super().__init__(f"{kind} {seed} {index}")
        self.steps: list[str] = []

    def chance(self, probability: float) -> bool:
        return self.random() < probability

    def few(self, most: int) -> range:
        """0 to `most` times; few are likelier. The first of hundred cases has none."""
        return range(min(most, int(self.expovariate(0.8))))

    def note(self, text: str) -> None:
        self.steps.append(text[:120])


NAMES = (
    "",
    " ",
    "a",
    "world",
    "base",
    "../secret/secret",
    "/etc/passwd",
    "~",
    "~root",
    "a\nb",
    "a\tb",
    "\x1b[31mred\x1b[0m",
    "\x07",
    "\u202e",
    "\ufeff",
    "\x85",
    "x" * 300,
    "x" * 5000,
    "%s%n",
    "${v}",
    "$(arg x)",
    "{0}",
    "-1",
    "--help",
    "nan",
    "None",
    "C:\\a",
    "a/b",
    "a\\b",
    ".",
    "..",
    ".zip",
    "con",
    "'; x",
    "<script>",
    "&amp;",
    "\u00e9",
    "\U0001f916",
    "a\u0301",
    "000000",
    "=1+1",
)
REFERENCES = (
    "../secret/secret.obj",
    "../../secret/secret.stl",
    "../secret/secret.png",
    "/etc/passwd",
    "file:///etc/passwd",
    "http://127.0.0.1:9/a.obj",
    "ftp://x/a.stl",
    "package://m/a.stl",
    "package:///etc/passwd",
    "package://../secret/secret.obj",
    "model://m/cube.obj",
    "~/a.obj",
    "C:\\a.obj",
    "\\\\host\\a.obj",
    "link.obj",
    "pipe.obj",
    "folder.obj",
    "./cube.obj",
    "m.urdf",
    "cube.obj/../cube.obj",
    "%2e%2e/secret/secret.obj",
    "a%00.obj",
    "cube.OBJ",
    "cube.obj#1",
    "",
    "data:application/octet-stream;base64,AAAA",
    "x" * 2000 + ".obj",
    "nowhere.stl",
    "big.png",
)
NUMBERS = (
    "0",
    "-0",
    "1",
    "-1",
    "2",
    "0.5",
    "1e-9",
    "-1e-9",
    "1e-320",
    "1e9",
    "-1e9",
    "1e16",
    "1e30",
    "1e38",
    "1e39",
    "1e308",
    "1e309",
    "1e999",
    "-1e999",
    "nan",
    "NaN",
    "inf",
    "-inf",
    "Infinity",
    "2147483647",
    "2147483648",
    "4294967295",
    "9223372036854775807",
    "9223372036854775808",
    "18446744073709551616",
    "1" + "0" * 400,
    "1" + "0" * 5000,
    "0x10",
    "1_0",
    "1,5",
    "1.5.5",
    "--1",
    "+1",
    "1e",
    ".",
    "",
    "${v}",
    "n/a",
    "\u0661",
    "1 2",
    "1 2 3 4 5 6 7",
    "true",
    "1f",
    "-0.0",
)
_JSON_RAW = (
    "1e999",
    "-1e999",
    "NaN",
    "Infinity",
    "-Infinity",
    "1" + "0" * 400,
    "1" + "0" * 5000,
    '"\\ud800"',
    "[" * 600 + "]" * 600,
    "1e-400",
    "-0",
    "0.1e1",
    '"\\u0000"',
)


def value(rng: CaseRng) -> Any:
    """A value that a reader may not expect."""
    return rng.choice(
        [
            lambda: None,
            lambda: rng.chance(0.5),
            lambda: rng.choice(
                [
                    0,
                    -1,
                    1,
                    2,
                    3,
                    7,
                    255,
                    256,
                    65535,
                    65536,
                    2**31 - 1,
                    2**31,
                    2**32,
                    2**53 + 1,
                    2**63,
                    2**64,
                    -(2**31),
                    -(2**63) - 1,
                    10**30,
                ]
            ),
            lambda: rng.choice(
                [0.0, -0.0, 0.5, 1.5, -1.5, 1e-12, 1e-320, 1e9, 1e20, 1e300, -1e300]
            ),
            lambda: rng.choice(NAMES),
            lambda: rng.choice(REFERENCES),
            lambda: rng.choice(NUMBERS),
            lambda: [],
            lambda: {},
            lambda: [value(rng) for _ in range(rng.randrange(1, 5))],
            lambda: {rng.choice(NAMES): value(rng)},
            lambda: Raw(rng.choice(_JSON_RAW)),
        ]
    )()


def shown(item: Any) -> str:
    return ascii(item)[:60]
