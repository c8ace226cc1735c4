"""A router on a given endpoint, until it is killed."""
import json, sys, time
import zenoh

config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", json.dumps([sys.argv[1]]))
config.insert_json5("scouting/multicast/enabled", "false")
with zenoh.open(config):
    print("READY", flush=True)
    time.sleep(600)
