"""Compares what a node published with what NumPy makes of the same frames: python check.py BAG fit.npz"""

import sys

import numpy as np
from mcap_ros2.reader import read_ros2_messages

bag, weights = sys.argv[1:3]
fit = np.load(weights)
frames, answers = {}, {}
for message in read_ros2_messages(bag):
    ros = message.ros_msg
    if message.channel.topic.endswith("taxels") and not any(ros.flags):
        frames[ros.sequence] = np.array(ros.values, np.float32)
    elif message.channel.topic.endswith("contacts") and len(ros.contacts) == 1:
        contact = ros.contacts[0]
        answers[ros.sequence] = (contact.position.x, contact.position.y, -contact.force.z)
compared, worst = 0, 0.0
for sequence in sorted(frames.keys() & answers.keys()):
    x, y, force = frames[sequence] / np.float32(1000.0) @ fit["matrix"] + fit["bias"]
    # Positions beyond the rim are moved onto it, and nothing pulls.
    if max(abs(x), abs(y)) < 17.0 and force > 0.0:
        got = np.array(answers[sequence])
        worst = max(worst, np.abs(got - (x * 1e-3, y * 1e-3, force)).max())
        compared += 1
print("SAME", compared, worst)
assert compared >= 50, f"only {compared} frames could be compared of {len(frames)} frames and {len(answers)} answers"
assert worst < 1e-5, f"differs by {worst} m or N"
