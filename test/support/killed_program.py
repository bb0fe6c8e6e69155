"""Runs a program again and again, and kills it: what is left?

Arguments: the folder, the kind (a command of `coded_aperture`, or `record`), the number
of kills, a seed, and the words of the command, which writes `out` in the folder. Half of the kills
are at random moments, half around the moments when files get their names. Prints JSON: how many
were killed, and what was found wrong.
"""

import ctypes
import json
import os
import random
import signal
import sys
import tempfile
import time
import traceback
from contextlib import suppress
from pathlib import Path

import numpy as np
from killed_steps import is_naming, kill_near_naming

from coded_aperture_ros.bags.reading import Bag
from coded_aperture_ros.cli.main import main
from coded_aperture_ros.likelihood.bank import load_bank

# Steps after a naming at which a process is killed; 0: before it.
LATER = (0, 1, 3)
# What a killed program has started ends by itself within this time, s.
LONGEST_END_S = 20.0

_SET_CHILD_SUBREAPER = 36


class Program:
    """A program that is run in processes of its own, and its output."""

    def __init__(self, folder, kind, words):
        self.folder = folder
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115  closed with the process
        if kind == "record":
            from recorded_viewer import check_kept, recorder

            self._main = recorder(folder)
            self.check = lambda: check_kept(folder / "out")
        else:
            check, name = CHECKS[kind]
            self._main = lambda: main([kind, *words])
            self.check = lambda: check(folder / name)

    def begin(self, prepare=lambda: None):
        """Process of the program, in a group of its own."""
        self._errors.seek(0)
        self._errors.truncate()
        child = os.fork()
        if child:
            with suppress(PermissionError):  # the child has done it
                os.setpgid(child, child)
            return child
        os.setpgid(0, 0)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(self._errors.fileno(), 2)
        status = 1
        try:
            prepare()
            status = self._main()
        except BaseException:
            traceback.print_exc()
        sys.stderr.flush()
        os._exit(status)

    def end(self, child):
        """How a process has ended, unless well or by SIGKILL, and whether it was killed."""
        _, status = os.waitpid(child, 0)
        if status == signal.SIGKILL:
            return "", True
        if status == 0:
            return "", False
        self._errors.seek(0)
        return f"status {os.waitstatus_to_exitcode(status)}: {self._errors.read()}", False

    def namings(self):
        """Number of namings of a run, and what is wrong with it."""
        reading, writing = os.pipe()
        child = self.begin(lambda: self._count_namings(writing))
        os.close(writing)
        with os.fdopen(reading, "rb") as pipe:
            count = len(pipe.read())
        fault, _ = self.end(child)
        return count, [fault] if fault else []

    def _count_namings(self, pipe):
        process = os.getpid()

        def hook(event, arguments):
            if os.getpid() == process and is_naming(event, arguments, self.folder):
                os.write(pipe, b".")

        sys.addaudithook(hook)

    def faults(self, what):
        """What is wrong with the output."""
        try:
            self.check()
        except Exception as error:
            return [f"{what}: {type(error).__name__}: {error}"]
        return []


def check_bag(path):
    """Raise an error unless a bag is whole."""
    with Bag(path) as bag:
        assert sum(1 for _ in bag.messages()) > 0
        assert not bag.damage, bag.damage
    assert json.loads((path / "report" / "report.json").read_text())


def check_depth(path):
    """Raise an error unless every map is whole."""
    for each in path.parent.glob("out*.npy"):
        assert np.load(each).ndim == 2
    assert path.exists()


CHECKS = {
    "bag": (check_bag, "out"),
    "learn": (load_bank, "out.npz"),
    "depth": (check_depth, "out.npy"),
}


def wait_for_group(group):
    """Whether all processes of a group have ended by themselves."""
    ends_s = time.monotonic() + LONGEST_END_S
    while time.monotonic() < ends_s:
        try:
            os.waitpid(-group, os.WNOHANG)
        except ChildProcessError:
            return True
        time.sleep(0.02)
    os.killpg(group, signal.SIGKILL)
    return False


def run(folder, kind, kills, seed, words):
    """Number of runs that were killed, and descriptions of what was wrong."""
    program = Program(folder, kind, words)
    chance = random.Random(seed)
    namings, faults = program.namings()
    started_s = time.monotonic()
    fault, _ = program.end(program.begin())
    whole_s = time.monotonic() - started_s
    faults += [fault] if fault else []
    points = [(number, later) for number in range(namings) for later in LATER]
    chance.shuffle(points)
    killed = 0
    for number in range(3 * kills):  # some runs end before they are killed
        if killed == kills:
            break
        if number % 2 and points:
            point = points[number // 2 % len(points)]
            what = f"naming {point[0]}, step {point[1]}"
            child = program.begin(lambda point=point: kill_near_naming(folder, *point))
        else:
            # More often near the end, where names are exchanged.
            share = chance.choice([chance.random(), chance.uniform(0.8, 1.05)])
            what = f"{share:.2f} of its time"
            child = program.begin()
            time.sleep(share * whole_s)
            os.killpg(child, signal.SIGKILL)
        fault, was_killed = program.end(child)
        killed += was_killed
        faults += [f"{what}: {fault}"] if fault else []
        if not wait_for_group(child):
            faults.append(f"{what}: processes go on")
        faults += program.faults(what)
    fault, _ = program.end(program.begin())
    faults += [f"last run: {fault}"] if fault else []
    faults += program.faults("last run")
    faults += [f"left: {path}" for path in folder.rglob(".*")]
    return {"killed": killed, "namings": namings, "seconds": whole_s, "faults": faults}


if __name__ == "__main__":
    # What a killed program has started becomes a child of this one.
    ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1)
    folder, kind, kills, seed, *words = sys.argv[1:]
    print(json.dumps(run(Path(folder), kind, int(kills), int(seed), words)))
