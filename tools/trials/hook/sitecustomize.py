"""Do one fault inside a process of twinct, at a moment that is counted from its start.

Python imports this file at the start of every process of a trial. A moment is a file opened for
writing, renamed or removed, a folder made, a process started, or a module of twinct imported. A
fault is done at a moment, or a while after it, and then at the next moment at the latest: so it
also meets long computations, and hardly ever comes too late. ``TWINCT_TRIAL`` holds the victim, the
moment, the while in seconds, the fault, its argument, and a folder. There, ``fired`` says that the
fault has been done, so that it is done once. At moment 0, no fault is done, and the times of all
moments of each victim, and of its end, are written there.
"""

import atexit
import json
import os
import sys
import threading
import time
from pathlib import Path

VICTIMS = {
    "main": ["-m", "twinct"],
    "robots": ["-m", "twinct.link", "robots"],
    "xray": ["-m", "twinct.link", "xray"],
    "worker": ["-m", "twinct.workers.worker"],
}
BEGIN = "twinct.cli.commands"
MOMENTS = {"os.rename", "os.remove", "os.mkdir", "os.rmdir", "subprocess.Popen"}
BETWEEN_S = 0.05
NOTE_S = 0.2
WATCH = "watch of a trial"
WRITING = os.O_WRONLY | os.O_RDWR


class Fault:
    """The fault, and the moments until then."""

    def __init__(self, victim, moment, wait_s, kind, argument, folder):
        """Store what to do, and when."""
        self.moment, self.wait_s = int(moment), float(wait_s)
        self.kind, self.argument = kind, argument
        self.folder, self.victim, self.times = Path(folder), victim, []
        self.begun = victim != "main"  # Python's own start is not the command's
        self.met = threading.Event()

    def hear(self, event, arguments):
        """Count an audit event if it is a moment."""
        if event == "import":
            counts = str(arguments[0]).startswith("twinct.")
            self.begun |= arguments[0] == BEGIN
        elif event == "open":
            counts = isinstance(arguments[2], int) and bool(arguments[2] & WRITING)
        else:
            counts = event in MOMENTS
        if counts and self.begun and threading.current_thread().name != WATCH:
            self.times.append(time.monotonic())
            passed = len(self.times) - self.moment
            if passed == 0:
                self.met.set()
            if self.moment and passed == (1 if self.wait_s else 0):
                self.strike()

    def strike(self):
        """Do the fault, unless it was done before."""
        try:
            os.close(os.open(self.folder / "fired", os.O_CREAT | os.O_EXCL))
        except FileExistsError:
            return
        self.do()

    def do(self):
        """Send the signals, fill the disk, or move the clock."""
        if self.kind == "signals":
            first, *later = map(int, self.argument.split(","))
            for number in later:
                threading.Timer(BETWEEN_S, os.kill, (os.getpid(), number)).start()
            os.kill(os.getpid(), first)
        elif self.kind == "fill":
            place = os.open(self.argument, os.O_CREAT | os.O_WRONLY)
            free = os.fstatvfs(place)
            os.posix_fallocate(place, 0, free.f_bavail * free.f_bsize)
            os.close(place)
        elif self.kind == "clock":
            offset, before, before_ns = float(self.argument), time.time, time.time_ns
            time.time = lambda: before() + offset
            time.time_ns = lambda: before_ns() + int(offset * 1e9)

    def watch(self):
        """Do the fault a while after its moment; without one, note the moments now and then."""
        if self.moment:
            self.met.wait()
            time.sleep(self.wait_s)
            self.strike()
        while not self.moment:
            time.sleep(NOTE_S)
            self.note()

    def note(self):
        """Write the times of all moments, and the present one as that of the end."""
        draft = (
            self.folder / f".{os.getpid()}.{threading.get_ident()}"
        )  # it may die while it writes
        draft.write_text(json.dumps([*self.times, time.monotonic()]))
        draft.rename(self.folder / f"{self.victim}.json")


def begin():
    """Start to count, if this process is the victim."""
    victim, *fault = os.environ["TWINCT_TRIAL"].split("|")
    words = [word for word in sys.orig_argv[1:] if word not in ("-P", "-u")]
    if words[:2] == ["-X", "faulthandler"]:
        words = words[2:]
    own = next((name for name, line in VICTIMS.items() if words[: len(line)] == line), None)
    if own is not None and victim in (own, "any"):
        told = Fault(own, *fault)
        threading.Thread(target=told.watch, name=WATCH, daemon=True).start()
        if not told.moment:
            atexit.register(told.note)  # it runs last
        sys.addaudithook(told.hear)


if "TWINCT_TRIAL" in os.environ:
    begin()
