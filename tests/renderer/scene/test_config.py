"""A configuration states its bounds, and survives JSON and TOML."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from gcbench.errors import ConfigError, ModelError
from gcbench.renderer.scene.config import (
    FACTORS,
    LAYERS,
    STUDIO,
    Bounds,
    CameraConfig,
    RandomizationConfig,
    RenderConfig,
    TexturesConfig,
    find_invalid_values,
    resolve,
)
from gcbench.renderer.scene.config_files import config_tree, parse_config, read_config
from gcbench.renderer.scene.images import KINDS, PLAIN
from hypothesis import given
from hypothesis import strategies as st


def fields(kind: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """(dotted name, annotation) of every field that holds no other config."""
    for name, hint in get_type_hints(kind, include_extras=True).items():
        if dataclasses.is_dataclass(hint):
            yield from fields(hint, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", hint


def is_numeric(hint: Any) -> bool:
    return hint in (int, float) or any(is_numeric(inner) for inner in get_args(hint))


def bounds_of(hint: Any) -> list[Bounds]:
    return [b for b in get_args(hint)[1:] if isinstance(b, Bounds)]


def test_every_number_has_bounds() -> None:
    numeric = {name: hint for name, hint in fields(RenderConfig) if is_numeric(hint)}
    assert {"frames", "randomization.camera.azimuth", "randomization.lights.number"} <= {*numeric}
    assert [name for name, hint in numeric.items() if len(bounds_of(hint)) != 1] == []


def set_field(config: Any, name: str, value: Any) -> Any:
    first, _, rest = name.partition(".")
    inner = set_field(getattr(config, first), rest, value) if rest else value
    return replace(config, **{first: inner})


@pytest.mark.parametrize("name", [n for n, hint in fields(RenderConfig) if bounds_of(hint)])
def test_a_number_out_of_bounds_is_refused_by_name(name: str) -> None:
    hint = dict(fields(RenderConfig))[name]
    (bounds,) = bounds_of(hint)
    many = get_origin(hint.__origin__) is not None and hint.__origin__ != (float | None)
    for wrong in (bounds.low - 1, float("nan")):
        value = (wrong,) * (3 if name.endswith("color") else 2) if many else wrong
        config = set_field(RenderConfig(), name, value)
        assert [field for field, _ in find_invalid_values(config)] == [name]
        option = name.removeprefix("randomization.").replace("_", "-")
        is_whole = hint.__origin__ in (int, tuple[int, int]) and wrong != wrong  # NaN is none
        message = rf"{name}.*: expected a whole number" if is_whole else f"^--{option} .*: give "
        with pytest.raises(ConfigError, match=message):
            resolve(config)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("stream", "tets", "stream: expected one of test, train, got 'tets'"),
        ("samples", 3, "samples: expected one of 1, 4, 9, got 3"),
        ("samples", True, "samples: expected one of 1, 4, 9, got True"),
        ("flow", "all", "flow: expected one of both, forward, none, got 'all'"),
        ("visibility", "no", "visibility: expected True or False, got 'no'"),
        ("animation", None, "animation: expected a text, got None"),
        ("frames", 2.5, "frames: expected a whole number, got 2.5"),
        ("frames", True, "frames: expected a whole number, got True"),
        ("scale", "1", "scale: expected a number, got '1'"),
        ("layers", "normal", r"layers: write a tuple, layers=\('normal',\)"),
        ("vary", {"motion"}, "vary: expected a tuple, got {'motion'}"),
        ("scored_joints", ("base", 3), r"scored_joints\[1\]: expected a text, got 3"),
        ("randomization", None, "randomization: expected a RandomizationConfig, got None"),
        ("randomization.camera.fov", (40.0,), r"camera.fov: expected 2 values, got \(40.0,\)"),
        ("randomization.camera.azimuth", "0", "camera.azimuth: expected a tuple, got '0'"),
    ],
)
def test_a_value_of_another_type_is_refused(name: str, value: Any, message: str) -> None:
    """What `dataset.json` could not hold, and what would be read letter by letter."""
    config = set_field(RenderConfig(), name, value)
    with pytest.raises(ConfigError, match=rf"^RenderConfig\.([\w.]+\.)?{message}$"):
        resolve(config)


def test_lists_and_numbers_of_numpy_become_plain() -> None:
    config = RenderConfig(frames=np.int64(3), vary=["motion"], samples=np.int8(4))  # pyright: ignore
    config = set_field(config, "randomization.camera.fov", np.array([30.0, 40.0]))
    found = resolve(config)
    assert (type(found.frames), found.vary, found.samples) == (int, ("motion",), 4)
    assert found.randomization.camera.fov == (30.0, 40.0)
    with pytest.raises(ConfigError, match="expected a RenderConfig, got 'ur5'"):
        resolve("ur5")  # pyright: ignore


def test_ranges_ascend() -> None:
    camera = CameraConfig(fov=(50.0, 40.0))
    with pytest.raises(ConfigError, match=r"--camera\.fov 50 40: give the smaller number first"):
        resolve(RenderConfig(randomization=RandomizationConfig(camera=camera)))


@pytest.mark.parametrize("text", ["a\0b", "\x1b[31mur5", "m\udcff.urdf", "a\nb"])
def test_text_that_no_file_or_terminal_takes_is_refused(text: str) -> None:
    """`dataset.json` could not be read back, or the terminal would obey."""
    for name, value in (("animation", text), ("scored_joints", ("a", text)),
                        ("randomization.textures.folder", text)):
        with pytest.raises(ConfigError, match="leave out control characters") as caught:
            resolve(set_field(RenderConfig(), name, value))
        assert str(caught.value).isascii() and "\n" not in str(caught.value)


def values(hint: Any) -> st.SearchStrategy[Any]:
    """Values of an annotation within its bounds."""
    if bounds := bounds_of(hint):
        (b,), inner = bounds, get_args(hint)[0]
        inner = next(k for k in (*get_args(inner), inner) if k is not type(None)) \
            if type(None) in get_args(inner) else inner
        kind = int if int in (inner, *get_args(inner)) else float
        high = min(b.high, 1e15)
        number = st.integers(int(b.low), int(high)) if kind is int else st.floats(b.low, high)
        if get_origin(inner) is tuple:
            count = len(get_args(inner))
            drawn = st.lists(number, min_size=count, max_size=count)
            return drawn.map(sorted if b.ordered else list).map(tuple)
        return number
    if hint is bool:
        return st.booleans()
    if hint is str:
        return st.text(st.characters(exclude_categories=("Cc", "Cs")), max_size=8)
    if get_origin(hint) is tuple:
        return st.lists(values(get_args(hint)[0]), min_size=1, max_size=3).map(tuple)
    return st.sampled_from(get_args(hint))


@st.composite
def configs(draw: st.DrawFn) -> RenderConfig:
    config = draw(st.sampled_from([RenderConfig(), RenderConfig(randomization=STUDIO)]))
    known = {"layers": LAYERS, "vary": FACTORS}
    kinds = {"randomization.textures.kinds": (*KINDS,),
             "randomization.background.kinds": (*KINDS, PLAIN)}
    for name, hint in draw(st.lists(st.sampled_from([*fields(RenderConfig)]), max_size=6)):
        if name in known:
            value = tuple(draw(st.lists(st.sampled_from(known[name]), unique=True)))
        elif name in kinds:
            value = tuple(draw(st.lists(st.sampled_from(kinds[name]), min_size=1, max_size=3)))
        elif name in ("robot", "twin_of"):
            names = ["ur5", "ur5-textured", "microwave", "x/y.urdf"]
            value = draw(st.sampled_from([*names, "", "own"] if name == "twin_of" else names))
        else:
            value = draw(values(hint))
        config = set_field(config, name, value)
    return config


def toml(tree: dict[str, Any], table: str = "") -> str:
    """TOML of a config's tree; JSON writes its strings, numbers and lists alike."""
    lines = [f"{k} = {json.dumps(v, ensure_ascii=False)}" for k, v in tree.items()
             if not isinstance(v, dict)]
    tables = [f"[{table}{k}]\n{toml(v, f'{table}{k}.')}" for k, v in tree.items()
              if isinstance(v, dict)]
    return "\n".join([*lines, *tables]) + "\n"


@given(configs())
def test_a_config_survives_json_and_toml(tmp_path_factory: Any, config: RenderConfig) -> None:
    config = resolve(config)
    assert resolve(config) == config
    tree = config_tree(config)
    assert parse_config(tree, "") == config
    folder = Path(tmp_path_factory.getbasetemp())
    for suffix, text in ((".toml", toml(tree)), (".json", json.dumps(tree))):
        (folder / f"config{suffix}").write_text(text, encoding="utf-8")
        assert read_config(folder / f"config{suffix}") == config


def test_fields_that_earlier_versions_lacked_are_stored_where_they_are_set() -> None:
    usual = RenderConfig()
    assert "exposure_drift" not in config_tree(usual)["randomization"]["image"]
    assert not any("shake" in name for name in config_tree(usual)["randomization"]["camera"])
    assert "flow" not in config_tree(usual)
    ranges = usual.randomization
    changed = replace(usual, flow="none", randomization=replace(
        ranges, image=replace(ranges.image, exposure_drift=(0.0, 1.0)),
        camera=replace(ranges.camera, shake_turn=(0.1, 0.2))))
    tree = config_tree(changed)
    assert tree["randomization"]["image"]["exposure_drift"] == [0.0, 1.0]
    assert tree["randomization"]["camera"]["shake_turn"] == [0.1, 0.2]
    assert tree["flow"] == "none"
    assert parse_config(tree, "") == replace(changed, twin_of=tree["twin_of"])


def test_a_file_of_an_earlier_version_has_its_draws(tmp_path: Path) -> None:
    (tmp_path / "old.toml").write_text("seed = 3")
    (tmp_path / "new.toml").write_text('seed = 3\ntwin_of = "own"')
    old, new = (resolve(read_config(tmp_path / name)) for name in ("old.toml", "new.toml"))
    assert (old.twin_of, new.twin_of) == ("", "ur5")
    assert resolve(old) == old
    assert resolve(new) == new
    stored = {k: v for k, v in config_tree(old).items() if k != "twin_of"}
    assert parse_config(stored, "") == old


def test_a_twin_is_a_robot() -> None:
    assert resolve(RenderConfig(twin_of="ur5-textured")).twin_of == "ur5"
    for name, message in (("ur55", "no robot 'ur55' .perhaps you meant ur5"),
                          ("oven:x", "names no object")):
        with pytest.raises(ModelError, match=message):
            resolve(RenderConfig(twin_of=name))


def test_no_kind_to_draw_from_is_refused() -> None:
    for name in ("textures", "background"):
        said = rf"randomization\.{name}\.kinds: is empty: name a kind"
        with pytest.raises(ConfigError, match=said):
            parse_config({"randomization": {name: {"kinds": []}}}, "")
    ranges = RandomizationConfig(textures=TexturesConfig(kinds=()))
    with pytest.raises(ConfigError, match=r"--textures\.kinds is empty: name a kind"):
        resolve(RenderConfig(randomization=ranges))


@pytest.mark.parametrize(("option", "wrong"), [
    ("textures", "foo"), ("textures", "plain"), ("background", "foo")])
def test_an_unknown_kind_is_refused_before_a_sequence_draws_it(option: str, wrong: str) -> None:
    config = set_field(RenderConfig(), f"randomization.{option}.kinds", ("noise", wrong))
    with pytest.raises(ConfigError, match=rf"^--{option}\.kinds {wrong}: there are noise, checker"):
        resolve(config)


def test_a_configuration_file_has_a_suffix_that_tells_its_format(tmp_path: Path) -> None:
    (tmp_path / "config.txt").write_text("frames = 3")
    with pytest.raises(ConfigError, match=r"config\.txt: a configuration file is named \.toml or"):
        read_config(tmp_path / "config.txt")


def test_what_was_not_given_stays_open_until_the_robot_is_known() -> None:
    unresolved = parse_config({"frames": 3}, "")
    assert unresolved.randomization.camera.azimuth is None
    assert unresolved.randomization.textures.probability is None
    for robot in ("ur5", "microwave"):
        assert resolve(replace(unresolved, robot=robot)).randomization.camera.azimuth
