"""What a lab writes in place of `dermis fusion`: numpy, every skin's contacts as arrays.

    fusion_peer.py DATA.json SECONDS PROCESSES

DATA holds reports of eight skins, the assumptions, and what our fusion makes of the reports. Position and velocity are filtered by
the same Schmidt-Kalman filter, force by a random walk, vectorised over the contacts of a report. Which contact is whose is taken from the
report: nothing is assigned, merged or published. Printed as one line of JSON: microseconds for the eight reports of a millisecond, and
the largest deviation from ours, as a share of each standard deviation and value.
"""

import json
import sys
import time

import numpy as np


class Filter:
    """Mean, covariance, and covariance with the skin's bias, of n contacts with `size` components each."""

    def __init__(self, values, noise, bias, size, rest):
        n = len(values)
        self.mean = np.zeros((n, size))
        self.mean[:, :3] = values
        self.covariance = np.tile(np.eye(size) * rest, (n, 1, 1))
        self.covariance[:, :3, :3] = noise + bias
        self.cross = np.zeros((n, size, 3))
        self.cross[:, :3] = -bias
        self.bias = bias

    def predict(self, f, q):
        self.mean = self.mean @ f.T
        self.covariance = f @ self.covariance @ f.T + q
        self.cross = f @ self.cross

    def update(self, values, noise):
        head = self.cross[:, :3]
        innovation = values - self.mean[:, :3]
        spread = self.covariance[:, :3, :3] + head + head.transpose(0, 2, 1) + self.bias + noise
        gain = (self.covariance[:, :, :3] + self.cross) @ np.linalg.inv(spread)
        self.mean = self.mean + (gain @ innovation[:, :, None])[:, :, 0]
        self.covariance = self.covariance - gain @ spread @ gain.transpose(0, 2, 1)
        self.covariance = (self.covariance + self.covariance.transpose(0, 2, 1)) * 0.5
        self.cross = self.cross - gain @ (head + self.bias)


class Fusion:
    def __init__(self, data):
        self.data = data
        self.skins = {}
        dt, tau, variance = data["period"], data["slide_time"], data["slide_speed"] ** 2
        x = dt / tau
        decay, lost = np.exp(-x), -np.expm1(-x)
        spread = 2 * x - 3 + 4 * decay - decay * decay
        self.f, self.q = np.eye(6), np.zeros((6, 6))
        for i in range(3):
            self.f[i, i + 3], self.f[i + 3, i + 3] = tau * lost, decay
            self.q[i, i] = variance * tau * tau * spread
            self.q[i, i + 3] = self.q[i + 3, i] = variance * tau * lost * lost
            self.q[i + 3, i + 3] = variance * (1 - decay * decay)
        self.still, self.walk = np.eye(3), np.eye(3) * data["force_change"] ** 2 * dt

    def take(self, skin, report):
        d, share = self.data, self.data["systematic_share"]
        place, force = report[:, :3], report[:, 3:]
        position = np.tile(np.eye(3) * (d["position_variance"] + d["least"]), (len(report), 1, 1))
        mount = np.eye(3) * d["mount_deviation"] ** 2
        strength = np.tile(np.eye(3) * (d["force_variance"] + d["least"]), (len(report), 1, 1))
        if skin not in self.skins:
            gain = np.zeros_like(strength)
            for i in range(3):
                gain[:, i, i] = (d["gain_deviation"] * force[:, i]) ** 2
            self.skins[skin] = (
                Filter(place, position * (1 - share), position * share + mount, 6, d["slide_speed"] ** 2),
                Filter(force, strength * (1 - share), strength * share + gain, 3, 0.0),
            )
            return
        of_place, of_force = self.skins[skin]
        of_place.predict(self.f, self.q)
        of_force.predict(self.still, self.walk)
        of_place.update(place, position * (1 - share))
        of_force.update(force, strength * (1 - share))

    def rows(self):
        for skin in sorted(self.skins):
            place, force = self.skins[skin]
            for k in range(len(place.mean)):
                root = [place.covariance[k, 0, 0], force.covariance[k, 2, 2], place.covariance[k, 3, 3]]
                yield [*place.mean[k, :3], *force.mean[k], *np.sqrt(root)]


def main():
    data = json.load(open(sys.argv[1]))
    seconds = float(sys.argv[2])
    frames = [[np.array(report) for report in frame] for frame in data["frames"]]

    def once():
        fusion = Fusion(data)
        for frame in frames:
            for skin, report in enumerate(frame):
                fusion.take(skin, report)
        return fusion

    found, expected = np.array(list(once().rows())), np.array(data["expected"])
    deviation = float(np.max(np.abs(found - expected) / (1e-3 + np.abs(expected))))
    runs, begun = 0, time.perf_counter()
    while time.perf_counter() - begun < seconds:
        once()
        runs += 1
    each = (time.perf_counter() - begun) / (runs * len(frames))
    print(json.dumps([{"name": "numpy", "millisecond_us": each * 1e6, "deviation": deviation}]))


if __name__ == "__main__":
    main()
