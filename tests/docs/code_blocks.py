"""Code blocks of the pages, and what each kind has to be."""

from __future__ import annotations

import ast
import contextlib
import importlib
import inspect
import io
import re
import shlex
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml

from twinct.core.errors import ScenarioError
from twinct.measured import read_description
from twinct.scenario import load_scenario, scenario_names
from twinct.study import load_study
from twinct.trajectory import commanded_views

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs" / "site"))

from generated_pages import command_parser  # noqa: E402

FENCE = re.compile(r"^( *)```(\w+)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)
NOT_RUN = re.compile(r"<!-- not run: ([^\n]+) -->\n\s*$")
"""Comment above a block that only readers can run."""
SYSTEM = {"source", "xdg-open", "export", "cd", "git", "apt-get", "ros2", "sbatch", "srun", "ray"}
"""Programs of the reader's system, which cannot be checked here."""
NOT_HERE = {"howto/errors.md", "scenario.md", "validation.md"}
"""Wrong keys on purpose (test_errors.py), sketches, and long measurements."""
PAGES = [
    ROOT / "README.md",
    *sorted(
        page
        for page in (ROOT / "docs").rglob("*.md")
        if str(page.relative_to(ROOT / "docs")) not in NOT_HERE
        and page.relative_to(ROOT / "docs").parts[0] not in ("tutorials", "gallery")
    ),
]


class Block(NamedTuple):
    """A block of code in a page."""

    page: Path
    number: int
    language: str
    text: str
    not_run: str = ""
    """Why no test runs it."""

    @property
    def name(self) -> str:
        """Name of the block in a test's name."""
        return f"{self.page.relative_to(ROOT)}-{self.number}-{self.language}"


def blocks() -> list[Block]:
    """Return the code blocks of all new pages, but for those that Sphinx itself reads."""
    return [block for page in PAGES for block in _of(page)]


def _of(page: Path) -> Iterator[Block]:
    whole = page.read_text(encoding="utf-8")
    for number, found in enumerate(FENCE.finditer(whole)):
        indent, language, text = found.groups()
        text = re.sub(f"^{indent}", "", text, flags=re.MULTILINE)
        reason = NOT_RUN.search(whole[: found.start()])
        yield Block(page, number, language, text, reason[1] if reason else "")


def check(block: Block, folder: Path) -> None:
    """Check a block of code; an unknown language fails."""
    kinds = {"sh": _shell, "yaml": _yaml, "python": _python, "toml": _toml}
    kinds |= {"text": _nothing, "csv": _views}
    if "import torch" in block.text:
        pytest.importorskip("torch", reason="needs torch: pip install twinct[torch]")
    kinds[block.language](block, folder)


def _nothing(block: Block, folder: Path) -> None:
    """Output of a program and formulas are no code."""


# Commands -----------------------------------------------------------------------------------------


def commands(text: str) -> Iterator[list[str]]:
    """Yield the words of each command, without variables, redirections and ROS arguments."""
    for line in text.replace("\\\n", " ").splitlines():
        for command in re.split(r" \| | && ", line.partition(" --ros-args ")[0]):
            words = shlex.split(command.split(" > ")[0], comments=True)
            words = [word for word in words if not re.fullmatch(r"[A-Z_]+=\S*|&", word)]
            if words:
                yield words


def _shell(block: Block, folder: Path) -> None:
    for words in commands(block.text):
        if words[0] not in SYSTEM:
            _command(words)


def _command(words: list[str]) -> None:
    program, *arguments = words
    if program == "twinct":
        if arguments != ["--version"]:
            twinct(arguments)
    elif program == "make":
        made = (ROOT / "Makefile").read_text(encoding="utf-8")
        assert re.search(rf"^{arguments[0]}:", made, re.MULTILINE), arguments
    elif program == "pip":
        _extras(arguments)
    elif program == "python3":
        assert arguments[:2] == ["-m", "venv"], arguments
    elif program == "python" and arguments[:2] == ["-m", "pip"]:
        _extras(arguments[2:])
    elif program == "python":
        assert arguments[0] == "load.py" or (ROOT / arguments[0]).exists(), arguments
    else:
        assert (ROOT / program).exists(), f"unknown program {program}"


def _extras(arguments: list[str]) -> None:
    if arguments[0] == "uninstall":
        return
    assert arguments[0] == "install"
    package = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for word in arguments[1:]:
        assert not word.startswith("twinct"), "no package index has it"
        if found := re.fullmatch(r"\.\[([\w,]+)\]", word):
            assert set(found[1].split(",")) <= package["optional-dependencies"].keys()


def twinct(arguments: list[str]) -> None:
    """Check the words of a command: its options, the scenario that it names, and its keys."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            command_parser().parse_args(arguments)
    except SystemExit as stop:
        assert stop.code == 0, f"twinct {shlex.join(arguments)}: {said.getvalue()}"
    given = [
        value for word, value in zip(arguments, arguments[1:], strict=False) if word == "--set"
    ]
    for word in arguments:
        assert not word.startswith("examples/") or (ROOT / word).exists(), word
    if arguments[0] != "study":
        named = arguments[1] if len(arguments) > 1 else ""
        _load(named if named in scenario_names() else "head_screws", given)  # it has a spectrum


def _load(scenario: str, given: list[str]) -> None:
    """Load a scenario; files that an earlier command of the page writes are not there."""
    try:
        load_scenario(scenario, given)
    except ScenarioError as error:
        if any(": no file at" not in problem for problem in error.problems):
            raise


# Files --------------------------------------------------------------------------------------------


def _yaml(block: Block, folder: Path) -> None:
    content = yaml.safe_load(block.text)
    file = folder / "mine.yaml"
    if "images" in content:
        file.write_text(block.text, encoding="utf-8")
        _without_the_readers_files(lambda: read_description(file), block)
    elif "scenario" in content:
        file.write_text(block.text, encoding="utf-8")
        design = load_study(file)
        design.scenario(next(iter(design.trials())))
    else:
        base = "" if "extends" in content else "extends: demo\n"
        file.write_text(base + block.text, encoding="utf-8")
        _without_the_readers_files(lambda: load_scenario(file), block)


def _without_the_readers_files(load: Any, block: Block) -> None:
    try:
        load()
    except ScenarioError as error:
        own = rf"\.({'|'.join(_made_on(block.page)) or 'none'}): unknown key"
        others = [p for p in error.problems if "no file" not in p and not re.search(own, p)]
        assert not others, f"{error}\n\n{block.text}"


def _made_on(page: Path) -> list[str]:
    """Return the names of extensions that a page shows how to make; none of them is installed."""
    tables = [tomllib.loads(text) for _, language, text in _fences(page) if language == "toml"]
    groups = [group for table in tables for group in table["project"]["entry-points"].values()]
    return [name for group in groups for name in group]


def _fences(page: Path) -> list[tuple[str, str, str]]:
    return FENCE.findall(page.read_text(encoding="utf-8"))


def _toml(block: Block, folder: Path) -> None:
    """Entry points go to groups that twinct loads."""
    for group in tomllib.loads(block.text)["project"]["entry-points"]:
        sources = (ROOT / "src").rglob("*.py")
        assert any(f'"{group}"' in source.read_text(encoding="utf-8") for source in sources), group


def _views(block: Block, folder: Path) -> None:
    file = folder / "views.csv"
    file.write_text(block.text, encoding="utf-8")
    view = load_scenario("demo", [f"trajectory={{kind: file, path: {file}}}"])
    assert len(commanded_views(view.trajectory, view.detector.panel))


# Programs -----------------------------------------------------------------------------------------


def _python(block: Block, folder: Path) -> None:
    """Each import is there, and functions of twinct have the arguments of their calls."""
    names: dict[str, Any] = {}
    tree = ast.parse(block.text)
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("twinct"):
            module = importlib.import_module(str(node.module))
            names |= {one.asname or one.name: getattr(module, one.name) for one in node.names}
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in names:
            positional = [None for one in node.args if not isinstance(one, ast.Starred)]
            named = {str(one.arg): None for one in node.keywords if one.arg is not None}
            inspect.signature(names[node.func.id]).bind_partial(*positional, **named)
