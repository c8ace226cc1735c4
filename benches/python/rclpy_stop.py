"""What a lab writes in place of `dermis reflex`: a stop message where a contact presses with more than a limit.

    rclpy_stop.py LIMIT

It compares and publishes, and nothing else: no timeout, no latch, no hysteresis, no repeat.
"""

import sys

import rclpy
from dermis_msgs.msg import ContactArray
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import Bool


def main():
    limit = float(sys.argv[1])
    rclpy.init()
    node = rclpy.create_node("lab_stop")
    publisher = node.create_publisher(Bool, "stop", 10)

    def decide(array):
        def force(contact):
            f = contact.force
            return (f.x * f.x + f.y * f.y + f.z * f.z) ** 0.5

        publisher.publish(Bool(data=any(force(contact) > limit for contact in array.contacts)))

    node.create_subscription(ContactArray, "contacts", decide, qos_profile_sensor_data)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
