"""As much of the API of ROS 2 launch as our launch files use, for machines where that package is not installed."""


class LaunchContext:
    def __init__(self):
        self.launch_configurations = {}


class LaunchDescription:
    def __init__(self, entities):
        self.entities = list(entities)
