"""Sub-commands that hand over to packages beside this one."""

import dataclasses
import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from coded_aperture_ros.core.errors import InputError


@dataclasses.dataclass(frozen=True)
class Extension:
    """A sub-command in a package of its own, installed or in the checkout that we run from."""

    command: str
    folder: str
    package: str
    help: str

    def prepare(self, program: str, words: Sequence[str]) -> Callable[[], int]:
        """Return what runs the sub-command with some words, for its exit status."""
        main: Callable[[Sequence[str]], int] = self.module("__main__", program).main
        return partial(main, words)

    def module(self, name: str, what: str) -> Any:
        """Return a module of the package; an `InputError` says that `what` needs it."""
        if find_spec(self.package) is None:
            folder = Path(__file__).resolve().parents[2] / self.folder
            if not (folder / self.package).is_dir():
                raise InputError(
                    f"{what}: {self.package} is not installed: in a checkout of the project, "
                    f"'pip install ./{self.folder}'"
                )
            sys.path.append(str(folder))
        try:
            return import_module(f"{self.package}.{name}")
        except ModuleNotFoundError as error:
            needed = f"{error.name}: 'pip install ./{self.folder}'"
            raise InputError(f"{what}: needs {needed}") from error


_BENCHMARKS = "benchmarks", "coded_aperture_benchmarks"
BENCH = Extension(
    "bench", *_BENCHMARKS, "measure accuracy on frames whose truth is known, and speed"
)
VIEWER = Extension(
    "view", "viewer", "coded_aperture_viewer", "show a camera, a video or a bag live in the browser"
)
