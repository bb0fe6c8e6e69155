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
    first: tuple[str, ...] = ()  # what the package is told before the arguments
    entry: str = "__main__"  # the module whose `main` takes them

    def prepare(self, program: str, words: Sequence[str]) -> Callable[[], int]:
        """Return what runs the sub-command with some words, for its exit status."""
        main: Callable[[Sequence[str]], int] = self.module(self.entry, program).main
        return partial(main, [*self.first, *words])

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
MASK_DESIGN = Extension(
    "design",
    *_BENCHMARKS,
    "compare masks for a camera, a depth range and some light, from end to end",
    ("design",),
)
MASK_SCORE = Extension(
    "score",
    *_BENCHMARKS,
    "predict depth and deblurring error of masks",
    entry="mask_scores.command",
)
MASK_SEARCH = Extension(
    "search",
    *_BENCHMARKS,
    "look for masks with less depth and deblurring error",
    entry="mask_search.command",
)
MASK_MOTION = Extension(
    "motion",
    *_BENCHMARKS,
    "find the placement of holes that preserves most under defocus and motion",
    ("motion", "fragmentation"),
)
CALIBRATE_REFINE = Extension(
    "refine",
    *_BENCHMARKS,
    "find out from ordinary frames whether a lens was refocused, or its mask moved",
    entry="footage.command",
)
CALIBRATE_TRACE = Extension(
    "trace",
    *_BENCHMARKS,
    "trace rays through the prescription of a lens, for its PSFs",
    entry="prescription.command",
)
VIEW = Extension(
    "view", "viewer", "coded_aperture_viewer", "show a camera, a video or a bag live in the browser"
)
