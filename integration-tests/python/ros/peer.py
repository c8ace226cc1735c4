"""A ROS 2 node for tests, driven over standard input.

Each line of standard input is a command, a JSON object with the key `do`; each line of standard output tells what
happened, a JSON object again. NaN is null in both directions. The program ends with its standard input.
"""

import array
import importlib
import json
import math
import queue
import sys
import threading

import numpy
import rclpy
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def type_of(name):
    """The Python class of `pkg/msg/Type` or `pkg/srv/Type`."""
    package, kind, short = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), short)


def to_json(value):
    if hasattr(value, "get_fields_and_field_types"):
        return {name: to_json(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, float):
        return None if math.isnan(value) else value
    if isinstance(value, bytes):
        # `byte` fields.
        return value[0] if len(value) == 1 else list(value)
    if isinstance(value, (list, tuple, array.array)):
        return [to_json(item) for item in value]
    if isinstance(value, numpy.ndarray):
        return [to_json(item) for item in value.tolist()]
    return value


def fill(message, value):
    """Sets the fields of a message that `value` names."""
    kinds = message.get_fields_and_field_types()
    for name, given in value.items():
        setattr(message, name, from_json(kinds[name], getattr(message, name), given))
    return message


def from_json(kind, current, value):
    if kind.startswith("sequence<"):
        inner = kind[len("sequence<") : -1].split(",")[0].strip()
        return [from_json(inner, None, item) for item in value]
    if kind.endswith("]"):
        inner = kind[: kind.index("[")]
        return [from_json(inner, None, item) for item in value]
    if kind in ("float", "double"):
        return math.nan if value is None else float(value)
    if kind == "octet":
        return bytes([value])
    if "/" in kind:
        package, short = kind.split("/")[0], kind.split("/")[-1]
        return fill(type_of(f"{package}/msg/{short}")() if current is None else current, value)
    return value


def profile(qos):
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.get("depth", 10),
        reliability=ReliabilityPolicy.RELIABLE if qos.get("reliable", True) else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.get("latched", False) else DurabilityPolicy.VOLATILE,
    )


class Peer:
    def __init__(self, node):
        self.node = node
        self.kept = []
        self.publishers = {}
        self.timers = {}
        self.pending = []
        self.clients = {}
        self.parameter_clients = {}

    def tell(self, **what):
        print(json.dumps(what), flush=True)

    def later(self, future, done):
        """Tells `done(result)` when the future has one."""
        self.pending.append((future, done))

    def step(self):
        open_ = []
        for future, done in self.pending:
            if future.done():
                done(future.result())
            else:
                open_.append((future, done))
        self.pending = open_

    def do(self, command):
        getattr(self, "do_" + command.pop("do"))(**command)

    def do_subscribe(self, topic, type, qos={}, counted=False):
        """Tells each message, or only that one came where the messages are large."""
        events = SubscriptionEventCallbacks(
            incompatible_qos=lambda event: self.tell(
                event="incompatible", topic=topic, count=event.total_count, policy=int(event.last_policy_kind)
            )
        )
        self.kept.append(
            self.node.create_subscription(
                type_of(type),
                topic,
                lambda message: self.tell(
                    event="message", topic=topic, value=None if counted else to_json(message)
                ),
                profile(qos),
                event_callbacks=events,
            )
        )
        self.tell(event="subscribed", topic=topic)

    def do_publish(self, topic, type, value={}, qos={}, period=None):
        if topic not in self.publishers:
            events = PublisherEventCallbacks(
                incompatible_qos=lambda event: self.tell(
                    event="incompatible", topic=topic, count=event.total_count, policy=int(event.last_policy_kind)
                )
            )
            self.publishers[topic] = self.node.create_publisher(
                type_of(type), topic, profile(qos), event_callbacks=events
            )
        publisher = self.publishers[topic]
        message = fill(type_of(type)(), value)
        if topic in self.timers:
            self.node.destroy_timer(self.timers.pop(topic))
        if period is not None:
            self.timers[topic] = self.node.create_timer(period, lambda: publisher.publish(message))
        publisher.publish(message)
        self.tell(event="published", topic=topic)

    def do_call(self, service, type, request={}):
        kind = type_of(type)
        if service not in self.clients:
            self.clients[service] = self.node.create_client(kind, service)
        client = self.clients[service]
        if not client.wait_for_service(timeout_sec=15.0):
            self.tell(event="no service", service=service)
            return
        self.later(
            client.call_async(fill(kind.Request(), request)),
            lambda response: self.tell(event="response", service=service, value=to_json(response)),
        )

    def do_serve(self, service, type, response={}):
        def answer(request, blank):
            self.tell(event="request", service=service, value=to_json(request))
            return fill(blank, response)

        self.kept.append(self.node.create_service(type_of(type), service, answer))
        self.tell(event="served", service=service)

    def do_parameters(self, node, ask, names=(), values=None):
        """Asks through rclpy's own parameter client."""
        if node not in self.parameter_clients:
            self.parameter_clients[node] = AsyncParameterClient(self.node, node)
        client = self.parameter_clients[node]
        if not client.wait_for_services(timeout_sec=15.0):
            self.tell(event="no service", service=node)
            return
        if ask == "list":
            future = client.list_parameters()
        elif ask == "get":
            future = client.get_parameters(names)
        elif ask == "describe":
            future = client.describe_parameters(names)
        elif ask == "set":
            future = client.set_parameters([Parameter(name, value=value) for name, value in values.items()])
        elif ask == "set atomically":
            future = client.set_parameters_atomically(
                [Parameter(name, value=value) for name, value in values.items()]
            )
        self.later(future, lambda answer: self.tell(event="parameters", ask=ask, value=to_json(answer)))

    def do_graph(self):
        self.tell(
            event="graph",
            nodes=[f"{namespace.rstrip('/')}/{name}" for name, namespace in self.node.get_node_names_and_namespaces()],
            topics=dict(self.node.get_topic_names_and_types()),
            services=dict(self.node.get_service_names_and_types()),
        )


def main():
    name = sys.argv[1]
    rclpy.init()
    node = rclpy.create_node(name)
    peer = Peer(node)
    commands = queue.Queue()

    def read():
        for line in sys.stdin:
            commands.put(json.loads(line))
        commands.put(None)

    threading.Thread(target=read, daemon=True).start()
    peer.tell(event="ready", node=node.get_fully_qualified_name())
    while True:
        rclpy.spin_once(node, timeout_sec=0.02)
        peer.step()
        while not commands.empty():
            command = commands.get()
            if command is None:
                node.destroy_node()
                rclpy.shutdown()
                return
            peer.do(command)


main()
