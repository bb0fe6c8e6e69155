"""The demo's processes, and the network that they have to themselves."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.machine import processor_time_s

_LAST_LINES = 15
_END_TIMEOUT_S = 5.0
# Niceness counts only within a session (Linux autogroups), so the nodes stay in this one; Ctrl-C
# then reaches them too, which they take as it is meant. With 19 a busy computer would leave
# deblurring nothing.
_NICENESS = {"deblur_node": 5}


class Children(AbstractContextManager["Children"]):
    """The nodes' processes; none of them outlives the `with` block."""

    def __init__(self, log_folder: Path) -> None:
        self._log_folder = log_folder
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    def __exit__(self, *_: object) -> None:
        for process in self._processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        deadline = time.monotonic() + _END_TIMEOUT_S
        for process in self._processes.values():
            try:
                process.wait(max(0.1, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def start(self, node: str, parameters: dict[str, Any]) -> None:
        """Start a node in a process of its own."""
        command = [sys.executable, "-m", "coded_aperture_ros.ros.programs", node, "--ros-args"]
        for name, value in parameters.items():
            command += ["-p", f"{name}:={json.dumps(value)}"]
        with self._log(node).open("wb") as log:
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT
            )
        self._processes[node] = process
        os.setpriority(os.PRIO_PROCESS, process.pid, _NICENESS.get(node, 0))

    def check(self) -> None:
        """Raise an `InputError` with the last lines of a node that has ended."""
        for node, process in self._processes.items():
            if process.poll() is not None:
                raise InputError(f"{node} ended with status {process.returncode}:{self.said(node)}")

    def processor_s(self) -> dict[str, float]:
        """Processor time that each node has taken so far, s."""
        return {
            node: processor_time_s(process.pid)
            for node, process in self._processes.items()
            if process.poll() is None
        }

    def end(self, node: str) -> None:
        """End one node; it is not checked any more."""
        process = self._processes[node]
        process.send_signal(signal.SIGINT)
        try:
            process.wait(_END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        del self._processes[node]

    def said(self, node: str) -> str:
        """Return the last lines that a node has written."""
        lines = self._log(node).read_text(errors="replace").splitlines()[-_LAST_LINES:]
        return "".join(f"\n    {line}" for line in lines)

    def _log(self, node: str) -> Path:
        return self._log_folder / f"{node}.log"
