"""A planner's view of a skin: GO, STOP on a contact, BLIND where the skin cannot tell.

python3 planner.py --ros-args -p limit:=0.2 -r contacts:=/left/contacts
"""

import rclpy
from dermis_msgs.msg import Contact, ContactArray
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

# The skin can tell what touches it: with less certainty where channels are missing.
SEEING = (ContactArray.STATUS_OK, ContactArray.STATUS_DEGRADED)


def force(contact):
    """Force along the inward normal [N], NaN where the model gives none."""
    if contact.force_components == Contact.FORCE_NONE:
        return float("nan")
    f, n = contact.force, contact.normal
    return -(f.x * n.x + f.y * n.y + f.z * n.z)


class Planner(Node):
    def __init__(self):
        super().__init__("planner")
        self.limit = self.declare_parameter("limit", 0.2).value  # [N]
        self.said = None
        # Best effort: a planner wants the newest contacts, not all of them.
        self.create_subscription(ContactArray, "contacts", self.decide, qos_profile_sensor_data)
        self.heard = self.get_clock().now()
        self.create_timer(0.1, self.watch)

    def decide(self, array):
        self.heard = self.get_clock().now()
        if array.status not in SEEING:
            self.say("BLIND", f"{array.skin}: {array.status_text}")
            return
        # A contact whose force is unknown (NaN) counts as strong.
        strong = [c for c in array.contacts if not force(c) <= self.limit]
        if strong:
            worst = max(strong, key=force)
            where = f"{worst.position.x:.4f} {worst.position.y:.4f} {worst.position.z:.4f}"
            self.say("STOP", f"{array.skin} {force(worst):.2f} N at {where} m in {array.header.frame_id}")
        else:
            self.say("GO", array.skin)

    def watch(self):
        # A node that is gone says nothing at all.
        if (self.get_clock().now() - self.heard).nanoseconds > 500_000_000:
            self.say("BLIND", "no contacts for 0.5 s")

    def say(self, word, why):
        if word != self.said:
            self.said = word
            print(word, why, flush=True)


rclpy.init()
try:
    rclpy.spin(Planner())
except KeyboardInterrupt:
    pass
