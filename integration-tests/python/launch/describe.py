"""
Print the commands that a ROS 2 launch file would run, one JSON list a line: describe.py FILE NAME:=VALUE…

The first line says whether the real package `launch` evaluated it, or the stand-in beside this file.
"""

import importlib.util
import json
import os
import sys

try:
    import launch
except ImportError:
    sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), 'stand_in'))
    import launch

from launch.actions import ExecuteProcess

real = 'stand_in' not in launch.__file__
print('launch' if real else 'stand-in', flush=True)
path, *arguments = sys.argv[1:]
spec = importlib.util.spec_from_file_location('described', path)
module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)

context = launch.LaunchContext()
context.launch_configurations.update(argument.split(':=', 1) for argument in arguments)
left = list(module.generate_launch_description().entities)
while left:
    entity = left.pop(0)
    if isinstance(entity, ExecuteProcess):
        words = entity.cmd
        if real:
            from launch.utilities import perform_substitutions

            words = [perform_substitutions(context, word) for word in words]
        print(json.dumps(words), flush=True)
    else:
        left = list(entity.execute(context) or []) + left
