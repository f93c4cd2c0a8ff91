"""The part of YAML that is read: what words mean, and what is refused with its line and key."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from twinct.core.errors import ScenarioError
from twinct.core.files import plain_yaml
from twinct.core.files.plain_yaml import (
    DEEPEST,
    LARGEST_BYTES,
    MOST_VALUES,
    read_file,
    read_value,
    written,
)

MEANT: list[tuple[str, Any]] = [
    *(("1", 1), ("-3", -3), ("+3", 3), ("0x1F", 31), ("0o17", 15), ("1e-3", 0.001), ("1.", 1.0)),
    *((".5", 0.5), ("1e400", math.inf), ("-.inf", -math.inf), ("~", None), ("", None)),
    *(("null", None), ("true", True), ("FALSE", False), ("[1, [2], {a: b}]", [1, [2], {"a": "b"}])),
    # Of YAML 1.1, and texts in 1.2:
    *((word, word) for word in ("yes", "no", "on", "off", "y", "1_000", "1:30", "0b11", "=", "-x")),
    *((word, word) for word in ("2020-01-01", "2020-13-45", "2020-01-01T25:61:00Z", "0x", "1e")),
    *(("'1'", "1"), ('"true"', "true"), ("{1: 2, true: 3}", {"1": 2, "true": 3})),
]


@pytest.mark.parametrize(("text", "value"), MEANT)
def test_words_mean_what_yaml_1_2_says(text: str, value: Any) -> None:
    read = read_value(text, "here")
    assert read == value and type(read) is type(value)


REFUSED = [
    *(("a: 1\nb: *x\n", ":2: b: *x: aliases"), ("a: &x 1\n", ":1: a: &x: anchors")),
    *(("a: 1\na: 2\n", ":2: the key 'a' appears twice"), ("a:\n  <<: b\n", ":2: a: merge keys")),
    *(('a: !!null "x"\n', ":1: a: tag:yaml.org,2002:null: tags"), ("a: !x y\n", ":1: a: !x: tags")),
    *(("[1]: 2\n", ":1: a key must be text"), ("a: 010\n", ":1: a: 010 begins with a zero")),
    ("a:\n\tb: 2\n", ":2: not valid YAML: a line begins with a tab; indent it with spaces"),
    *(("a: 1\n---\nb: 2\n", ":2: not valid YAML: a second document"), ("a: [\n", ":1: not valid")),
    *(('a: "\\0"\n', r":1: a: the character '\x00'"), ("a: 1\nb: \x07\n", r":2: the character")),
    *(("a: " + "9" * 5000, ":1: a: the number has 5000 digits"), ('a: "\\ud800"\n', ":1:")),
    ("a:\n  b:\n" + "".join(f"{' ' * k}x:\n" for k in range(4, 4 + DEEPEST)), "nested too deep"),
    ("[" * 100_000, "nested too deep"),
    (f"a: [{'1,' * 4 * MOST_VALUES}]", f"at most {MOST_VALUES} keys and values"),
    ("#" * (LARGEST_BYTES + 1), f"the limit is {LARGEST_BYTES}"),
    # Each level ten times the one before (billion laughs).
    ("a: &a [x]\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a,*a,*a]\n", ":1: a: &a: anchors"),
]


@pytest.fixture
def events(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """The parser's events that a reader has taken: the work that a text makes."""
    taken: list[object] = []

    def counted(*text: Any, **keys: Any) -> Iterator[object]:
        for event in parse(*text, **keys):
            taken.append(event)
            yield event

    parse = yaml.parse
    monkeypatch.setattr(plain_yaml.yaml, "parse", counted)
    return taken


@pytest.mark.parametrize(("text", "said"), REFUSED, ids=lambda v: v[:20])
def test_what_is_no_plain_data_is_refused_with_file_line_and_key(
    tmp_path: Path, text: str, said: str, events: list[object]
) -> None:
    path = tmp_path / "x.yaml"
    path.write_bytes(text.encode("utf-8"))
    with pytest.raises(ScenarioError) as caught:
        read_file(path, "scenario")
    (message,) = caught.value.problems
    assert message.startswith(f"{path}") and said in message
    assert len(message) < 400
    assert (
        len(events) <= MOST_VALUES + 10
    )  # and not all of an endless text; seconds: bench_refusals


@pytest.mark.parametrize("data", [b"\xff\xfea\0", b"a: \xe4\n", b"\x80"])
def test_other_encodings_are_said(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "x.yaml").write_bytes(data)
    with pytest.raises(ScenarioError, match=r"x\.yaml: the study cannot be read: not UTF-8 text"):
        read_file(tmp_path / "x.yaml", "study")


@pytest.mark.parametrize("data", [b"\xef\xbb\xbfa: 1\nb:\n  - c\n", b"a: 1\r\nb:\r\n  - c\r\n"])
def test_a_mark_at_the_beginning_and_other_ends_of_lines_change_nothing(
    tmp_path: Path, data: bytes
) -> None:
    (tmp_path / "x.yaml").write_bytes(data)
    read = read_file(tmp_path / "x.yaml", "study")
    assert read.value == {"a": 1, "b": ["c"]}
    assert read.lines == {(): 1, ("a",): 1, ("b",): 3, ("b", 0): 3}


def test_what_is_written_is_read_again() -> None:
    texts = [*(text for text, _ in MEANT), "08", "0.5.1", "a: b", "#x", "ä\n", "<<", "&a", "1e-3"]
    data = {"texts": texts, "numbers": [0, -1, 1e-5, 1e22, 10**40], "none": None, "no": [True, {}]}
    assert read_value(written(data), "here") == data


def test_scenarios_mean_the_same_to_another_reader() -> None:
    for file in sorted((Path(__file__).parents[2] / "scenarios").glob("*.yaml")):
        assert read_file(file, "scenario").value == yaml.safe_load(file.read_text(encoding="utf-8"))


def test_a_value_that_occurs_twice_is_written_twice() -> None:
    pair = [1.0, 2.0]
    assert read_value(written({"a": pair, "b": pair}), "here") == {"a": pair, "b": pair}
