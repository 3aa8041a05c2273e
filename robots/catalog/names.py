"""Articulated objects by name: `microwave` (any), `microwave:17` (that one), `partnet:7310`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from ...errors import GcbenchError
from ..appliances import GENERATED, IDS
from ..appliances import generator as appliances
from ..model import ArticulatedModel

PARTNET = "partnet"
KINDS = (*GENERATED, PARTNET)
HELP = f"{', '.join(GENERATED)} (or one of them, as {GENERATED[0]}:17), {PARTNET}:ID"
_NAMES = re.compile(rf"({'|'.join(KINDS)})(:.*)?")


def is_object(name: str) -> bool:
    """Whether a name means an object; it may still be one that does not exist."""
    return _NAMES.fullmatch(name) is not None


def is_category(name: str) -> bool:
    """Whether a name means any object of a category: each sequence shows another one."""
    return name in GENERATED


def split(name: str) -> tuple[str, int]:
    """Kind and number of one object. Raises GcbenchError if the name is not that of one."""
    kind, _, number = name.partition(":")
    most = appliances.LARGEST if kind in GENERATED else 10**9
    if not re.fullmatch(r"\d{1,9}", number, re.ASCII) or int(number) > most:
        raise GcbenchError(f"{name!r} names no object; write {kind}:NUMBER with a number of 0 to "
                           f"{most}, as {kind}:{17 if kind in GENERATED else 7310}")
    return kind, int(number)


def instances(category: str, stream: str) -> range:
    """Numbers of the category's objects that a stream ("test" or "train") may show."""
    if category not in GENERATED:
        raise GcbenchError(f"no category {category!r}; there are {', '.join(GENERATED)}")
    return IDS[stream]


def folder_of(
    name: str, packages: Mapping[str, Path] | None = None, download: bool = True
) -> Path:
    """The folder of one object: generated, or the user's (`packages["partnet"]` goes first).

    Raises GcbenchError if there is none of that name, or it would have to be downloaded and may
    not be.
    """
    kind, number = split(name)
    if kind in GENERATED:
        return appliances.appliance_folder(kind, number)
    from ..urdf import partnet_folder

    return partnet_folder(str(number), (packages or {}).get(PARTNET), download)


def load_named(
    name: str, packages: Mapping[str, Path] | None = None, allow_missing: bool = False
) -> ArticulatedModel:
    """The model of one object. Raises GcbenchError if there is none of that name."""
    from ..urdf import partnet

    kind, number = split(name)
    model = partnet.load_object(folder_of(name, packages), allow_missing)
    name = f"{kind}:{number}"
    if kind in GENERATED:
        return replace(model, name=name, source=appliances.SOURCE, licence=appliances.LICENCE)
    return replace(model, name=name, source=f"{name}, PartNet-Mobility", licence=partnet.LICENCE)
