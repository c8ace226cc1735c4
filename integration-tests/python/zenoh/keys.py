"""Counts what a bridge sends. Usage: keys.py ROBOT [CONFIG]; prints one JSON object a second: by key below the robot, the number
of messages, of those with contacts, and the skins that they name. CONFIG is the text of a zenoh configuration."""
import collections, json, sys, threading, time
import zenoh

robot = sys.argv[1]
config = zenoh.Config.from_json5(sys.argv[2]) if len(sys.argv) > 2 else zenoh.Config()
session = zenoh.open(config)
lock, seen = threading.Lock(), collections.defaultdict(lambda: {"n": 0, "touched": 0, "skins": []})


def take(sample):
    _, name, key = str(sample.key_expr).split("/", 2)
    if name.split("@")[0] != robot:
        return
    value = json.loads(sample.payload.to_string())
    with lock:
        entry = seen[key]
        entry["n"] += 1
        entry["touched"] += bool(value.get("contacts"))
        if value.get("skin") not in entry["skins"]:
            entry["skins"].append(value.get("skin"))


subscriber = session.declare_subscriber("dermis/*/**", take)
while True:
    time.sleep(0.5)
    with lock:
        print(json.dumps(seen), flush=True)
