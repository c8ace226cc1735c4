"""Kinematics of a robot with skins in numpy: URDF and robot file, joint states by time, forward kinematics and J^T f.

Part of the peer of `dermis fusion` in `body_fusion.py`. Units are SI; stamps are integer nanoseconds.
"""

import xml.etree.ElementTree as ElementTree
from bisect import bisect_left

import numpy as np

JOINT_HOLD, JOINT_GAP, JOINT_SPAN = 0.1, 0.5, 2.0


def cross(a, b):
    """Cross products of rows, without the checks that take most of `np.cross` for a few of them."""
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]


def swap(m):
    return m.swapaxes(-1, -2)


def apply(m, v):
    """Matrices (..., 3, 3) times vectors (..., 3)."""
    return (m @ v[..., None])[..., 0]


def transform(translation, rpy):
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy), np.cos(rpy)
    out = np.eye(4)
    out[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    out[:3, 3] = translation
    return out


def inverse(t):
    """Of rigid transforms (..., 4, 4)."""
    out = np.zeros_like(t)
    out[..., :3, :3] = swap(t[..., :3, :3])
    out[..., :3, 3] = -apply(out[..., :3, :3], t[..., :3, 3])
    out[..., 3, 3] = 1
    return out


class Robot:
    """Links and joints of a URDF, and the skins of a robot file (both parsed already)."""

    def __init__(self, urdf, robot):
        tree = ElementTree.fromstring(urdf)
        links = [link.get("name") for link in tree.iter("link")]
        joints = [joint for joint in tree.findall("joint")]
        if any(joint.find("mimic") is not None for joint in joints):
            raise ValueError("joints that mimic others are not supported here; take them out of the URDF")
        by_child = {joint.find("child").get("link"): joint for joint in joints}
        depth = {}

        def level(link):
            if link not in depth:
                joint = by_child.get(link)
                depth[link] = 0 if joint is None else level(joint.find("parent").get("link")) + 1
            return depth[link]

        self.links = sorted(links, key=level)
        self.unmoved = np.tile(np.eye(4), (len(links), 1, 1))
        index = {name: i for i, name in enumerate(self.links)}
        # The joint above each link but the root, in the order of the links.
        joints = [by_child[name] for name in self.links[1:]]
        numbers = lambda element, key, default: [float(v) for v in element.get(key, default).split()]  # noqa: E731
        nothing = ElementTree.Element("nothing")
        origins = [joint.find("origin") if joint.find("origin") is not None else nothing for joint in joints]
        self.origin = np.array([transform(numbers(o, "xyz", "0 0 0"), numbers(o, "rpy", "0 0 0")) for o in origins])
        self.origin = self.origin.reshape(-1, 4, 4)
        self.parent = np.array([index[joint.find("parent").get("link")] for joint in joints], int)
        kinds = [joint.get("type") for joint in joints]
        self.levels = [
            np.array([i for i, name in enumerate(self.links[1:]) if depth[name] == d], int)
            for d in range(1, max(depth.values(), default=0) + 1)
        ]
        # Joints that move, in the order of the URDF.
        order = [j for j in tree.findall("joint") if j.get("type") in ("revolute", "continuous", "prismatic")]
        self.joints = [joint.get("name") for joint in order]
        self.moving = np.array([joints.index(joint) for joint in order], int)
        axes = [joint.find("axis") if joint.find("axis") is not None else nothing for joint in order]
        self.axis = np.array([numbers(a, "xyz", "1 0 0") for a in axes]).reshape(-1, 3)
        self.axis /= np.linalg.norm(self.axis, axis=1, keepdims=True)
        self.slides = np.array([joint.get("type") == "prismatic" for joint in order], bool)
        self.wraps = np.array([joint.get("type") == "continuous" for joint in order], bool)
        limits = [joint.find("limit") if joint.find("limit") is not None else nothing for joint in order]
        low = np.array([float(limit.get("lower", "0")) for limit in limits])
        high = np.array([float(limit.get("upper", "0")) for limit in limits])
        self.rest = np.where(self.wraps | (low > high), 0.0, np.clip(0.0, low, np.maximum(low, high)))
        skew = np.zeros((len(order), 3, 3))
        for (i, j), k, sign in (((0, 1), 2, -1), ((0, 2), 1, 1), ((1, 2), 0, -1)):
            skew[:, i, j], skew[:, j, i] = sign * self.axis[:, k], -sign * self.axis[:, k]
        self.skew, self.square = skew, skew @ skew
        # Which joints carry which links.
        self.carries = np.zeros((len(order), len(self.links)))
        for link in range(len(self.links)):
            at = link
            while at:
                if at - 1 in self.moving:
                    self.carries[list(self.moving).index(at - 1), link] = 1
                at = self.parent[at - 1]
        self.base = index[robot.get("base", self.links[0])]
        self._add_skins(robot["skins"], index, kinds)

    def _add_skins(self, skins, index, kinds):
        self.skins = [skin["name"] for skin in skins]
        frames = [skin.get("frame_id", skin["name"] + "_skin") for skin in skins]
        self.topics = [skin.get("namespace", "/" + skin["name"]) + "/contacts" for skin in skins]
        self.timeouts = np.array([skin.get("timeout", 0.2) for skin in skins])
        self.link, poses, tops, top_from_link = [], [], [], []
        for skin, frame in zip(skins, frames):
            mount = skin.get("mount", {"parent": frame, "translation": [0, 0, 0], "rpy": [0, 0, 0]})
            link, climbed = index[mount["parent"]], np.eye(4)
            self.link.append(link)
            poses.append(transform(mount["translation"], mount["rpy"]))
            while link and kinds[link - 1] == "fixed":
                climbed, link = self.origin[link - 1] @ climbed, self.parent[link - 1]
            tops.append(link)
            top_from_link.append(climbed)
        self.link = np.array(self.link)
        self.touched_links = np.array(list(dict.fromkeys(self.link)))
        # Skins that are rigidly connected are a group, and a slot of it each.
        groups = list(dict.fromkeys(tops))
        self.group = np.array([groups.index(top) for top in tops])
        self.slot = np.array([tops[:i].count(top) for i, top in enumerate(tops)])
        self.slots = int(self.slot.max()) + 1
        self.top_from_skin = np.array(top_from_link) @ np.array(poses)
        self.link_from_top = inverse(np.array(top_from_link))
        self.skin_at = np.zeros((len(groups), self.slots), int)
        self.skin_at[self.group, self.slot] = np.arange(len(skins))

    def poses(self, q):
        """Transforms (links, 4, 4) of the links in the body frame at joint positions q."""
        local = self.origin.copy()
        motion = self.unmoved[: len(q)].copy()
        angle = np.where(self.slides, 0.0, q)[:, None, None]
        motion[:, :3, :3] += np.sin(angle) * self.skew + (1 - np.cos(angle)) * self.square
        motion[:, :3, 3] = np.where(self.slides, q, 0.0)[:, None] * self.axis
        local[self.moving] = self.origin[self.moving] @ motion
        world = self.unmoved.copy()
        for of_level in self.levels:
            world[of_level + 1] = world[self.parent[of_level]] @ local[of_level]
        return world if self.base == 0 else inverse(world[self.base]) @ world

    def torques(self, world, force, torque):
        """J^T f of wrenches (links, 3) about the origin of the body frame, by the joints that carry the links."""
        joints = world[self.moving + 1]
        axis = apply(joints[:, :3, :3], self.axis)
        force, torque = self.carries @ force, self.carries @ torque
        turning = np.sum(axis * (torque - cross(joints[:, :3, 3], force)), axis=1)
        return np.where(self.slides, np.sum(axis * force, axis=1), turning)


class Joints:
    """Joint states, interpolated."""

    def __init__(self, robot, assume_rest):
        self.robot = robot
        self.index = {name: i for i, name in enumerate(robot.joints)}
        self.start = robot.rest if assume_rest else np.full(len(robot.joints), np.nan)
        self.stamps, self.positions = [], []
        self.columns = (None, None)

    def take(self, stamp, names, positions):
        if self.stamps and stamp <= self.stamps[-1]:
            return
        if names != self.columns[0]:
            known = [(i, self.index[name]) for i, name in enumerate(names) if name in self.index]
            self.columns = (names, np.array(known, int).reshape(-1, 2).T)
        q = (self.positions[-1] if self.positions else self.start).copy()
        source, target = self.columns[1]
        q[target] = np.asarray(positions)[source]
        self.stamps.append(stamp)
        self.positions.append(q)
        if self.stamps[0] < stamp - 2 * JOINT_SPAN * 1e9:
            kept = bisect_left(self.stamps, stamp - int(JOINT_SPAN * 1e9))
            del self.stamps[:kept], self.positions[:kept]

    def at(self, stamp):
        """Positions at a stamp; NaN where they are not known."""
        stamps, positions = self.stamps, self.positions
        if not stamps:
            return self.start
        after = bisect_left(stamps, stamp)
        if after < len(stamps) and stamps[after] == stamp:
            return positions[after]
        unknown = np.full_like(self.start, np.nan)
        if after == 0:
            return unknown
        since = (stamp - stamps[after - 1]) * 1e-9
        if after == len(stamps):
            return positions[-1] if since <= JOINT_HOLD else unknown
        whole = (stamps[after] - stamps[after - 1]) * 1e-9
        if whole > JOINT_GAP:
            return unknown
        way = positions[after] - positions[after - 1]
        way = np.where(self.robot.wraps, (way + np.pi) % (2 * np.pi) - np.pi, way)
        return positions[after - 1] + way * (since / whole)
