"""Draws docs/live.svg from what a running `dermis demo` sends: python3 docs/picture.py (needs eclipse-zenoh)

The picture shows one frame in which something presses: readings of the 25 barometers as colours, the contact that the node found, and
the line that `dermis watch` prints of it.
"""

import json
import math
import threading
import time
import tomllib

import zenoh

SKIN = tomllib.load(open("launch/skins/baro-grid.toml", "rb"))
frames, done, lock = {}, threading.Event(), threading.Lock()
stamps = []


def hear(sample):
    kind = str(sample.key_expr).rsplit("/", 1)[-1]
    message = json.loads(sample.payload.to_string())
    with lock:
        frame = frames.setdefault(message["sequence"], {})
        frame[kind] = message
        if kind == "contacts":
            stamps.append(time.monotonic())
        contacts = frame.get("contacts", {}).get("contacts", [])
        if len(frame) == 2 and contacts and abs(contacts[0]["force"]["z"]) > 0.4 and len(stamps) > 300:
            frames["found"] = frame
            done.set()


with zenoh.open(zenoh.Config.from_file("launch/loopback.json5")) as session:
    subscribers = [session.declare_subscriber(f"dermis/*/*/{kind}", hear) for kind in ("contacts", "taxels")]
    if not done.wait(60.0):
        raise SystemExit("no frame with a contact within 60 s: run `dermis demo` beside this")

array, taxels = frames["found"]["contacts"], frames["found"]["taxels"]
rate = (len(stamps) - 1) / (stamps[-1] - stamps[0])
contact = array["contacts"][0]
x, y, force = contact["position"]["x"] * 1e3, contact["position"]["y"] * 1e3, -contact["force"]["z"]

# viridis, at nine values.
COLOURS = [(68, 1, 84), (71, 45, 123), (59, 82, 139), (44, 114, 142), (33, 145, 140), (40, 174, 128), (94, 201, 98), (173, 220, 48), (253, 231, 37)]


def colour(share):
    at = max(0.0, min(1.0, share)) * (len(COLOURS) - 1)
    i = min(int(at), len(COLOURS) - 2)
    return "#" + "".join(f"{round(a + (b - a) * (at - i)):02x}" for a, b in zip(COLOURS[i], COLOURS[i + 1]))


SCALE, LEFT, TOP = 8.0, 30.0, 46.0  # [px/mm], [px]
SIDE = SKIN["surface"]["size"][0] * 1e3 * SCALE
px = lambda v: LEFT + SIDE / 2 + v * SCALE
py = lambda v: TOP + SIDE / 2 - v * SCALE
most = max(max(taxels["values"]), 1.0)
out = ['<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 860 370" font-family="sans-serif" font-size="13">']
out.append("<title>One frame of the demo: readings of 25 barometers, and the contact that the node found</title>")
out.append('<rect x="0" y="0" width="860" height="370" fill="#ffffff"/>')
out.append(f'<text x="{LEFT}" y="30" font-weight="bold" fill="#1d3550">baro-grid, 34 × 34 mm, seen from above</text>')
out.append(f'<rect x="{LEFT}" y="{TOP}" width="{SIDE:.0f}" height="{SIDE:.0f}" rx="6" fill="#eef3f8" stroke="#38577a"/>')
for taxel, value in zip(SKIN["taxels"], taxels["values"]):
    a, b = taxel["position"][0] * 1e3, taxel["position"][1] * 1e3
    out.append(f'<circle cx="{px(a):.1f}" cy="{py(b):.1f}" r="11" fill="{colour(value / most)}"/>')
out.append(f'<circle cx="{px(x):.1f}" cy="{py(y):.1f}" r="16" fill="none" stroke="#d1352b" stroke-width="2.5"/>')
for dx, dy in ((-22, 0), (10, 0), (0, -22), (0, 10)):
    ex, ey = dx + (12 if dx else 0), dy + (12 if dy else 0)
    out.append(f'<path d="M{px(x) + dx:.1f},{py(y) + dy:.1f}L{px(x) + ex:.1f},{py(y) + ey:.1f}" stroke="#d1352b" stroke-width="2.5"/>')
bar = TOP + SIDE + 12
stops = "".join(f'<stop offset="{i / 8}" stop-color="{colour(i / 8)}"/>' for i in range(9))
out.append(f'<defs><linearGradient id="scale">{stops}</linearGradient></defs>')
out.append(f'<rect x="{LEFT + 60}" y="{bar:.0f}" width="140" height="10" fill="url(#scale)"/>')
out.append(f'<text x="{LEFT}" y="{bar + 10:.0f}" font-size="11" fill="#444">0 kPa</text>')
out.append(f'<text x="{LEFT + 210}" y="{bar + 10:.0f}" font-size="11" fill="#444">{most / 1e3:.1f} kPa</text>')
out.append(f'<text x="360" y="30" font-weight="bold" fill="#1d3550">$ dermis watch</text>')
out.append('<rect x="360" y="46" width="470" height="92" rx="6" fill="#1e2430"/>')
lines = [
    f"baro-grid    {rate:.1f} frames/s",
    "  track    x / mm    y / mm     F / N  confidence",
    f"  {contact['track_id']:5}  {x:8.2f}  {y:8.2f}  {force:8.3f}  {contact['confidence']:10.2f}",
]
for i, line in enumerate(lines):
    out.append(f'<text x="376" y="{74 + 22 * i}" font-family="monospace" font-size="14" xml:space="preserve" fill="#e6e6e6">{line}</text>')
sigma = math.sqrt(max(contact["position_covariance"][0], contact["position_covariance"][4])) * 1e3
facts = [
    ("device", "a physics model behind a pseudo-terminal, 20 Pa of noise"),
    ("node", "tare, network, forward model: the same as with hardware"),
    ("red", f"the contact that was found, standard deviation {sigma:.2f} mm"),
    ("colour", "pressure that each barometer reads, 5 mm below the surface"),
]
for i, (word, text) in enumerate(facts):
    out.append(f'<text x="360" y="{176 + 26 * i}" font-weight="bold" fill="#38577a">{word}</text>')
    out.append(f'<text x="424" y="{176 + 26 * i}" fill="#444">{text}</text>')
out.append("</svg>")
open("docs/live.svg", "w").write("\n".join(out) + "\n")
print("docs/live.svg:", lines[2])
