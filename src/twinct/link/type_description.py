"""Description of a message type, by which ROS 2 distinguishes types, and its hash (REP 2011).

``rosidl_generator_type_description`` defines the numbers and the hash. ROS 2 asks for both where
an endpoint is made, and shows the hash to others.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from typing import Any

from rosidl_generator_type_description import FIELD_TYPE_NAME_TO_ID, calculate_type_hash

from twinct.link.definitions import Member, full_name, members, with_parts

_CALLED = {"float64": "DOUBLE", "float32": "FLOAT", "bool": "BOOLEAN"}
"""Types whose names in a description are not those of a ``.msg`` file."""


def description(name: str) -> dict[str, Any]:
    """Return the description of a message such as ``geometry_msgs/Pose``, as plain data."""
    first, *others = with_parts(name)
    return {
        "type_description": _individual(first),
        "referenced_type_descriptions": [
            _individual(other) for other in sorted(others, key=full_name)
        ],
    }


def hash_of(data: dict[str, Any]) -> bytes:
    """Return the 32 bytes of the hash of a description."""
    return bytes.fromhex(calculate_type_hash(data).removeprefix("RIHS01_"))


def _individual(name: str) -> dict[str, Any]:
    fields = [_field(member) for member in members(name)]
    return {"type_name": full_name(name), "fields": fields}


def _field(member: Member) -> dict[str, Any]:
    kind = "NESTED_TYPE" if member.nested else _CALLED.get(member.kind, member.kind.upper())
    size = member.array.strip("[<=]")
    ending = ""
    if member.array:
        unlimited = "_ARRAY" if size else "_UNBOUNDED_SEQUENCE"
        ending = "_BOUNDED_SEQUENCE" if "<=" in member.array else unlimited
    numbers = {
        "type_id": FIELD_TYPE_NAME_TO_ID[f"FIELD_TYPE_{kind}{ending}"],
        "capacity": int(size or 0),
        "string_capacity": 0,
        "nested_type_name": full_name(member.kind) if member.nested else "",
    }
    return {"name": member.name, "type": numbers, "default_value": ""}


class _Sequence(ctypes.Structure):
    """A text or a sequence of ``rosidl_runtime_c``."""

    _fields_ = (
        ("data", ctypes.c_void_p),
        ("size", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
    )


class _FieldType(ctypes.Structure):
    _fields_ = (
        ("type_id", ctypes.c_uint8),
        ("capacity", ctypes.c_uint64),
        ("string_capacity", ctypes.c_uint64),
        ("nested_type_name", _Sequence),
    )


class _Field(ctypes.Structure):
    _fields_ = (("name", _Sequence), ("type", _FieldType), ("default_value", _Sequence))


class _Individual(ctypes.Structure):
    _fields_ = (("type_name", _Sequence), ("fields", _Sequence))


class _Description(ctypes.Structure):
    _fields_ = (("type_description", _Individual), ("referenced", _Sequence))


_kept: list[Any] = []
"""Memory that ROS 2 reads for as long as the process lives."""


@cache
def structures(name: str) -> tuple[int, int, int]:
    """Return addresses of a type's hash, its description, and its list of sources, which is empty.

    Args:
        name: type such as ``geometry_msgs/Pose``.
    """
    described = description(name)
    number = ctypes.create_string_buffer(b"\x01" + hash_of(described), 33)
    whole = _Description(
        _of_individual(described["type_description"]),
        _sequence(
            _Individual, [_of_individual(t) for t in described["referenced_type_descriptions"]]
        ),
    )
    sources = _Sequence(None, 0, 0)
    _kept.append((number, whole, sources))
    return ctypes.addressof(number), ctypes.addressof(whole), ctypes.addressof(sources)


def _of_individual(data: dict[str, Any]) -> _Individual:
    fields = [
        _Field(
            _text(field["name"]),
            _FieldType(
                field["type"]["type_id"],
                field["type"]["capacity"],
                field["type"]["string_capacity"],
                _text(field["type"]["nested_type_name"]),
            ),
            _text(field["default_value"]),
        )
        for field in data["fields"]
    ]
    return _Individual(_text(data["type_name"]), _sequence(_Field, fields))


def _text(text: str) -> _Sequence:
    data = ctypes.create_string_buffer(text.encode())
    _kept.append(data)
    return _Sequence(ctypes.addressof(data), len(text), len(text) + 1)


def _sequence(kind: Any, values: Sequence[Any]) -> _Sequence:
    data = (kind * len(values))(*values)
    _kept.append(data)
    return _Sequence(ctypes.addressof(data), len(values), len(values))
