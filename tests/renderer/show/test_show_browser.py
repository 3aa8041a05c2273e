"""The page of `gcbench show` in a real browser: Debian's `chromium`, driven by Playwright."""

from __future__ import annotations

import dataclasses
import itertools
import os
import re
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gcbench.renderer.show.page import write_page
from gcbench.renderer.types.sequence import Sequence

from ...support.analytic import render
from .test_view3d import modelled

HOSTILE = '</script><img src="http://example.invalid/x" onerror="window.hacked=1"><b>\u2028&amp;'
FLAGS = ("--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync", "--disable-quic")
PANES = ("rgb", "depth", "part", "flow", "flow_backward", "visibility")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    def missing(what: str) -> None:
        if os.environ.get("CI") == "true":
            pytest.fail(f"{what} is missing, and in CI the page must be tested")
        pytest.skip(f"{what} is missing: `apt-get install chromium`, `pip install playwright`")

    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        missing("the browser `chromium`")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        missing("the Python package playwright")
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=path, args=list(FLAGS))
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a sequence whose every name is an attack."""
    s = render(width=160, height=120, frames=5)
    rgb = [np.full((120, 160, 3), 40 * t + 20, np.uint8) for t in range(5)]
    joints = (HOSTILE, *s.meta.joint_names[1:])
    meta = dataclasses.replace(
        s.meta, name=HOSTILE, asset={"name": HOSTILE, HOSTILE: HOSTILE}, joint_names=joints,
        part_names=(*s.meta.part_names[:1], HOSTILE, *s.meta.part_names[2:]),
        scored_joints=joints[:2], observability={"joints": {HOSTILE: {HOSTILE: HOSTILE}}})
    sequence = Sequence(meta, s.state, rgb, s.depth, s.part, s.flow, s.flow_backward, s.visibility)
    links = [("up", "index.html", HOSTILE), ("next", "000001.html", "000001 →")]
    return write_page(sequence, tmp_path_factory.mktemp("page") / "page.html", None, links)


@pytest.fixture(params=["light", "dark"])
def scheme(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def page(browser: Any, file: Path) -> Iterator[Any]:
    yield from opened(browser, file, width=1280)


def opened(browser: Any, file: Path, width: int, scheme: str = "light") -> Iterator[Any]:
    """The open page; afterwards, that nothing was logged, fetched, or run from the data."""
    context = browser.new_context(viewport={"width": width, "height": 800}, color_scheme=scheme)
    tab = context.new_page()
    said: list[str] = []
    asked: list[str] = []
    tab.on("console", lambda message: said.append(f"{message.type}: {message.text}")
           if "GPU stall" not in message.text else None)  # by screenshots, without a GPU
    tab.on("pageerror", lambda error: said.append(str(error)))
    tab.on("dialog", lambda dialog: (said.append("dialog"), dialog.dismiss()))
    tab.on("request", lambda request: asked.append(request.url))
    tab.goto(file.as_uri())
    at_frame(tab, 0)
    yield tab
    assert not said
    assert [url for url in asked if not url.startswith("data:")] == [file.as_uri()]
    assert tab.evaluate("window.hacked") is None
    assert tab.locator("img[onerror], main b b, script").count() == 2, "the page's own scripts only"
    context.close()


def at_frame(tab: Any, frame: int) -> None:
    """Wait until every pane shows this frame."""
    until(tab, f"""{list(PANES)}.every(
        k => document.getElementById('canvas-' + k).dataset.frame === '{frame}')""")
    assert f"frame {frame} of" in tab.locator("#time").text_content()


def until(tab: Any, expression: str, seconds: float = 20) -> None:
    """Wait until an expression is true. Playwright's own way evaluates text inside the page, which
    the page's security policy forbids."""
    end = time.monotonic() + seconds
    while not tab.evaluate(expression):
        assert time.monotonic() < end, f"never true: {expression}"
        tab.wait_for_timeout(20)


def grey(tab: Any, pane: str = "rgb") -> int:
    """The red of a canvas's middle."""
    return tab.evaluate("""id => {
        const copy = new OffscreenCanvas(160, 120).getContext('2d', {willReadFrequently: true});
        copy.drawImage(document.getElementById(id), 0, 0);
        return copy.getImageData(80, 60, 1, 1).data[0];
    }""", f"canvas-{pane}")


def space(tab: Any) -> bytes:
    """The pixels of the 3D view once it shows the slider's frame."""
    until(tab, """document.getElementById('canvas-space').dataset.frame
        === document.getElementById('slider').value""")
    tab.wait_for_timeout(100)  # it is drawn in the browser's next animation frame
    return tab.locator("#canvas-space").screenshot()


def cursor(tab: Any) -> float:
    return float(tab.locator("#curves .cursor").first.get_attribute("x1"))


def test_slider_changes_pictures_axes_and_cursor(page: Any) -> None:
    before = cursor(page), page.locator("#axes path").nth(3).get_attribute("d")
    assert abs(grey(page) - 20) < 4
    page.locator("#slider").fill("3")
    at_frame(page, 3)
    assert abs(grey(page) - 140) < 4
    assert cursor(page) > before[0]
    assert page.locator("#axes path").nth(3).get_attribute("d") != before[1]


def test_flow_is_absent_where_there_is_no_other_frame(page: Any) -> None:
    assert page.locator("#pane-flow_backward .empty").is_visible()
    assert not page.locator("#pane-flow .empty").is_visible()
    page.keyboard.press("End")
    at_frame(page, 4)
    assert page.locator("#pane-flow .empty").is_visible()
    assert page.locator("#pane-visibility .empty").is_visible()
    assert not page.locator("#pane-flow_backward .empty").is_visible()


def test_keys(page: Any) -> None:
    for key, frame in (("ArrowRight", 1), ("ArrowRight", 2), ("ArrowLeft", 1), ("Home", 0),
                       ("ArrowLeft", 0), ("End", 4), ("ArrowRight", 4)):
        page.keyboard.press(key)
        at_frame(page, frame)
    assert page.locator("#axes").is_visible()
    page.keyboard.press("a")
    assert not page.locator("#axes").is_visible()


def test_play_and_pause(page: Any) -> None:
    page.keyboard.press("Space")
    assert page.locator("#play").text_content() == "Pause"
    until(page, "document.getElementById('slider').value === '3'")
    page.locator("#play").click()
    assert page.locator("#play").text_content() == "Play"
    frame = page.locator("#slider").input_value()
    page.wait_for_timeout(400)
    assert page.locator("#slider").input_value() == frame


def test_toggles(page: Any) -> None:
    page.locator("#show-axes").uncheck()
    assert not page.locator("#axes").is_visible()
    page.locator("#show-axes").check()
    assert page.locator("#axes").is_visible()

    path = page.locator("#curves svg path").first
    absolute = path.get_attribute("d")
    page.locator("#relative").check()
    assert path.get_attribute("d") != absolute

    stage = page.locator("#pane-depth .stage")
    width = stage.bounding_box()["width"]
    larger = page.get_by_role("button", name="Enlarge Depth")
    larger.click()
    assert stage.bounding_box()["width"] > 1.5 * width
    assert larger.get_attribute("aria-pressed") == "true"


def test_3d_view_moves_with_the_slider_and_turns(page: Any) -> None:
    first = space(page)
    page.locator("#slider").fill("3")
    later = space(page)
    assert later != first
    page.locator("#slider").fill("0")
    assert space(page) == first
    page.locator("#show-background").uncheck()
    assert space(page) != first
    page.locator("#show-background").check()
    assert space(page) == first
    seen = {first}
    for button in ("Nearer", "Camera's view", "Farther"):
        page.get_by_role("button", name=button).click()
        seen.add(space(page))
    assert len(seen) == 4
    page.get_by_role("button", name="Reset").click()
    assert space(page) == first
    box = page.locator("#canvas-space").bounding_box()
    page.mouse.move(box["x"] + 200, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 300, box["y"] + 220)
    page.mouse.up()
    assert space(page) not in seen
    assert not page.locator("#model-label").is_visible(), "there is no model to show or hide"
    note = page.locator("#space-note").text_content()
    assert "The model is not available on this machine" in note


def test_3d_view_of_a_model(browser: Any, tmp_path: Path) -> None:
    s = render(width=160, height=120, frames=2)
    rgb = [np.full((120, 160, 3), 90, np.uint8)] * 2
    meta = dataclasses.replace(s.meta, asset={})
    sequence = dataclasses.replace(s, meta=meta, rgb=rgb)
    file = write_page(sequence, tmp_path / "page.html", modelled())
    for tab in opened(browser, file, width=800):
        first = space(tab)
        tab.locator("#show-model").uncheck()
        assert space(tab) != first
        tab.locator("#show-model").check()
        assert space(tab) == first


def test_labels_of_axes_do_not_overlap(browser: Any, tmp_path: Path) -> None:
    s = render(width=160, height=120, frames=2)
    many = 20
    names = tuple(f"vertebra_{j}_joint" for j in range(many))
    meta = dataclasses.replace(s.meta, joint_names=names, scored_joints=names, observability={},
                               joint_types=s.meta.joint_types[:1] * many,
                               joint_limits=s.meta.joint_limits[:1] * many)
    screw = np.repeat(s.state.joint_screw[:, :1], many, axis=1)
    state = dataclasses.replace(
        s.state, joint_screw=screw, joint_positions=np.zeros((2, many)),
        joint_parent_part=np.ones(many, np.int64), joint_child_part=np.full(many, 2))
    file = write_page(dataclasses.replace(s, meta=meta, state=state), tmp_path / "page.html")
    for tab in opened(browser, file, width=1280):
        boxes = tab.evaluate("""[...document.querySelectorAll('#axes text')].map(
            node => node.getBBox()).map(
            box => [box.x, box.y, box.x + box.width, box.y + box.height])""")
        assert len(boxes) >= 12
        high = 20 * 160 / 640
        for a, b in itertools.combinations(boxes, 2):  # a line's box is a little higher than text
            assert (a[0] >= b[2] or b[0] >= a[2]
                    or a[1] >= b[3] - 0.5 * high or b[1] >= a[3] - 0.5 * high)


def test_no_card_is_empty(browser: Any, tmp_path: Path) -> None:
    """A single frame of an object without joints."""
    s = render(width=160, height=120, frames=2)
    none = np.zeros(0, np.int64)
    state = dataclasses.replace(
        s.state, times=s.state.times[:1], joint_positions=np.zeros((1, 0)),
        cam_from_world=s.state.cam_from_world[:1], world_from_part=s.state.world_from_part[:1],
        joint_screw=np.zeros((1, 0, 6)), joint_parent_part=none, joint_child_part=none,
        part_pixels=s.state.part_pixels[:1])
    meta = dataclasses.replace(s.meta, frames=1, joint_names=(), joint_types=(), joint_limits=(),
                               scored_joints=(), observability={})
    lone = Sequence(meta, state, s.rgb[:1], s.depth[:1], s.part[:1], [], [], [])
    context = browser.new_context()
    tab = context.new_page()
    tab.goto(write_page(lone, tmp_path / "page.html").as_uri())
    until(tab, "document.getElementById('canvas-part').dataset.frame === '0'")
    assert tab.locator(".pane").count() == 3
    assert not tab.locator(".empty:visible, #controls:visible, #curves-card:visible").count()
    assert not tab.locator("#joints-card").is_visible()
    assert tab.locator("#space").is_visible()
    assert "arrows" not in tab.locator("#space-note").text_content()
    assert not tab.locator("#show-axes").is_visible()
    context.close()


def test_images_are_visible_without_scripts(browser: Any, file: Path) -> None:
    context = browser.new_context(java_script_enabled=False, viewport={"width": 390, "height": 800})
    tab = context.new_page()
    tab.goto(file.as_uri())
    images = tab.locator("#static img")
    assert [image.get_attribute("alt") for image in images.all()] == [
        f"{name} of the first frame" for name in ("RGB", "Depth", "Parts", "Forward flow",
                                                  "Visibility")]
    for image in images.all():
        assert image.bounding_box()["width"] > 300
        assert image.bounding_box()["height"] > 200, "the picture itself, not its alternative text"
    assert HOSTILE in tab.locator("noscript h1").text_content()
    assert tab.locator("nav:visible a").all_text_contents() == [HOSTILE, "000001 →"]
    assert not tab.locator("#bar").is_visible()
    assert tab.locator("img[onerror], b b").count() == 0
    context.close()


def test_links_are_text(page: Any) -> None:
    assert page.locator("#nav a").all_text_contents() == [HOSTILE, "000001 →"]
    assert page.locator("#nav a[rel=next]").get_attribute("href") == "000001.html"


def test_pointer_reads_the_values_of_the_truth(page: Any) -> None:
    s = render(width=160, height=120, frames=5)
    v, u = (int(x) for x in np.argwhere(s.part[0] == 3).mean(axis=0))
    box = page.locator("#pane-part .stage canvas").bounding_box()
    at = (box["x"] + (u + 0.5) * box["width"] / 160, box["y"] + (v + 0.5) * box["height"] / 120)
    page.mouse.move(*at)
    until(page, "document.getElementById('readout').textContent.includes('depth')")
    said = page.locator("#readout").text_content()
    pixel, depth, *flow = (float(x) for x in re.search(
        r"pixel \((\d+), .*depth ([\d.]+) m.*flow \((\S+), (\S+)\) px", said).groups())
    u = round(pixel)
    assert "part upper" in said
    assert depth == pytest.approx(float(s.depth[0][v, u]), abs=2e-3)
    assert flow == pytest.approx(list(s.flow[0][v, u]), abs=0.02)
    assert page.locator("#part-legend li.at").text_content() == "upper"
    page.mouse.move(5, 5)
    until(page, "document.getElementById('readout').textContent.startsWith('Move the pointer')")


def test_hostile_names_are_text(page: Any) -> None:
    assert page.locator("#part-legend li").nth(1).text_content() == HOSTILE
    assert HOSTILE in page.locator("#joints tbody").text_content()
    assert HOSTILE in page.locator("#joints thead").text_content()
    assert HOSTILE in page.locator("h1").text_content()
    assert page.locator("#about th", has_text="onerror").count() == 1
    assert page.title().startswith("</script>")


@pytest.mark.parametrize("width", [320, 390, 768])
def test_no_horizontal_scrolling(browser: Any, file: Path, width: int, scheme: str) -> None:
    for tab in opened(browser, file, width, scheme):
        assert tab.evaluate("document.documentElement.scrollWidth") <= width
        tab.locator("summary").click()
        assert tab.evaluate("document.documentElement.scrollWidth") <= width


def test_text_is_legible_in_both_schemes(browser: Any, file: Path, scheme: str) -> None:
    """WCAG AA: a contrast of 4.5 between text and what is behind it."""
    for tab in opened(browser, file, 1280, scheme):
        for chosen in ("h1", "#facts", "#time", "#readout", "#joints th", "#joints td", "h2"):
            colors = tab.locator(chosen).first.evaluate("""node => {
                let back = node;
                while (getComputedStyle(back).backgroundColor === 'rgba(0, 0, 0, 0)')
                    back = back.parentElement;
                return [getComputedStyle(node).color, getComputedStyle(back).backgroundColor];
            }""")
            dark, light = sorted(luminance(color) for color in colors)
            assert (light + 0.05) / (dark + 0.05) > 4.5, chosen


def luminance(css: str) -> float:
    c = np.array([int(x) for x in re.findall(r"\d+", css)[:3]]) / 255
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))


def test_everything_that_can_be_used_has_a_name(page: Any) -> None:
    unnamed = page.evaluate("""() => [...document.querySelectorAll('button, input, select, canvas')]
        .filter(n => !(n.getAttribute('aria-label') || n.textContent.trim() || n.closest('label')))
        .map(n => n.outerHTML)""")
    assert not unnamed
    assert page.locator("#slider").get_attribute("aria-valuetext").startswith("frame 0")
