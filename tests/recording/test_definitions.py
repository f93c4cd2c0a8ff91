import importlib
import re

import pytest

from twinct.link.definitions import _FIELDS, definition
from twinct.link.topics import KINDS

CALLED = {"double": "float64", "float": "float32", "octet": "byte", "boolean": "bool"}
"""What a ``.msg`` file calls the types that the classes name."""


def fields_of(kind: str) -> list[str]:
    """What the class of a message says of its fields."""
    package, name = kind.split("/")
    cls = getattr(importlib.import_module(f"{package}.msg"), name)
    fields = []
    for field, told in cls.get_fields_and_field_types().items():
        inner = re.sub(r"sequence<(.*)>", r"\1[]", told)
        base, array = re.fullmatch(r"([^\[]*)(.*)", inner).groups()
        fields.append(f"{CALLED.get(base, base)}{array} {field}")
    return fields


# No wheel has /tf's; rosbags knows it: test_local. Nor does one have the action's.
@pytest.mark.parametrize(
    "kind", sorted(k for k in _FIELDS if not k.startswith(("tf2_msgs/", "control_msgs/")))
)
def test_fields_are_those_of_ros(kind):
    package = kind.partition("/")[0]
    own = [
        f"{package}/{field}" if field[0].isupper() else field for field in _FIELDS[kind].split(", ")
    ]
    assert own == fields_of(kind)


def test_a_definition_has_each_part_once():
    text = definition("sensor_msgs/msg/CameraInfo")
    parts = re.findall(r"^MSG: (.*)$", text, re.MULTILINE)
    assert parts == ["std_msgs/Header", "sensor_msgs/RegionOfInterest", "builtin_interfaces/Time"]


def test_all_topics_have_definitions():
    for kind in KINDS.values():
        assert definition(kind)
