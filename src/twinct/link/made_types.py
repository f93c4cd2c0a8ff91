"""Message and action types that no wheel brings, made from their definitions.

rclpy takes a type as Python classes with pointers to C functions, which a compiler usually makes
for each type. Here a message in C is only a key: the functions turn a Python object into its CDR
bytes and back, and pass the bytes to Fast CDR. Topics, services, type names, type hashes and bytes
are those of the real package. Structures are those of ROS 2 Jazzy with ``rmw_fastrtps_cpp``.
"""

from __future__ import annotations

import ctypes
import importlib
import itertools
import re
import struct
from collections.abc import Callable
from ctypes import c_bool, c_char_p, c_size_t, c_uint32, c_void_p, py_object
from functools import cache
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatusArray
from action_msgs.srv import CancelGoal
from mcap.exceptions import McapError
from mcap_ros2._dynamic import generate_dynamic, serialize_dynamic
from rclpy.type_support import check_for_type_support
from unique_identifier_msgs.msg import UUID

from twinct.link.definitions import Member, definition, full_name, members
from twinct.link.type_description import structures

_CDR = "rosidl_typesupport_fastrtps_c"
_FIELDS = "rosidl_typesupport_introspection_c"
"""Two languages of type supports, which are libraries: bytes, and a description of the fields."""

_CDR_HEADER = b"\0\1\0\0"
"""Bytes before a message, which tell its encoding: CDR, little-endian."""

_BROKEN = (McapError, ValueError, LookupError, struct.error, MemoryError, OverflowError)
"""Errors of reading bytes that do not fit a type."""


def _structure(*names: str) -> type[ctypes.Structure]:
    """Return a structure of pointers."""
    return type("Pointers", (ctypes.Structure,), {"_fields_": [(n, c_void_p) for n in names]})


_ABOUT = ("hash", "description", "sources")
_Message = _structure("language", "data", "find", *_ABOUT)
"""``rosidl_message_type_support_t``."""
_Callbacks = _structure("scope", "name", "write", "read", "size", "largest", "key")
"""``message_type_support_callbacks_t``."""
_Service = _structure(
    *("language", "data", "find", "request", "response", "event", "create", "destroy"), *_ABOUT
)
"""``rosidl_service_type_support_t``."""
_ServiceCallbacks = _structure("scope", "name", "request", "response")
"""``service_type_support_callbacks_t``."""
_FIELD_KINDS = (
    *("float32", "float64", "", "", "", "bool", "byte", "uint8", "int8", "uint16", "int16"),
    *("uint32", "int32", "uint64", "int64", "string", ""),
)
"""Types of fields, in the order of their numbers in ``rosidl_typesupport_introspection_c``."""


class _Field(ctypes.Structure):
    """``rosidl_typesupport_introspection_c__MessageMember``."""

    _fields_ = (
        *(("name", c_void_p), ("kind", ctypes.c_uint8), ("bound", c_size_t)),
        *(("nested", c_void_p), ("key", c_bool), ("array", c_bool), ("size", c_size_t)),
        *(("bounded", c_bool), ("offset", c_uint32), ("functions", c_void_p * 7)),
    )


class _Fields(ctypes.Structure):
    """``rosidl_typesupport_introspection_c__MessageMembers``."""

    _fields_ = (
        *(("scope", c_void_p), ("name", c_void_p), ("count", c_uint32), ("size", c_size_t)),
        *(("key", c_bool), ("fields", c_void_p), ("functions", c_void_p * 2)),
    )


_Action = _structure("goal", "result", "cancel", "feedback", "status", *_ABOUT)
"""``rosidl_action_type_support_t``."""

_find = ctypes.CFUNCTYPE(c_void_p, c_void_p, c_char_p)
_get = ctypes.CFUNCTYPE(c_void_p, c_void_p)
_write = ctypes.CFUNCTYPE(c_bool, c_void_p, c_void_p)
_size = ctypes.CFUNCTYPE(c_uint32, c_void_p)
_largest = ctypes.CFUNCTYPE(c_size_t, ctypes.POINTER(ctypes.c_char))
_create = ctypes.PYFUNCTYPE(c_void_p)
_destroy = ctypes.PYFUNCTYPE(None, c_void_p)
_from_python = ctypes.PYFUNCTYPE(c_bool, py_object, c_void_p)
_to_python = ctypes.PYFUNCTYPE(py_object, c_void_p)

_new_capsule = ctypes.pythonapi.PyCapsule_New
_new_capsule.restype, _new_capsule.argtypes = py_object, (c_void_p, c_char_p, c_void_p)
_pointer_in = ctypes.pythonapi.PyCapsule_GetPointer
_pointer_in.restype, _pointer_in.argtypes = c_void_p, (py_object, c_char_p)

_kept: list[Any] = []
"""Functions and structures that ROS 2 uses for as long as the process lives."""


class CompiledMessage:
    """Message of a type that is made here; fields that are not given keep their defaults.

    Attributes:
        readable: False if the bytes that came did not fit the type; all fields are defaults then.
    """

    KIND = ""
    readable = True

    def __init__(self, **fields: Any) -> None:
        """Set fields by name: plain values, messages, or mappings of fields."""
        for member in members(self.KIND):
            given = member.name in fields
            setattr(self, member.name, fields[member.name] if given else _default(member))


def _default(member: Member) -> Any:
    if member.array:
        return []
    if member.nested:
        return message_type(member.kind)()
    return {"string": "", "bool": False}.get(member.kind, 0)


@cache
def message_type(name: str) -> Any:
    """Return the class of a type such as ``tf2_msgs/TFMessage``: the installed one, else made."""
    package, short = name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), short)
    except (ImportError, AttributeError):
        return _made(name)


@cache
def action_type(name: str) -> Any:
    """Return the class of an action such as ``control_msgs/FollowJointTrajectory``."""
    check_for_type_support(CancelGoal)
    check_for_type_support(GoalStatusArray)
    send, result = _service(f"{name}_SendGoal"), _service(f"{name}_GetResult")
    feedback = _made(f"{name}_FeedbackMessage")
    support = _Action(
        *(_pointer_in(type(part)._TYPE_SUPPORT, None) for part in (send, result, CancelGoal)),
        *(_pointer_in(type(part)._TYPE_SUPPORT, None) for part in (feedback, GoalStatusArray)),
        *_about(name),
    )
    parts = {"SendGoalService": send, "GetResultService": result, "CancelGoalService": CancelGoal}
    parts |= {"FeedbackMessage": feedback, "GoalStatusMessage": GoalStatusArray}
    own = {part: _made(f"{name}_{part}") for part in ("Goal", "Result", "Feedback")}
    return _class(name, {**own, "Impl": type("Impl", (), parts)}, _TYPE_SUPPORT=_capsule(support))


def _service(name: str) -> Any:
    request, response = _made(f"{name}_Request"), _made(f"{name}_Response")
    pointers = [_pointer_in(type(part)._TYPE_SUPPORT, None) for part in (request, response)]
    members_ = _ServiceCallbacks(*_called(name), *pointers)
    more = pointers, (None, None, None), _about(name)
    support = _Service(_language(_CDR), _kept_at(members_), None, *itertools.chain(*more))
    support.find = _finder({_CDR: support})
    parts = {"Request": request, "Response": response}
    return _class(name, parts, _TYPE_SUPPORT=_capsule(support))


@cache
def _made(name: str) -> Any:
    memory = _Memory()
    callbacks = _Callbacks(
        *_called(name),
        _kept_at(_write(memory.write)),
        _kept_at(_write(memory.read)),
        _kept_at(_size(memory.size)),
        _kept_at(_largest(_unbounded)),
        None,
    )
    support = _Message(_language(_CDR), _kept_at(callbacks), None, *_about(name))
    described = _Message(_language(_FIELDS), _kept_at(_fields_of(name)), None, *_about(name))
    support.find = described.find = _finder({_CDR: support, _FIELDS: described})
    made = _class(
        name,
        {"KIND": name},
        CompiledMessage,
        _TYPE_SUPPORT=_capsule(support),
        _CREATE_ROS_MESSAGE=_capsule(_create(memory.create)),
        _DESTROY_ROS_MESSAGE=_capsule(_destroy(memory.destroy)),
        _CONVERT_FROM_PY=_capsule(_from_python(memory.from_python)),
        _CONVERT_TO_PY=_capsule(_to_python(lambda address: _read(made, memory.bytes_at(address)))),
    )
    return made


def _class(name: str, content: dict[str, Any], *bases: type, **pointers: Any) -> Any:
    """Return a class whose own class holds pointers, as rclpy expects it."""
    short = name.rpartition("/")[2]
    return type(f"Metaclass_{short}", (type,), pointers)(short, bases, content)


def _called(name: str) -> tuple[int, int]:
    """Return addresses of the namespace and the name of a type, as DDS builds its own from."""
    package, middle, short = full_name(name).split("/")
    return _kept_at(f"{package}::{middle}".encode()), _kept_at(short.encode())


def _about(name: str) -> list[int]:
    """Return functions that return a type's hash, description and sources."""
    return [_kept_at(_get(lambda _, address=address: address)) for address in structures(name)]


def _finder(supports: dict[str, ctypes.Structure]) -> int:
    """Return a function that returns the type support for a language."""
    addresses = {name.encode(): ctypes.addressof(support) for name, support in supports.items()}
    _kept.extend(supports.values())
    return _kept_at(_find(lambda _, language: addresses.get(language)))


def _language(name: str) -> int:
    """Return the library's own text with its name, which ROS 2 compares by address."""
    value = c_void_p.in_dll(ctypes.CDLL(f"lib{name}.so"), f"{name}__identifier").value
    assert value is not None
    return value


def _fields_of(name: str) -> _Fields:
    """Return the description of all fields, of which Fast DDS makes its own."""
    package, middle, short = full_name(name).split("/")
    fields = (_Field * len(members(name)))()
    for field, member in zip(fields, members(name), strict=True):
        field.name = _kept_at(member.name.encode())
        field.kind = len(_FIELD_KINDS) + 1
        if member.nested:
            part = message_type(member.kind)
            check_for_type_support(part)
            field.nested = _pointer_in(type(part)._TYPE_SUPPORT, None)
        else:
            field.kind = _FIELD_KINDS.index(member.kind) + 1
        field.array = bool(member.array)
        field.size = int(member.array.strip("[<=]") or 0)
        field.bounded = "<=" in member.array
    scope = _kept_at(f"{package}__{middle}".encode())
    return _Fields(scope, _kept_at(short.encode()), len(fields), 8, False, _kept_at(fields))


def _capsule(value: Any) -> Any:
    return _new_capsule(_kept_at(value), None, None)


def _kept_at(value: Any) -> int:
    """Keep a text, a structure or a function, and return its address."""
    if isinstance(value, bytes):
        value = ctypes.create_string_buffer(value)
    _kept.append(value)
    if isinstance(value, ctypes.Structure | ctypes.Array):
        return ctypes.addressof(value)
    address = ctypes.cast(value, c_void_p).value
    assert address is not None
    return address


def _unbounded(bounds: Any) -> int:
    bounds[0] = b"\0"
    return 0


class _Memory:
    """Messages of one type in C: an address each, and the bytes that belong to it."""

    def __init__(self) -> None:
        self._held: dict[int, tuple[Any, bytes]] = {}

    def bytes_at(self, address: int) -> bytes:
        return self._held[address][1]

    def create(self) -> int:
        memory = ctypes.create_string_buffer(8)
        self._held[ctypes.addressof(memory)] = memory, b""
        return ctypes.addressof(memory)

    def destroy(self, address: int) -> None:
        self._held.pop(address, None)

    def _fill(self, address: int, data: bytes) -> bool:
        self._held[address] = self._held[address][0], data
        return True

    def from_python(self, message: CompiledMessage, address: int) -> bool:
        return self._fill(address, _written(message))

    def size(self, address: int) -> int:
        return len(self.bytes_at(address))

    def write(self, address: int, cdr: int) -> bool:
        data = self.bytes_at(address)
        _cdr("15serialize_arrayEPKcm", c_char_p, c_size_t)(cdr, data, len(data))
        return True

    def read(self, cdr: int, address: int) -> bool:
        start = _cdr("20get_current_positionEv")(cdr)
        # Nothing public tells the end. After seven pointers to methods, 16 bytes each, a Cdr has a
        # reference to its buffer, which has a table of methods, its address and its size.
        buffer = ctypes.cast(cdr, ctypes.POINTER(c_size_t))[14]
        _, first, size = ctypes.cast(buffer, ctypes.POINTER(c_size_t))[:3]
        if first != _cdr("18get_buffer_pointerEv")(cdr) or not first <= start <= first + size:
            return False
        return self._fill(address, ctypes.string_at(start, first + size - start))


@cache
def _cdr(name: str, *arguments: Any) -> Any:
    """Return a method of ``eprosima::fastcdr::Cdr``, of the library that rclpy has loaded."""
    function = ctypes.CDLL("libfastcdr.so.2")[f"_ZN8eprosima7fastcdr3Cdr{name}"]
    function.restype, function.argtypes = c_void_p, (c_void_p, *arguments)
    return function


def _written(message: CompiledMessage) -> bytes:
    """Return the CDR bytes of a message, without the header."""
    fields = {m.name: getattr(message, m.name) for m in members(message.KIND)}
    if isinstance(goal := fields.get("goal_id"), UUID):
        fields["goal_id"] = {"uuid": np.asarray(goal.uuid, np.uint8).tobytes()}
    return _encoder(message.KIND)(fields)[len(_CDR_HEADER) :]


def _read(made: type[CompiledMessage], data: bytes) -> CompiledMessage:
    """Return the message of CDR bytes; one that is not ``readable`` if they do not fit."""
    message = made()
    try:
        got = _decoder(made.KIND)(_CDR_HEADER + data)
        for member in members(made.KIND):
            setattr(message, member.name, getattr(got, member.name))
        if hasattr(got, "goal_id"):
            message.__dict__["goal_id"] = UUID(uuid=list(got.goal_id.uuid))
    except _BROKEN:
        message = made()
        message.readable = False
    return message


@cache
def _encoder(name: str) -> Callable[[Any], bytes]:
    return serialize_dynamic(*_schema(name))[_schema(name)[0]]


@cache
def _decoder(name: str) -> Callable[[bytes], Any]:
    return generate_dynamic(*_schema(name))[_schema(name)[0]]


def _schema(name: str) -> tuple[str, str]:
    """Return a type and its definition, with names that the MCAP library accepts as messages'."""
    kind, text = full_name(name), definition(full_name(name))
    return re.sub("_(?=[A-Z])", "", kind), re.sub("_(?=[A-Z])", "", text)
