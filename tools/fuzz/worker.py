"""Process that tries cases under a memory limit.

It reads the number of a case from each line of stdin, and answers with a line of JSON. With
``any-speed`` as its last argument, no case is too slow.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import random
import resource
import shutil
import sys
import time
import traceback
from pathlib import Path
from typing import TextIO

from cases import Case, Kind

from twinct.core.errors import InputError

LONGEST = 2000
"""Number of characters that neither a message nor one of its problems reaches."""

FRESH_BYTES = 64 * 2**20
"""Address space beyond the memory of a case: libraries map more than they touch."""


def main() -> None:
    """Try cases until the input ends."""
    name, seed, place, folder = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]), Path(sys.argv[4])
    any_speed = "any-speed" in sys.argv[5:]
    sys.path.append(str(Path(__file__).parents[1]))  # modules shared with other tools
    answers = _own_output(place / "worker.log")
    material = place / "material"
    material.mkdir(parents=True, exist_ok=True)
    os.chdir(place)  # MuJoCo writes its log here
    kind: Kind = importlib.import_module(name).Kind(material)
    limit = kind.memory_bytes + FRESH_BYTES + _status("VmSize") - _status("VmRSS")
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    limits = {"seconds": kind.seconds, "memory_bytes": kind.memory_bytes}
    answers.write(json.dumps(limits) + "\n")
    answers.flush()
    for line in sys.stdin:
        told = tried(kind, name, seed, int(line), folder, any_speed=any_speed)
        answers.write(json.dumps(told) + "\n")
        answers.flush()


def tried(
    kind: Kind, name: str, seed: int, number: int, folder: Path, *, any_speed: bool
) -> dict[str, object]:
    """Try a case; return ``word``, ``ok``, ``told``, ``trace``, ``seconds``, ``memory_bytes``."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    case, trace, longest = Case("cannot be made", lambda: ""), "", 0
    Path("/proc/self/clear_refs").write_text("5")  # resets the memory peak
    before = time.process_time()
    try:
        case = kind.case(random.Random(f"{name} {seed} {number}"), folder)
        before = time.process_time()
        word = case.act()
    except InputError as error:
        word, trace = "refused", "\n".join(error.problems)
        longest = max(map(len, (str(error), *error.problems)))
    except BaseException as error:
        word, trace = f"{type(error).__name__}", traceback.format_exc()
    seconds = time.process_time() - before
    ok = word == "refused" or not trace
    if longest >= LONGEST:
        word, ok = f"a message of {longest} characters", False
    if ok and seconds > kind.seconds and not any_speed:
        word, ok = "too slow", False
    if ok and (peak := _status("VmHWM")) > kind.memory_bytes:
        word, ok = f"{peak / 2**20:.0f} MB", False
    return {
        **{"word": word, "ok": ok, "told": case.told, "trace": trace, "seconds": seconds},
        "memory_bytes": _status("VmHWM"),
    }


def _own_output(log: Path) -> TextIO:
    """Return a stream to the parent process, and redirect the output of libraries to a log."""
    answers = os.fdopen(os.dup(1), "w")
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("a") as stream:
        os.dup2(stream.fileno(), 1)
        os.dup2(stream.fileno(), 2)
    return answers


def _status(name: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith(f"{name}:"))


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main()
