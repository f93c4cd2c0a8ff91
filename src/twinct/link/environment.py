"""Environment of ROS 2: packages, settings, a separate domain, and shared memory."""

from __future__ import annotations

import fcntl
import os
import random
import re
import socket
import sys
import sysconfig
import time
from collections.abc import Collection, Iterator, Mapping, MutableMapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from twinct.core.errors import InputError, LinkError
from twinct.core.extras import require
from twinct.core.files.private import temporary_folder
from twinct.core.foreign_text import quoted, whole_number

MIDDLEWARE = "rmw_fastrtps_cpp"
DOMAINS = range(1, 101)
"""Candidate domains: their UDP ports stay below the kernel's ephemeral range."""
LARGEST_DOMAIN = 232
ROS_ARGUMENTS: list[str] = []
"""Arguments after ``--ros-args`` of the command line: names that nodes by themselves remap."""

_YOUNG_S = 1.0
_SHARED = re.compile(r"fastrtps_(port[0-9]+|[0-9a-f]{16})")
"""Names of a port and a segment in shared memory."""

_PORT_BASE, _PORTS_PER_DOMAIN, _FIRST_PARTICIPANT, _LAST_PROBED = 7400, 250, 10, 50


def take_ros_arguments(arguments: list[str]) -> list[str]:
    """Keep what follows ``--ros-args``, up to ``--``, and return the other arguments."""
    if "--ros-args" not in arguments:
        return arguments
    first = arguments.index("--ros-args")
    rest = arguments[first + 1 :]
    last = rest.index("--") if "--" in rest else len(rest)
    ROS_ARGUMENTS[:] = rest[:last]
    return arguments[:first] + rest[last + 1 :]


def require_ros() -> None:
    """Check that the ROS 2 link is usable.

    If ROS comes from wheels, ignore a system ROS that the shell has sourced, because it is built
    for another Python.

    Raises:
        InputError: rclpy or a message package is not installed, or cannot be imported, or the
            shared memory is full.
    """
    outside = _system_ros(os.environ)
    sys.path[:] = [path for path in sys.path if not path.startswith(outside)]
    require_shared_memory()  # before any library of ROS is loaded
    require("ros")


SHARED_MEMORY = Path("/dev/shm")
_TRACER_FILES = (r"lttng-ust-wait-\d+", r"lttng-ust-wait-\d+-{user}")
"""Files of LTTng's tracer, which every process of ROS 2 loads: a page each, for all users and for
this one. The tracer maps them without asking whether there is room, so that a full disk ends the
process by SIGBUS. Fast DDS asks, and sends over UDP if there is none."""


def require_shared_memory(folder: Path = SHARED_MEMORY, free: int | None = None) -> None:
    """Check that the tracer of ROS 2 has room for its two pages.

    Args:
        folder: where shared memory is.
        free: bytes that are free there; None: as the system says.

    Raises:
        InputError: there is no room.
    """
    if free is None and (free := free_shared_memory(folder)) is None:
        return
    there = [file.name for file in folder.glob("lttng-ust-wait-*") if file.lstat().st_blocks]
    wanted = [re.compile(name.format(user=os.getuid())) for name in _TRACER_FILES]
    missing = [name for name in wanted if not any(map(name.fullmatch, there))]
    needed = len(missing) * os.sysconf("SC_PAGE_SIZE")
    if free < needed:
        raise InputError(
            f"{folder} is full: {free} bytes of shared memory are free, and ROS 2 needs {needed} "
            f"at its start. Remove files from {folder} that no process uses; a container gets more "
            "with --shm-size=64m. Or use the link local (--link local)"
        )


def free_shared_memory(folder: Path = SHARED_MEMORY) -> int | None:
    """Return the bytes that are free in shared memory; None if there is none."""
    try:
        there = os.statvfs(folder)
    except OSError:
        return None
    return there.f_bavail * there.f_frsize


def without_system_ros(environment: Mapping[str, str]) -> dict[str, str]:
    """Return an environment for processes that use ROS from the same wheels as this one."""
    outside = _system_ros(environment)
    cleaned = dict(environment)
    for key in ("PYTHONPATH", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH"):
        if outside and key in cleaned:
            paths = cleaned[key].split(os.pathsep)
            cleaned[key] = os.pathsep.join(p for p in paths if not p.startswith(outside))
    return cleaned


def _system_ros(environment: Mapping[str, str]) -> tuple[str, ...]:
    """Return prefixes of ROS outside this Python; empty if this Python contains no ROS."""
    if not Path(sysconfig.get_paths()["platlib"], "rclpy").is_dir():
        return ()
    prefixes = environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return tuple(prefix for prefix in prefixes if prefix and not prefix.startswith(sys.prefix))


def settle(environment: MutableMapping[str, str]) -> None:
    """Set the environment variables of ROS 2; keep a discovery range that is already set."""
    environment["RMW_IMPLEMENTATION"] = MIDDLEWARE
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    # The current folder may be a stranger's, and profiles there can lead messages to his machine.
    environment.setdefault("SKIP_DEFAULT_XML_FILE", "1")


_SETTINGS = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">{profiles}
<library_settings><intraprocess_delivery>OFF</intraprocess_delivery></library_settings>
</dds>
"""
_ROOMY = """<profiles>
<transport_descriptors>
<transport_descriptor><transport_id>memory</transport_id><type>SHM</type>
<segment_size>{size}</segment_size></transport_descriptor>
<transport_descriptor><transport_id>network</transport_id><type>UDPv4</type></transport_descriptor>
</transport_descriptors>
<participant profile_name="twinct" is_default_profile="true"><rtps>
<userTransports><transport_id>memory</transport_id><transport_id>network</transport_id></userTransports>
<useBuiltinTransports>false</useBuiltinTransports>
</rtps></participant>
</profiles>"""
_FILE_KEYS = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
_USUAL_SEGMENT, _LARGEST_SEGMENT = 512 * 2**10, 256 * 2**20


@contextmanager
def middleware_settings(size: int = 0) -> Iterator[None]:
    """Set up Fast DDS for participants created in this context.

    A process reads these settings once, with its first participant. Files of settings named in the
    environment take precedence.

    Participants in one process exchange messages like any others. Fast DDS would otherwise call one
    participant from the threads of another, whose locks it then takes in any order: a scan and its
    tap, or two cells in one process, can wait for each other forever (Fast DDS, issue 6193).

    Args:
        size: bytes of shared memory for sending. Fast DDS uses 0.5 MB by default. Data that do not
            fit are lost and sent again after a pause, which makes an image of 1.2 MB three times as
            slow.
    """
    size = min(size, _LARGEST_SEGMENT)
    if (free := free_shared_memory()) is not None:
        size = min(size, free // 4)
    if any(os.environ.get(key) for key in _FILE_KEYS):
        yield
        return
    roomy = size > _USUAL_SEGMENT and not os.environ.get("FASTDDS_BUILTIN_TRANSPORTS")
    with temporary_folder() as folder:
        file = folder / "profiles.xml"
        file.write_text(_SETTINGS.format(profiles=_ROOMY.format(size=size) if roomy else ""))
        os.environ[_FILE_KEYS[0]] = str(file)
        try:
            yield
        finally:
            del os.environ[_FILE_KEYS[0]]


class Domain:
    """A ROS domain that no other scan on this machine uses, held until ``close``.

    The hold is the name of a socket that the nodes inherit. It ends with the last process that has
    the socket, however that process ends. All processes in a network namespace share such names,
    including containers and other users, whatever folders they see.

    Attributes:
        id: the number for ``ROS_DOMAIN_ID``.
    """

    def __init__(self, wanted: int | None = None) -> None:
        """Take the domain requested by ``wanted`` or ``ROS_DOMAIN_ID``, else a free one.

        Raises:
            InputError: the requested domain is invalid, or another scan uses it.
            LinkError: no domain is free.
        """
        origin = "domain_id"
        if wanted is None and (text := os.environ.get("ROS_DOMAIN_ID", "").strip()):
            origin = "ROS_DOMAIN_ID"
            wanted = whole_number(text)
            if wanted is None:
                setting = f"{origin}={quoted(text)}"
                raise InputError(f"{setting} is not a number from 0 to {LARGEST_DOMAIN}")
        if wanted is not None:
            if not 0 <= wanted <= LARGEST_DOMAIN:
                raise InputError(f"{origin}={wanted} is not a number from 0 to {LARGEST_DOMAIN}")
            hold = _hold(wanted)
            if hold is None:
                taken = f"{origin}={wanted}: another scan on this machine uses this domain"
                raise InputError(f"{taken}; choose another, or none for a free one")
            self.id, self._hold = wanted, hold
            return
        # Random, because containers that start alike also have equal process ids.
        for number in random.SystemRandom().sample(DOMAINS, len(DOMAINS)):
            hold = _hold(number)
            if hold is None:
                continue
            if _silent(number):
                self.id, self._hold = number, hold
                return
            hold.close()
        all_ = f"all ROS domains from {DOMAINS[0]} to {DOMAINS[-1]}"
        raise LinkError(f"{all_} are in use on this machine")

    @property
    def hold(self) -> int:
        """Descriptor of the held socket, for child processes to inherit."""
        return self._hold.fileno()

    def close(self) -> None:
        """Release the domain; a second call does nothing."""
        self._hold.close()


def _hold(domain: int) -> socket.socket | None:
    """Return the socket named after the domain; None if another process has it."""
    held = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        held.bind(f"\0twinct-ros-domain-{domain}")  # a name without a file
    except OSError:
        held.close()
        return None
    return held


def _silent(domain: int) -> bool:
    """Return True if no ROS participant of this machine listens on the domain's ports."""
    base = _PORT_BASE + _PORTS_PER_DOMAIN * domain
    # Two ports per participant: the first may have left while others remain.
    for port in (base, *range(base + _FIRST_PARTICIPANT, base + _LAST_PROBED)):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", port))
            except OSError:
                return False
    return True


def sweep_shared_memory(folder: Path = SHARED_MEMORY) -> None:
    """Remove shared memory of killed DDS participants.

    A live participant locks the ``_el`` file beside each of its segments, and every port with a
    listener has such a file. A segment for which there was no space has none, and Fast DDS leaves
    it: ``ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST`` tries shared memory whatever the settings say.

    Ports are numbered, and all domains of a machine share the numbers. The locks are held until
    the files are gone, so that a participant that starts meanwhile takes another port. A file that
    any process has open or mapped stays, this process included: a participant here that still
    sends to a port whose listener has left would send to nobody once another listener takes it.
    """
    with ExitStack() as held:
        locks = {
            name: lock
            for name in sorted(_left_behind(folder))
            if (lock := _locked(folder / f"{name}_el", held)) is not None
        }
        if not locks:
            return
        in_use = _in_use(folder, except_for=locks.values())
        for name in locks:
            if in_use.isdisjoint((name, f"{name}_el")):
                for leftover in (name, f"sem.{name}_mutex", f"{name}_el"):
                    with suppress(OSError):
                        (folder / leftover).unlink()


def _left_behind(folder: Path) -> Iterator[str]:
    """Yield names of segments and ports that are old enough to have been locked by now."""
    for path in folder.glob("fastrtps_*"):
        with suppress(OSError):
            if time.time() - path.lstat().st_mtime < _YOUNG_S:
                continue
            if path.name.endswith("_el"):
                yield path.name.removesuffix("_el")
            elif _SHARED.fullmatch(path.name) and not path.with_name(f"{path.name}_el").exists():
                yield path.name


def _locked(guard: Path, held: ExitStack) -> int | None:
    """Lock a segment's guard until ``held`` ends; None if its participant is alive."""
    made = not guard.exists()
    flags = os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW | (os.O_CREAT | os.O_EXCL if made else 0)
    try:
        descriptor = os.open(guard, flags, 0o666)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)  # at once: whoever sweeps, too, would take the file for one in use
        return None
    held.callback(os.close, descriptor)
    if made:  # Fast DDS takes a port for dead whose guard nobody locks
        held.callback(guard.unlink, missing_ok=True)
    return descriptor


def _in_use(folder: Path, except_for: Collection[int]) -> frozenset[str]:
    """Return the names of files of a folder that processes have open or mapped.

    Args:
        folder: where the files are.
        except_for: descriptors of this process that do not count.
    """
    results: set[str] = set()
    own = {str(descriptor) for descriptor in except_for}
    for process in Path("/proc").glob("[0-9]*"):
        uncounted = own if process.name == str(os.getpid()) else ()
        with suppress(OSError):  # it ended, or is another user's
            results.update(re.findall(rf"{folder}/(\S+)", (process / "maps").read_text()))
            for descriptor in (process / "fd").iterdir():
                if descriptor.name not in uncounted:
                    target = Path(os.readlink(descriptor))
                    if target.parent == folder:
                        results.add(target.name)
    return frozenset(results)
