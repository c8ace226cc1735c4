"""Measures the fusion of `body_fusion.py` in one process.

    fusion_peer.py DATA.json SECONDS PROCESSES

DATA holds three kinds of scenes, each with a URDF and a robot file: `agreement`, with what our fusion makes of it; `millisecond`,
in which each frame has a report of every skin; `growth`, with more and more contacts on one skin. An update is the reports of a
frame worked in together, and what the body feels after that: contacts, wrenches and joint torques. Nothing is published, and
messages are arrays before the clock starts. With `agreement` alone nothing is measured. Printed as one line of JSON: microseconds
an update, SECONDS for each scene, and the largest deviation from ours, as a share of each value. One process in any case.
"""

import json
import sys
import time
import tomllib

import numpy as np
from body_fusion import BodyFusion, Report
from body_robot import Robot


def robot_of(scene):
    return Robot(scene["urdf"], tomllib.loads(scene["robot"]))


def report_of(data):
    rows = np.array(data["contacts"], float).reshape(-1, 10)
    ids, count = rows[:, 0].astype(int), len(rows)
    tile = lambda values: np.tile(np.reshape(values, (3, 3)), (count, 1, 1))  # noqa: E731
    covariances = tile(data["position_covariance"]), tile(data["force_covariance"])
    components = np.full(count, data["components"])
    place, normal, force = rows[:, 1:4], rows[:, 4:7], rows[:, 7:10]
    return Report(data["skin"], data["stamp"], ids, place, normal, force, *covariances, components)


def deviation(scene):
    """The largest difference from what is expected of a scene, as a share of each value; infinite where contacts differ."""
    robot = robot_of(scene)
    fusion = BodyFusion(robot)
    for event in scene["events"]:
        if "names" in event:
            fusion.joints.take(event["stamp"], event["names"], event["positions"])
        else:
            fusion.take([report_of(event)], event["stamp"])
    out = fusion.state(scene["now"])
    found = {}
    for k in range(len(out["id"])):
        felt = [
            (int(skin), int(called))
            for skin, called, feels in zip(robot.skin_at[out["group"][k]], out["called"][k], out["feels"][k])
            if feels
        ]
        roots = [np.sqrt(np.diag(out[key][k])) for key in ("position_covariance", "force_covariance", "velocity_covariance")]
        q = out["body_quaternion"][k]
        values = [out[key][k] for key in ("position", "normal", "force", "velocity", "body_position")]
        found[tuple(sorted(felt))] = np.concatenate([*values, q * np.sign(q[3]), *roots])
    expected = {tuple(map(tuple, c["felt"])): np.array(c["values"]) for c in scene["contacts"]}
    if found.keys() != expected.keys() or len(found) != len(out["id"]):
        print(f"contacts are of {sorted(found)}, not of {sorted(expected)}", file=sys.stderr)
        return float("inf")
    pairs = [(found[key], expected[key]) for key in expected]
    for k, link in enumerate(out["links"]):
        values = [out[key][k] for key in ("link_force", "link_torque", "body_force", "body_torque")]
        pairs.append((np.concatenate(values), np.array(scene["wrenches"][robot.links[link]])))
    pairs.append((np.concatenate([out["net_force"], out["net_torque"]]), np.array(scene["net"])))
    pairs.append((out["joint_torques"], np.array([scene["torques"][joint] for joint in robot.joints])))
    return max(float(np.max(np.abs(a - b) / (1e-3 + np.abs(b)))) for a, b in pairs)


def measure(scene, seconds):
    """Microseconds of each update, of a fusion that begins anew with each repetition of the scene."""
    robot = robot_of(scene)
    frames = [[report_of(report) for report in frame] for frame in scene["frames"]]
    times, end = [], time.perf_counter() + seconds
    while not times or time.perf_counter() < end:
        fusion = BodyFusion(robot, assume_rest=True)
        for k, frame in enumerate(frames):
            begun = time.perf_counter()
            fusion.take(frame, frame[0].stamp)
            out = fusion.state(frame[0].stamp)
            # The first frames are those in which all contacts begin.
            if k >= 10:
                times.append((time.perf_counter() - begun) * 1e6)
        if len(out["id"]) != sum(len(report.ids) for report in frames[-1]):
            sys.exit(f"{len(out['id'])} contacts remain of those of the last frame")
    mean, p50, p99, longest = np.mean(times), *np.percentile(times, [50, 99, 100])
    return {"mean": mean, "p50": p50, "p99": p99, "max": longest}


def main():
    with open(sys.argv[1]) as file:
        data = json.load(file)
    seconds = float(sys.argv[2])
    found = deviation(data["agreement"])
    answer = {"name": "numpy and scipy", "deviation": found if np.isfinite(found) else 1e9}
    if "millisecond" in data:
        answer["millisecond_us"] = measure(data["millisecond"], seconds)
        growth = []
        for scene in data["growth"]:
            times = measure(scene, seconds)
            growth.append({"contacts": scene["contacts"], "update_us": times["p50"], "p99_us": times["p99"]})
        answer["contacts"] = growth
    print(json.dumps([answer]))


if __name__ == "__main__":
    main()
