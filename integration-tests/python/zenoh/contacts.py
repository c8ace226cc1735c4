"""Prints contacts from JSON over zenoh: what README.md shows, and nothing else."""
import json, sys, time
import zenoh

def show(sample):
    for c in json.loads(sample.payload.to_string())["contacts"]:
        print("contact", c["position"]["x"], c["position"]["y"], c["force"]["z"], flush=True)

with zenoh.open(zenoh.Config.from_file("launch/loopback.json5")) as session:
    subscriber = session.declare_subscriber("dermis/*/*/contacts", show)
    time.sleep(float(sys.argv[1]) if len(sys.argv) > 1 else 1e9)
