"""The page of error messages quotes what the commands say."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from twinct.cli import run_command

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "howto" / "errors.md").read_text(encoding="utf-8")
QUOTED = re.findall(r"^### (.+)\n\n```sh\n(.+)\n```\n\n```text\n(.+)\n```", PAGE, re.MULTILINE)


@pytest.mark.parametrize(("title", "command", "message"), QUOTED, ids=[one[0] for one in QUOTED])
def test_a_command_says_what_the_page_quotes(
    title: str,
    command: str,
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(ROOT)
    assert run_command(shlex.split(command)[1:]) == 2
    said = capfd.readouterr().err
    assert title in said
    assert message in said
