"""Names of articulated objects: `microwave` (any), `microwave:17` (that one), `partnet:7310`."""

from __future__ import annotations

import re

from ...errors import ConfigError, ModelError
from ..appliances import GENERATED, IDS, LAST_ID

PARTNET = "partnet"
OBJECT_FORMS = f"{', '.join(GENERATED)} (or one of them, as {GENERATED[0]}:17), {PARTNET}:ID"
"""The names of objects, for messages."""
_OBJECT = re.compile(rf"({'|'.join((*GENERATED, PARTNET))})(:.*)?")


def is_object(name: str) -> bool:
    """Whether a name has the form of an object's name; the object may still not exist."""
    return _OBJECT.fullmatch(name) is not None


def is_category(name: str) -> bool:
    """Whether a name is that of a category: each sequence shows another instance of it."""
    return name in GENERATED


def parse_object_name(name: str) -> tuple[str, int]:
    """Split the name of one object into its kind and its number."""
    kind, _, number = name.partition(":")
    most = LAST_ID if kind in GENERATED else 10**9
    if not re.fullmatch(r"\d{1,9}", number, re.ASCII) or int(number) > most:
        raise ModelError(f"{name!r} names no object; write {kind}:NUMBER with a number of 0 to "
                         f"{most}, as {kind}:{17 if kind in GENERATED else 7310}")
    return kind, int(number)


def instance_numbers(category: str, stream: str) -> range:
    """Return the numbers of a category's instances that a stream ("test" or "train") may show."""
    if category not in GENERATED:
        raise ConfigError(f"no category {category!r}; there are {', '.join(GENERATED)}")
    return IDS[stream]
