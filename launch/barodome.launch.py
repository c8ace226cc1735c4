"""
The node of one skin, for people who start their robot with ROS 2 launch.

    ros2 launch /path/to/dermis/launch/barodome.launch.py skin:=palm.toml source:=serial:///dev/ttyACM0

From a launch file of your own:

    IncludeLaunchDescription(
        PythonLaunchDescriptionSource('/path/to/dermis/launch/barodome.launch.py'),
        launch_arguments={'skin': palm, 'source': 'serial:///dev/ttyACM0', 'namespace': 'left'}.items(),
    )

The node is no ament package: it is run by the program `dermis`, which is looked for in $DERMIS, then on PATH. It needs the
package `launch` only, and follows PushRosNamespace of launch_ros. `dermis launch` starts several skins at once; see
dermis.launch.py.
"""

import os

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration

ARGUMENTS = [
    ('sensor', 'barodome', 'sensor family of the skin: the command of `dermis` that reads it, e.g. hapdef'),
    ('config', '', 'configuration file of the node, in place of skin and source'),
    ('skin', '', 'skin description file'),
    ('source', '', 'where the bytes come from, e.g. serial:///dev/ttyACM0?baud=921600'),
    ('model', '', 'folders of model bundles, with spaces between them'),
    ('name', '', 'node name; that of the skin where empty'),
    ('instance', '', 'name of the device, unique on the robot; from namespace and name where empty'),
    ('frame_id', '', 'coordinate frame of the device; that of the skin file where empty'),
    ('mount', '', 'where it is fixed: parent,x,y,z and roll,pitch,yaw or a quaternion x,y,z,w'),
    ('namespace', '', 'ROS namespace, below the one that is pushed'),
    ('remap', '', 'remappings from:=to, with spaces between them'),
    ('backend', 'ros2', 'ros2: the ROS that is sourced; hiroz: the wire of rmw_zenoh, without ROS'),
    ('log', 'info', 'least level of log lines'),
    ('respawn', 'true', 'whether it is started again where it ends'),
    ('respawn_delay', '2.0', '[s] before it is started again'),
    ('program', os.environ.get('DERMIS', 'dermis'), 'the program dermis'),
]


def joined(pushed, namespace):
    """Join a namespace to the one that is pushed, as launch_ros does."""
    if namespace.startswith('/'):
        return namespace
    return '/' + '/'.join(part for part in (pushed.strip('/'), namespace.strip('/')) if part)


def start(context):
    """Make the process, now that the arguments are known."""
    given = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    command = [given['program'], given['sensor'], '--backend', given['backend']]
    if given['config']:
        command += ['--config', given['config']]
    elif given['skin'] and given['source']:
        command += ['--skin', given['skin'], '--source', given['source']]
    else:
        raise RuntimeError('barodome.launch.py: give skin:=… and source:=…, or config:=…')
    for model in given['model'].split():
        command += ['--model', model]
    if given['name']:
        command += ['--name', given['name']]
    namespace = joined(context.launch_configurations.get('ros_namespace', ''), given['namespace'])
    if namespace != '/':
        command += ['--namespace', namespace]
    for option in ('instance', 'frame_id', 'mount'):
        if given[option]:
            command += ['--' + option.replace('_', '-'), given[option]]
    for rule in given['remap'].split():
        command += ['--remap', rule]
    return [
        ExecuteProcess(
            cmd=command,
            name=given['name'] or given['sensor'],
            output='screen',
            additional_env={'DERMIS_LOG': given['log']},
            respawn=given['respawn'].lower() in ('true', '1', 'yes'),
            respawn_delay=float(given['respawn_delay']),
        )
    ]


def generate_launch_description():
    """Declare the arguments, then start the node."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text) for name, default, text in ARGUMENTS
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])
