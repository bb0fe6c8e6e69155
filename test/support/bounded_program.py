"""Runs `coded_aperture` once for each line of words (JSON), each in a process of its own with
little memory, and prints what it did: status, errors, seconds, and bytes that it grew by.

Argument: largest address space, GiB.
"""

import faulthandler
import importlib
import json
import os
import re
import resource
import sys
import tempfile
import time
from pathlib import Path

# As the program sets it before it imports OpenCV.
os.environ["OPENCV_LOG_LEVEL"] = "SILENT"

from coded_aperture_ros.cli.main import main
from coded_aperture_ros.core.figures import new_figure

# What hangs is ended, and says where.
LONGEST_S = 12
WANTED = ("bags.conversion", "cli.bag", "cli.depth", "cli.learn", "io.picture_file")


def resident(which):
    """Bytes of memory, now (VmRSS) or at most since it was set back (VmHWM)."""
    status = Path("/proc/self/status").read_text()
    return int(re.search(rf"{which}:\s+(\d+)", status)[1]) * 1024


def run(words, address_space):
    """What a program did."""
    with tempfile.TemporaryFile("w+") as errors:
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            os.dup2(errors.fileno(), 2)
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            resource.setrlimit(resource.RLIMIT_AS, (address_space,) * 2)
            Path("/proc/self/clear_refs").write_text("5")
            before = resident("VmRSS")
            started_s = time.monotonic()
            status = -1
            faulthandler.dump_traceback_later(LONGEST_S, exit=True)
            try:
                status = main(words)
            finally:
                figures = [status, time.monotonic() - started_s, resident("VmHWM") - before]
                os.write(writing, json.dumps(figures).encode())
                sys.stderr.flush()
                if status == -1:
                    import traceback

                    traceback.print_exc()
                    sys.stderr.flush()
                os._exit(0)
        os.close(writing)
        with os.fdopen(reading) as pipe:
            text = pipe.read()
        os.waitpid(child, 0)
        status, seconds, growth = json.loads(text) if text else [-2, 0, 0]
        errors.seek(0)
        return {"status": status, "seconds": seconds, "growth": growth, "errors": errors.read()}


if __name__ == "__main__":
    for name in WANTED:
        importlib.import_module(f"coded_aperture_ros.{name}")
    new_figure(1, 1)  # imports much, too
    for line in sys.stdin:
        print(json.dumps(run(json.loads(line), int(sys.argv[1]) * 2**30)), flush=True)
