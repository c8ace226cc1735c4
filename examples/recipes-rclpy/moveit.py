"""Contacts as MoveIt writes them: the fields of `moveit_msgs/ContactInformation`, from the fused contacts of a robot.

python3 moveit.py

Where `moveit_msgs` is installed, the messages go to `contact_information`; they are printed in any case, one JSON object a contact.

| field | here |
|---|---|
| `header` | stamp of the message; the frame of the contact's link |
| `position`, `normal` | on the link's surface, out of it [m] |
| `depth` | 0: skins measure force; how far an object reaches into the robot is not known |
| `contact_body_1`, `body_type_1` | the link, `ROBOT_LINK` |
| `contact_body_2`, `body_type_2` | what touches: another link where the fusion says so, `environment` of type `WORLD_OBJECT` otherwise |
"""

import json

import rclpy
from dermis_msgs.msg import BodyContact, BodyContacts
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

try:
    from moveit_msgs.msg import ContactInformation
except ImportError:
    ContactInformation = None

ROBOT_LINK, WORLD_OBJECT = 0, 1


def information(header, found):
    """The fields by their names; vectors as lists."""
    contact = found.contact
    itself = found.cause == BodyContact.CAUSE_SELF
    return {
        "stamp": [header.stamp.sec, header.stamp.nanosec],
        "frame_id": found.link,
        "position": [contact.position.x, contact.position.y, contact.position.z],
        "normal": [contact.normal.x, contact.normal.y, contact.normal.z],
        "depth": 0.0,
        "contact_body_1": found.link,
        "body_type_1": ROBOT_LINK,
        "contact_body_2": "another link" if itself else "environment",
        "body_type_2": ROBOT_LINK if itself else WORLD_OBJECT,
    }


def message(fields):
    out = ContactInformation()
    out.header.stamp.sec, out.header.stamp.nanosec = fields["stamp"]
    out.header.frame_id = fields["frame_id"]
    out.position.x, out.position.y, out.position.z = fields["position"]
    out.normal.x, out.normal.y, out.normal.z = fields["normal"]
    for name in ("depth", "contact_body_1", "body_type_1", "contact_body_2", "body_type_2"):
        setattr(out, name, fields[name])
    return out


class Translator(Node):
    def __init__(self):
        super().__init__("contact_information")
        if ContactInformation is not None:
            self.publisher = self.create_publisher(ContactInformation, "contact_information", 10)
        self.create_subscription(BodyContacts, "body_contacts", self.translate, qos_profile_sensor_data)

    def translate(self, body):
        for found in body.contacts:
            # Where no position is known, there is nothing that MoveIt could place.
            if found.contact.position.x != found.contact.position.x:
                continue
            fields = information(body.header, found)
            print(json.dumps(fields), flush=True)
            if ContactInformation is not None:
                self.publisher.publish(message(fields))


rclpy.init()
try:
    rclpy.spin(Translator())
except KeyboardInterrupt:
    pass
