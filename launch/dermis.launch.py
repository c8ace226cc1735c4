"""
A launch file of dermis, started from ROS 2 launch: several skins with their bridge and recorder.

    ros2 launch /path/to/dermis/launch/dermis.launch.py file:=robot.launch.yaml arguments:="left:=/dev/ttyACM0"

`dermis launch` keeps its processes running and stops them in order by itself, so that ROS 2 launch gives it time. The program
`dermis` is looked for in $DERMIS, then on PATH.
"""

import os

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration

ARGUMENTS = [
    ('file', '', 'launch file of dermis'),
    ('arguments', '', 'its arguments name:=value, with spaces between them'),
    ('log_dir', '', 'folder of one log file for each process'),
    ('patience', '20', '[s] that its processes get to stop'),
    ('program', os.environ.get('DERMIS', 'dermis'), 'the program dermis'),
]


def start(context):
    """Make the process, now that the arguments are known."""
    given = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    if not given['file']:
        raise RuntimeError('dermis.launch.py: give file:=…')
    command = [given['program'], 'launch', given['file'], *given['arguments'].split()]
    if given['log_dir']:
        command += ['--log-dir', given['log_dir']]
    return [
        ExecuteProcess(
            cmd=command,
            name='dermis',
            output='screen',
            sigterm_timeout=given['patience'],
            sigkill_timeout=given['patience'],
        )
    ]


def generate_launch_description():
    """Declare the arguments, then start the program."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text) for name, default, text in ARGUMENTS
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])
