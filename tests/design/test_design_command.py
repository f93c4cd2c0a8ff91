"""``twinct design`` as a process: what it refuses, and what is left when it is killed."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from listener import Listener

from twinct.cli import run_command
from twinct.design.draft import Draft
from twinct.design.kept import path_beside


def test_what_is_neither_a_file_nor_a_name_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["design", "nothing"]) == 2
    assert "neither a scenario file nor a built-in scenario" in capsys.readouterr().err


@pytest.mark.process
def test_a_killed_server_leaves_the_draft(small_file: Path) -> None:
    before = small_file.read_text(encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "-u", "-m", "twinct", "design", str(small_file), "--port", "0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=dict(os.environ),
    )
    try:
        assert process.stdout is not None
        said = ""
        while (found := re.search(r"page: (http\S+)", said)) is None:
            line = process.stdout.readline()
            assert line, said
            said += line
        with closing(Listener(found[1])) as listener:
            listener.wait(lambda: listener.control("views"))
            listener.set("views", 9)
            listener.wait(lambda: "--set trajectory.views=9" in listener.texts())
            process.send_signal(signal.SIGKILL)
            listener.until_closed()
    finally:
        process.kill()
        process.communicate()
    assert small_file.read_text(encoding="utf-8") == before
    assert path_beside(small_file).is_file()
    draft = Draft.open(small_file)
    assert "views: 9" in draft.text and draft.can_undo
