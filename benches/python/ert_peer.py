"""What a lab writes in place of the panel's forward model: scipy, or pyEIT, which solve the sheet anew for each frame.

    ert_peer.py DATA.json SECONDS PROCESSES

DATA holds the grid of the sheet, where its electrodes are, and frames: conductances that contacts add, and the resistances between
electrodes that our model has for them (from its own discs of electrodes, off the diagonal). Each method assembles the sheet with
the contacts of a frame and solves it for a current into each electrode, for SECONDS in each of PROCESSES. Printed as one line of
JSON: frames per second in all, by the clock and by CPU time, and the largest deviation from our resistances.
"""

import json
import multiprocessing
import sys
import time

import numpy as np
import scipy.sparse
import scipy.sparse.linalg


class Sheet:
    """The grid as triangles, and the currents into each electrode."""

    def __init__(self, data):
        columns, rows = data["cells"]
        width, height = data["size"]
        x, y = np.meshgrid(np.linspace(0, width, columns + 1), np.linspace(0, height, rows + 1))
        self.nodes = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
        corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
        a, b, c, d = (corner + by for by in (0, 1, columns + 1, columns + 2))
        self.elements = np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])
        self.size = x.size
        self.currents = np.zeros((self.size, len(data["electrodes"])))
        for e, corners in enumerate(data["electrodes"]):
            for node, weight in corners:
                self.currents[int(node), e] += weight
        # Half a cell's area belongs to a point of the border, a quarter to a corner.
        share = lambda n: np.concatenate([[0.5], np.ones(n - 1), [0.5]])
        area = np.outer(share(rows), share(columns)).ravel() * width * height / columns / rows
        self.leak = data["leak"] * area
        self.square = data["square"]

    def ground(self, frame):
        ground = self.leak.copy()
        ground[np.array(frame["nodes"], dtype=int)] += frame["conductances"]
        return ground


class Scipy(Sheet):
    """One sparse factor of each frame's matrix (SuperLU), and all electrodes at once."""

    def __init__(self, data):
        super().__init__(data)
        corners = self.nodes[self.elements][:, :, :2]
        edges = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]
        area = 0.5 * np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
        local = np.einsum("eik,ejk->eij", edges, edges) / (4 * area)[:, None, None] / self.square
        rows = np.repeat(self.elements, 3, axis=1).ravel()
        columns = np.tile(self.elements, (1, 3)).ravel()
        self.stiffness = scipy.sparse.csc_matrix((local.ravel(), (rows, columns)), shape=(self.size,) * 2)

    def read(self, frame):
        matrix = self.stiffness + scipy.sparse.diags(self.ground(frame), format="csc")
        factor = scipy.sparse.linalg.splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        return self.currents.T @ factor.solve(self.currents)


class PyEIT(Sheet):
    """Its own assembly for each frame, and its own solution for each electrode."""

    def __init__(self, data):
        super().__init__(data)
        from pyeit.eit.fem import Forward
        from pyeit.mesh import PyEITMesh

        # Its point of reference is one that belongs to no element, so that the sheet keeps its own ground.
        nodes = np.vstack([self.nodes, [[9.0, 9.0, 0.0]]])
        self.conductance = np.full(len(self.elements), 1.0 / self.square)
        mesh = PyEITMesh(nodes, self.elements, self.conductance, np.array([0, 1]), ref_node=self.size)
        self.forward = Forward(mesh)

    def read(self, frame):
        self.forward.assemble_pde(self.conductance)
        ground = scipy.sparse.diags(np.append(self.ground(frame), 0.0))
        matrix = (self.forward.kg + ground).tocsr()
        found = []
        for current in self.currents.T:
            # As Forward.solve does, which knows pairs of electrodes only.
            found.append(scipy.sparse.linalg.spsolve(matrix, np.append(np.real(current), 0.0))[:-1])
        return self.currents.T @ np.real(np.array(found).T)


METHODS = {"scipy, factored again": Scipy, "pyEIT": PyEIT}


def deviation(method, data):
    worst = 0.0
    for frame in data["frames"][:3]:
        found, ours = method.read(frame), np.array(frame["resistances"]).reshape(len(data["electrodes"]), -1)
        off = ~np.eye(len(ours), dtype=bool)
        worst = max(worst, np.abs(found - ours)[off].max() / np.abs(ours[off]).max())
    return float(worst)


def work(data, name, seconds, start, results):
    method = METHODS[name](data)
    method.read(data["frames"][0])
    start.wait()
    begun, idle, count = time.perf_counter(), time.process_time(), 0
    while time.perf_counter() - begun < seconds:
        method.read(data["frames"][count % len(data["frames"])])
        count += 1
    results.put((count / (time.perf_counter() - begun), count / (time.process_time() - idle)))


def main():
    data = json.load(open(sys.argv[1]))
    seconds, processes = float(sys.argv[2]), int(sys.argv[3])
    out = []
    for name, method in METHODS.items():
        off = deviation(method(data), data)
        start, results = multiprocessing.Barrier(processes), multiprocessing.Queue()
        workers = [multiprocessing.Process(target=work, args=(data, name, seconds, start, results)) for _ in range(processes)]
        for worker in workers:
            worker.start()
        clock, cpu = (sum(rates) for rates in zip(*(results.get() for _ in workers)))
        for worker in workers:
            worker.join()
        out.append({"name": name, "frames_per_s": clock, "by_cpu_time": cpu, "deviation": off})
    print(json.dumps(out))


if __name__ == "__main__":
    main()
