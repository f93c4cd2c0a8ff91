"""Do one fault inside a process of twinct, at a moment that is counted from its start.

Python imports this file at the start of every process of a trial. A moment is a file opened for
writing, renamed or removed, a folder made, a process started, a module of twinct imported, or a
twentieth of a second. ``TWINCT_TRIAL`` holds the victim, the moment, the fault, its argument, and a
folder. There, ``fired`` says that the fault has been done, so that it is done once. At moment 0, no
fault is done, and the number of moments of each victim is written there.
"""

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
TICK_S = 0.05
WATCH = "watch of a trial"
WRITING = os.O_WRONLY | os.O_RDWR


class Fault:
    """The fault, and the moments until then."""

    def __init__(self, victim, moment, kind, argument, folder):
        """Store what to do, and when."""
        self.moment, self.kind, self.argument = int(moment), kind, argument
        self.folder, self.count, self.victim = Path(folder), 0, victim
        self.begun = victim != "main"  # Python's own start is not the command's

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
            self.tick()

    def tick(self):
        """Count a moment; do the fault if it is its turn."""
        self.count += 1
        if self.count == self.moment:
            try:
                os.close(os.open(self.folder / "fired", os.O_CREAT | os.O_EXCL))
            except FileExistsError:
                return
            self.do()

    def do(self):
        """Send the signals, fill the disk, or move the clock."""
        if self.kind == "signals":
            first, *later = map(int, self.argument.split(","))
            os.kill(os.getpid(), first)
            for number in later:
                threading.Timer(TICK_S, os.kill, (os.getpid(), number)).start()
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
        """Count twentieths of a second, also while nothing else happens."""
        while True:
            time.sleep(TICK_S)
            if self.begun:
                self.tick()
            if not self.moment:
                draft = self.folder / f".{os.getpid()}"  # the process may be killed while it writes
                draft.write_text(str(self.count))
                draft.rename(self.folder / self.victim)


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
        sys.addaudithook(told.hear)


if "TWINCT_TRIAL" in os.environ:
    begin()
