"""The page of `gcbench report` in a real browser: Debian's `chromium`, driven by Playwright."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gcbench.benchmark.report.gallery import Picture
from gcbench.benchmark.report.leaderboard import read_leaderboard
from gcbench.benchmark.report.lines import CURVE_THRESHOLDS
from gcbench.benchmark.report.page import report_page
from gcbench.benchmark.report.tables import format_error
from gcbench.benchmark.results.rows import Attribution, Row, write_scores
from gcbench.benchmark.results.runs import RUN, SCORES, read_run, write_run

from ...renderer.show.test_show_browser import HOSTILE, luminance, until
from ...renderer.show.test_show_browser import (
    browser as browser,  # the fixture, with its rule of skipping
)
from ...support.fake_results import (
    FREE,
    GCPOSE,
    ICP,
    NOISY,
    ORACLE,
    STILL,
    read_results,
    write_results,
)

NASTY = Row(HOSTILE.replace("\u2028", ""), "<i>1</i>", "rgbd", "free", f"supervised: {HOSTILE}")
PIXEL = ("data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk"
         "+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg==")

FILM = PIXEL.replace("png;", "png;name=film;")


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    for dataset, n in ("mini/ur5", 6), ("mini/iiwa14", 8):
        write_results(folder, GCPOSE, 0.002, dataset, n, seed=1)
        write_results(folder, NOISY, 0.004, dataset, n, seed=2)
        write_results(folder, FREE, 0.008, dataset, n, seed=3)
        write_results(folder, ICP, 0.05, dataset, n, seed=4, failing=(2,), reason=HOSTILE)
        write_results(folder, STILL, None, dataset, n)
    path = write_results(folder, ORACLE, 0.02, "mini/ur5", seed=5)
    by = Attribution(f"A. Author {HOSTILE}".replace("\u2028", ""), "https://example.org/p", "2024")
    write_run(path, dataclasses.replace(read_run(path / RUN), attribution=by))
    old = [r for r in read_results(path / SCORES) if r.metric not in ("pixels", "distance")]
    write_scores(path / SCORES, old)
    write_results(folder, NASTY, 0.03, "mini/ur5", seed=6)
    write_results(folder, GCPOSE, 0.01, "zz" + HOSTILE, joints=(HOSTILE, "slide"), prismatic=1)
    return folder


@pytest.fixture(scope="module")
def file(results: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    board = read_leaderboard([results])
    pictures = [
        Picture(0, "worst", "000001", 2.0, (("pan", 1.0), (HOSTILE, 3.0)), image=PIXEL, film=FILM,
                page="sequences/01-ur5-000001.html"),
        Picture(0, "median", "000002", 1.0, (("pan", 1.0),), reason=HOSTILE),
        Picture(1, "worst", "000003", 1.0, (), reason=HOSTILE, command=f"gcbench show {HOSTILE}"),
    ]
    path = tmp_path_factory.mktemp("page") / "index.html"
    path.write_text(report_page(board, pictures))
    return path


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
    tab.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
    tab.on("pageerror", lambda error: said.append(str(error)))
    tab.on("dialog", lambda dialog: (said.append("dialog"), dialog.dismiss()))
    tab.on("request", lambda request: asked.append(request.url))
    tab.goto(file.as_uri())
    until(tab, "document.querySelectorAll('#board tbody tr').length > 0")
    yield tab
    assert not said
    assert {url.split("#")[0] for url in asked if not url.startswith("data:")} == {file.as_uri()}
    assert tab.evaluate("window.hacked") is None
    assert tab.locator("img[onerror], main b b, main i, script").count() == 2, "our scripts only"
    context.close()


def column(tab: Any, title: str) -> list[str]:
    heads = [text.strip() for text in tab.locator("#board thead th").all_text_contents()]
    cells = tab.locator(f"#board tbody tr > :nth-child({heads.index(title) + 1})")
    return cells.all_text_contents()


def methods(tab: Any) -> list[str]:
    return tab.locator("#board tbody .name").all_text_contents()


def means(tab: Any) -> list[float]:
    return [float(text.rstrip("°m ")) for text in column(tab, "mean error")]


def choose(tab: Any, kind: str, value: str) -> None:
    # The box lies invisibly over its chip.
    tab.locator(f"#filters input[data-filter={kind}][value={value!r}]").check(force=True)


def test_the_table_has_the_numbers_of_the_board(page: Any, results: Path) -> None:
    board = read_leaderboard([results])
    lines = board.lines
    assert methods(page) == [re.sub(r"\s+", " ", line.row.name) for line in lines]
    assert column(page, "mean error") == [
        format_error(x.summary.mean) + ("°" if x.unit == "deg" else " m") for x in lines]
    assert column(page, "PCP@5") == [f"{x.summary.pcp[2]:.1f} %" for x in lines]
    assert [int(x) for x in column(page, "#")] == list(board.ranks)
    assert page.locator("#shown").text_content() == f"{len(lines)} rows"


def test_sort_by_pointer_and_by_keyboard(page: Any) -> None:
    def head(title: str) -> Any:
        return page.locator("#board thead th", has_text=title)

    page.get_by_role("button", name="mean error", exact=True).click()
    assert means(page) == sorted(means(page))
    assert head("mean error").get_attribute("aria-sort") == "ascending"
    page.get_by_role("button", name="mean error", exact=True).press("Enter")
    assert means(page) == sorted(means(page), reverse=True)
    assert head("mean error").get_attribute("aria-sort") == "descending"
    page.get_by_role("button", name="PCP@5", exact=True).focus()
    page.keyboard.press("Space")
    shares = [float(text.rstrip(" %")) for text in column(page, "PCP@5")]
    assert shares == sorted(shares, reverse=True), "a share is best when it is large"
    assert head("mean error").get_attribute("aria-sort") == "none"
    page.get_by_role("button", name="s / frame", exact=True).click()
    assert column(page, "s / frame")[-2:] == ["–", "–"], "what is unknown is last"
    page.get_by_role("button", name="knowledge", exact=True).click()
    order = ["none", "free", "axes", "kinematics", "model"]
    found = column(page, "knowledge")
    assert found == sorted(found, key=order.index)


def test_filter(page: Any) -> None:
    everything = len(methods(page))
    choose(page, "dataset", "mini/iiwa14")
    assert len(methods(page)) == 5
    assert page.locator("#shown").text_content() == f"5 of {everything} rows"
    choose(page, "knowledge", "axes")
    assert methods(page) == ["gcpose", "gcpose", "icp"]
    choose(page, "inputs", "rgbd")
    assert set(column(page, "inputs")) == {"rgbd"}
    choose(page, "method", "hold-still")
    assert methods(page) == []
    assert page.locator("#nothing").is_visible() and not page.locator("#board").is_visible()
    page.get_by_role("button", name="Show all rows").click()
    assert len(methods(page)) == everything
    assert not page.locator("#filters input:checked").count()


def test_the_address_keeps_the_view(page: Any, file: Path) -> None:
    choose(page, "inputs", "rgbd")
    choose(page, "dataset", "mini/iiwa14")
    page.get_by_role("button", name="mean error", exact=True).click(click_count=2)
    view = "#dataset=mini%2Fiiwa14&track=rgbd&sort=-mean&below=mini%2Fiiwa14"
    assert page.url == file.as_uri() + view
    shown = methods(page)
    assert set(column(page, "inputs")) == {"rgbd"} and len(shown) == 3
    page.locator("nav a", has_text="Curves").click()
    assert page.evaluate("scrollY") > 500, "a link to a section keeps the filters"
    page.reload()
    until(page, "document.querySelectorAll('#board tbody tr').length > 0")
    assert methods(page) == shown
    assert page.locator("#filters input:checked").count() == 2
    assert page.locator("#dataset option:checked").text_content() == "mini/iiwa14"
    assert page.locator("#legend button").count() == 3, "the charts have the same rows"
    page.evaluate("location.hash = '#track=rgbd-noise&dataset=nowhere&sort=nothing&below=nothing'")
    until(page, "document.querySelectorAll('#filters input:checked').length === 1")
    assert set(column(page, "inputs")) == {"rgbd-noise"}


def test_ranks_are_among_the_rows_shown(page: Any) -> None:
    choose(page, "dataset", "mini/iiwa14")
    first = dict(zip(methods(page), column(page, "#"), strict=True))
    assert int(first["icp"]) > 1
    choose(page, "method", "icp")
    choose(page, "method", "hold-still")
    assert column(page, "#") == ["1", "2"]


def test_a_chosen_sign_is_said(page: Any) -> None:
    said = {row.locator(".name").text_content(): row.locator(".method").text_content()
            for row in page.locator("#board tbody tr").all()}
    assert "best sign" in said["hold-still"] and "best sign" not in said["icp"]


def test_a_method_has_its_authors_link_and_date(page: Any) -> None:
    cell = page.locator("#board tr", has_text="icp@true-parts").locator(".method")
    assert cell.locator("a").get_attribute("href") == "https://example.org/p"
    assert cell.locator("a").get_attribute("rel") == "noopener noreferrer"
    by = cell.locator(".by").text_content()
    assert by.startswith("A. Author </script>") and by.endswith(", 2024")
    assert page.locator("#board .method a").count() == 1


def test_errors_by_condition(page: Any) -> None:
    for name in ("displacement", "pixels", "distance"):
        curves = page.locator(f"#by-{name} path.series").count()
        assert curves == (7 if name == "displacement" else 6)
        assert page.locator(f"#by-{name} circle").count() == 4 * curves
    said = page.locator("#by-pixels .note").text_content()
    assert said.startswith("Not recorded for icp@true-parts · rgbd · axes: gcbench eval")
    assert page.locator("#by-displacement .note").text_content() == ""
    page.locator("#by-distance svg").focus()
    page.keyboard.press("Home")
    tip = page.locator("#by-distance .tip b").text_content()
    assert re.fullmatch(r"about [0-9.]+ m, 5 joints", tip)
    page.keyboard.press("Escape")


def test_all_columns(page: Any) -> None:
    page.get_by_label("all columns").check()
    heads = [text.strip() for text in page.locator("#board thead th").all_text_contents()]
    assert {"std", "PCP@1", "PCP@10", "within σ", "sequences", "sign", "training"} <= set(heads)
    assert "part mIoU" not in heads, "no row has one"
    assert column(page, "sequences")[0] == "6"


def test_the_papers_numbers_are_marked_and_apart(page: Any) -> None:
    table = page.locator("#tables table.paper").first
    assert table.locator("thead tr").first.locator("th").nth(1).text_content() == "ur5"
    ours = table.locator("tbody tr", has_text="gcpose · rgbd · axes").locator("td")
    assert ours.nth(2).text_content() == "2.21, 91.6 %"
    assert "reference" in ours.nth(2).get_attribute("class")
    assert table.locator("tbody tr.reference").count() == 3
    assert "(paper)" not in page.locator("#board").text_content()
    assert page.locator("#board", has_text="FlowNet2").count() == 0


def test_differences_follow_the_reference(page: Any, results: Path) -> None:
    board = read_leaderboard([results])
    lines, labels, found = board.lines, board.labels, board.differences
    here = [k for k, line in enumerate(lines) if line.dataset == "mini/ur5"]
    last = here[-1]
    page.locator("#reference").select_option(str(last))
    rows = page.locator("#differences tbody tr")
    assert rows.count() == len(here) - 1
    text = rows.first.locator("td").all_text_contents()
    d = found[here[0], last]
    assert rows.first.locator("th").text_content() == labels[here[0]]
    assert float(text[0].replace("\u2212", "-").rstrip("°")) == pytest.approx(d.mean, rel=6e-3)
    assert text[-1] == "better" and d.ci_high < 0
    page.locator("#reference").select_option(str(here[0]))
    assert rows.last.locator("td").last.text_content() == "worse"


def test_hover_reads_the_curves(page: Any, results: Path) -> None:
    lines = [x for x in read_leaderboard([results]).lines if x.dataset == "mini/ur5"]
    drift = page.locator("#drift svg")
    drift.scroll_into_view_if_needed()
    box = drift.bounding_box()
    page.mouse.move(box["x"] + box["width"] - 14, box["y"] + box["height"] / 2)
    tip = page.locator("#drift .tip")
    assert tip.is_visible() and tip.locator("b").text_content() == "frame 4"
    rows = tip.locator("div").all_text_contents()
    worst = max(lines, key=lambda line: line.drift[4])
    assert rows[0] == f"hold-still{format_error(worst.drift[4])}°"
    assert len(rows) == len(lines)
    assert tip.bounding_box()["height"] < 30 * (1 + len(lines))
    assert {s.bounding_box()["width"] for s in tip.locator("svg").all()} == {22}
    page.mouse.move(5, 5)
    assert not tip.is_visible()

    page.locator("#pcp svg").focus()
    page.keyboard.press("End")
    page.keyboard.press("ArrowLeft")
    tip = page.locator("#pcp .tip")
    limit = CURVE_THRESHOLDS["deg"][-2]
    assert tip.locator("b").text_content() == f"at most {limit:g}°"
    icp = next(line for line in lines if line.row == ICP)
    assert f"icp · rgbd · axes{icp.curve[-2]:.1f} %" in tip.locator("div").all_text_contents()
    page.keyboard.press("Escape")
    assert not tip.is_visible()


def test_curves_can_be_hidden_and_made_linear(page: Any) -> None:
    paths = page.locator("#drift path.series")
    before = paths.count()
    shape = paths.first.get_attribute("d")
    button = page.locator("#legend button", has_text="hold-still")
    button.click()
    assert paths.count() == before - 1
    assert button.get_attribute("aria-pressed") == "false"
    button.click()
    page.get_by_label("linear scales").check()
    assert page.locator("#drift path.series").first.get_attribute("d") != shape


def test_hover_reads_the_runtime_plot(page: Any) -> None:
    svg = page.locator("#runtime svg")
    svg.scroll_into_view_if_needed()
    dot = svg.locator("circle").first.bounding_box()
    page.mouse.move(dot["x"] + dot["width"] / 2, dot["y"] + dot["height"] / 2)
    tip = page.locator("#runtime .tip")
    assert tip.is_visible()
    assert "seconds a frame0.100" in tip.text_content()
    assert svg.locator("circle").count() == 6, "hold-still's time is unknown"


def test_labels_of_the_runtime_plot_hide_nothing(browser: Any, tmp_path: Path) -> None:
    """Rows of like times and errors: labels have room, or are named below the plot. Of twenty, the
    best twelve are drawn."""
    for k in range(20):
        write_results(tmp_path, dataclasses.replace(GCPOSE, method=f"method-{k}"), 0.01, seed=k)
    write_results(tmp_path, STILL, None)
    path = tmp_path / "index.html"
    path.write_text(report_page(read_leaderboard([tmp_path]), []))
    for tab in opened(browser, path, 800):
        tab.locator("#speed").scroll_into_view_if_needed()
        texts = [text.bounding_box() for text in tab.locator("#runtime text.label").all()]
        dots = [dot.bounding_box() for dot in tab.locator("#runtime circle").all()]
        assert len(dots) == 12 and len(texts) >= 6
        for k, a in enumerate(texts):
            for b in (*texts[:k], *dots):
                assert (a["x"] + a["width"] <= b["x"] or b["x"] + b["width"] <= a["x"]
                        or a["y"] + a["height"] <= b["y"] + 3 or b["y"] + b["height"] <= a["y"] + 3)
        below = tab.locator("#untimed").text_content()
        assert below.startswith("Untimed: hold-still.")
        assert len(texts) + below.count("method-") == 12
        assert tab.locator("#drift path.series").count() == 12
        assert tab.locator("#drawn").text_content().startswith("The 12 rows with the smallest")
        tab.locator("#legend button[aria-pressed=false]").first.click()
        assert tab.locator("#drift path.series").count() == 13
        assert tab.locator("#runtime circle").count() == 13


def test_calibration_is_shown_of_rows_that_tell_their_errors(page: Any, results: Path) -> None:
    lines = [line for line in read_leaderboard([results]).lines if line.dataset == "mini/iiwa14"]
    assert lines[0].calibration is not None
    page.locator("#dataset").select_option("mini/iiwa14")
    paths = page.locator("#calibration-chart path.series")
    rows = page.locator("#calibration-table tbody tr")
    assert (len(lines), paths.count(), rows.count()) == (5, 4, 4), "hold-still tells nothing"
    cells = rows.first.locator("td").all_text_contents()
    assert cells[0] == f"{100 * lines[0].means['within_sigma']:.1f} %"
    assert cells[6] == str(lines[0].calibration.large_reliable)
    icp = [row.text_content() or "" for row in rows.all() if "icp" in (row.text_content() or "")]
    assert [row.count("% of 21 joints") for row in icp] == [2], "one sequence of 8 failed"
    assert cells[1:3] == ["66.7 %", f"{format_error(lines[0].calibration.reliable_error)}°"]
    page.locator("#legend button").first.click()
    assert (paths.count(), rows.count()) == (3, 4)


def test_another_dataset(page: Any) -> None:
    assert page.locator("#pictures figure").count() == 3
    page.locator("#dataset").select_option(label="mini/iiwa14")
    assert page.locator("#legend button").count() == 5
    assert not page.locator("#gallery").is_visible()
    prismatic = page.locator("#dataset option", has_text="prismatic").get_attribute("value")
    page.locator("#dataset").select_option(prismatic)
    assert "(m)" in page.locator("#drift").text_content()
    assert not page.locator("#compare").is_visible()


def test_the_gallery_shows_the_picture_or_the_reason(page: Any) -> None:
    first, second, third = page.locator("#pictures figure").all()
    first.scroll_into_view_if_needed()
    until(page, "document.querySelector('#pictures img').naturalWidth === 1")
    assert "worst" in first.text_content() and "000001: 2.00° on average" in first.text_content()
    assert "red" in first.locator("img").get_attribute("alt")
    assert "onerror" in second.locator(".none").text_content()
    assert first.locator("a").get_attribute("href") == "sequences/01-ur5-000001.html"
    assert first.locator("code").count() == second.locator("code").count() == 0
    assert third.locator("a").count() == 0, "no page, so a command instead of a dead link"
    assert third.locator("code").text_content().startswith("gcbench show </script>")
    picture, button = first.locator("img"), first.get_by_role("button")
    button.click()
    assert picture.get_attribute("src") == FILM and button.text_content() == "stop"
    button.click()
    assert picture.get_attribute("src") == PIXEL and button.text_content() == "play"
    said = page.locator("#gallery-bounds").text_content()
    assert said.startswith("To keep this page small, 2 of 14 rows have pictures")


def test_hostile_names_are_text(page: Any) -> None:
    said = " ".join(HOSTILE.split())
    assert NASTY.name in methods(page)
    assert said in page.locator("#failures").text_content()
    for where in ("#filters", "#about", "#table-list", "#dataset", "#legend", "#pictures",
                  "#reference", "#differences", "#numbers"):
        assert "onerror" in page.locator(where).text_content(), where


def test_provenance_says_machine_limits_and_failures(page: Any) -> None:
    text = page.locator("#provenance").text_content()
    for words in ("seconds_per_sequence300.0", "cpua cpu", "numpy2",
                  "oracles: true-parts", "are not published", "Failed sequences (2)",
                  "mini/iiwa14"):  # fmt: skip
        assert words in text, words


@pytest.mark.parametrize("width", [320, 390, 768])
def test_no_horizontal_scrolling(browser: Any, file: Path, width: int, scheme: str) -> None:
    for tab in opened(browser, file, width, scheme):
        assert tab.evaluate("document.documentElement.scrollWidth") <= width
        tab.get_by_label("all columns").check()
        for summary in tab.locator("summary").all():
            summary.click()
        assert tab.evaluate("document.documentElement.scrollWidth") <= width
        inside = tab.evaluate("""() => [...document.querySelectorAll('section, .chart svg, figure')]
            .filter(n => n.getBoundingClientRect().right > innerWidth + 1).length""")
        assert inside == 0


def test_a_phone_sees_method_and_error_at_once(browser: Any, file: Path) -> None:
    for tab in opened(browser, file, 390):
        row = tab.locator("#board tbody tr").first
        right = row.locator("td.n").first.bounding_box()
        assert right["x"] + right["width"] <= 390
        assert "mini/ur5 · rgbd · axes" in row.locator(".tag.phone").text_content()
        assert row.locator(".tag.phone").is_visible()


def test_text_is_legible_in_both_schemes(browser: Any, file: Path, scheme: str) -> None:
    """WCAG AA: a contrast of 4.5 between text and what is behind it."""
    seen = ("h1", "#facts", "h2", ".note", "nav a", "#board th button", "#board td.n", ".name",
            ".tag", ".tag.oracle", ".medal.top", ".medal", ".chip span", "legend", "summary",
            "table.paper td.reference", "tr.reference th", ".verdict-worse", "#legend button",
            "figcaption .kind.worst", "#about th", "#about td", "#failures td")  # fmt: skip
    for tab in opened(browser, file, 1280, scheme):
        choose(tab, "dataset", "mini/ur5")
        for chosen in (*seen, "input:checked + span"):
            colors = tab.locator(chosen).first.evaluate("""node => {
                let back = node;
                while (/^rgba\\(.*, 0\\)$/.test(getComputedStyle(back).backgroundColor))
                    back = back.parentElement;
                return [getComputedStyle(node).color, getComputedStyle(back).backgroundColor];
            }""")
            dark, light = sorted(luminance(color) for color in colors)
            assert (light + 0.05) / (dark + 0.05) > 4.5, (chosen, colors)


def test_everything_that_can_be_used_has_a_name(page: Any) -> None:
    unnamed = page.evaluate("""() =>
        [...document.querySelectorAll('button, input, select, svg, img')].filter(
            n => !(n.getAttribute('aria-label') || n.getAttribute('aria-hidden') || n.alt
                       || n.textContent.trim() || n.closest('label'))).map(n => n.outerHTML)""")
    assert not unnamed
    for region in page.locator(".scroll").all():
        assert region.get_attribute("tabindex") == "0"


def test_the_page_of_one_row_and_one_sequence(browser: Any, tmp_path: Path) -> None:
    """Nothing to compare, no interval, no time, one joint."""
    row = dataclasses.replace(STILL, method="alone")
    write_results(tmp_path, row, None, sequences=1, joints=("one",), frames=2)
    board = read_leaderboard([tmp_path])
    path = tmp_path / "index.html"
    path.write_text(report_page(board, []))
    for tab in opened(browser, path, 1280):
        assert column(tab, "#") == ["1"]
        assert not tab.locator("#compare").is_visible()
        assert not tab.locator("#gallery").is_visible()
        assert tab.locator("#board svg title").text_content().startswith("no interval")
        tab.get_by_label("linear scales").check()
        assert np.isfinite(tab.evaluate("document.querySelector('#drift svg').clientHeight"))
