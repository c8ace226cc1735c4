"""What a lab writes in place of the forward model: numpy and scipy, vectorised, one process a core.

    table_peer.py DATA.json SECONDS PROCESSES

DATA holds a table of pressure per newton over the cube root of the force and the distance, the taxels, and stimuli with what
our model reads for them. Each method looks the table up for every taxel, adds Gaussian noise, and cuts off at the range, in
batches, for SECONDS in each of PROCESSES. Printed as one line of JSON: samples per second in all, by the clock and by CPU time,
and the largest deviation from our noise-free readings as a share of each stimulus' peak. The first method is the look-up that
ours does.
"""

import json
import multiprocessing
import sys
import time

import numpy as np
from scipy import ndimage

BATCH = 2048


class Table:
    def __init__(self, data):
        table = data["table"]
        self.values = np.array(table["values"]).reshape(table["rows"], -1)
        self.root_step, self.step = table["root_step"], table["step"]
        self.taxels = np.array(data["taxels"])

    def locations(self, contacts):
        """Row (samples x 1) and column (samples x taxels) of every look-up, as fractions."""
        dx = contacts[:, 0:1] - self.taxels[:, 0]
        dy = contacts[:, 1:2] - self.taxels[:, 1]
        return np.cbrt(contacts[:, 2:3]) / self.root_step, np.sqrt(dx * dx + dy * dy) / self.step


class Spline(Table):
    """map_coordinates: splines of this order in both directions; the coefficients are computed once."""

    def __init__(self, data, order):
        super().__init__(data)
        self.order = order
        # The field is even in the distance: mirrored at the axis.
        self.coefficients = ndimage.spline_filter(self.values, order=3, mode="mirror") if order > 1 else self.values

    def read(self, contacts):
        row, column = self.locations(contacts)
        coordinates = np.stack([np.broadcast_to(row, column.shape), column])
        found = ndimage.map_coordinates(
            self.coefficients, coordinates, order=self.order, mode="mirror", prefilter=False
        )
        return found * contacts[:, 2:3]


class Bilinear(Table):
    """Four gathers from a flat table."""

    def read(self, contacts):
        row, column = self.locations(contacts)
        i, j = row.astype(np.intp), column.astype(np.intp)
        s, t = row - i, column - j
        flat, width = self.values.ravel(), self.values.shape[1]
        at = i * width + j
        low = flat.take(at) * (1 - t) + flat.take(at + 1) * t
        high = flat.take(at + width) * (1 - t) + flat.take(at + width + 1) * t
        return (low + s * (high - low)) * contacts[:, 2:3]


METHODS = {
    "scipy map_coordinates, cubic": ("table", lambda data: Spline(data, 3)),
    "scipy map_coordinates, linear in a finer table": ("fine", lambda data: Spline(data, 1)),
    "numpy, linear in a finer table": ("fine", lambda data: Bilinear(data)),
}


def prepare(data, name):
    table, make = METHODS[name]
    return make({**data, "table": data[table]})


def work(data, name, seconds, seed, start, results):
    method = prepare(data, name)
    contacts = np.array(data["contacts"])
    contacts = np.tile(contacts, (-(-BATCH // len(contacts)), 1))[:BATCH]
    rng = np.random.Generator(np.random.SFC64(seed))
    sigma, (low, high) = np.float32(data["noise"]), data["range"]
    method.read(contacts)
    start.wait()
    begun, idle, count = time.perf_counter(), time.process_time(), 0
    while time.perf_counter() - begun < seconds:
        frames = method.read(contacts).astype(np.float32)
        frames += sigma * rng.standard_normal(frames.shape, dtype=np.float32)
        np.clip(frames, low, high, out=frames)
        count += len(frames)
    results.put((count / (time.perf_counter() - begun), count / (time.process_time() - idle)))


def main():
    data = json.load(open(sys.argv[1]))
    seconds, processes = float(sys.argv[2]), int(sys.argv[3])
    contacts, ours = np.array(data["contacts"]), np.array(data["clean"])
    out = []
    for name in METHODS:
        deviation = np.abs(prepare(data, name).read(contacts) - ours).max(1) / ours.max(1)
        start, results = multiprocessing.Barrier(processes), multiprocessing.Queue()
        workers = [
            multiprocessing.Process(target=work, args=(data, name, seconds, seed, start, results))
            for seed in range(processes)
        ]
        for worker in workers:
            worker.start()
        clock, cpu = (sum(rates) for rates in zip(*(results.get() for _ in workers)))
        for worker in workers:
            worker.join()
        out.append({"name": name, "samples_per_s": clock, "by_cpu_time": cpu, "deviation": float(deviation.max())})
    print(json.dumps(out))


if __name__ == "__main__":
    main()
