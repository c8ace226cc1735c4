"""Commands a skin as a client that knows no ROS. Usage: commands.py ROBOT OTHER: two bridges, of which the second only shows.
Prints OK lines, then DONE."""
import json, sys, time
import zenoh

session = zenoh.open(zenoh.Config())
deadline = time.time() + 50
latest = {}


def keep(sample):
    latest["contacts"] = json.loads(sample.payload.to_string())




def wait(what, question):
    while time.time() < deadline:
        answer = question()
        if answer:
            print("OK", what, flush=True)
            return answer
        time.sleep(0.05)
    sys.exit(f"no {what}; the last contacts were {latest}")


def ask(selector, payload=None):
    replies = [r.ok for r in session.get(selector, payload=payload, timeout=30.0) if r.ok]
    return {str(r.key_expr): (str(r.encoding), r.payload.to_string()) for r in replies}


def command(word, payload=None):
    replies = ask(f"{key}/{word}", payload)
    [(replied, (encoding, text))] = replies.items()
    assert replied.endswith(f"/{word}") and "*" not in replied, replied
    assert encoding == "application/json", encoding
    return json.loads(text)


# Where there are several ROS domains on a machine, the robot's name has the domain behind it.
arm, window = sys.argv[1:]


def skins():
    found = [str(r.ok.key_expr) for r in session.liveliness().get("dermis/*/*") if r.ok]
    return [k for k in found if k.split("/")[1].split("@")[0] == arm]


[key] = wait("skin", skins)
subscriber = session.declare_subscriber(f"{key}/contacts", keep)
wait("contacts", lambda: "contacts" in latest)
wait("commands", lambda: ask(f"{key}/set_enabled"))
# Whoever looks around gets what there is, and commands nothing.
around = ask("dermis/**")
assert any(k.endswith("/contacts") for k in around), list(around)
assert not any(k.endswith(("/tare", "/set_enabled", "/load_model")) for k in around), list(around)

tared = command("tare")
assert tared["success"] and tared["message"].startswith("tared over"), tared
print("OK tare:", tared["message"], flush=True)

assert command("set_enabled", "false")["success"]
wait("a skin that is switched off", lambda: latest["contacts"]["status"] == 2 and "set_enabled" in latest["contacts"]["status_text"])
assert command("set_enabled", '{"data": true}')["success"]
wait("a skin that is switched on", lambda: latest["contacts"]["status"] == 0)
for wrong in (None, "maybe"):
    refused = command("set_enabled", wrong)
    assert not refused["success"] and "takes true or false" in refused["message"], refused

refused = command("load_model", json.dumps("no/such/bundle"))
assert not refused["success"] and refused["message"], refused
print("OK load_model:", refused["message"], flush=True)
# The other bridge shows the same skin, and takes no commands.
window = key.replace(arm, window)
wait("the other bridge", lambda: ask(f"{window}/contacts"))
for word in ("tare", "set_enabled", "load_model"):
    assert not ask(f"{window}/{word}"), word
session.close()
print("DONE", flush=True)
