"""A device of 25 barometers behind a pseudo-terminal: python3 device.py LINK [SECONDS]

LINK becomes a link to the terminal. The wire is that of crates/transport/WIRE.md.
"""

import math
import os
import random
import struct
import sys
import time
import tty

CHANNELS, RATE = 25, 100.0  # of launch/skins/baro-grid.toml


def crc16(data):
    """CRC-16/IBM-3740: polynomial 0x1021, initial value 0xFFFF."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


assert crc16(b"123456789") == 0x29B1


def cobs(data):
    """Consistent overhead byte stuffing: no zero byte remains."""
    out = bytearray()
    while True:
        run = data[:254].split(b"\0", 1)[0]
        if len(run) == 254 and len(data) > 254:
            out += b"\xff" + run
            data = data[254:]
            continue
        out += bytes([len(run) + 1]) + run
        if len(run) >= len(data):
            return bytes(out)
        data = data[len(run) + 1 :]


def frame(sequence, micros, values):
    """Version 1, format 0: single precision in the unit of the skin."""
    body = struct.pack("<BBHIQ", 1, 0, len(values), sequence & 0xFFFFFFFF, micros)
    body += struct.pack(f"<{len(values)}f", *values)
    return cobs(body + struct.pack("<H", crc16(body))) + b"\0"


def readings(t):
    """[Pa] with 20 Pa of noise: untouched for 15 s, in which the node takes its zero; then a press on the middle every 3 s."""
    phase = t % 3.0
    press = 3000.0 * math.sin(math.pi * phase / 2.0) if t > 15.0 and phase < 2.0 else 0.0
    values = []
    for i in range(CHANNELS):
        x, y = (i % 5 - 2) * 6.5e-3, (i // 5 - 2) * 6.5e-3
        # What a point load does at depth h (Boussinesq), in shape: (h / distance)^5.
        values.append(random.gauss(press * (5e-3 / math.hypot(5e-3, x, y)) ** 5, 20.0))
    return values


def main():
    link = sys.argv[1]
    seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 1e9
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    if os.path.islink(link):
        os.remove(link)
    os.symlink(os.ttyname(theirs), link)
    os.set_blocking(ours, False)
    print("sending to", link, flush=True)
    start = time.monotonic()
    sequence = 0
    try:
        # If the last frame before a reset was cut off, this saves the first one after it.
        os.write(ours, b"\0")
        while (t := time.monotonic() - start) < seconds:
            try:
                os.write(ours, frame(sequence, int(t * 1e6) + 1, readings(t)))
            except BlockingIOError:
                pass  # Nobody reads: the frame is dropped, and its number with it.
            sequence += 1
            time.sleep(max(0.0, start + sequence / RATE - time.monotonic()))
    except KeyboardInterrupt:
        pass
    finally:
        os.remove(link)


if __name__ == "__main__":
    main()
