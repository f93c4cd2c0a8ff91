"""Faults that meet a command while it works, and how the command has to end."""

import os
import resource
import signal
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from simulated_cluster import SimulatedCluster

ODD_NAME = 'a b\'s "c"\n\u00fc \u6f22'


@dataclass(frozen=True)
class Fault:
    """A fault.

    Attributes:
        codes: exit codes of a command that it has met.
        said: regular expression for the message of a command that does not end with 0.
        kind: of what ``hook/sitecustomize.py`` does at a drawn moment; empty: it holds all along.
        argument: function of a random generator and a path on the disk of the output, which returns
            the argument of the kind.
        victim: process in which that is done.
        environment: changed environment variables; None removes one.
        limit: called in the process before the command starts, with a random generator.
        name: name of the folder that holds the output.
        disk: size of the disk of the output, MiB; 0: the usual disk.
        read_only: the disk cannot be written.
        shared_kib: size of /dev/shm.
        unread: nobody reads the command's output.
        twice: the command starts a second time at the drawn moment.
        any_time: signal that comes at a drawn time since the start of the process, instead of a
            moment that the process counts; so it also meets the first imports.
        outside: called with a cluster, a generator, and a function that returns True when the
            command has ended, at the drawn moment.
    """

    codes: tuple[int, ...]
    said: str = ""
    kind: str = ""
    argument: Callable = lambda rng, disk: ""
    victim: str = "main"
    environment: Mapping = field(default_factory=dict)
    limit: Callable = lambda rng: None
    name: str = "out"
    disk: int = 0
    read_only: bool = False
    shared_kib: int = 64 * 1024
    unread: bool = False
    twice: bool = False
    any_time: int = 0
    outside: Callable | None = None

    @property
    def mounts(self):
        """True if the fault needs the right to mount."""
        return self.disk > 0 or self.shared_kib < 64 * 1024

    @property
    def ends(self):
        """True if the fault ends the command at a drawn moment."""
        return bool(self.kind) and 0 not in self.codes

    @property
    def ends_surely(self):
        """True if the fault is a signal that ends the command whenever it comes."""
        return self.kind == "signals" and self.victim == "main" and not self.stops

    @property
    def stops(self):
        """True if the command itself is stopped, until its nodes have ended."""
        return self is FAULTS["scan stopped"]


def sent(numbers, codes, said="", victim="main"):
    """Return the fault that a victim gets signals, each a little after the one before."""
    return Fault(codes, said, "signals", lambda rng, disk: numbers, victim)


def without_streams(rng):
    """Close stdin, stdout and stderr, and leave the terminal."""
    os.setsid()
    os.closerange(0, 3)


def few_descriptors(rng):
    """Allow 64 open files."""
    resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))


def little_memory(rng):
    """Allow 0.3 to 3 GiB of address space."""
    most = int(rng.uniform(0.3, 3) * 2**30)
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def jump(rng, disk):
    """Return a jump of the clock by up to a year, s."""
    return str(rng.choice([-1, 1]) * 10 ** rng.uniform(1, 7.5))


IN_C = {"LC_ALL": "C", "LANG": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
FULL = "disk is full|are free"
HUNG = "node hung or was stop"

FAULTS = {
    "SIGKILL": sent("9", (-9,)),
    "Ctrl-C": sent("2", (130,), "interrupted: "),
    "Ctrl-C twice": sent("2,2", (130, -2)),
    "SIGTERM": sent("15", (143,), "interrupted: "),
    "SIGHUP": sent("1", (129,), "interrupted: "),
    "Ctrl-C at any time": Fault((130,), "interrupted: ", any_time=signal.SIGINT),
    "SIGTERM at any time": Fault((143,), "interrupted: ", any_time=signal.SIGTERM),
    "disk full": Fault((2,), FULL, "fill", lambda rng, disk: f"{disk}/filler", disk=112),
    "read-only folder": Fault((2,), "cannot be written", disk=112, read_only=True),
    "odd path": Fault((0,), name=ODD_NAME),
    "no HOME": Fault((0,), environment={"HOME": None}),
    "LANG=C": Fault((0,), environment=IN_C, name=ODD_NAME),
    "no terminal": Fault((0,), limit=without_streams),
    "closed pipe": Fault((0, 141), unread=True),
    "64 descriptors": Fault((0,), limit=few_descriptors),
    "little memory": Fault((0, 2), "memory", limit=little_memory),
    "64 KB of /dev/shm": Fault((0,), shared_kib=64),
    "clock jumps": Fault((0,), "", "clock", jump),
    "robots killed": sent("9", (1,), "robots node was ended by SIGKILL", "robots"),
    "xray killed": sent("9", (1,), "xray node was ended by SIGKILL", "xray"),
    "robots stopped": sent("19", (1,), HUNG, "robots"),
    "xray stopped": sent("19", (1,), HUNG, "xray"),
    "scan stopped": sent("19", (1,), "was silent"),
    "worker killed": sent("9", (0,), "", "worker"),
    "a worker of a cluster killed": Fault((0,), "", "none", outside=SimulatedCluster.kill_worker),
    "a node of a cluster killed": Fault((0,), "", "none", outside=SimulatedCluster.lose_node),
    "two at once": Fault(
        (0, 2), "is using this folder|already holds|holds a search", "none", twice=True
    ),
}


def suits(fault, command):
    """Return True if a fault can meet a command."""
    if fault.victim != "main":
        return fault.victim in command.victims
    if fault.stops:
        return "robots" in command.victims
    if fault.outside:
        return command.of_cluster
    return not fault.twice or bool(command.again)
