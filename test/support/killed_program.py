"""Runs `coded_aperture` again and again, and kills it at a random moment: what is left?

Arguments: folder, kind (bag, learn or depth), number of kills, seed, and the words of the program,
which write `out` in the folder. Prints JSON: how many were killed, and what was found wrong.
"""

import json
import os
import random
import signal
import sys
import time
from pathlib import Path

import numpy as np

from coded_aperture_ros.bags.reading import Bag
from coded_aperture_ros.cli.main import main
from coded_aperture_ros.likelihood.bank import load_bank


def begin(words):
    """Process of the program, in a group of its own."""
    child = os.fork()
    if child == 0:
        os.setpgid(0, 0)
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)
        os._exit(main(words))
    return child


def check_bag(path):
    """Raise an error unless a bag is whole."""
    with Bag(path) as bag:
        assert sum(1 for _ in bag.messages()) > 0
        assert not bag.damage, bag.damage
    assert (path / "report" / "report.json").exists()


CHECKS = {"bag": ("out", check_bag), "learn": ("out.npz", load_bank), "depth": ("out.npy", np.load)}


def run(folder, kind, kills, seed, words):
    """Number of runs that were killed, and descriptions of what was wrong."""
    name, check = CHECKS[kind]
    chance = random.Random(seed)
    os.waitpid(begin(words), 0)  # compiles
    started_s = time.monotonic()
    _, status = os.waitpid(begin(words), 0)
    whole_s = time.monotonic() - started_s
    faults = [] if status == 0 else [f"first run ended with {status}"]
    killed = 0
    for number in range(kills):
        child = begin(words)
        # More often near the end, where names are exchanged.
        share = chance.choice([chance.random(), chance.uniform(0.8, 1.05)])
        time.sleep(share * whole_s)
        try:
            os.killpg(child, signal.SIGKILL)
        except ProcessLookupError:
            os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        killed += os.WIFSIGNALED(status)
        try:
            check(folder / name)
        except Exception as error:
            faults.append(f"kill {number}: {type(error).__name__}: {error}")
    _, status = os.waitpid(begin(words), 0)
    if status:
        faults.append(f"last run ended with {status}")
    else:
        check(folder / name)
    faults += [f"left: {path.name}" for path in folder.glob(".*")]
    return {"killed": killed, "seconds": whole_s, "faults": faults}


if __name__ == "__main__":
    folder, kind, kills, seed, *words = sys.argv[1:]
    print(json.dumps(run(Path(folder), kind, int(kills), int(seed), words)))
