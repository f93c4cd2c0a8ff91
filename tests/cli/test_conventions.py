"""Conventions that people expect of a command line: help, near names, completion."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from twinct.cli import run_command
from twinct.cli.commands import COMMANDS as NAMES
from twinct.cli.commands import METHODS, command_named

LINES = 75
"""Of the help of twinct itself: three times a small terminal."""


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    run_command(arguments)
    told = capsys.readouterr()
    return told.out + told.err


@pytest.mark.parametrize("name", NAMES)
def test_help_is_text_for_a_terminal(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    pages = [(name,), *((name, method) for method in METHODS.get(name, ()))]
    for page in pages:
        text = said(capsys, *page, "--help")
        assert f"usage: twinct {' '.join(page)}" in text
        for mark in ("``", "`", ":class:", ":func:", "(default: None)", "(default: )"):
            assert mark not in text, page


def test_the_help_of_twinct_names_each_command_in_a_sentence(
    capsys: pytest.CaptureFixture[str],
) -> None:
    text = said(capsys, "--help")
    words = " ".join(text.split())
    assert all(f" {name} {summary}" in words for name, summary in NAMES.items())
    first = text[text.index("start:") : text.index("look at a scene:")]
    assert [line.split()[0] for line in first.splitlines()[1:] if line[2:3].strip()] == [
        "demo", "init", "doctor", "check", "run", "view"
    ]  # fmt: skip
    assert len(text.splitlines()) <= LINES
    assert said(capsys) == text, "and without arguments"


@pytest.mark.parametrize("name", [name for name in NAMES if name not in METHODS])
def test_the_help_of_a_command_begins_with_its_sentence(name: str) -> None:
    first = (command_named(name).__doc__ or "").partition("\n\n")[0]
    assert " ".join(first.split()) == NAMES[name]


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["chek", "demo"], "twinct has no command 'chek'; did you mean 'check'?"),
        (["calibrate", "slef", "out"], "calibrate has no command 'slef'; did you mean 'self'?"),
        (["ctsimu", "rendr"], "twinct ctsimu has no command 'rendr'; did you mean 'render'?"),
        (["xyzzy"], "twinct has no command 'xyzzy' (demo, init, doctor, check"),
    ],
)
def test_an_unknown_command_is_answered_with_the_nearest(
    words: list[str], hint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(words) == 2
    assert hint in capsys.readouterr().err


@pytest.mark.process
def test_bash_completes_commands_and_options(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    script = tmp_path / "twinct.bash"
    assert run_command(["--completion", "bash"]) == 0
    script.write_text(capsys.readouterr().out)
    ask = (
        f'source {script}; complete_it() {{ COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); '
        '_tyro_twinct; printf "%s\\n" "${COMPREPLY[@]}"; }; '
        "complete -p twinct; complete_it twinct che; complete_it twinct check --time-"
    )
    done = subprocess.run(["bash", "-c", ask], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [
        *"complete -F _tyro_twinct twinct".split(), "check", "--time-limit"
    ]  # fmt: skip
