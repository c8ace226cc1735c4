"""Values per link by topic: the force and torque on each link, as a force-torque sensor broadcaster would publish them.

python3 links.py

For every link of the fused contacts, `<link>/wrench` (`geometry_msgs/WrenchStamped`) in the frame of the link. While a link cannot
be sensed its topic falls silent, as a sensor that is unplugged does: a controller with a timeout sees that, and would not see zeros.
"""

import rclpy
from dermis_msgs.msg import BodyContacts, ContactArray
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

# The skins of a link can tell what touches it: with less certainty where channels are missing.
FEELING = (ContactArray.STATUS_OK, ContactArray.STATUS_DEGRADED)


class Links(Node):
    def __init__(self):
        super().__init__("link_wrenches")
        self.outputs = {}
        self.create_subscription(BodyContacts, "body_contacts", self.spread, qos_profile_sensor_data)

    def spread(self, body):
        for of in body.wrenches:
            if of.status not in FEELING:
                print(f"{of.link} is not sensed", flush=True)
                continue
            if of.link not in self.outputs:
                self.outputs[of.link] = self.create_publisher(WrenchStamped, f"{of.link}/wrench", 10)
            message = WrenchStamped()
            message.header.stamp = body.header.stamp
            message.header.frame_id = of.link
            message.wrench = of.wrench
            self.outputs[of.link].publish(message)
            force = of.wrench.force
            print(f"{of.link} {force.x:.3f} {force.y:.3f} {force.z:.3f} N", flush=True)


rclpy.init()
try:
    rclpy.spin(Links())
except KeyboardInterrupt:
    pass
