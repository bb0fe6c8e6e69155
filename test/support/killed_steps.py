"""Lets a process kill itself between two steps on its files, as a power cut or `kill -9` may."""

import os
import signal
import sys

# Python's audit events of what changes folders. The exchange of two names is a call of the C
# library, which is looked up just before.
_RENAME = "os.rename"
_EXCHANGE = "renameat2"
_STEPS = {"os.remove", "os.rmdir", "os.mkdir", "os.chmod", "shutil.rmtree", "open"}


def is_naming(event, arguments, folder):
    """Whether an audit event is that a file or folder in a folder gets a name, not a hidden one."""
    if event != _RENAME:
        return event == "ctypes.dlsym" and arguments[1] == _EXCHANGE
    name = os.fsdecode(arguments[1])
    return name.startswith(str(folder)) and "/." not in name.removeprefix(str(folder))


def kill_at_step(number):
    """End this process by SIGKILL right before its step of this number (from 0)."""
    steps = 0
    process = os.getpid()

    def hook(event, arguments):
        nonlocal steps
        if os.getpid() == process and (event in _STEPS or is_naming(event, arguments, "")):
            if steps == number:
                os.kill(process, signal.SIGKILL)
            steps += 1

    sys.addaudithook(hook)


def kill_near_naming(folder, number, later):
    """End this process by SIGKILL so many steps after its naming of this number in a folder.

    0: right before it.
    """
    namings = steps = 0
    process = os.getpid()

    def hook(event, arguments):
        nonlocal namings, steps
        if os.getpid() != process:
            return
        if is_naming(event, arguments, folder):
            namings += 1
            is_due = later == 0
        elif event in _STEPS and namings > number:
            steps += 1
            is_due = steps == later
        else:
            return
        if is_due and namings > number:
            os.kill(process, signal.SIGKILL)

    sys.addaudithook(hook)
