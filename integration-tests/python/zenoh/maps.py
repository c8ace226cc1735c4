"""Waits for maps of a skin that is touched. Usage: maps.py SKIN; prints the name and the number of values of each."""
import json, sys, time
import zenoh

skin, wanted = sys.argv[1], {"displacement_map": "displacements", "force_map": "forces"}
with zenoh.open(zenoh.Config()) as session:
    latest = {}

    def keep(sample):
        latest[str(sample.key_expr).split("/")[-1]] = json.loads(sample.payload.to_string())

    subscribers = [session.declare_subscriber(f"dermis/*/{skin}/{name}", keep) for name in wanted]
    for name, values in wanted.items():
        while max(latest.get(name, {}).get(values) or [0]) <= 0:
            time.sleep(0.1)
        print(name, len(latest[name][values]), flush=True)
