"""Untrusted JSON and TOML become a record, or an error of one line that names file and field."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import pytest
from gcbench.errors import ConfigError, DatasetError
from gcbench.renderer.runtime import (
    MAX_JSON,
    dump_json,
    parse_json,
    parse_toml,
    read_record,
    to_record,
)
from hypothesis import example, given
from hypothesis import strategies as st

Share = Annotated[float, msgspec.Meta(ge=0, le=1)]


@dataclass(frozen=True)
class Inner:
    side: Literal["left", "right"]
    range: tuple[float, float] | None = None


@dataclass(frozen=True)
class Outer:
    frames: Annotated[int, msgspec.Meta(ge=1, le=100)]
    inner: Inner
    shares: tuple[Share, ...] = ()
    more: Mapping[str, Any] | None = None


GOOD: dict[str, Any] = {"frames": 3, "inner": {"side": "left"}}


def test_a_record_has_the_types_of_its_annotations() -> None:
    tree = GOOD | {"shares": [0, 0.5], "unknown": 1}
    assert to_record(tree, Outer, "f") == Outer(3, Inner("left"), (0.0, 0.5))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frames": 0}, "$.frames: expected int >= 1, got 0"),
        ({"frames": 3.0}, "$.frames: expected int, got 3.0"),
        ({"frames": True}, "$.frames: expected int, got True"),
        ({"frames": 10**400}, "$.frames: expected int <= 100, got " + "1" + "0" * 56 + "..."),
        ({"frames": 10**5000}, "$.frames: expected int <= 100, got a huge integer"),
        ({"inner": 3}, "$.inner: expected object, got 3"),
        ({"inner": {}}, "$.inner.side: missing"),
        ({"inner": {"side": "up"}}, "$.inner.side: expected one of left, right, got 'up'"),
        (
            {"inner": {"side": "left", "range": [1]}},
            "$.inner.range: expected array of length 2, got 1",
        ),
        (
            {"inner": {"side": "left", "range": [1, "a\nb"]}},
            r"$.inner.range[1]: expected float, got 'a\nb'",
        ),
        ({"shares": [0.5, 1.5]}, "$.shares[1]: expected float <= 1.0, got 1.5"),
    ],
)
def test_a_wrong_field_is_named(change: dict[str, Any], message: str) -> None:
    with pytest.raises(DatasetError) as caught:
        to_record(GOOD | change, Outer, "data/x.json")
    assert str(caught.value) == f"data/x.json: {message}"


def test_unknown_fields_are_refused_where_asked() -> None:
    tree = {"frames": 3, "inner": {"side": "left", "sight": 1}}
    with pytest.raises(ConfigError, match=r"^f: \$\.inner\.sight: unknown field; there are side, "):
        to_record(tree, Outer, "f", only_known=True, error=ConfigError)


@pytest.mark.parametrize(
    "data",
    [
        b"", b"{", b"[]", b"3", b'{"a": NaN}', b'{"a": Infinity}', b'{"a": 1e999}',
        b"[" * 100_000, b'{"a":' * 5000, b'{"a": ' + b"9" * 40_000 + b"}", b"\xff",
        b'{"a": "\\ud800"}', b'{"a": ' + b"9" * 400 + b"}", b'{"a": -' + b"9" * 400 + b"}",
        b'{"a": ' + b"[" * 600 + b"]" * 600 + b"}", b'{"a":' * 600 + b"1" + b"}" * 600,
    ],
)
def test_what_is_no_json_object_is_one_line(data: bytes) -> None:
    with pytest.raises(DatasetError, match=r"^f: not ") as caught:
        parse_json(data, "f")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "data",
    [b"a =", b"a = nan", b"a = inf", b"a = -1e999", b"\xff", b"a = " + b"9" * 9000,
     b"a = " + b"[" * 9000, b"a = " + b"[" * 300 + b"]" * 300, b"a = " + b"9" * 400,
     b".".join([b"a"] * 600) + b" = 1", b"a = 2026-01-31", b"a = [{b = 12:00:00}]"],
)
def test_what_is_no_toml_is_one_line(data: bytes) -> None:
    with pytest.raises(ConfigError, match=r"^f: not TOML") as caught:
        parse_toml(data, "f")
    assert "\n" not in str(caught.value)


def test_the_format_of_a_file_is_checked(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_bytes(dump_json({"format": "x/1", **GOOD}))
    assert read_record(path, Outer, "x/1", only_known=True).frames == 3
    with pytest.raises(DatasetError, match="'x/1'; this version reads 'x/2'"):
        read_record(path, Outer, "x/2")
    with pytest.raises(DatasetError, match="is larger than"):
        path.write_bytes(b" " * (MAX_JSON + 1))
        read_record(path, Outer)
    with pytest.raises(DatasetError, match="No such file"):
        read_record(tmp_path / "nowhere", Outer)


trees = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=20,
)


def test_a_seed_of_128_bits_and_64_levels_are_read() -> None:
    tree: dict[str, Any] = {"seed": 2**128 - 1}
    for _ in range(63):
        tree = {"a": tree}
    assert parse_json(dump_json(tree), "f") == tree
    with pytest.raises(DatasetError, match="more than 64 levels of nesting"):
        parse_json(dump_json({"a": tree}), "f")


@given(st.dictionaries(st.text(), trees))
def test_what_is_written_is_read(tree: dict[str, Any]) -> None:
    data = dump_json(tree)
    assert json.loads(data) == tree
    assert parse_json(data, "f") == tree


@given(
    st.builds(
        Outer,
        frames=st.integers(1, 100),
        inner=st.builds(Inner, st.sampled_from(["left", "right"])),
        shares=st.lists(st.floats(0, 1)).map(tuple),
    )
)
def test_records_come_back(record: Outer) -> None:
    tree = parse_json(dump_json(asdict(record)), "f")
    assert to_record(tree, Outer, "f", only_known=True) == record


@given(trees, st.booleans())
@example({"frames": 3, "inner": {"side": "left"}, "shares": math.nan}, True)
def test_any_tree_is_a_record_or_one_line(tree: Any, only_known: bool) -> None:
    try:
        assert isinstance(to_record(tree, Outer, "f", only_known), Outer)
    except DatasetError as error:
        assert "\n" not in str(error)
