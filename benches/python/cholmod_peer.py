"""The same stiffness by CHOLMOD (SuiteSparse, through scikit-sparse) with OpenBLAS.

    cholmod_peer.py FOLDER REPEATS

FOLDER holds the lower half of the matrix by columns (`starts`, `rows`: int64; `values`: float64), and the loads: for each
of the nodes its unknowns (`unknowns`: int64, three a node, -1 where held) and its normal (`normals`: float64, three a node);
`green` (float32, nodes x nodes by columns) is our answer. OPENBLAS_NUM_THREADS says how many threads it has.

Printed as one line of JSON: for each way of ordering the seconds that analysis and factor take (the best of REPEATS), the
seconds of all loads in blocks of several sizes, both by the clock and by the CPU time of the process, the largest difference from our
answer as a share of its largest number, and which BLAS the process has loaded.
"""

import json
import sys
import time
from pathlib import Path

import numpy as np
import sksparse.cholmod as cholmod
from scipy import sparse

BLOCKS = [16, 64, 256, 1024]
ORDERINGS = ["amd", "metis", "nesdis", "default", "best"]


class Watch:
    """Seconds since it was made."""

    def __init__(self):
        self.begun = time.perf_counter(), time.process_time()

    def read(self):
        return {"clock": time.perf_counter() - self.begun[0], "cpu": time.process_time() - self.begun[1]}


def loaded_blas():
    """Files of every BLAS in this process, as the kernel maps them."""
    maps = Path("/proc/self/maps").read_text().splitlines()
    files = {line.split()[-1] for line in maps if "blas" in line.split()[-1].lower()}
    # What CHOLMOD was linked against; numpy and scipy bring copies of their own.
    return sorted(f for f in files if "site-packages" not in f)


def main():
    folder, repeats = Path(sys.argv[1]), int(sys.argv[2])
    read = lambda name, kind: np.fromfile(folder / name, dtype=kind)
    starts, rows, values = read("starts", np.int64), read("rows", np.int64), read("values", np.float64)
    size = len(starts) - 1
    lower = sparse.csc_matrix((values, rows.astype(np.int32), starts.astype(np.int32)), shape=(size, size))
    unknowns, normals = read("unknowns", np.int64).reshape(-1, 3), read("normals", np.float64).reshape(-1, 3)
    nodes = len(unknowns)
    ours = read("green", np.float32).reshape(nodes, nodes)

    node, axis = np.nonzero(unknowns >= 0)
    along = sparse.csc_matrix((normals[node, axis], (unknowns[node, axis], node)), shape=(size, nodes))

    factors, best = {}, None
    for ordering in ORDERINGS:
        times = []
        try:
            for _ in range(repeats):
                watch = Watch()
                factor = cholmod.analyze(lower, mode="supernodal", ordering_method=ordering)
                factor.cholesky_inplace(lower)
                times.append(watch.read())
        except cholmod.CholmodError as e:
            print(f"{ordering}: {e}", file=sys.stderr)
            continue
        factors[ordering] = {kind: min(t[kind] for t in times) for kind in ("clock", "cpu")}
        if best is None or factors[ordering]["cpu"] < best[0]:
            best = factors[ordering]["cpu"], factor
    factor = best[1]

    green = np.empty((nodes, nodes), dtype=np.float32)
    solves = {}
    for block in BLOCKS:
        watch = Watch()
        for first in range(0, nodes, block):
            loads = along[:, first : first + block]
            moved = factor(loads.toarray(order="F"))
            # By columns, as ours.
            green[first : first + block] = (along.T @ moved).T
        solves[str(block)] = watch.read()
    difference = float(np.abs(green - ours).max() / np.abs(ours).max())
    print(
        json.dumps(
            {
                "unknowns": size,
                "factor_s": factors,
                "loads_s": solves,
                "deviation": difference,
                "blas": loaded_blas(),
            }
        )
    )


if __name__ == "__main__":
    main()
