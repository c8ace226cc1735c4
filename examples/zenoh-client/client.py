"""Contacts of every skin as JSON over zenoh: python3 client.py [--tare SKIN] [--seconds S] [--config FILE]"""

import argparse
import json
import time

import zenoh

STATUS = {0: "OK", 1: "DEGRADED", 2: "STALE", 3: "UNCALIBRATED", 4: "FAULT"}

arguments = argparse.ArgumentParser()
arguments.add_argument("--tare", metavar="SKIN", help="tare this skin first; nothing may touch it")
arguments.add_argument("--seconds", type=float, default=1e9)
arguments.add_argument("--config", default="launch/loopback.json5")
options = arguments.parse_args()
last = {}


def show(sample):
    _, robot, skin, _ = str(sample.key_expr).split("/")
    array = json.loads(sample.payload.to_string())
    status = STATUS.get(array["status"], "?")
    if last.get((robot, skin)) != status:
        last[robot, skin] = status
        print("status", robot, skin, status, array["status_text"], flush=True)
    for contact in array["contacts"]:
        at, force = contact["position"], contact["force"]
        print("contact", skin, contact["track_id"], at["x"], at["y"], at["z"], force["z"], flush=True)


with zenoh.open(zenoh.Config.from_file(options.config)) as session:
    if options.tare:
        deadline = time.monotonic() + 10.0
        answered = False
        while not answered and time.monotonic() < deadline:
            for reply in session.get(f"dermis/*/{options.tare}/tare", timeout=30.0):
                answer = json.loads((reply.ok or reply.err).payload.to_string())
                print("tare", answer["success"], answer["message"], flush=True)
                answered = True
            time.sleep(0.2)
    subscriber = session.declare_subscriber("dermis/*/*/contacts", show)
    time.sleep(options.seconds)
