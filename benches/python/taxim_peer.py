"""A renderer of tactile images that others wrote: Taxim (Si and Yuan 2022) on JAX, for its own sensor, a flat GelSight of 480 x 640 pixels.

    taxim_peer.py DATA.json SECONDS PROCESSES

DATA holds presses of a ball: for each picture one to three locations (shares of the picture's width and height), depths [mm], and the
ball's diameter [mm]. Pictures are rendered for SECONDS in each of PROCESSES, without and with shadows. Printed as one line of JSON:
pictures per second in all, by the clock and by CPU time, and the size of a picture.
"""

import json
import multiprocessing
import os
import sys
import time

import numpy as np


def height_map(press, shape, pixel, diameter):
    """[mm] above the gel, which the tips reach below 0."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    radius = diameter / 2
    lowest = np.full(shape, 10.0)
    for x, y, depth in press:
        squared = ((columns - x * shape[1]) ** 2 + (rows - y * shape[0]) ** 2) * pixel**2
        ball = radius - depth - np.sqrt(np.maximum(radius**2 - squared, 0.0))
        lowest = np.minimum(lowest, np.where(squared < radius**2, ball, 10.0))
    return lowest.astype(np.float32)


def work(data, shadow, seconds, start, results):
    # One thread in each process, as ours has; read when the renderer is loaded, which happens here and not in the parent.
    os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    import jax.numpy as jnp
    from taxim import Taxim

    taxim = Taxim(backend="jax", device="cpu")
    shape = (taxim.height, taxim.width)
    pixel = taxim.sensor_params.pixmm
    maps = [jnp.asarray(height_map(press, shape, pixel, data["diameter"])) for press in data["presses"]]

    def render(k):
        return taxim.render(maps[k % len(maps)], with_shadow=shadow).block_until_ready()

    if float(abs(render(0) - render(1)).max()) < 0.05:
        raise SystemExit("Taxim drew two presses alike")
    start.wait()
    begun, idle, count = time.perf_counter(), time.process_time(), 0
    while time.perf_counter() - begun < seconds:
        render(count)
        count += 1
    results.put((count / (time.perf_counter() - begun), count / (time.process_time() - idle), shape))


def main():
    data = json.load(open(sys.argv[1]))
    seconds, processes = float(sys.argv[2]), int(sys.argv[3])
    context = multiprocessing.get_context("spawn")
    out = []
    for name, shadow in (("Taxim 1.4.1 on JAX", False), ("Taxim 1.4.1 on JAX, with shadows", True)):
        start, results = context.Barrier(processes), context.Queue()
        workers = [context.Process(target=work, args=(data, shadow, seconds, start, results)) for _ in range(processes)]
        for worker in workers:
            worker.start()
        rates = [results.get() for _ in workers]
        for worker in workers:
            worker.join()
        clock, cpu = (sum(rate[i] for rate in rates) for i in (0, 1))
        out.append({"name": name, "size": list(rates[0][2][::-1]), "pictures_per_s": clock, "pictures_by_cpu_time": cpu})
    print(json.dumps(out))


if __name__ == "__main__":
    main()
