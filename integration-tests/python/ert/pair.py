"""What pyEIT makes of the panel's sheet.

    pair.py COLUMNS ROWS WIDTH HEIGHT OHMS_PER_SQUARE NODE...

The sheet is WIDTH x HEIGHT metres of COLUMNS x ROWS cells, each of which is two linear triangles. Of the points NODE, each pair is
an electrode pair in turn: 1 A goes in at the first and out at the second. Printed as one line of JSON: volts between both, pair
by pair.
"""

import itertools
import json
import sys

import numpy as np
from pyeit.eit.fem import Forward
from pyeit.mesh import PyEITMesh


def sheet(columns, rows, width, height):
    x, y = np.meshgrid(np.linspace(0, width, columns + 1), np.linspace(0, height, rows + 1))
    nodes = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    corner = np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)
    a, b, c, d = (corner.ravel() + by for by in (0, 1, columns + 1, columns + 2))
    return nodes, np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])


def main():
    columns, rows = int(sys.argv[1]), int(sys.argv[2])
    width, height, square = (float(text) for text in sys.argv[3:6])
    electrodes = np.array([int(text) for text in sys.argv[6:]])
    nodes, elements = sheet(columns, rows, width, height)
    conductance = np.full(len(elements), 1.0 / square)
    # The point of reference is none of the electrodes: differences do not depend on it.
    mesh = PyEITMesh(nodes, elements, conductance, electrodes, ref_node=1)
    forward = Forward(mesh)
    volts = []
    for pair in itertools.combinations(range(len(electrodes)), 2):
        potential = np.real(forward.solve(np.array(pair)))
        volts.append(float(potential[electrodes[pair[0]]] - potential[electrodes[pair[1]]]))
    print(json.dumps(volts))


main()
