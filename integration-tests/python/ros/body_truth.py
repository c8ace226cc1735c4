"""What a body says beside what really touches it: `/one/body_contacts` against `/one/body_truth`, in a node of rclpy.

Prints one JSON object once enough messages of enough presses were compared, and ends: medians of the distance [mm], of the contact's force and of the
net force (shares of the true one), the number of presses, and how often an identity changed within a press.
"""

import json
import statistics
import sys

import rclpy
from dermis_msgs.msg import BodyContacts, Indentation
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

PRESSES, LONGEST = int(sys.argv[1]), 15_000_000


def ns(stamp):
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def xyz(v):
    return (v.x, v.y, v.z)


def size(v):
    return sum(c * c for c in v) ** 0.5


def less(a, b):
    return tuple(x - y for x, y in zip(a, b))


class Compare(Node):
    def __init__(self):
        super().__init__("body_truth_check")
        qos = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.truth, self.waiting = [], []
        self.away, self.force, self.net, self.tracks = [], [], [], {}
        self.create_subscription(Indentation, "/one/body_truth", self.is_true, qos)
        self.create_subscription(BodyContacts, "/one/body_contacts", self.waiting.append, qos)

    def is_true(self, truth):
        self.truth.append(truth)
        # What the body says of before it can be compared now.
        while self.waiting and ns(self.waiting[0].header.stamp) < ns(truth.header.stamp):
            self.compare(self.waiting.pop(0))
        del self.truth[:-500]

    def compare(self, said):
        at = ns(said.header.stamp)
        before = next((t for t in reversed(self.truth) if ns(t.header.stamp) <= at), None)
        after = next((t for t in self.truth if ns(t.header.stamp) > at), None)
        if before is None or after is None or before.press != after.press:
            return
        if ns(after.header.stamp) - ns(before.header.stamp) > LONGEST or len(said.contacts) != 1:
            return
        for truth in (before, after):
            if truth.phase != Indentation.PHASE_HOLD or len(truth.contacts) != 1:
                return
        share = (at - ns(before.header.stamp)) / (ns(after.header.stamp) - ns(before.header.stamp))
        a, b = (xyz(t.contacts[0].position) for t in (before, after))
        place = tuple(x + (y - x) * share for x, y in zip(a, b))
        force = xyz(before.contacts[0].force)
        found = said.contacts[0]
        self.away.append(1e3 * size(less(xyz(found.body_from_contact.position), place)))
        self.force.append(abs(size(xyz(found.contact.force)) / size(force) - 1.0))
        self.net.append(size(less(xyz(said.net_wrench.force), force)) / size(force))
        self.tracks.setdefault(before.press, []).append(found.contact.track_id)
        whole = [tracks for tracks in self.tracks.values() if len(tracks) >= 10]
        if len(whole) >= PRESSES:
            changed = sum(a != b for tracks in whole for a, b in zip(tracks, tracks[1:]))
            medians = {n: statistics.median(v) for n, v in [("away_mm", self.away), ("force", self.force), ("net", self.net)]}
            print(json.dumps({**medians, "messages": len(self.away), "presses": len(whole), "changed": changed}), flush=True)
            raise SystemExit


rclpy.init()
try:
    rclpy.spin(Compare())
except (KeyboardInterrupt, SystemExit):
    pass
