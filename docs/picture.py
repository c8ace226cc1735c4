"""Draws docs/live.svg from a run of `dermis demo`: cargo xtask docs --pictures

By hand: python3 docs/picture.py DERMIS, where DERMIS is the program; needs eclipse-zenoh. The demo runs in a terminal of its own. The
picture shows one frame in which something presses: readings of the 25 barometers as colours, the contact that the node found, and the
table that the demo drew of that frame, as it stood in the terminal.
"""

import collections
import fcntl
import html
import json
import math
import os
import pty
import re
import struct
import subprocess
import sys
import termios
import threading
import time
import tomllib

import zenoh

SKIN = tomllib.load(open("launch/skins/baro-grid.toml", "rb"))
LEAST_N, WARM_S, PATIENCE_S = 0.4, 5.0, 60.0
# A table is drawn over the last one: so many lines up, and clear what is below.
REDRAWN = re.compile(rb"\x1b\[\d+A\x1b\[J")
ROW = re.compile(r"^ +(\d+) +(-?[\d.]+) +(-?[\d.]+) +(-?[\d.]+) +[\d.]+$")
# Contacts and taxels of the newest frames, by their sequence.
frames, lock = collections.OrderedDict(), threading.Lock()


def hear(sample):
    message = json.loads(sample.payload.to_string())
    with lock:
        frames.setdefault(message["sequence"], {})[str(sample.key_expr).rsplit("/", 1)[-1]] = message
        while len(frames) > 200:
            frames.popitem(last=False)


def shown(lines):
    """The frame with both kinds of messages whose one contact is what the table shows; None where there is none."""
    rows = [row for row in map(ROW.match, lines) if row]
    if len(rows) != 1 or float(rows[0][4]) < LEAST_N:
        return None
    with lock:
        for frame in reversed(frames.values()):
            contacts = frame.get("contacts", {}).get("contacts", [])
            if len(frame) == 2 and len(contacts) == 1:
                at = contacts[0]["position"]
                if rows[0].groups()[:3] == (str(contacts[0]["track_id"]), f"{at['x'] * 1e3:.2f}", f"{at['y'] * 1e3:.2f}"):
                    return frame
    return None


def watch(terminal):
    """The lines of a table, and its frame."""
    text, begun = b"", time.monotonic()
    while time.monotonic() < begun + PATIENCE_S:
        try:
            text += os.read(terminal, 65536)
        except OSError:
            raise SystemExit("the demo ended before a contact was shown") from None
        *whole, text = REDRAWN.split(text)
        if whole and time.monotonic() > begun + WARM_S:
            lines = whole[-1].decode().replace("\r", "").strip("\n").split("\n")
            if frame := shown(lines):
                return lines, frame
    raise SystemExit(f"no table with a contact of {LEAST_N} N and its frame within {PATIENCE_S:.0f} s")


terminal, inside = pty.openpty()
fcntl.ioctl(inside, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 120, 0, 0))
with zenoh.open(zenoh.Config.from_file("launch/loopback.json5")) as session:
    subscribers = [session.declare_subscriber(f"dermis/demo/{SKIN['name']}/{kind}", hear) for kind in ("contacts", "taxels")]
    demo = subprocess.Popen([sys.argv[1], "demo"], stdout=inside, env={**os.environ, "ROS_DOMAIN_ID": "0"})
    # Who reads a terminal whose last program has ended gets an error, and waits for nothing.
    os.close(inside)
    try:
        lines, frame = watch(terminal)
    finally:
        demo.terminate()
        try:
            demo.wait(10.0)
        except subprocess.TimeoutExpired:
            demo.kill()
            raise

array, taxels = frame["contacts"], frame["taxels"]
contact = array["contacts"][0]
x, y = contact["position"]["x"] * 1e3, contact["position"]["y"] * 1e3

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
LETTER = 12.0  # [px] of the terminal's letters, which are at most 0.61 times as wide
box = max(470, math.ceil(0.61 * LETTER * max(map(len, lines)) + 32))
width = 360 + box + 30
out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} 370" font-family="sans-serif" font-size="13">']
out.append("<title>One frame of the demo: readings of 25 barometers, and the contact that the node found</title>")
out.append(f'<rect x="0" y="0" width="{width}" height="370" fill="#ffffff"/>')
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
out.append('<text x="360" y="30" font-weight="bold" fill="#1d3550">$ dermis demo</text>')
out.append(f'<rect x="360" y="46" width="{box}" height="{26 + 22 * len(lines)}" rx="6" fill="#1e2430"/>')
for i, line in enumerate(lines):
    out.append(f'<text x="376" y="{74 + 22 * i}" font-family="monospace" font-size="{LETTER:.0f}" xml:space="preserve" fill="#e6e6e6">{html.escape(line)}</text>')
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
print("docs/live.svg:", lines[-1].strip())
