"""Keys, options, commands and defaults in the text of the pages are those of the code."""

from __future__ import annotations

import argparse
import inspect
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from code_blocks import FENCE, PAGES, ROOT

from twinct.recon.algorithms import BUILT_IN
from twinct.runs import export_scan
from twinct.scenario import Scenario, load_scenario
from twinct.scenario.digests import declared

sys.path.insert(0, str(ROOT / "docs" / "site"))

from generated_pages import command_parser, scenario, subcommands  # noqa: E402

SECTIONS = "|".join(Scenario.model_fields)
KEY = re.compile(rf"`((?:{SECTIONS})(?:\.[a-z_0-9]+)+)`")
OPTION = re.compile(r"`(--[a-z][a-z.-]*)")
COMMAND = re.compile(r"`twinct ([a-z]+)\b")
OTHER_PROGRAMS = {
    "--ros-args": "ROS 2's own arguments",
    "--raw": "gdcmconv",
    "--factor": "bench_quality.py",
    "--rtk": "bench_quality.py",
    "--floor": "bench_planned_metal.py",
}
"""Options of programs that are not twinct."""
FILES_AND_MODULES = re.compile(
    r"\.(script|zarr|mcap|json|png|csv)$"
    r"|^(uncertainty|xray|trajectory)\.(executed|fam|rep|im|pa|me|tu|te|cuda|arm_)"
    r"|^motion\.(joints|speeds|time_s)$"
)
"""Words with a dot that are no keys: names of files, modules, and attributes in Python."""


def _text(page: Path) -> str:
    return FENCE.sub("", page.read_text(encoding="utf-8"))


def _parsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    yield parser
    for inner in subcommands(parser).values():
        yield from _parsers(inner)


PARSER = command_parser()
OPTIONS = {
    word
    for parser in _parsers(PARSER)
    for action in parser._actions
    for word in action.option_strings
}
KEYS = {key for key, _ in declared(Scenario)}


def _is_key(key: str) -> bool:
    """Return whether a key, a section above it or a key of one kind of the section exists."""
    return any(known == key or known.startswith(f"{key}.") for known in KEYS) or _of_a_kind(key)


def _of_a_kind(key: str) -> bool:
    """Return whether the scenario reference lists the key below a section that has kinds."""
    *path, name = key.split(".")
    sections = re.split(r"^## ", scenario(), flags=re.MULTILINE)
    return any(
        section.split("\n")[0].split(" (")[0] == ".".join(path) and f"\n| `{name}` |" in section
        for section in sections
    )


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_keys_options_and_commands_exist(page: Path) -> None:
    text = _text(page)
    keys = {key for key in KEY.findall(text) if not FILES_AND_MODULES.search(key)}
    assert not {key for key in keys if not _is_key(key)}
    assert not set(OPTION.findall(text)) - OPTIONS - OTHER_PROGRAMS.keys()
    assert set(COMMAND.findall(text)) <= subcommands(PARSER).keys()


def test_a_key_that_does_not_exist_is_seen() -> None:
    assert not _is_key("detector.colums")
    assert not _is_key("specimen.parts.sort")
    assert _is_key("trajectory.latitude_amplitude_deg")


def _option(command: str, word: str) -> Callable[[], Any]:
    def default() -> Any:
        parser = PARSER
        for name in command.split():
            parser = subcommands(parser)[name]
        texts = [str(a.help) for a in parser._actions if word in a.option_strings]
        found = re.search(r"\(default: ([^()]*)\)", texts[0])
        return found[1] if found else None

    return default


def _argument(function: Callable[..., Any], name: str) -> Callable[[], Any]:
    return lambda: inspect.signature(function).parameters[name].default


def _key(path: str) -> Callable[[], Any]:
    def default() -> Any:
        value: Any = load_scenario({"specimen": {"parts": [PART]}, "trajectory": PATH})
        for name in path.split("."):
            value = getattr(value, name)
        return getattr(value, "kind", value)

    return default


PART = {"shape": {"kind": "sphere", "radius_mm": 20}, "material": "bone"}
PATH = {"kind": "circle", "views": 8, "sod_mm": 300, "sdd_mm": 600}
CLAIMS = [
    ("arms.md", "`ur10e` (default)", _key("cell.source_arm.model"), "ur10e"),
    (
        "calibration.md",
        "`--start believed` is the default",
        _option("calibrate self", "--start"),
        "believed",
    ),
    (
        "exchange.md",
        "`--geometry` is `believed` (default;",
        _argument(export_scan, "geometry"),
        None,
    ),
    (
        "physics.md",
        "`integrating` (its energy; the default)",
        _key("detector.response"),
        "integrating",
    ),
    ("physics.md", "`detector.scatter`: off by default", _key("detector.scatter"), None),
    ("engines.md", "`gvxr`, the default", _key("xray.engine"), "gvxr"),
    ("ros_driving.md", "`motion.scheme: planned`, the default", _key("motion.scheme"), "planned"),
]


def test_memory_and_resume_of_each_algorithm_are_those_of_the_code() -> None:
    page = (ROOT / "docs" / "reconstruction.md").read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| `(\w+)` \|.*\| (.*) \| (continues|starts again) \|$", page, re.MULTILINE
    )
    stated = {
        name: (
            float(memory.split()[0]),
            float((re.findall(r"([\d.]+) x", memory) or [0])[0]),
            resume == "continues",
        )
        for name, memory, resume in rows
    }
    code = {name: (one.volumes, one.projections, one.resumes) for name, one in BUILT_IN.items()}
    assert stated == {name: code[name] for name in stated}
    assert code.keys() - stated.keys() == {"rtk_sart"}


@pytest.mark.parametrize(
    ("page", "words", "default", "value"),
    CLAIMS,
    ids=[f"{page}-{words[:40]}" for page, words, *_ in CLAIMS],
)
def test_a_default_is_that_of_the_code(
    page: str, words: str, default: Callable[[], Any], value: Any
) -> None:
    assert words in (ROOT / "docs" / page).read_text(encoding="utf-8")
    assert default() == value
