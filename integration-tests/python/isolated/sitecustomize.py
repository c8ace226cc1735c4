"""Keeps Python's zenoh within one test: zenoh.Config() takes what ZENOH_CONFIG_OVERRIDE says, as rmw_zenoh and dermis do.

Python imports this by itself before any script, where its folder is on PYTHONPATH; the scripts stay as users would write them.
"""
import os

overrides = [e.partition("=") for e in os.environ.get("ZENOH_CONFIG_OVERRIDE", "").split(";") if "=" in e]
try:
    import zenoh
except ImportError:
    zenoh = None
if zenoh and overrides:
    plain = zenoh.Config

    def apply(config):
        for key, _, value in overrides:
            config.insert_json5(key.strip(), value.strip())
        return config

    def overridden():
        return apply(plain())

    overridden.from_file = lambda path: apply(plain.from_file(path))
    overridden.from_json5 = lambda text: apply(plain.from_json5(text))
    zenoh.Config = overridden
