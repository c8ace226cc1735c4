"""Fills messages with values and writes what rclpy makes of them: FOLDER/<n>.cdr and FOLDER/<n>.json.

usage: rclpy_samples.py FOLDER VARIANTS < NAMES

NAMES are full names of messages, one a line, as `dermis_msgs/msg/ContactArray`. Prints one line a sample: n and name.
A name whose package is not installed is printed after `missing`.
"""

import importlib
import json
import math
import pathlib
import random
import struct
import sys

from rclpy.serialization import deserialize_message, serialize_message
from rosidl_parser.definition import (
    AbstractSequence,
    AbstractString,
    Array,
    BasicType,
    BoundedSequence,
    NamespacedType,
)

INTEGERS = {
    "octet": (0, 2**8 - 1),
    "char": (0, 2**8 - 1),
    "uint8": (0, 2**8 - 1),
    "int8": (-(2**7), 2**7 - 1),
    "uint16": (0, 2**16 - 1),
    "int16": (-(2**15), 2**15 - 1),
    "uint32": (0, 2**32 - 1),
    "int32": (-(2**31), 2**31 - 1),
    "uint64": (0, 2**64 - 1),
    "int64": (-(2**63), 2**63 - 1),
}
TEXTS = ["", "a", "taxel_07", "Haut °C µT", "触覚", "two\nlines \"quoted\""]


def load(name):
    package, kind, type_name = name.split("/")
    module = importlib.import_module(f"{package}.{kind}")
    for suffix in ("_Request", "_Response"):
        if type_name.endswith(suffix):
            return getattr(getattr(module, type_name[: -len(suffix)]), suffix[1:])
    return getattr(module, type_name)


def scalar(slot, rng):
    """A value for rclpy, and the same as JSON."""
    if isinstance(slot, NamespacedType):
        return filled(load("/".join(slot.namespaced_name())), rng)
    if isinstance(slot, AbstractString):
        text = rng.choice(TEXTS)
        return text, text
    assert isinstance(slot, BasicType), slot
    if slot.typename == "boolean":
        value = rng.random() < 0.5
        return value, value
    if slot.typename in INTEGERS:
        low, high = INTEGERS[slot.typename]
        value = rng.choice([low, high, 0, 1, rng.randint(low, high)])
        # rclpy keeps a byte as a bytes object of length 1.
        return (bytes([value]) if slot.typename == "octet" else value), value
    value = rng.choice([0.0, -0.0, 1.5, math.nan, rng.gauss(0, 1), rng.gauss(0, 1e30)])
    if slot.typename == "float":
        (value,) = struct.unpack("f", struct.pack("f", value))
    return value, None if math.isnan(value) else value


def filled(cls, rng):
    """A message for rclpy, and the same as JSON. Without `rng`: the defaults."""
    message, as_json = cls(), {}
    for field, slot in zip(cls.get_fields_and_field_types(), cls.SLOT_TYPES):
        if field == "structure_needs_at_least_one_member":
            continue
        if isinstance(slot, (Array, AbstractSequence)):
            if isinstance(slot, Array):
                count = slot.size
            else:
                count = rng.choice([0, 1, 2, 3, 5])
                if isinstance(slot, BoundedSequence):
                    count = min(count, slot.maximum_size)
            pairs = [scalar(slot.value_type, rng) for _ in range(count)]
            setattr(message, field, [value for value, _ in pairs])
            as_json[field] = [value for _, value in pairs]
        else:
            value, as_json[field] = scalar(slot, rng)
            setattr(message, field, value)
    return message, as_json


def main():
    folder, variants = pathlib.Path(sys.argv[1]), int(sys.argv[2])
    n = 0
    for name in sys.stdin.read().split():
        try:
            cls = load(name)
        except ModuleNotFoundError:
            print("missing", name)
            continue
        for variant in range(variants):
            message, as_json = filled(cls, random.Random(f"{name} {variant}"))
            cdr = serialize_message(message)
            deserialize_message(cdr, cls)
            (folder / f"{n}.cdr").write_bytes(cdr)
            (folder / f"{n}.json").write_text(json.dumps(as_json, allow_nan=False))
            print(n, name)
            n += 1
        (folder / f"{n}.cdr").write_bytes(serialize_message(cls()))
        (folder / f"{n}.json").write_text("{}")
        print(n, name)
        n += 1


main()
