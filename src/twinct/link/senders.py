"""Sender of a message: the participant that owns its publisher, according to the middleware.

rclpy returns a message without the identifier (GID) of its publisher, but the library below it has
both. So messages are taken from that library, with the functions and structures of ROS 2 Jazzy.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message

from twinct.core.errors import LinkError

_PARTICIPANT_BYTES = 12
"""Bytes of a GID that identify the participant; the other four identify its publisher."""
_NOTHING_TO_TAKE = 401


class _Gid(ctypes.Structure):
    _fields_ = (("middleware", ctypes.c_char_p), ("data", ctypes.c_uint8 * 16))


class _Origin(ctypes.Structure):
    """``rmw_message_info_t``."""

    _fields_ = (
        ("sent_ns", ctypes.c_int64),
        ("received_ns", ctypes.c_int64),
        ("number", ctypes.c_uint64),
        ("number_received", ctypes.c_uint64),
        ("publisher", _Gid),
        ("from_this_process", ctypes.c_bool),
    )


class _Allocator(ctypes.Structure):
    _fields_ = tuple(
        (name, ctypes.c_void_p)
        for name in ("allocate", "deallocate", "reallocate", "zero_allocate", "state")
    )


class _Bytes(ctypes.Structure):
    """``rcutils_uint8_array_t``."""

    _fields_ = (
        ("start", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    )


def _function(name: str, *arguments: Any, result: Any = ctypes.c_int) -> Any:
    """Return a function of the libraries that rclpy itself has loaded."""
    function = ctypes.CDLL(rclpy_implementation.__file__)[name]
    function.argtypes, function.restype = arguments, result
    return function


_pointer, _void = ctypes.POINTER, ctypes.c_void_p
_default_allocator = _function("rcutils_get_default_allocator", result=_Allocator)
_init = _function("rcutils_uint8_array_init", _pointer(_Bytes), ctypes.c_size_t, _void)
_free = _function("rcutils_uint8_array_fini", _pointer(_Bytes))
_take = _function("rcl_take_serialized_message", _void, _pointer(_Bytes), _pointer(_Origin), _void)
_rmw_handle = _function("rcl_publisher_get_rmw_handle", _void, result=_void)
_gid_of = _function("rmw_get_gid_for_publisher", _void, _pointer(_Gid))


class Sender(NamedTuple):
    """Origin of a message, unique to it.

    Attributes:
        publisher: GID of the publisher, in hexadecimal.
        number: sequence number of the message at its publisher.
    """

    publisher: str
    number: int

    @property
    def participant(self) -> str:
        """Participant that owns the publisher."""
        return participant(bytes.fromhex(self.publisher))


def participant(gid: Iterable[int]) -> str:
    """Return the participant in a publisher's GID, in hexadecimal."""
    return bytes(gid)[:_PARTICIPANT_BYTES].hex()


def participant_of(publisher: Publisher) -> str:
    """Return the participant that owns a publisher of this process.

    Raises:
        LinkError: the middleware reports no GID.
    """
    gid = _Gid()
    with publisher.handle:
        fault = _gid_of(_rmw_handle(publisher.handle.pointer), ctypes.byref(gid))
    if fault:
        raise LinkError(f"ROS 2 does not report the identifier of a publisher (error {fault})")
    return participant(gid.data)


class Raw(NamedTuple):
    """A serialised message as received, with times of sending and receipt, ns since 1970."""

    data: bytes
    sent_ns: int
    received_ns: int


class SenderExecutor(SingleThreadedExecutor):
    """Executor that calls subscriptions with a message (``Raw`` for raw ones) and its ``Sender``.

    Attributes:
        on_garbled: called with topic name and sender of data that do not fit the topic's type.
            Any participant of the domain can send such data; subscriptions do not receive them.
    """

    on_garbled: Callable[[str, Sender], None] | None = None

    def _take_subscription(self, sub: Any) -> Any:
        origin, content, allocator = _Origin(), _Bytes(), _default_allocator()
        _init(ctypes.byref(content), 0, ctypes.byref(allocator))
        try:
            with sub.handle:
                fault = _take(sub.handle.pointer, ctypes.byref(content), ctypes.byref(origin), None)
            if fault == _NOTHING_TO_TAKE:
                return None
            if fault:
                raise LinkError(
                    f"ROS 2 cannot take a message from {sub.topic_name} (error {fault})"
                )
            data = ctypes.string_at(content.start, content.length)
        finally:
            _free(ctypes.byref(content))
        message: Any = Raw(data, origin.sent_ns, origin.received_ns)
        sender = Sender(bytes(origin.publisher.data).hex(), origin.number)
        garbled = False
        if not sub.raw:
            try:
                message = deserialize_message(data, sub.msg_type)
            except rclpy_implementation.RMWError:
                garbled = True
            except TypeError as error:
                if isinstance(error.__cause__, KeyboardInterrupt):  # pressed during deserialisation
                    raise error.__cause__ from None
                raise

        async def call() -> None:
            if not garbled:
                sub.callback(message, sender)
            elif self.on_garbled is not None:
                self.on_garbled(sub.topic_name, sender)

        return call


class Members:
    """Processes of one scan and their participants, in a folder that only they can write.

    A node registers before it publishes anything, so messages of any other participant are foreign,
    whatever its name.
    """

    def __init__(self, folder: Path) -> None:
        """Use the members in a folder."""
        self._folder = folder
        self._known: dict[str, str] = {}

    def enter(self, name: str, participant: str) -> None:
        """Register the participant of a process of the scan."""
        draft = self._folder / f"{name}.new"
        draft.write_text(participant, encoding="ascii")
        draft.replace(self._folder / f"{name}.id")

    def knows(self, name: str) -> bool:
        """Return True if a process has registered; its entry is read once, and cached."""
        file = self._folder / f"{name}.id"
        if name not in self._known and file.exists():
            self._known[name] = file.read_text(encoding="ascii")
        return name in self._known

    def sent(self, name: str, sender: Sender) -> bool:
        """Return True if a message comes from this process of the scan."""
        return self.knows(name) and self._known[name] == sender.participant
