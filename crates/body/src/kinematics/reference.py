"""Poses of the demo robot's links as yourdfpy computes them: python reference.py > reference.json (pip install yourdfpy)."""

import json
import pathlib
import random

import yourdfpy

urdf = pathlib.Path(__file__).parents[4] / "launch" / "robots" / "humanoid.urdf"
robot = yourdfpy.URDF.load(str(urdf), load_meshes=False, build_scene_graph=True)
random.seed(20)
cases = []
for case in range(5):
    joints = {name: 0.0 if case == 0 else round(random.uniform(-1.2, 1.2), 6) for name in robot.actuated_joint_names}
    robot.update_cfg(joints)
    links = {link: robot.get_transform(link, "pelvis")[:3].round(9).tolist() for link in robot.link_map}
    cases.append({"joints": joints, "links": links})
print(json.dumps(cases))
