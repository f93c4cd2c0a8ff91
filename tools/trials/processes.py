"""Processes of a trial, the disks that are mounted for it, and what they leave behind."""

import contextlib
import os
import signal
import subprocess
import time
from pathlib import Path

MARK = "TWINCT_TRIAL_MARK"
LOOK_S = 0.02
PATIENCE_S = 600.0
TO_END_S = 120.0


def alive(mark, variable=MARK):
    """Return the command lines, by pid, of all processes with a mark in a variable, no zombies."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            environment = (folder / "environ").read_bytes().split(b"\0")
            words = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode().strip()
        except OSError:
            continue
        if words and f"{variable}={mark}".encode() in environment:
            found[int(folder.name)] = words
    return found


def until(condition, patience_s=PATIENCE_S):
    """Wait until a function returns something true; return that, or None if it takes too long."""
    begun = time.monotonic()
    while time.monotonic() - begun < patience_s:
        if found := condition():
            return found
        time.sleep(LOOK_S)
    return None


def end_all(mark):
    """Kill all processes of a trial; return their command lines."""
    left = alive(mark)
    for pid in left:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    return list(left.values())


def may_mount(folder):
    """Return True if this process may mount a disk, and give processes a /dev/shm of their own."""
    try:
        with mounted(folder / "probe", 64):
            done = subprocess.run(["unshare", "--mount", "true"], capture_output=True)
            return done.returncode == 0
    except (OSError, subprocess.CalledProcessError):
        return False


@contextlib.contextmanager
def mounted(folder, kib):
    """Mount a disk of a size at a new folder while the block runs."""
    folder.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", f"size={kib}k", "twinct-trial", str(folder)]
    subprocess.run(words, check=True, capture_output=True)
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def remount(folder, how):
    """Make a disk read-only (``ro``) or writable (``rw``)."""
    subprocess.run(["mount", "-o", f"remount,{how}", str(folder)], check=True)


def with_shared_memory(shared, line):
    """Return a command line whose processes see a folder as /dev/shm."""
    program = 'mount --bind "$0" /dev/shm && exec "$@"'
    return ["unshare", "--mount", "sh", "-c", program, str(shared), *line]
