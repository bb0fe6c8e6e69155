"""Fit the network that blends closed forms; goes on where it was stopped.

python training/blend_fit.py --pictures DIR --output DIR --minutes 50
"""

import argparse
import copy
import math
import queue
import threading
import time
from pathlib import Path

import numpy as np
import torch
from blend_network import PIXELS, Blend, blended

_BATCH, _PART = 16, 32
_RATE, _AVERAGE = 2e-3, 0.998
# What is not worth removing, as a share of the blurred frame's error.
_ENOUGH = 0.02
_SIDE = 4


def _symmetries():
    """Orders of a cell's pixels under the eight symmetries."""
    grid = np.arange(PIXELS).reshape(_SIDE, _SIDE)
    return {(flip, turn): np.rot90(grid[:, ::-1] if flip else grid, turn).ravel().copy() for flip in (0, 1) for turn in range(4)}


SYMMETRIES = _symmetries()


def load(folder, shards):
    parts = []
    for shard in shards:
        path = folder / f"pictures_{shard:04d}.npz"
        if path.exists():
            parts.append(dict(np.load(path)))
    whole = {}
    for name in list(parts[0]):
        whole[name] = np.concatenate([part.pop(name) for part in parts])
        whole[name] = whole[name].reshape(-1, *whole[name].shape[2:])
    return whole


def sample(data, index, random, augment):
    cells, maps, sharp, scale = (data[name][index] for name in ("cells", "maps", "sharp", "scale"))
    y, x = random.integers(0, scale.shape[0] - _PART + 1, 2) if augment else (0, 0)
    side = _PART if augment else scale.shape[0]
    at = np.s_[..., y : y + side, x : x + side]
    cells, maps, sharp, scale = cells[at], maps[at], sharp[at], scale[at]
    if augment:
        flip, turn = int(random.integers(2)), int(random.integers(4))
        order = SYMMETRIES[flip, turn]

        def turned(v):
            v = v[..., ::-1] if flip else v
            return np.ascontiguousarray(np.rot90(v, turn, axes=(-2, -1)))

        cells, maps, sharp, scale = map(turned, (cells, maps, sharp, scale))
        cells = cells.reshape(-1, PIXELS, side, side)[:, order].reshape(cells.shape)
        sharp = sharp[order]
        if random.random() < 0.5:
            cells, sharp = -cells, -sharp
    return [v.astype(np.float32) for v in (cells, maps, sharp, scale)]


def batches(data, random, augment=True, size=_BATCH):
    count = len(data["noise"])
    while True:
        order = random.permutation(count) if augment else np.arange(count)
        for start in range(0, count - size + 1, size):
            some = [sample(data, i, random, augment) for i in order[start : start + size]]
            yield [torch.from_numpy(np.stack(v)) for v in zip(*some)]
        if not augment:
            return


def ahead(source):
    waiting = queue.Queue(4)

    def run():
        for b in source:
            waiting.put(b)
        waiting.put(None)

    threading.Thread(target=run, daemon=True).start()
    while (b := waiting.get()) is not None:
        yield b


def loss_of(network, batch):
    cells, maps, sharp, scale = batch
    out = blended(network(torch.cat([cells, maps], 1)), cells)
    scale = scale[:, None] / scale.mean((1, 2), keepdim=True)[:, None]
    error = ((out - sharp) * scale).pow(2).mean((1, 2, 3))
    coded = ((cells[:, -PIXELS:] - sharp) * scale).pow(2).mean((1, 2, 3))
    ratio = error / (coded + 1e-4)
    # Local errors count too, in units of local contrast: plain areas must stay plain.
    local = (out - sharp).abs().mean((1, 2, 3)) / ((cells[:, -PIXELS:] - sharp).abs().mean((1, 2, 3)) + 0.02)
    return (ratio + _ENOUGH).log().mean(), local.mean(), ratio.detach()


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pictures", type=Path, required=True)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--minutes", type=float, default=50)
    parser.add_argument("--shards", type=int, nargs=2, default=(2, 400))
    parser.add_argument("--validate", type=int, nargs=2, default=(0, 2))
    parser.add_argument("--start", type=Path)
    parser.add_argument("--rate", type=float, default=_RATE)
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    torch.manual_seed(0)
    args.output.mkdir(parents=True, exist_ok=True)
    held, data = load(args.pictures, range(*args.validate)), load(args.pictures, range(*args.shards))
    print(len(data["noise"]), len(held["noise"]), flush=True)
    network = Blend()
    if args.start:
        network.load_state_dict(torch.load(args.start)["average"])
    network = network.to(memory_format=torch.channels_last)
    average = copy.deepcopy(network)
    optimizer = torch.optim.AdamW(network.parameters(), lr=args.rate, weight_decay=1e-3)
    random = np.random.default_rng(int(time.time()))
    started = reported = saved = time.perf_counter()
    step, sums = 0, []
    for batch in ahead(batches(data, random)):
        spent = (time.perf_counter() - started) / 60 / args.minutes
        if spent >= 1:
            break
        for g in optimizer.param_groups:
            g["lr"] = args.rate * min(1, (step + 1) / 200) * (0.5 + 0.5 * math.cos(math.pi * spent)) + 1e-6
        network.train()
        batch = [b.contiguous(memory_format=torch.channels_last) if b.dim() == 4 else b for b in batch]
        gain, local, _ = loss_of(network, batch)
        optimizer.zero_grad(set_to_none=True)
        (gain + 0.5 * local).backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        step += 1
        keep = min(_AVERAGE, (step + 1) / (step + 20))
        with torch.no_grad():
            for m, v in zip(average.state_dict().values(), network.state_dict().values()):
                if m.is_floating_point():
                    m.lerp_(v, 1 - keep)
        sums.append((float(gain.detach()), float(local.detach())))
        now = time.perf_counter()
        if now - reported > 60:
            print(f"{spent*args.minutes:.1f} min step {step}: dB {-4.343*np.mean([s[0] for s in sums]):.3f} local {np.mean([s[1] for s in sums]):.4f}", flush=True)
            sums, reported = [], now
        if now - saved > 240:
            save(args.output, network, average, step)
            print("held out", validated(average, held), flush=True)
            saved = time.perf_counter()
    save(args.output, network, average, step)
    print("held out", validated(average, held), flush=True)


def validated(network, held):
    network.eval()
    rs = []
    with torch.no_grad():
        for b in batches(held, np.random.default_rng(0), False, 10):
            rs.append(loss_of(network, b)[2])
    r = -10 * torch.cat(rs).log10()
    return f"estimated {float(r[0::2].mean()):.3f} dB (worst tenth {float(r[0::2].sort()[0][:len(r)//20].mean()):.2f}), true-ish {float(r[1::2].mean()):.3f} ({float(r[1::2].sort()[0][:len(r)//20].mean()):.2f})"


def save(folder, network, average, step):
    torch.save({"network": network.state_dict(), "average": average.state_dict(), "step": step}, folder / "state.part")
    (folder / "state.part").rename(folder / "state.pt")


if __name__ == "__main__":
    main()
