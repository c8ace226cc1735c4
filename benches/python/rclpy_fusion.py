"""What a lab writes in place of `dermis fusion`: `body_fusion.py` in a node of rclpy, with the same topics and messages.

    rclpy_fusion.py ROBOT.toml [--assume-rest]

Callbacks only keep what has come. A timer of 1 kHz works all of it in, with one pass of numpy over all skins, and publishes
`body_contacts` where anything has come, and every 0.1 s in any case. No parameters, no lifecycle, no transforms, no diagnostics; no
topics of wrenches, points and markers. A skin is OK or STALE.
"""

import argparse
import pathlib
import time
import tomllib

import numpy as np
import rclpy
from body_fusion import BodyFusion, Report
from body_robot import Robot
from dermis_msgs.msg import BodyContact, BodyContacts, Contact, ContactArray, LinkWrench, SkinHealth
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

PERIOD, HEARTBEAT_NS = 1e-3, 100_000_000
FEELS = (ContactArray.STATUS_OK, ContactArray.STATUS_DEGRADED)


def nanoseconds(stamp):
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def set_stamp(stamp, value):
    stamp.sec, stamp.nanosec = divmod(int(value), 1_000_000_000)


def set_vector(target, values):
    target.x, target.y, target.z = values


def report_of(skin, array):
    contacts = array.contacts
    vectors = np.array(
        [
            (c.position.x, c.position.y, c.position.z, c.normal.x, c.normal.y, c.normal.z, c.force.x, c.force.y, c.force.z)
            for c in contacts
        ]
    ).reshape(-1, 3, 3)
    covariances = np.array([(c.position_covariance, c.force_covariance) for c in contacts]).reshape(-1, 2, 3, 3)
    numbers = np.array([(c.track_id, c.force_components) for c in contacts], int).reshape(-1, 2)
    return Report(
        skin,
        nanoseconds(array.header.stamp),
        numbers[:, 0],
        *(vectors[:, i] for i in range(3)),
        *(covariances[:, i] for i in range(2)),
        numbers[:, 1],
    )


class FusionNode:
    def __init__(self, robot, assume_rest):
        self.robot, self.fusion = robot, BodyFusion(robot, assume_rest)
        self.waiting, self.sequence, self.answered, self.knows_joints = [], 0, 0, assume_rest
        self.node = rclpy.create_node("lab_fusion")
        self.publisher = self.node.create_publisher(BodyContacts, "body_contacts", qos_profile_sensor_data)
        for skin, topic in enumerate(robot.topics):
            self.node.create_subscription(
                ContactArray, topic, lambda array, skin=skin: self.waiting.append((skin, array)), qos_profile_sensor_data
            )
        self.node.create_subscription(JointState, "/joint_states", self.joints, qos_profile_sensor_data)
        self.timer = self.node.create_timer(PERIOD, self.answer)

    def joints(self, state):
        self.knows_joints = True
        self.fusion.joints.take(nanoseconds(state.header.stamp), state.name, state.position)

    def answer(self):
        now = time.time_ns()
        came, self.waiting = self.waiting, []
        if not came and now - self.answered < HEARTBEAT_NS:
            return
        self.answered = now
        usable = [(skin, a) for skin, a in came if a.status in FEELS and a.skin == self.robot.skins[skin]]
        if usable:
            self.fusion.take([report_of(skin, array) for skin, array in usable], now)
        self.publisher.publish(self.message(self.fusion.state(now)))

    def message(self, state):
        robot, out = self.robot, BodyContacts()
        self.sequence += 1
        out.sequence, out.header.frame_id = self.sequence, robot.links[robot.base]
        set_stamp(out.header.stamp, state["stamp"])
        for skin, stale in enumerate(state["stale"].tolist()):
            health = SkinHealth(skin=robot.skins[skin], link=robot.links[robot.link[skin]])
            health.status = ContactArray.STATUS_STALE if stale else ContactArray.STATUS_OK
            health.rate, health.healthy = float(state["rate"][skin]), float("nan")
            set_stamp(health.stamp, self.fusion.last[skin])
            out.skins.append(health)
            out.status = max(out.status, health.status)
        out.contacts = [self.contact(state, k) for k in range(len(state["id"]))]
        keys = ("link_force", "link_torque", "body_force", "body_torque")
        for k, values in enumerate(np.stack([state[key] for key in keys], axis=1).tolist()):
            load = LinkWrench(link=robot.links[state["links"][k]])
            targets = (load.wrench.force, load.wrench.torque, load.body_wrench.force, load.body_wrench.torque)
            for target, vector in zip(targets, values):
                set_vector(target, vector)
            load.force_covariance = state["link_force_covariance"][k].ravel()
            out.wrenches.append(load)
        set_vector(out.net_wrench.force, state["net_force"].tolist())
        set_vector(out.net_wrench.torque, state["net_torque"].tolist())
        if self.knows_joints:
            unknown = np.full(len(robot.joints), np.nan)
            out.joints, out.joint_torques = robot.joints, state["joint_torques"].tolist()
            out.unexplained_torques = out.unexplained_variances = unknown.tolist()
        return out

    def contact(self, state, k):
        robot, out, contact = self.robot, BodyContact(), Contact()
        contact.track_id, contact.force_components = int(state["id"][k]), int(state["components"][k])
        for target, key in ((contact.position, "position"), (contact.normal, "normal"), (contact.force, "force")):
            set_vector(target, state[key][k].tolist())
        contact.position_covariance = state["position_covariance"][k].ravel()
        contact.force_covariance = state["force_covariance"][k].ravel()
        contact.confidence, contact.diameter = 1.0, float("nan")
        out.contact, out.link = contact, robot.links[state["link"][k]]
        feels = state["feels"][k]
        out.skins = [robot.skins[skin] for skin in robot.skin_at[state["group"][k]][feels]]
        out.skin_tracks = state["called"][k][feels].tolist()
        set_vector(out.body_from_contact.position, state["body_position"][k].tolist())
        turn = out.body_from_contact.orientation
        turn.x, turn.y, turn.z, turn.w = state["body_quaternion"][k].tolist()
        set_vector(out.velocity, state["velocity"][k].tolist())
        out.velocity_covariance = state["velocity_covariance"][k].ravel()
        set_stamp(out.stamp, state["seen"][k])
        out.age.sec, out.age.nanosec = divmod(int(state["seen"][k] - state["born"][k]), 1_000_000_000)
        out.slip_confidence, out.cause = float("nan"), BodyContact.CAUSE_ENVIRONMENT
        return out


def main():
    parser = argparse.ArgumentParser(description="fusion of skins in rclpy and numpy")
    parser.add_argument("robot", type=pathlib.Path)
    parser.add_argument("--assume-rest", action="store_true")
    options = parser.parse_args()
    robot = tomllib.loads(options.robot.read_text())
    urdf = (options.robot.parent / robot["urdf"]).read_text()
    rclpy.init()
    fusion = FusionNode(Robot(urdf, robot), options.assume_rest)
    # The executor of most nodes: with the wheels of Kilted, `rclpy.experimental.EventsExecutor` calls neither timers nor subscriptions.
    rclpy.spin(fusion.node)


if __name__ == "__main__":
    main()
