"""Commands of twinct, one after the other in one fresh process, which sees other packages."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from subprocess import CompletedProcess
from types import TracebackType

_LOOP = """
import json, os, sys
from twinct.cli import run_command

asked, answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
nothing = os.open(os.devnull, os.O_RDONLY)
os.dup2(nothing, 0)
for line in asked:
    arguments, *files = json.loads(line)
    for number, file in enumerate(files, 1):
        opened = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(opened, number)
        os.close(opened)
    code = run_command(arguments)
    sys.stdout.flush()
    sys.stderr.flush()
    print(code, file=answers, flush=True)
"""
"""Runs each command with streams in files of its own, so that child processes write there, too."""


class Shell:
    """A process that runs commands. Starting one for each command takes most of a short test.

    Args:
        folder: what the commands write to their streams goes here.
        path: folders for ``PYTHONPATH``, before those of this process.
    """

    def __init__(self, folder: Path, *path: Path) -> None:
        before = filter(None, [os.environ.get("PYTHONPATH")])
        self._files = [str(folder / name) for name in ("stdout", "stderr")]
        self._process = subprocess.Popen(
            [sys.executable, "-c", _LOOP],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join([*map(str, path), *before])},
        )

    def __enter__(self) -> Shell:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.communicate()

    def __call__(self, *arguments: str | Path) -> CompletedProcess[str]:
        """Run one command, and return its exit code and both streams."""
        assert self._process.stdin is not None and self._process.stdout is not None
        words = [str(word) for word in arguments]
        print(json.dumps([words, *self._files]), file=self._process.stdin, flush=True)
        code = self._process.stdout.readline()
        out, err = (Path(file).read_text(encoding="utf-8") for file in self._files)
        assert code, f"the process ended at {words}: {err}"
        return CompletedProcess(words, int(code), out, err)
