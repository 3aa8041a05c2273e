"""Find methods by name and load them; only the process that runs a method imports it."""

from __future__ import annotations

import hashlib
import inspect
import json
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast
from urllib.parse import parse_qsl, urlencode

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError, MethodError, suggestion
from ...renderer.runtime import dump_json, to_record
from ...renderer.types import Inputs, Knowledge, Method, Observation
from ..protocol import ORACLES, are_compatible
from ..results import INPUTS, KNOWLEDGE, LABEL, Attribution, Row, is_label
from .standalone import CannotLoadError, find_method, parameters_of

GROUP = "gcbench.methods"
"""Group of the entry points of other packages: name = module:attribute."""
METHODS = {
    "gcpose": "gcbench.gcpose.method:GCPose",
    "gcpose-flow": "gcbench.gcpose.paper.pipeline:FlowOnly",
    "gcpose-epipolar": "gcbench.gcpose.paper.pipeline:Epipolar",
    "gcpose-depth": "gcbench.gcpose.paper.pipeline:WithDepth",
    "screwnet": "gcbench.gcpose.learned.screwnet:ScrewNetMethod",
    "abbatematteo": "gcbench.gcpose.learned.abbatematteo:Abbatematteo",
    "dustnet": "gcbench.gcpose.learned.dustnet:DustNetMethod",
    "craves": "gcbench.gcpose.learned.craves:Craves",
    "icp": "gcbench.benchmark.methods.icp:Icp",
    "icp-first": "gcbench.benchmark.methods.icp:IcpFirst",
    "hold-still": "gcbench.benchmark.methods.baselines:HoldStill",
    "constant-velocity": "gcbench.benchmark.methods.baselines:ConstantVelocity",
}
_SEGMENTER = "gcpose"
_FORMER_SOURCES = {
    "gcbench.gcpose.published:FlowOnly": "gcpose-flow",
    "gcbench.gcpose.published:Epipolar": "gcpose-epipolar",
    "gcbench.gcpose.published:WithDepth": "gcpose-depth",
    "gcbench.benchmark.icp:Icp": "icp",
    "gcbench.benchmark.icp:IcpFirst": "icp-first",
    "gcbench.benchmark.baselines:HoldStill": "hold-still",
    "gcbench.benchmark.baselines:ConstantVelocity": "constant-velocity",
}
"""Names of methods by their module:attribute in earlier versions. Results folders of these versions
store the keys; do not remove an entry."""
_SOURCE = re.compile(r"[\w./~-]+:[A-Za-z_][\w.]*")
_FILE_SOURCE = re.compile(r".+\.py:[A-Za-z_][\w.]*", re.DOTALL)
_FORM = (
    "A method is a class with the attributes name, version, training (str), inputs (a tuple of "
    f"{', '.join(INPUTS)}), knowledge (a tuple of {', '.join(KNOWLEDGE)}) and the function "
    "estimate(observation) -> gcbench.Estimate; its constructor needs no arguments"
)


@dataclass(frozen=True)
class Declaration:
    """The declared properties of a method."""

    name: str
    version: str
    training: str
    inputs: tuple[Inputs, ...]
    knowledge: tuple[Knowledge, ...]
    hint: str = ""
    """Advice for the user on how to enable more inputs."""
    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Settings of the method as a JSON object; empty without settings."""
    attribution: Attribution = field(default_factory=Attribution)
    """Authors, link and date, as far as the method declares them."""
    source: str = ""
    """The source from which it was loaded, with the options that it takes."""
    versions: Mapping[str, str] = field(default_factory=dict[str, str])
    """Of Python and NumPy, if the method runs in another Python."""


@cache
def registered_methods() -> Mapping[str, str]:
    """Return module:attribute by name, also of packages that were installed at the first call.

    Built-in methods win over those of packages.
    """
    others = {e.name: e.value for e in metadata.entry_points(group=GROUP)}
    return MappingProxyType({**others, **METHODS})


def list_methods() -> list[dict[str, str]]:
    """List the methods that `gcbench eval` knows by name.

    Returns:
        For each method its name, inputs, knowledge and training. Methods of other packages are not
        loaded: their training names the module.

    Examples:
        >>> [record["method"] for record in gb.list_methods()][-1]
        'constant-velocity'
    """
    records: list[dict[str, str]] = []
    for name, source in registered_methods().items():
        inputs = knowledge = ""
        training = f"of another package: {source}"
        if name in METHODS:
            try:
                method = declaration_of(load_method(name), name)
                inputs, knowledge = " ".join(method.inputs), " ".join(method.knowledge)
                training = method.training
            except (ConfigError, MethodError) as error:  # it needs an option, or PyTorch
                training = str(error)
        records.append({"method": name, "inputs": inputs, "knowledge": knowledge,
                        "training": training})
    return records


def split_oracles(name: str) -> tuple[str, tuple[str, ...]]:
    """Split METHOD@ORACLE+ORACLE into method and oracles. Raises MethodError if one is unknown.

    In a source, FILE.py:attribute, an @ before the attribute is a part of the path.
    """
    where, colon, named = name.rpartition(":")
    attribute, at, flags = named.partition("@")
    method = where + colon + attribute
    oracles = tuple(dict.fromkeys(flags.split("+"))) if at else ()
    if unknown := [o for o in oracles if o not in ORACLES]:
        raise MethodError(f"{name!r}: no oracle {unknown[0]!r}; there are {', '.join(ORACLES)}")
    return method, oracles


def method_identity(name: str) -> str:
    """Return the identity of a method, with its options, as `run.json` stores it.

    This is the registered name, also for a current or earlier module:attribute of a registered
    method; the source of another method is returned unchanged.
    """
    source, mark, options = name.partition("?")
    names = _FORMER_SOURCES | {path: key for key, path in registered_methods().items()}
    return names.get(source, source) + mark + options


def method_source(name: str) -> str:
    """Return the module:attribute or FILE.py:attribute of a method.

    Raises MethodError with the registered names if there is no such method.
    """
    table, name = registered_methods(), method_identity(name)
    if name in table:
        return table[name]
    if _SOURCE.fullmatch(name):
        return name
    if _FILE_SOURCE.fullmatch(name):
        if "?" in name or not name.isprintable():
            raise MethodError(f"{name}: the path of a method must be printable text without ?; "
                              "rename the file or its folder")
        return name
    raise MethodError(f"no method {name!r}{suggestion(name, table)}; there are {', '.join(table)}, "
                      "and any module:attribute or FILE.py:attribute")


def with_options(source: str, options: dict[str, str]) -> str:
    """Add constructor options to the name or source of a method: `gcpose?flow=raft`."""
    return f"{source}?{urlencode(options)}" if options else source


def is_own(source: str) -> bool:
    """Whether a method, with or without options, is one of gcbench's."""
    return method_identity(source).partition("?")[0] in METHODS


def load_method(source: str) -> Method:
    """Load and construct a method from its name or source, with options (see `with_options`).

    Modules are also searched in the current folder. Raises MethodError if the method is missing or
    invalid, or does not take the options.
    """
    taken, method = open_method(source)
    if unknown := options_of(source).keys() - options_of(taken).keys():
        raise MethodError(f"{source} has no option --{min(unknown)}; leave it out")
    return method


def open_method(source: str) -> tuple[str, Method]:
    """Load a method with those of the options in `source` that it takes.

    Returns `source` with these options, and the method. Raises MethodError as `load_method`.
    """
    name = source.partition("?")[0]
    where = method_source(name)
    try:
        found = find_method(where)
    except CannotLoadError as error:
        raise MethodError(str(error)) from error
    defaults = parameters_of(found)
    settings = ("set",) if "settings" in defaults else ()
    options = {key: value for key, value in options_of(source).items()
               if key in (*defaults, *settings)}
    if isinstance(found, type) or not hasattr(found, "estimate"):
        if not callable(found):
            raise MethodError(f"{where}: not a method. {_FORM}")
        found = _construct(where, cast("Callable[..., Any]", found), options, defaults)
    declaration_of(found, where)
    return with_options(name, options), found


def options_of(source: str) -> dict[str, str]:
    """Return the options that `with_options` added to the source of a method."""
    return dict(parse_qsl(source.partition("?")[2]))


def fingerprint_options(source: str) -> dict[str, str]:
    """Return the hash of the file that each option of a method names, such as weights; options
    without a file are left out."""
    found: dict[str, str] = {}
    for name, value in options_of(source).items():
        for path in map(Path, (value, *(part.partition(":")[2] for part in value.split("+")))):
            with suppress(OSError):  # as for a text that is too long for a path
                if path.is_file():
                    found[name] = _hash_file(path)
    return found


def _hash_file(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(2**20):
            digest.update(block)
    return digest.hexdigest()


def _construct(where: str, method: Callable[..., Any], options: dict[str, str],
               defaults: Mapping[str, Any]) -> Any:
    arguments: dict[str, Any] = dict(options)
    if "set" in options:
        arguments["settings"] = defaults["settings"].override(_parse_changes(arguments.pop("set")))
    if "segment" in defaults:
        arguments.setdefault("segment", _segment)
    with suppress(ValueError):  # compiled code may have no signature
        try:
            inspect.signature(method).bind(**arguments)
        except TypeError as error:
            raise MethodError(f"{where}: {error}; methods are made without any. {_FORM}") from error
    return method(**arguments)


def _segment(observation: Observation) -> NDArray[np.uint8] | None:
    """Segment with the method _SEGMENTER, for methods with a parameter `segment`."""
    return load_method(_SEGMENTER).estimate(observation).part


def _parse_changes(text: str) -> dict[str, str]:
    """Parse "NAME=VALUE NAME=VALUE ...". Raises ConfigError for anything else."""
    out: dict[str, str] = {}
    for item in text.split():
        name, equals, value = item.partition("=")
        if not (name and equals and value):
            raise ConfigError(f"--set {item}: expected NAME=VALUE, such as rgbd.candidates=800")
        out[name] = value
    return out


def declaration_of(method: Any, source: str) -> Declaration:
    """Return the declaration of a method. Raises MethodError with the invalid attribute."""
    if not callable(getattr(method, "estimate", None)):
        raise MethodError(f"{source}: no function estimate(observation). {_FORM}")
    for name in ("name", "version", "training"):
        value = getattr(method, name, None)
        if not is_label(value):
            raise MethodError(f"{source}: {name} is {value!a}, expected {LABEL}. {_FORM}")
    for name, known in (("inputs", INPUTS), ("knowledge", KNOWLEDGE)):
        values = getattr(method, name, None)
        if not isinstance(values, tuple | list) or not values:
            raise MethodError(f"{source}: {name} is {values!a}, expected a tuple of {known}")
        if wrong := [v for v in cast("list[Any]", values) if v not in known]:
            raise MethodError(f"{source}: no {name} {wrong[0]!a}; there are {', '.join(known)}")
    settings = getattr(getattr(method, "settings", None), "as_dict", dict[str, Any])
    return Declaration(
        method.name, method.version, method.training, tuple(method.inputs),
        tuple(method.knowledge), str(getattr(method, "hint", "")),
        json.loads(dump_json(settings())), _attribution(method, source),
    )


def _attribution(method: Any, source: str) -> Attribution:
    given = {name: getattr(method, name, "") for name in ("authors", "link", "date")}
    try:
        return to_record(given, Attribution, source, error=MethodError)
    except MethodError as error:
        raise MethodError(f"{source}: authors is {given['authors']!a}, link {given['link']!a}, "
                          f"date {given['date']!a}, expected one line, an address with https:// "
                          "and YYYY-MM-DD, YYYY-MM or YYYY (all optional)") from error


def plan_rows(
    declared: Declaration,
    oracles: tuple[str, ...] = (),
    inputs: tuple[Inputs, ...] = (),
    knowledge: tuple[Knowledge, ...] = (),
) -> list[Row]:
    """Return the rows to evaluate: the requested inputs and knowledge, by default all supported.

    A method without images, or without knowledge, is beside all others: requests do not concern it.
    Raises MethodError for an unsupported request.
    """
    inputs = () if declared.inputs == ("none",) else inputs
    knowledge = () if declared.knowledge == ("none",) else knowledge
    for requested, supported, what in (
        (inputs, declared.inputs, "inputs"),
        (knowledge, declared.knowledge, "knowledge"),
    ):
        if missing := [value for value in requested if value not in supported]:
            hint = f"; {declared.hint}" if declared.hint and what == "inputs" else ""
            raise MethodError(
                f"{declared.name} does not support {what} {missing[0]}; "
                f"it supports {', '.join(supported)}{hint}"
            )
    rows = [
        Row(declared.name, declared.version, i, k, declared.training, oracles)
        for i in inputs or declared.inputs
        for k in knowledge or declared.knowledge
        if are_compatible(i, k)
    ]
    if not rows:
        raise MethodError(f"{declared.name}: it supports no such pair of inputs and knowledge")
    if oracles and all(row.inputs == "none" for row in rows):
        raise MethodError(f"{declared.name} gets no images; leave out @{'+'.join(oracles)}")
    return rows
