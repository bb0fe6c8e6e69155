"""Writes files and folders, killed right before each step of it in turn: what is left?

Arguments: folder, and which of `WRITERS`. Prints JSON: the number of steps, and what was wrong.
"""

import json
import os
import shutil
import signal
import sys
from pathlib import Path

from killed_steps import kill_at_step

from coded_aperture_ros.core import files, folders
from coded_aperture_ros.core.leftovers import remove_leftovers

OLD, NEW = {"a": "old", "b": "old"}, {"a": "new", "b": "new"}


def write_each_file(folder):
    """Write two files, one after the other."""
    for name, text in NEW.items():
        with files.atomic_output(folder / name) as path:
            path.write_text(text)


def write_files(folder):
    """Write a set of two files."""
    with files.output_set():
        for name, text in NEW.items():
            with files.atomic_output(folder / name) as path:
                path.write_text(text)


def write_folder(folder):
    """Replace a folder that has two files."""
    with folders.temporary_folder(folder / "bag") as temporary:
        new = temporary / "bag"
        new.mkdir()
        for name, text in NEW.items():
            (new / name).write_text(text)
        folders.replace_folder(new, folder / "bag")


def write_folder_in_two_steps(folder):
    """Replace a folder where names cannot be exchanged."""
    folders._exchange = lambda one, other: False
    write_folder(folder)


def content(folder):
    """Texts of the files that a folder has, by their names; hidden ones apart."""
    return {path.name: path.read_text() for path in folder.glob("[!.]*")}


def check_files(folder):
    """Raise an error unless each file is one of the two."""
    found = content(folder)
    assert found.keys() == OLD.keys(), found
    assert set(found.values()) <= {"old", "new"}, found


def check_folder(folder):
    """Raise an error unless the folder is one of the two."""
    assert content(folder / "bag") in (OLD, NEW), content(folder / "bag")
    assert [path.name for path in folder.glob("[!.]*")] == ["bag"]


def check_folder_in_two_steps(folder):
    """Raise an error unless the folder is one of the two, as soon as anything looks for it."""
    remove_leftovers(folder)
    check_folder(folder)
    assert not list(folder.glob(".*"))


WRITERS = {
    "each file": (write_each_file, check_files, "."),
    "files": (write_files, check_files, "."),
    "folder": (write_folder, check_folder, "bag"),
    "folder in two steps": (write_folder_in_two_steps, check_folder_in_two_steps, "bag"),
}


def status_of(function, *arguments):
    """Status of a process that calls a function."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            function(*arguments)
            status = 0
        finally:
            os._exit(status)
    return os.waitpid(child, 0)[1]


def killed(write, folder, step):
    """Write, and be killed before a step."""
    kill_at_step(step)
    write(folder)


def run(folder, kind):
    """Number of steps, and descriptions of what was wrong."""
    write, check, name = WRITERS[kind]
    faults = []
    step = -1
    status = signal.SIGKILL
    while status == signal.SIGKILL:
        step += 1
        place = folder / str(step)
        (place / name).mkdir(parents=True)
        for each, text in OLD.items():
            (place / name / each).write_text(text)
        status = status_of(killed, write, place, step)
        last = status_of(check, place) or status_of(write, place)
        if last or status not in (0, signal.SIGKILL) or content(place / name) != NEW:
            faults.append(f"step {step}: {status}, {last}: {content(place / name)}")
        faults += [f"step {step} left {path.name}" for path in place.glob(".*")]
        shutil.rmtree(place)
    return {"steps": step, "faults": faults}


if __name__ == "__main__":
    print(json.dumps(run(Path(sys.argv[1]), sys.argv[2])))
