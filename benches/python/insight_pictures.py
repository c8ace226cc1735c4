"""Where does one contact touch a soft thumb, and how hard, seen in a picture from inside: the thesis' ResNet-18 beside a small network.

    insight_pictures.py --network resnet18 --network small --train BAG... --answer BAG=FILE-{network}.jsonl --out RESULT.json

Problem: chapter 6 of the thesis infers the position and the force of a single contact by a ResNet-18 of 5 GMAC a picture. How much of its
accuracy has a network of at most 0.4 GMAC, that one CPU can run for every frame, on the same data?
Method: both take six planes of 410 x 308: the picture's difference from its bag's reference (mean of the untouched frames at the start),
and the reference itself, in shares of full scale; scaling by constants of the training part is the first step of their graphs. Both give
position [m] and force [N] in the link frame. Loss: mean squared error of standardised outputs, of the force on all frames (0 where
untouched), of the position on touched ones. Adam, its rate falling to 0 by a cosine. A quarter of the locations is held out, and weights
of the epoch with the least loss there are kept, so errors on held-out locations are a little too good: answers for other bags, which the
shared metrics score, are the comparison.
Assumptions: at most one contact (frames with more, or of unknown truth, are left out of training); frames without a contact and without a
location go to both parts at random, as they look alike; a bag's mounting and light stay as in its reference.
Where two cores learn, the ResNet sees means of K x K pixels (--shrink), which costs it detail, and K x K times less.
Cost: N frames are held whole on the device, 379 kB each. An epoch costs three times the network's multiplications for each frame, and no
Python per frame. Results are written at the end of each network, so an interrupted run keeps those that finished.
"""

import argparse
import concurrent.futures.process
import contextlib
import copy
import json
import math
import multiprocessing
import os
import shutil
import signal
import struct
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch.nn import functional

WIDTH, HEIGHT = 410, 308
BYTES = WIDTH * HEIGHT * 3
# Untouched frames that the reference averages at most.
REFERENCE = 100
# Frames that one process reads at a time: bags are cut, so that one long bag keeps all of them busy.
PART = 256
IDLE, UNKNOWN = 0, 255
IMAGE, TRUTH = "sensor_msgs/msg/Image", "dermis_msgs/msg/Indentation"


class Failure(Exception):
    """Something from outside is not as it must be; the text says what, where, and what to do."""


def summarise(bag):
    """Parts [(file, begin, end)] of a bag in order, in [ns] of log time, and its count of pictures."""
    from mcap.reader import make_reader

    files = [bag] if bag.is_file() else sorted(bag.glob("*.mcap"))
    if not files:
        raise Failure(f"{bag}: no *.mcap there: give the folder of a recorded bag")
    parts, count = [], 0
    for file in files:
        try:
            with open(file, "rb") as stream:
                summary = make_reader(stream).get_summary()
        except Exception as error:
            raise Failure(f"{file}: not a readable MCAP file ({error}): repair it by `mcap recover` or record it again") from error
        if not (summary and summary.statistics and summary.chunk_indexes):
            raise Failure(f"{file}: has no index, as its recording was cut off: repair it by `mcap recover` or record it again")
        for name in (IMAGE, TRUTH):
            ids = [c.id for c in summary.channels.values() if summary.schemas[c.schema_id].name == name]
            if len(ids) != 1:
                raise Failure(f"{file}: has {len(ids)} topics of {name}, not 1: record one camera with its ground truth")
            if name == IMAGE:
                images = summary.statistics.channel_message_counts.get(ids[0], 0)
        starts = sorted(chunk.message_start_time for chunk in summary.chunk_indexes)
        cuts = starts[:: max(1, math.ceil(len(starts) * PART / max(images, 1)))]
        begin = min(summary.statistics.message_start_time, cuts[0])
        # Outer bounds are those of all messages, so that none is left out.
        edges = [begin, *(cut for cut in sorted(set(cuts)) if cut > begin), summary.statistics.message_end_time + 1]
        parts += [(summary.statistics.message_start_time, file, a, b) for a, b in zip(edges, edges[1:])]
        count += images
    if not count:
        raise Failure(f"{bag}: has no pictures: record it with the camera's topic")
    return [part[1:] for part in sorted(parts, key=lambda part: (part[0], part[2]))], count


def picture(data, file):
    """Stamp [ns] and pixels of a sensor_msgs/Image in CDR. By hand: a general decoder makes an integer object of each byte."""
    order = "<" if data[1] else ">"

    def take(form, at):
        # Positions are aligned after the four bytes of encapsulation, so to multiples of 4 in the whole message as well.
        at += -at % 4
        return *struct.unpack_from(order + form, data, at), at + struct.calcsize("<" + form)

    seconds, nanoseconds, length, at = take("iII", 4)
    height, width, length, at = take("III", at + length)
    encoding = bytes(data[at : at + length - 1]).decode()
    # One byte says whether numbers are big-endian; pixels of one byte each do not care.
    step, length, at = take("II", at + length + 1)
    if (width, height, encoding, step, length) != (WIDTH, HEIGHT, "rgb8", 3 * WIDTH, BYTES):
        found = f"{width} x {height} {encoding} in rows of {step} bytes"
        raise Failure(f"{file}: pictures are {found}, not {WIDTH} x {HEIGHT} rgb8: record them at the network's size")
    return seconds * 1_000_000_000 + nanoseconds, memoryview(data)[at : at + BYTES]


def read_part(part, path):
    """Writes a part's pictures to `path`; returns their stamps, and for each truth its stamp, phase, location and contacts."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    file, begin, end = part
    stamps, truths, decode = [], [], None
    try:
        with open(file, "rb") as stream, open(path, "wb") as out:
            reader = make_reader(stream)
            channels = reader.get_summary().channels.values()
            names = {c.id: reader.get_summary().schemas[c.schema_id].name for c in channels}
            topics = [c.topic for c in channels if names[c.id] in (IMAGE, TRUTH)]
            for schema, _, message in reader.iter_messages(topics=topics, starting_at=begin, ending_before=end):
                if schema.name == IMAGE:
                    stamp, pixels = picture(message.data, file)
                    out.write(pixels)
                    stamps.append(stamp)
                else:
                    decode = decode or DecoderFactory().decoder_for("cdr", schema)
                    truth = decode(message.data)
                    contacts = [(c.position.x, c.position.y, c.position.z, c.force.x, c.force.y, c.force.z) for c in truth.contacts]
                    stamp = truth.header.stamp.sec * 1_000_000_000 + truth.header.stamp.nanosec
                    truths.append((stamp, truth.phase, truth.location, contacts))
    except (Failure, OSError):
        raise
    except Exception as error:
        raise Failure(f"{file}: cannot be read ({error!r}): repair it by `mcap recover` or record it again") from error
    return stamps, truths


class Data:
    """Frames of all bags on a device: pictures in the order in which they came, and what is known of each."""

    def __init__(self, bags, device, processes):
        begun = time.perf_counter()
        plans = {bag: summarise(bag) for bag in bags}
        total = sum(count for _, count in plans.values())
        shared = Path("/dev/shm")
        # Memory where there is enough of it, else a disk: readers hand pictures over in files, which are gone once they are copied.
        room = shared.is_dir() and shutil.disk_usage(shared).free > 1.2 * total * BYTES
        jobs = [(bag, k, part) for bag, (parts, _) in plans.items() for k, part in enumerate(parts)]
        context = multiprocessing.get_context("fork")
        found, row = {}, 0
        with tempfile.TemporaryDirectory(prefix="insight-", dir=shared if room else None) as folder:
            with concurrent.futures.ProcessPoolExecutor(min(processes, len(jobs)), mp_context=context) as pool:
                # All processes are forked by the first submission, before the device is touched.
                waiting = {pool.submit(read_part, job[2], f"{folder}/{i}"): (i, job) for i, job in enumerate(jobs)}
                self.pictures = torch.empty((total, HEIGHT, WIDTH, 3), dtype=torch.uint8, device=device)
                try:
                    for future in concurrent.futures.as_completed(waiting):
                        i, (bag, k, _) = waiting[future]
                        stamps, truths = future.result()
                        if stamps:
                            pixels = np.memmap(f"{folder}/{i}", np.uint8, "c", shape=(len(stamps), HEIGHT, WIDTH, 3))
                            self.pictures[row : row + len(stamps)] = torch.from_numpy(pixels).to(device)
                        os.unlink(f"{folder}/{i}")
                        found[bag, k] = (row, stamps, truths)
                        row += len(stamps)
                except concurrent.futures.process.BrokenProcessPool as error:
                    raise Failure("a process that read bags was ended, probably for want of memory: give fewer --processes") from error
                except BaseException:
                    pool.shutdown(cancel_futures=True)
                    raise
        if row != total:
            raise Failure(f"{bags[0]} and others: {row} of {total} pictures could be read: repair bags by `mcap recover`")
        self.rows, self.stamps, self.references = {}, {}, []
        self.truth, self.locations = np.zeros((total, 6), np.float32), np.zeros(total, np.int64)
        self.bag, self.touched, self.usable = np.zeros(total, np.int64), np.zeros(total, bool), np.zeros(total, bool)
        for bag, (parts, _) in plans.items():
            self.label(bag, [found[bag, k] for k in range(len(parts))])
        self.references = torch.stack(self.references)
        self.bag = torch.from_numpy(self.bag).to(device)
        self.seconds = time.perf_counter() - begun
        say(f"{total} frames of {len(bags)} bags read in {self.seconds:.1f} s, {self.touched.sum()} of them touched")

    def label(self, bag, parts):
        rows = np.concatenate([np.arange(row, row + len(stamps)) for row, stamps, _ in parts])
        stamps = [stamp for _, part, _ in parts for stamp in part]
        truths = {truth[0]: truth[1:] for _, _, part in parts for truth in part}
        missing = sum(stamp not in truths for stamp in stamps)
        if missing:
            raise Failure(f"{bag}: {missing} of {len(stamps)} pictures have no ground truth of their stamp: record both in one run")
        leading = 0
        for row, stamp in zip(rows, stamps):
            phase, location, contacts = truths[stamp]
            # Bags count their locations each from its own first one.
            self.locations[row] = len(self.references) << 32 | location
            if len(contacts) == 1 and np.isfinite(contacts[0]).all():
                self.truth[row], self.touched[row], self.usable[row] = contacts[0], True, True
            self.usable[row] |= not contacts and phase != UNKNOWN
        while leading < min(len(stamps), REFERENCE) and (truths[stamps[leading]][0], truths[stamps[leading]][2]) == (IDLE, []):
            leading += 1
        if not leading:
            raise Failure(f"{bag}: does not begin untouched, so that it has no reference: record some idle frames first")
        self.bag[rows] = len(self.references)
        first = torch.from_numpy(rows[:leading]).to(self.pictures.device)
        self.references.append(self.pictures[first].float().mean(0) / 255)
        self.rows[bag], self.stamps[bag] = rows, stamps

    def planes(self, rows):
        """Inputs of frames: (frames, 6, height, width), with channels last in memory."""
        reference = self.references[self.bag[rows]]
        return torch.cat([self.pictures[rows].float() / 255 - reference, reference], -1).permute(0, 3, 1, 2)


class Block(nn.Module):
    """Two 3 x 3 convolutions beside a shortcut (He et al. 2016)."""

    def __init__(self, before, after, stride):
        super().__init__()
        self.first = nn.Conv2d(before, after, 3, stride, 1, bias=False)
        self.second = nn.Conv2d(after, after, 3, 1, 1, bias=False)
        self.norms = nn.ModuleList([nn.BatchNorm2d(after), nn.BatchNorm2d(after)])
        same = before == after and stride == 1
        shortcut = [] if same else [nn.Conv2d(before, after, 1, stride, bias=False), nn.BatchNorm2d(after)]
        self.shortcut = nn.Sequential(*shortcut)

    def forward(self, x):
        y = functional.relu(self.norms[0](self.first(x)))
        return functional.relu(self.norms[1](self.second(y)) + self.shortcut(x))


class Network(nn.Module):
    """Six planes to position and force in SI units; the head in single precision, as eight bits of a coordinate are too few."""

    def __init__(self, trunk, head, shrink=1):
        super().__init__()
        self.shrink, self.trunk, self.head = nn.AvgPool2d(shrink), trunk, head
        for name, shape in (("offset", (1, 6, 1, 1)), ("scale", (1, 6, 1, 1)), ("centre", (6,)), ("spread", (6,))):
            self.register_buffer(name, torch.ones(shape))
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, planes):
        features = self.trunk(self.shrink((planes - self.offset) * self.scale))
        with torch.autocast(planes.device.type, enabled=False):
            return self.head(features.float()) * self.spread + self.centre


class Places(nn.Module):
    """Head that keeps the place: where each of some maps is highest, as the mean of coordinates, beside means over the whole picture."""

    def __init__(self, channels, maps, hidden):
        super().__init__()
        self.maps = nn.Conv2d(channels, maps, 1)
        self.layers = nn.Sequential(nn.Linear(channels + 2 * maps, hidden), nn.ReLU(), nn.Linear(hidden, 6))

    def forward(self, x):
        weights = self.maps(x).flatten(2).softmax(2)
        down, right = (torch.linspace(-1, 1, n, device=x.device) for n in x.shape[2:])
        grid = torch.stack([right.repeat(len(down)), down.repeat_interleave(len(right))], 1)
        return self.layers(torch.cat([(weights @ grid).flatten(1), x.mean((2, 3))], 1))


def stem(width, size, stride):
    return [nn.Conv2d(6, width, size, stride, size // 2 - (size % 2 == 0), bias=False), nn.BatchNorm2d(width), nn.ReLU()]


def resnet18(shrink):
    stages = [Block(64, 64, 1), Block(64, 64, 1)]
    for width in (128, 256, 512):
        stages += [Block(width // 2, width, 2), Block(width, width, 1)]
    head = nn.Sequential(nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(512, 6))
    return Network(nn.Sequential(*stem(64, 7, 2), nn.MaxPool2d(3, 2, 1), *stages), head, shrink)


def small(_):
    # Ridges inside the thumb move by fractions of their pitch, so the stem sees every pixel, unlike a picture made smaller first.
    stages = [Block(24, 24, 1), Block(24, 48, 2), Block(48, 96, 2), Block(96, 192, 2)]
    return Network(nn.Sequential(*stem(24, 8, 4), *stages), Places(192, 32, 128))


NETWORKS = {"resnet18": resnet18, "small": small}


def count(network):
    """Parameters, and multiplications with additions of convolutions and full layers for one picture."""
    macs = 0

    def add(module, _, out):
        nonlocal macs
        macs += module.weight[0].numel() * out[0].numel()

    hooks = [m.register_forward_hook(add) for m in network.modules() if isinstance(m, (nn.Conv2d, nn.Linear))]
    with torch.no_grad():
        network.eval()(torch.zeros(1, 6, HEIGHT, WIDTH))
    for hook in hooks:
        hook.remove()
    return sum(p.numel() for p in network.parameters()), macs


class Task:
    """What both networks learn from: rows of both parts, and targets on the device."""

    def __init__(self, data, bags, options):
        rng = np.random.default_rng(options.seed)
        rows = np.concatenate([data.rows[bag] for bag in bags])
        rows = rows[data.usable[rows]]
        touched = data.touched[rows]
        locations = np.unique(data.locations[rows[touched]])
        if len(locations) < 4:
            raise Failure(f"{bags[0]}: bags for training have {len(locations)} touched locations, too few to hold out a quarter: add more")
        held = rng.choice(locations, len(locations) // 4, replace=False)
        out = np.isin(data.locations[rows], held)
        # Untouched frames before the first press have no location.
        free = ~np.isin(data.locations[rows], locations)
        out[free] = rng.random(free.sum()) < 0.25
        device = data.pictures.device
        self.data, self.counts = data, {"train": int((~out).sum()), "validation": int(out.sum())}
        self.counts |= {"train_touched": int((touched & ~out).sum()), "validation_touched": int((touched & out).sum())}
        self.counts |= {"locations": len(locations), "validation_locations": len(held)}
        self.train, self.validation = (torch.from_numpy(rows[part]).to(device) for part in (~out, out))
        pressed = data.truth[rows[touched & ~out]]
        centre, spread = pressed.mean(0), pressed.std(0)
        centre[3:], spread[3:] = data.truth[rows[~out], 3:].mean(0), data.truth[rows[~out], 3:].std(0)
        self.centre, self.spread = (torch.from_numpy(v).to(device) for v in (centre, np.maximum(spread, 1e-9)))
        self.truth = torch.from_numpy(data.truth).to(device)
        self.touched = torch.from_numpy(data.touched).to(device)
        some = torch.from_numpy(rng.choice(rows[touched & ~out], min(256, len(pressed)), replace=False)).to(device)
        sums = torch.zeros(2, 6, device=device)
        for part in some.split(32):
            planes = data.planes(part)
            sums += torch.stack([planes.mean((0, 2, 3)), planes.square().mean((0, 2, 3))]) * len(part) / len(some)
        mean, square = sums
        # An untouched picture is 0 to the network: differences are scaled, not shifted.
        self.offset = torch.cat([torch.zeros(3, device=device), mean[3:]]).reshape(1, 6, 1, 1)
        self.scale = 1 / (square - self.offset.flatten().square()).clamp_min(1e-8).sqrt().reshape(1, 6, 1, 1)

    def errors(self, outputs, rows):
        """Sums of squares: of the force, and of the position where touched; and how many frames are."""
        square = ((outputs - self.truth[rows]) / self.spread).square()
        touched = self.touched[rows].float()
        return torch.stack([square[:, 3:].mean(1).sum(), (square[:, :3].mean(1) * touched).sum(), touched.sum()])

    def precision(self):
        cuda = self.data.pictures.is_cuda
        return torch.autocast("cuda", torch.bfloat16) if cuda else contextlib.nullcontext()

    @torch.no_grad()
    def outputs(self, network, rows, batch, quick):
        network.eval()
        # The last batch is filled up, as each new size would be tuned for anew.
        filled = torch.cat([rows, rows[:1].expand(-len(rows) % batch)])
        with self.precision() if quick else contextlib.nullcontext():
            return torch.cat([network(self.data.planes(part)) for part in filled.split(batch)])[: len(rows)]


def train(network, task, options):
    """Trains in place and leaves the best epoch's weights; returns what to report."""
    device = task.train.device
    adam = torch.optim.Adam(network.parameters(), options.rate, fused=device.type == "cuda")
    generator = torch.Generator(device).manual_seed(options.seed)
    rest = task.train[~task.touched[task.train]]
    pressed = task.train[task.touched[task.train]]
    kept = round(len(rest) * options.untouched)
    batch = min(options.batch, len(pressed) + kept)
    steps = (len(pressed) + kept) // batch
    best, losses, training = (math.inf, 0, None), [], []
    begun = time.perf_counter()
    for epoch in range(options.epochs):
        start = time.perf_counter()
        network.train()
        some = rest[torch.randperm(len(rest), generator=generator, device=device)[:kept]]
        rows = torch.cat([pressed, some])
        rows = rows[torch.randperm(len(rows), generator=generator, device=device)]
        total = torch.zeros(3, device=device)
        for step in range(steps):
            adam.param_groups[0]["lr"] = options.rate * 0.5 * (1 + math.cos(math.pi * (epoch + step / steps) / options.epochs))
            part = rows[step * batch : (step + 1) * batch]
            with task.precision():
                outputs = network(task.data.planes(part))
            sums = task.errors(outputs, part)
            loss = sums[0] / batch + sums[1] / sums[2].clamp_min(1)
            adam.zero_grad(set_to_none=True)
            loss.backward()
            adam.step()
            total += sums.detach()
        force, position, pushed = total.tolist()
        training.append(force / (steps * batch) + position / max(pushed, 1))
        outputs = task.outputs(network, task.validation, batch, True)
        force, position, pushed = task.errors(outputs, task.validation).tolist()
        losses.append(force / len(task.validation) + position / max(pushed, 1))
        if losses[-1] < best[0]:
            best = (losses[-1], epoch + 1, {k: v.clone() for k, v in network.state_dict().items()})
        took = time.perf_counter() - start
        say(f"  epoch {epoch + 1} of {options.epochs}: loss {training[-1]:.4f}, held out {losses[-1]:.4f}, {took:.1f} s")
    if best[2] is None:
        raise Failure("training diverged: lower --rate")
    network.load_state_dict(best[2])
    return {
        "epochs": options.epochs, "best_epoch": best[1], "seconds": time.perf_counter() - begun, "frames_per_epoch": steps * batch,
        "train_loss": training, "validation_loss": losses,
    }


def answer(network, task, bag, file, options):
    rows = torch.from_numpy(task.data.rows[bag]).to(task.train.device)
    values = task.outputs(network, rows, options.batch, False).cpu().numpy()
    with open(file, "w") as out:
        for stamp, value in zip(task.data.stamps[bag], values.astype(float)):
            touched = np.linalg.norm(value[3:]) >= options.least_force
            contacts = [{"position": value[:3].tolist(), "force": value[3:].tolist()}] if touched else []
            out.write(json.dumps({"stamp_ns": stamp, "contacts": contacts}) + "\n")


def one_thread(network):
    """[s] for one frame on one CPU thread in single precision: the median of 5."""
    network = copy.deepcopy(network).cpu().eval()
    frame, threads, seconds = torch.zeros(1, 6, HEIGHT, WIDTH), torch.get_num_threads(), []
    torch.set_num_threads(1)
    with torch.no_grad():
        network(frame)
        for _ in range(5):
            begun = time.perf_counter()
            network(frame)
            seconds.append(time.perf_counter() - begun)
    torch.set_num_threads(threads)
    return float(np.median(seconds))


def say(text):
    print(text, file=sys.stderr, flush=True)


def write(file, result):
    # Whole or not at all: a run that is stopped while it writes leaves the former result.
    Path(f"{file}.part").write_text(json.dumps(result, indent=1) + "\n")
    os.replace(f"{file}.part", file)


def parse():
    parser = argparse.ArgumentParser(description="Trains networks on a thumb's pictures and writes their answers for other bags.")
    parser.add_argument("--network", choices=NETWORKS, action="append", required=True, help="again for another on the same data")
    parser.add_argument("--train", type=Path, nargs="+", required=True, metavar="BAG", help="folders of *.mcap")
    parser.add_argument("--answer", action="append", default=[], metavar="BAG=FILE", help="{network} in FILE is its name")
    parser.add_argument("--out", required=True, metavar="RESULT.json")
    parser.add_argument("--epochs", type=int, default=32)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--rate", type=float, default=1e-3)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--device", choices=["cuda", "cpu"], help="cuda where there is one")
    parser.add_argument("--untouched", type=float, default=1.0, help="share of the untouched training frames in an epoch, drawn anew")
    parser.add_argument("--shrink", type=int, default=1, metavar="K", help="the ResNet sees means of K x K pixels: for CPUs")
    parser.add_argument("--least-force", type=float, default=0.015, help="[N] below which the answer is no contact")
    parser.add_argument("--processes", type=int, default=os.cpu_count(), help="that read bags")
    options = parser.parse_args()
    options.answer = [pair.rsplit("=", 1) for pair in options.answer]
    if any(len(pair) != 2 for pair in options.answer):
        parser.error("--answer takes BAG=FILE")
    files = [file for _, file in options.answer]
    if len(set(options.network)) > 1 and not all("{network}" in file for file in files):
        parser.error("with several networks, files of --answer need {network} in their names")
    if min(options.epochs, options.batch, options.shrink, options.processes) < 1 or not 0 <= options.untouched <= 1:
        parser.error("--epochs, --batch, --shrink and --processes are at least 1, and --untouched is 0 to 1")
    return options


def run(options):
    # Counted by the driver's library, which leaves CUDA untouched until the readers are forked.
    found = torch.cuda.device_count()
    if options.device == "cuda" and not found:
        raise Failure("no CUDA device was found: give --device cpu")
    device = torch.device(options.device or ("cuda" if found else "cpu"))
    answers = [(Path(bag), file) for bag, file in options.answer]
    bags = list(dict.fromkeys([*options.train, *(bag for bag, _ in answers)]))
    data = Data(bags, device, options.processes)
    task = Task(data, list(dict.fromkeys(options.train)), options)
    torch.backends.cudnn.benchmark = True
    result = {
        "size": [WIDTH, HEIGHT], "shrink_of_resnet18": options.shrink, "seed": options.seed, "batch": options.batch, "rate": options.rate,
        "untouched": options.untouched, "least_force_n": options.least_force,
        "device": torch.cuda.get_device_name() if device.type == "cuda" else f"CPU, {torch.get_num_threads()} threads",
        "torch": torch.__version__, "reading_s": data.seconds,
        "samples": task.counts, "networks": {},
    }
    say(f"training part and held out: {task.counts}")
    for name in dict.fromkeys(options.network):
        torch.manual_seed(options.seed)
        network = NETWORKS[name](options.shrink)
        parameters, macs = count(network)
        say(f"{name}: {parameters} parameters, {macs / 1e9:.3f} GMAC")
        for scale in ("offset", "scale", "centre", "spread"):
            setattr(network, scale, getattr(task, scale))
        network = network.to(device, memory_format=torch.channels_last)
        report = {"parameters": parameters, "macs": macs} | train(network, task, options)
        for bag, file in answers:
            answer(network, task, bag, file.replace("{network}", name), options)
        report["one_frame_one_thread_s"] = one_thread(network)
        result["networks"][name] = report
        write(options.out, result)
        say(f"{name}: one frame on one thread {report['one_frame_one_thread_s'] * 1e3:.1f} ms")


def main():
    # Ended by a signal, it clears what its readers left in memory.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        run(parse())
    except (Failure, OSError) as error:
        say(f"insight_pictures: {error}")
        sys.exit(1)


if __name__ == "__main__":
    main()
