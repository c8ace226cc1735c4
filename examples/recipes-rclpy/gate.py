"""The listener of a stop: velocities pass while the reflexes say that they may, and not where nobody says so.

python3 gate.py --ros-args -p timeout:=0.3

`cmd_vel_raw` goes to `cmd_vel` while `stop` (`std_msgs/Bool`, an action of kind `bool` with a `heartbeat`) is false and not older than
`timeout`. Otherwise zeros are sent: also where the reflexes were killed and say nothing any more.
"""

import rclpy
from geometry_msgs.msg import Twist
from rclpy.node import Node
from std_msgs.msg import Bool


class Gate(Node):
    def __init__(self):
        super().__init__("velocity_gate")
        self.timeout = self.declare_parameter("timeout", 0.3).value  # [s] three heartbeats
        self.free_until = None  # nobody has said so yet
        self.said = None
        self.publisher = self.create_publisher(Twist, "cmd_vel", 10)
        self.create_subscription(Bool, "stop", self.hear, 10)
        self.create_subscription(Twist, "cmd_vel_raw", self.drive, 10)
        self.create_timer(0.02, self.watch)

    def now(self):
        return self.get_clock().now().nanoseconds * 1e-9

    def hear(self, stop):
        self.free_until = None if stop.data else self.now() + self.timeout
        self.watch()

    def is_free(self):
        return self.free_until is not None and self.now() < self.free_until

    def drive(self, velocity):
        self.publisher.publish(velocity if self.is_free() else Twist())

    def watch(self):
        word = "GO" if self.is_free() else "STOP"
        if word == "STOP":
            self.publisher.publish(Twist())
        if word != self.said:
            self.said = word
            print(word, flush=True)


rclpy.init()
try:
    rclpy.spin(Gate())
except KeyboardInterrupt:
    pass
