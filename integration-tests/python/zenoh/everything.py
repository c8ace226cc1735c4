"""Holds the bridge to what a zenoh user expects. Usage: everything.py MODE [ENDPOINT]; prints OK lines, then DONE."""
import json, os, sys, time
import zenoh

mode, endpoints = sys.argv[1], sys.argv[2:]
# Domains other than 0 stand in the key.
domain = os.environ.get("ROS_DOMAIN_ID", "0")
robot = "demo" if domain == "0" else f"demo@{domain}"
config = zenoh.Config()
config.insert_json5("mode", json.dumps(mode))
if endpoints:
    config.insert_json5("connect/endpoints", json.dumps(endpoints))
    config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
deadline = time.time() + 40


def wait(what, question):
    while time.time() < deadline:
        answer = question()
        if answer:
            print("OK", what, flush=True)
            return answer
        time.sleep(0.1)
    sys.exit(f"no {what}")


samples = []
subscriber = session.declare_subscriber("dermis/*/*/contacts", samples.append)
wait("stream", lambda: len(samples) > 20)
assert all(str(s.encoding) == "application/json" for s in samples), samples[0].encoding
arrays = [json.loads(s.payload.to_string()) for s in samples]
assert all(str(s.key_expr) == f"dermis/{robot}/baro-grid/contacts" for s in samples)
assert all(a["skin"] == "baro-grid" for a in arrays)
sequences = [a["sequence"] for a in arrays]
assert sequences == sorted(sequences), sequences
wait("contact", lambda: any(json.loads(s.payload.to_string())["contacts"] for s in samples[-200:]))

present = wait("liveliness", lambda: [str(r.ok.key_expr) for r in session.liveliness().get("dermis/*/*") if r.ok])
assert present == [f"dermis/{robot}/baro-grid"], present


def latest(key):
    replies = [r.ok for r in session.get(key) if r.ok]
    return [(str(r.key_expr), str(r.encoding), r.payload.to_string()) for r in replies]


[(key, encoding, text)] = wait("geometry by get", lambda: latest("dermis/*/*/skin_geometry"))
geometry = json.loads(text)
assert encoding == "application/json" and len(geometry["taxels"]) == 25, key
# Frames carry a number for their channels; the bridge adds the names that the geometry holds.
named = lambda: [f for _, _, t in latest("dermis/*/*/taxels") if "channels" in (f := json.loads(t))]
[frame] = wait("names of channels", named)
assert frame["channels"] == geometry["channels"] and frame["unit"] == "Pa", frame
assert frame["layout_id"] == geometry["layout_id"] and len(frame["values"]) == 25, frame
assert json.loads(latest("dermis/*/*/contacts")[0][2])["sequence"] >= sequences[0]
schemas = wait("schemas", lambda: latest("dermis/*/schemas/**"))
assert any(k.endswith("dermis_msgs/msg/ContactArray") and "Contact[] contacts" in t for k, _, t in schemas)
session.close()
print("DONE", flush=True)
