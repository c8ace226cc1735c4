"""Reads and writes bags with libraries that others wrote: `rosbags` and `mcap-ros2-support` from PyPI.

clients.py check BAG EXPECTED.json   every message, by both libraries, equals the JSON lines
clients.py write BAG EXPECTED.json   writes the JSON lines as a bag with `rosbags`
"""

import json
import math
import sys
from pathlib import Path

import numpy
from mcap_ros2.reader import read_ros2_messages
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore


def plain(value):
    """A message as JSON would hold it: NaN is None."""
    if isinstance(value, numpy.ndarray):
        value = value.tolist()
    if isinstance(value, (bytes, bytearray, list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, numpy.generic):
        value = value.item()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, (str, bool, int)):
        return value
    names = getattr(value, "__slots__", None) or vars(value)
    # Constants of a message stand beside its fields; ROS writes them, and only them, in capitals. What has no field gets one.
    fields = (name for name in names if not name.isupper() and name != "structure_needs_at_least_one_member")
    return {name: plain(getattr(value, name)) for name in fields if not name.startswith("__")}


def differ(ours, theirs, path):
    """The first place where two JSON values differ, or None. Floats of 32 bits print differently: 1e-7 relative."""
    if isinstance(ours, dict) and isinstance(theirs, dict):
        if set(ours) != set(theirs):
            return f"{path}: fields {sorted(set(ours) ^ set(theirs))}"
        return next((d for k in ours if (d := differ(ours[k], theirs[k], f"{path}.{k}"))), None)
    if isinstance(ours, list) and isinstance(theirs, list):
        if len(ours) != len(theirs):
            return f"{path}: {len(ours)} and {len(theirs)} elements"
        return next((d for i, (a, b) in enumerate(zip(ours, theirs)) if (d := differ(a, b, f"{path}[{i}]"))), None)
    if isinstance(ours, (int, float)) and isinstance(theirs, (int, float)):
        close = math.isclose(ours, theirs, rel_tol=1e-7)
        return None if close else f"{path}: {ours} and {theirs}"
    return None if ours == theirs else f"{path}: {ours!r} and {theirs!r}"


def compare(library, expected, found):
    if len(expected) != len(found):
        sys.exit(f"{library} read {len(found)} messages of {len(expected)}")
    for index, (ours, theirs) in enumerate(zip(expected, found)):
        difference = differ(ours, theirs, f"message {index}")
        if difference:
            sys.exit(f"{library}: {difference}")
    print(f"{library}: {len(found)} messages equal")


def key(line):
    return line["log_time"], line["topic"]


def check(bag, expected):
    expected.sort(key=key)
    with AnyReader([bag]) as reader:
        found = [
            {
                "topic": connection.topic,
                "type": connection.msgtype,
                "log_time": time,
                "message": plain(reader.deserialize(data, connection.msgtype)),
            }
            for connection, time, data in reader.messages()
        ]
        kinds = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
    compare("rosbags", expected, sorted(found, key=key))
    for topic, profiles in kinds.items():
        if len(profiles) != 1:
            sys.exit(f"rosbags: topic {topic} has {len(profiles)} QoS profiles")

    files = sorted(bag.glob("*.mcap"))
    found = [
        {
            "topic": message.channel.topic,
            "type": message.schema.name,
            "log_time": message.log_time_ns,
            "message": plain(message.ros_msg),
        }
        for file in files
        for message in read_ros2_messages(str(file))
    ]
    compare("mcap-ros2-support", expected, sorted(found, key=key))


def build(store, type_name, value):
    """A `rosbags` message from JSON."""
    message_class = store.types[type_name]
    fields = {}
    for name, (kind, detail) in store.fielddefs[type_name][1]:
        fields[name] = convert(store, kind, detail, value[name])
    return message_class(**fields)


def convert(store, kind, detail, value):
    kind = int(kind)
    if kind == 1:
        return math.nan if value is None else value
    if kind == 2:
        return build(store, detail, value)
    inner_kind, inner = detail[0]
    items = [convert(store, inner_kind, inner, item) for item in value]
    if int(inner_kind) == 1 and inner[0] != "string":
        return numpy.array(items, dtype={"octet": "uint8"}.get(inner[0], inner[0]))
    return items


def write(bag, lines):
    store = get_typestore(Stores.EMPTY)
    for name, definition in {line["type"]: line["definition"] for line in lines}.items():
        store.register(get_types_from_msg(definition, name))
    forever = QosTime(9223372036, 854775807)
    qos = Qos(
        QosHistory.KEEP_LAST,
        7,
        QosReliability.BEST_EFFORT,
        QosDurability.VOLATILE,
        forever,
        forever,
        QosLiveliness.AUTOMATIC,
        forever,
        False,
    )
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for line in lines:
            topic, name = line["topic"], line["type"]
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=store, offered_qos_profiles=[qos])
            data = store.serialize_cdr(build(store, name, line["message"]), name)
            writer.write(connections[topic], line["log_time"], data)
        hashes = {c.topic: c.digest for c in writer.connections}
    print(json.dumps(hashes))


if __name__ == "__main__":
    command, bag, expected = sys.argv[1:]
    lines = [json.loads(line) for line in Path(expected).read_text().splitlines()]
    {"check": check, "write": write}[command](Path(bag), lines)
