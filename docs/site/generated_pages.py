"""Sphinx extension: fill the pages that are made from the code where a marker stands in them."""

from __future__ import annotations

import argparse
import ast
import functools
import re
import tomllib
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import tyro
from pydantic_core import PydanticUndefined
from pygments.lexers.special import TextLexer
from scenario_page import measured, scenario, stages, study

from twinct.cli.commands import application
from twinct.evaluation import IMAGE_FIGURES, figure_kinds
from twinct.evaluation.figure import Figure

ROOT = Path(__file__).resolve().parents[2]
OUTSIDE = re.compile(r"\[([^\]]+)\]\((?:\.\./)?[A-Z_]+\.md[^)]*\)")
"""Link to a page of the repository that is not in the site; its words stay."""
EXAMPLE = re.compile(r"\[([^\]]+)\]\((?:\.\./)+examples/((?:tutorials|gallery)/\w+)\.py\)")
"""Link to a program of the repository, of which the site has a page."""
MARKER = re.compile(r"^<!-- generated: (\w+) -->$", re.MULTILINE)


@functools.cache
def command_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    with warnings.catch_warnings():  # tyro offers no other way to the parser
        warnings.simplefilter("ignore", DeprecationWarning)
        return tyro.extras.get_parser(
            application()._build_union(use_underscores=False), prog="twinct"
        )


def subcommands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Return the parsers of a parser's subcommands, by name."""
    for action in parser._actions:
        if isinstance(action.choices, dict):
            return action.choices
    return {}


def commands() -> str:
    """Return the reference of the command line as Markdown."""
    return "\n".join(_command("twinct", command_parser(), 1))


def _command(name: str, parser: argparse.ArgumentParser, level: int) -> Iterator[str]:
    if level > 1:
        yield f"{'#' * level} {name}\n"
        yield _text(parser.description or "") + "\n"
        yield from _arguments(parser)
    for word, inner in subcommands(parser).items():
        yield from _command(f"{name} {word}", inner, level + 1)


def _arguments(parser: argparse.ArgumentParser) -> Iterator[str]:
    shown = [a for a in parser._actions if not isinstance(a.choices, dict) and a.dest != "help"]
    if not shown:
        return
    yield "| argument | default | meaning |"
    yield "|---|---|---|"
    for action in shown:
        words = [*action.option_strings] or [str(action.metavar)]
        value = "" if action.nargs == 0 or not action.option_strings else f" {action.metavar}"
        meaning, default = _split_default(action.help or "")
        yield f"| `{', '.join(words)}{value}` | {default} | {_cell(meaning)} |"
    yield ""


def _split_default(text: str) -> tuple[str, str]:
    """Split the help of an argument into its meaning and its default."""
    body, default = text, ""
    if found := re.search(r"\s*\((?:default: ([^()]*)|(required)|repeatable|optional)\)$", text):
        body = text[: found.start()]
        default = "**needed**" if found[2] else found[1] or ""
    if default in ("None", "False"):
        default = ""
    return body, f"`{default}`" if default and "*" not in default else default


def figures() -> str:
    """Return the reference of all figures of merit as Markdown."""
    parts = ["## Figures of every run\n", *_figures("image", IMAGE_FIGURES)]
    for name, kind in figure_kinds().items():
        parts.append(f"## evaluation.{name}\n")
        parts.append(f"{_text(kind.description)}\n")
        parts += ["| key | default | meaning |", "|---|---|---|"]
        for key, info in kind.settings.model_fields.items():
            needed = info.default is PydanticUndefined and info.default_factory is None
            default = "**needed**" if needed else _default(info.default)
            parts.append(f"| `{key}` | {default} | {_cell(info.description or '')} |")
        parts += ["", *_figures(f"image.{name}.NAME", kind.figures)]
    return "\n".join(parts)


def _default(value: Any) -> str:
    return "" if value in (None, PydanticUndefined) else f"`{value}`"


def _figures(where: str, shown: tuple[Figure, ...]) -> Iterator[str]:
    yield f"In `metrics.json` below `{where}`:\n"
    yield "| figure | title | unit | meaning | a good value | blind to |"
    yield "|---|---|---|---|---|---|"
    for one in (each.relative_to("bone") for each in shown):
        blind = ", ".join(one.blind_to or ()) if one.best else ""
        cells = (one.title, one.unit, one.meaning, one.good or _BETTER[one.best], blind)
        yield f"| `{one.key}` | " + " | ".join(_cell(cell) for cell in cells) + " |"
    yield ""


_BETTER = {"lower": "lower is better", "higher": "higher is better", "one": "near 1", "": ""}


def _text(text: str) -> str:
    """Return help as Markdown: reST's double backticks become single ones."""
    return text.replace("``", "`").replace("<", r"\<").strip()


def _cell(text: str) -> str:
    return " ".join(_text(text).split()).replace("|", r"\|")


def packages() -> str:
    """Return the packages by floor, as the contract of their imports orders them."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
    layers = contracts["importlinter"]["contracts"][0]["layers"]
    rows = ["| floor | package | holds |", "|---|---|---|"]
    for floor, layer in zip(range(len(layers), 0, -1), layers, strict=True):
        for name in re.findall(r"twinct\.(\w+)", layer):
            if about := _about(name):
                rows.append(f"| {floor} | `{name}` | {_cell(about)} |")
    return "\n".join(rows) + "\n"


def _about(name: str) -> str:
    """Return the first paragraph of a package's docstring; none if it is a private module."""
    room = ROOT / "src" / "twinct" / name
    file = room / "__init__.py" if room.is_dir() else room.with_suffix(".py")
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return text.partition("\n\n")[0] if name != "version" else ""


def changes() -> str:
    """Return the change log without its title; its links start where the site's pages do."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").partition("\n")[2]
    return text.replace("](docs/", "](/")


PARTS: dict[str, Callable[[], str]] = {
    **{"commands": commands, "figures": figures, "changes": changes, "packages": packages},
    **{"scenario": scenario, "stages": stages, "measured": measured, "study": study},
}


def filled(page: str) -> str:
    """Return the text of a page with what its markers stand for."""
    return MARKER.sub(lambda found: PARTS[found[1]](), page)


def _fill(app: Any, name: str, source: list[str]) -> None:
    text = filled(source[0])
    text = text.replace("](../CHANGELOG.md", "](/reference/changelog.md")
    text = EXAMPLE.sub(r"{doc}`\1 </\2>`", text)
    source[0] = OUTSIDE.sub(r"\1", text)


def _escape_bars(app: Any, what: str, name: str, one: Any, options: Any, lines: list[str]) -> None:
    """Keep the bars of formulas in docstrings: in reST they would begin a substitution."""
    lines[:] = [re.sub(r"(``.*?``)|\|", lambda found: found[1] or r"\|", line) for line in lines]


def setup(app: Any) -> dict[str, bool]:
    """Register the extension with Sphinx."""
    app.add_lexer("csv", TextLexer)  # Pygments has none
    app.connect("source-read", _fill)
    app.connect("autodoc-process-docstring", _escape_bars, priority=400)  # before napoleon
    return {"parallel_read_safe": True, "parallel_write_safe": True}
