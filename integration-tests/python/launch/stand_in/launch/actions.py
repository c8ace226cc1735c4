"""See the package. Arguments that the real actions do not take are refused here too."""


class DeclareLaunchArgument:
    def __init__(self, name, *, default_value=None, description=None, choices=None):
        self.name = name
        self.default_value = default_value

    def execute(self, context):
        if self.name not in context.launch_configurations:
            if self.default_value is None:
                raise RuntimeError(f'required launch argument {self.name!r} was not provided')
            context.launch_configurations[self.name] = self.default_value


class OpaqueFunction:
    def __init__(self, *, function, args=None, kwargs=None):
        self.function = function

    def execute(self, context):
        return self.function(context)


class ExecuteProcess:
    def __init__(
        self, *, cmd, name=None, output='log', additional_env=None, respawn=False, respawn_delay=None,
        sigterm_timeout='5', sigkill_timeout='5',
    ):
        assert all(isinstance(word, str) for word in cmd), cmd
        assert respawn_delay is None or isinstance(respawn_delay, float)
        assert float(sigterm_timeout) > 0 and float(sigkill_timeout) > 0
        self.cmd = cmd
