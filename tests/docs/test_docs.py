"""The pages: their commands and Python run, their links lead somewhere, nothing is left out."""

from __future__ import annotations

import inspect
import re
import runpy
import shlex
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import gcbench
import pytest
from gcbench.__main__ import COMMANDS, main
from gcbench.benchmark.report.published_rows import PUBLISHED_ROWS, published_lines

from ..test_architecture import LAYERS

CHECKOUT = Path(__file__).parents[2]
DOCS = CHECKOUT / "docs"
PAGES = [CHECKOUT / "README.md", CHECKOUT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
EXAMPLES = [
    pytest.param(example, id=example.stem, marks=[pytest.mark.slow] * ("ablation" in example.stem))
    for example in sorted((DOCS / "examples").glob("*.py"))
]
SMALL = ("--n", "2", "--frames", "5", "--width", "128", "--height", "96", "--workers", "1")
"""What a test renders in place of the sizes that a page asks for."""
LIMITED = ("--n", "--frames", "--width", "--height", "--workers")


@dataclass(frozen=True)
class Block:
    """A block of code of a page."""

    language: str
    text: str
    line: int
    mode: str
    """run; slow: only in a slow test; parse: never run, but its options or syntax are checked."""


def blocks(page: Path) -> Iterator[Block]:
    """The fenced blocks of a page. `<!-- test: MODE -->` in the line above one sets its mode."""
    text = page.read_text()
    pattern = r"(?m)^(?:<!-- test: (\w+) -->\n)?```(\w+)\n(.*?)^```$"
    for match in re.finditer(pattern, text, re.DOTALL):
        line = text.count("\n", 0, match.start()) + 1
        yield Block(match[2], match[3], line, match[1] or "run")


def commands(text: str) -> list[str]:
    """The `gcbench` and `make` lines of a block."""
    lines = text.replace("\\\n", " ").splitlines()
    return [line.removeprefix("$ ") for line in lines
            if line.removeprefix("$ ").startswith(("gcbench ", "make "))]


def name(page: Path) -> str:
    return page.relative_to(CHECKOUT).as_posix()


# -- what pages tell one to do ----------------------------------------------------------------


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_the_commands_of_a_page_parse(
    page: Path, parses: Callable[[str], bool], capsys: pytest.CaptureFixture[str], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    targets = re.findall(r"(?m)^([a-z-]+):", (CHECKOUT / "Makefile").read_text())
    for block in blocks(page):
        if block.language == "python" and "--8<--" not in block.text:
            compile(block.text, f"{name(page)}:{block.line}", "exec")
        for line in commands(block.text) if block.language == "bash" else ():
            words = shlex.split(line, comments=True)
            if words[0] == "make":
                assert set(words[1:]) <= {*targets, *(w for w in words if "=" in w)}, line
            elif not (words[1].startswith("-") or words[1] == "help"):
                if "--config" in words:
                    config = Path(words[words.index("--config") + 1])
                    config.parent.mkdir(exist_ok=True)
                    config.write_text("{}" if config.suffix == ".json" else "")
                assert parses(line), (line, capsys.readouterr().err)


@dataclass
class Page:
    """Runs the blocks of one page, in order, in a folder of its own."""

    rendered: dict[str, Path]
    """Datasets that this session has rendered, by their command line."""
    names: dict[str, Any]

    def run(self, block: Block) -> None:
        first = block.text.partition("\n")[0]
        if saved := re.fullmatch(r"(?:#|<!--) ([\w./]+\.\w+)(?: -->)?", first):
            Path(saved[1]).write_text(block.text)
        if block.language == "python" and not saved:
            exec(compile(block.text, f"line {block.line}", "exec"), self.names)
        elif block.language == "bash":
            for line in commands(block.text):
                self.command(shlex.split(line, comments=True))

    def command(self, words: list[str]) -> None:
        if words[0] == "make" or words[1].startswith("-"):
            return
        if words[1] == "render":
            self.render(words[1:])
            return
        allowed = (0, 1) if words[1] == "verify" and "broken" in words[-1] else (0,)
        assert main(words[1:]) in allowed, shlex.join(words)

    def render(self, words: list[str]) -> None:
        args: list[str] = []
        for k, word in enumerate(words):
            if word not in LIMITED and (k == 0 or words[k - 1] not in LIMITED):
                args.append(word)
        key = shlex.join(args)
        out = Path(args[args.index("--out") + 1]) if "--out" in args else None
        if out is None:
            robot = args[args.index("--robot") + 1] if "--robot" in args else "ur5"
            out = Path("data") / Path(robot).stem.replace(":", "-")
        if key in self.rendered and not out.exists():
            shutil.copytree(self.rendered[key], out)
            return
        assert main([*args, *SMALL]) == 0, key
        self.rendered.setdefault(key, out.absolute())


@pytest.fixture(scope="session")
def rendered() -> dict[str, Path]:
    return {}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty working folder, from which Python imports too."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    before = set(sys.modules)
    yield tmp_path
    for module in {n for n in set(sys.modules) - before if Path(f"{n}.py").is_file()}:
        del sys.modules[module]


def run_page(page: Path, modes: tuple[str, ...], rendered: dict[str, Path]) -> None:
    """Run the blocks of the page whose mode is one of these."""
    runner = Page(rendered, {"__name__": "__page__"})
    need_extras(page)
    for block in blocks(page):
        if block.mode in modes and "--8<--" not in block.text:
            try:
                runner.run(block)
            except BaseException as error:
                if hasattr(error, "add_note"):
                    error.add_note(f"{name(page)}:{block.line}")
                raise


def need_extras(file: Path) -> None:
    """Skip the test of a page or example that needs PyTorch or Ray where there is none."""
    text = file.read_text()
    if re.search(r"(?m)^(import|from) torch\b", text):
        pytest.importorskip("torch", reason="PyTorch is in the extra learn")
    if "--executor ray" in text:
        pytest.importorskip("ray", reason="no ray: pip install '.[cluster]'")


def modes_of(page: Path) -> set[str]:
    return {b.mode for b in blocks(page) if b.language in ("bash", "python")}


@pytest.mark.gl
@pytest.mark.parametrize("page", [p for p in PAGES if "run" in modes_of(p)], ids=name)
def test_a_page_runs(page: Path, rendered: dict[str, Path], folder: Path) -> None:
    run_page(page, ("run",), rendered)


@pytest.mark.gl
@pytest.mark.slow
@pytest.mark.parametrize("page", [p for p in PAGES if "slow" in modes_of(p)], ids=name)
def test_a_page_runs_to_its_end(page: Path, rendered: dict[str, Path], folder: Path) -> None:
    run_page(page, ("run", "slow"), rendered)


def test_blocks_have_a_language() -> None:
    """A block without one, or with an unknown one, would not be tested."""
    known = {"bash", "python", "toml", "xml", "text", "json", "csv", "bibtex"}
    for page in PAGES:
        fences = re.findall(r"(?m)^ *```(.*)$", page.read_text())
        assert len(fences) % 2 == 0, page
        assert {f.split()[0] if f else "" for f in fences[::2]} <= known, page


@pytest.mark.gl
@pytest.mark.parametrize("example", EXAMPLES)
@pytest.mark.ci
def test_an_example_runs(
    example: Path, folder: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    need_extras(example)
    monkeypatch.setattr(sys, "argv", [str(example), "--small", "--out", "out/data"])
    runpy.run_path(str(example), run_name="__main__")
    assert capsys.readouterr().out.strip()
    made = "door.csv" if "marker" in example.stem else "dataset.json"
    assert list(folder.rglob(made))


# -- what pages promise -----------------------------------------------------------------------


def test_the_readme_is_short() -> None:
    assert len((CHECKOUT / "README.md").read_text().splitlines()) <= 150


def test_every_page_is_in_the_navigation() -> None:
    listed = re.findall(r"- (?:[\w ]+: )?([\w/]+\.md)$", (CHECKOUT / "mkdocs.yml").read_text(),
                        re.MULTILINE)
    assert sorted(listed) == sorted(p.relative_to(DOCS).as_posix() for p in DOCS.rglob("*.md"))


def test_the_api_page_has_every_public_name() -> None:
    listed = set(re.findall(r"(?m)^::: gcbench\.(\w+)$", (DOCS / "reference/api.md").read_text()))
    errors = {name for name in gcbench.__all__ if name.endswith("Error")}
    assert listed == set(gcbench.__all__) - errors | {"errors"}


def test_the_api_page_has_what_the_public_functions_take_and_return() -> None:
    page = (DOCS / "reference/api.md").read_text()
    listed = set(re.findall(r"(?m)^::: gcbench\.(?:[\w.]+\.)?(\w+)$", page))
    names = [getattr(gcbench, name) for name in gcbench.__all__]
    functions = [public for public in names if inspect.isfunction(public)]
    named = {name for f in functions for hint in f.__annotations__.values()
             for name in re.findall(r"\b[A-Z]\w+", str(hint))}
    foreign = {"Any", "Collection", "Mapping", "None", "Path", "False", "True"}
    members = {"Meta", "State", "RandomizationConfig", "TorchDataset"}
    assert not (named | members) - foreign - listed


def test_the_page_on_architecture_shows_the_layers() -> None:
    text = (DOCS / "develop/architecture.md").read_text()
    cells = [row.split("|") for row in re.findall(r"(?m)^\| \d+ \|(.*)\|$", text)]
    for column, room in enumerate(LAYERS):
        shown = [set(re.findall(r"\w+", row[column])) for row in cells if row[column].strip()]
        shims = {"observation", "torch_dataset"}
        assert shown == [set(floor.split()) - shims for floor in LAYERS[room]], room


def test_every_example_can_be_downloaded() -> None:
    page = (DOCS / "examples/index.md").read_text()
    for script in DOCS.glob("examples/*.py"):
        assert f"[{script.name}]({script.name})" in page


OURS = "https://github.com/gcbench/gcbench/blob/main/"


@pytest.mark.parametrize("page", [*PAGES, CHECKOUT / "CHANGELOG.md"], ids=name)
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"(?s)```.*?```", "", page.read_text())
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        link = link.replace("https://raw.githubusercontent.com/gcbench/gcbench/main/", OURS)
        path, _, anchor = link.partition("#")
        if path.startswith(("http://", "https://")) and not path.startswith(OURS):
            continue
        target = CHECKOUT / path[len(OURS):] if path.startswith(OURS) else page.parent / path
        target = target if path else page
        assert target.exists(), link
        if anchor and target.name != "cli.md":  # its sections are generated
            titles = re.findall(r"(?m)^#+ (.*)$", target.read_text())
            slugs = {re.sub(r"[^\w\- ]", "", t.lower()).strip().replace(" ", "-") for t in titles}
            assert anchor in slugs, link


# -- what the site generates ------------------------------------------------------------------


@pytest.fixture(scope="module")
def hooks() -> ModuleType:
    import importlib.util

    spec = importlib.util.spec_from_file_location("docs_hooks", DOCS / "hooks.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_reference_has_every_command_and_option(hooks: ModuleType) -> None:
    reference = hooks.command_reference()
    for command in COMMANDS:
        assert reference.count(f"## gcbench {command}\n") == 1
        text = hooks.help_of(command)
        section = hooks.command_section(command, text)
        assert section.startswith(f"## gcbench {command}\n\n")
        options = set(re.findall(r"(?m)^  (?:-h, )?(--[\w.-]+)", text))
        assert "--help" in options
        listed = set(re.findall(r"(?m)^\| `(?:-h, )?(--[\w.-]+)", section))
        assert listed == options, command
        for row in re.findall(r"(?m)^\| `.*$", section):
            assert len(re.split(r"(?<!\\)\|", row)) == 5, row


@pytest.mark.parametrize("page", [
    "benchmark/leaderboard.md", "reference/cli.md", "examples/index.md", "reference/api.md"])
def test_a_generated_page_says_on_github_what_it_lacks(hooks: ModuleType, page: str) -> None:
    text = (DOCS / page).read_text()
    assert "`make docs` builds it" in text.split("\n\n")[1]
    assert "On GitHub" not in hooks.on_page_markdown(text)


def test_the_leaderboard_shows_every_published_row(hooks: ModuleType) -> None:
    page = hooks.on_page_markdown((DOCS / "benchmark/leaderboard.md").read_text())
    lines = published_lines(PUBLISHED_ROWS)
    assert lines and all(f"\n| {line.row.title} | {line.row.version} | " in page for line in lines)
    assert "### Robots of standard" in page and "### Articulated objects of standard" in page
    assert "| ur5 mean ± std | ur5 PCP@5° | ur5 paper |" in page


def test_an_option_s_meaning_and_default_are_told_apart(hooks: ModuleType) -> None:
    section = hooks.command_section("render", hooks.help_of("render"))
    row = next(r for r in section.splitlines() if r.startswith("| `--samples"))
    _, option, meaning, default, _ = re.split(r"(?<!\\)\|", row)
    assert option.strip() == "`--samples {1,4,9}`"
    assert default.strip() == "`4`"
    assert "pixel" in meaning
    assert "default" not in meaning
