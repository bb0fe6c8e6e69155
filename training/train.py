"""Fit one of the networks of the package, step by step; what is done already is not done again.

tasks:
  refinement   decides the depth
  teacher      a large network that the refinement learns from; fit it before
  blend        makes sharp pictures of hypotheses of deblurring
  second       tells two surfaces in one window
  check        tells whether frames fit the filter bank

steps, in this order:
  data         make what is learned from, in shards
  fit          fit for some minutes; goes on where it was stopped
  export       write the weights' file
  quantise     add the form in whole numbers for ONNX Runtime (refinement, blend)
  calibrate    fit the constants of the weights' file (refinement, second)

example:
  python training/train.py refinement data fit export quantise --folder build/training --minutes 75
"""

import argparse
import dataclasses
import importlib
import os
from collections.abc import Callable
from pathlib import Path

# Before NumPy is loaded: processes share the cores, not the work of one product.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from costs import COSTS
from misfits import MISFITS_DATA
from pictures import PICTURES
from shards import Data, expand_pairs, make
from task import Options, Task
from weights_file import package_weights, read_weights, write_weights
from windows import WINDOWS


@dataclasses.dataclass(frozen=True)
class Plan:
    """Where a task is, what it learns from, and how long.

    Attributes
    ----------
    task : str
        Module and class; PyTorch is loaded with it.
    data : Data
    shards, held_back : tuple of int
        See `expand_pairs`; what is held back is only scored.
    minutes : float
    steps : tuple of str
        Those that the task has.
    weights : str
        Name of the weights' file.
    """

    task: str
    data: Data
    shards: tuple[int, ...]
    held_back: tuple[int, ...]
    minutes: float
    steps: tuple[str, ...]
    weights: str = ""

    def make_task(self) -> Task:
        """The task; needs PyTorch."""
        module, _, name = self.task.partition(".")
        task: Task = getattr(importlib.import_module(module), name)()
        return task


TASKS = {
    "refinement": Plan(
        task="refinement.RefinementTask",
        data=COSTS,
        shards=(0, 80),
        held_back=(0, 4),
        minutes=75,
        steps=("data", "fit", "export", "quantise", "calibrate"),
        weights="refinement.npz",
    ),
    "teacher": Plan(
        task="refinement.TeacherTask",
        data=COSTS,
        shards=(0, 80),
        held_back=(0, 4),
        minutes=75,
        steps=("data", "fit"),
    ),
    "blend": Plan(
        task="blend.BlendTask",
        data=PICTURES,
        shards=(0, 120),
        held_back=(0, 2),
        minutes=45,
        steps=("data", "fit", "export", "quantise"),
        weights="blend.npz",
    ),
    # Scenes of all kinds: ordinary ones, rare ones, and nets, leaves and panes before rooms.
    "second": Plan(
        task="second.SecondTask",
        data=WINDOWS,
        shards=(4, 30, 84, 106, 200, 260),
        held_back=(28, 30, 104, 106, 258, 260),
        minutes=22,
        steps=("data", "fit", "export", "calibrate"),
        weights="second.npz",
    ),
    # One shard in eight is held back.
    "check": Plan(
        task="check.CheckTask",
        data=MISFITS_DATA,
        shards=(0, 32, 200, 216),
        held_back=(7, 8, 15, 16, 23, 24, 31, 32, 207, 208, 215, 216),
        minutes=30,
        steps=("data", "fit", "export"),
        weights="fit.npz",
    ),
}


def make_data(plan: Plan, options: Options) -> None:
    """Make the shards that are missing."""
    shards = sorted({*options.shards, *options.held_back})
    make(plan.data, options.folder, shards, options.processes, options.scheduler)


def fit(plan: Plan, options: Options) -> None:
    """Fit the network, and keep what was reached every few minutes."""
    import torch
    from states import averaged_weights, check_device

    from coded_aperture_ros.calibration.fine_tuning.loop import Fit

    check_device(options.device)
    torch.set_num_threads(options.threads)
    torch.manual_seed(0)
    problem = plan.make_task().problem(options)
    start = averaged_weights(options.start) if options.start else None
    Fit(problem, options.state, start, options.device).run()


def export(plan: Plan, options: Options) -> None:
    """Write the weights' file anew."""
    from states import averaged_weights

    task = plan.make_task()
    fitted = averaged_weights(options.state)
    write_weights(options.weights, task.module, task.arrays(fitted, options))


def quantise(plan: Plan, options: Options) -> None:
    """Add the form in whole numbers to the weights' file, by frames that were learned from."""
    from networks import quantised

    task = plan.make_task()
    arrays = read_weights(options.weights, task.module)
    with package_weights(options.weights, task.module):
        inputs = task.quantisation_inputs(options)
    for name, given in inputs.items():
        arrays[f"{name}_int8"] = quantised(arrays[f"{name}_onnx"], given, task.exact)
    write_weights(options.weights, task.module, arrays)


def calibrate(plan: Plan, options: Options) -> None:
    """Fit the constants in the weights' file."""
    task = plan.make_task()
    arrays = read_weights(options.weights, task.module)
    write_weights(options.weights, task.module, arrays | task.calibration(options))


STEPS: dict[str, Callable[[Plan, Options], None]] = {
    "data": make_data,
    "fit": fit,
    "export": export,
    "quantise": quantise,
    "calibrate": calibrate,
}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("task", choices=TASKS)
    add("steps", nargs="+", choices=STEPS, metavar="step", help=", ".join(STEPS))
    add("--folder", type=Path, default=Path("build/training"), help="of all files: %(default)s")
    pairs = "FIRST END pairs, as in 0 80 84 106; default: the task's"
    add("--shards", type=int, nargs="+", metavar="N", help=f"what is learned from: {pairs}")
    add("--held-back", type=int, nargs="*", metavar="N", help=f"what is only scored: {pairs}")
    add("--weights", type=Path, help="weights' file; default: in the folder, as the package's")
    cores = os.cpu_count() or 1
    data = parser.add_argument_group("data, calibrate")
    data.add_argument("--processes", type=int, default=cores, help="default: %(default)s")
    data.add_argument(
        "--scheduler",
        default="",
        metavar="ADDRESS",
        help="Dask scheduler whose workers make the data instead of processes here",
    )
    data.add_argument(
        "--frames", type=int, default=240, help="that calibrate looks at: %(default)s"
    )
    group = parser.add_argument_group("fit")
    group.add_argument("--minutes", type=float, help="default: the task's")
    group.add_argument("--rate", type=float, help="of learning; default: the task's")
    group.add_argument("--threads", type=int, default=cores, help="default: %(default)s")
    group.add_argument("--device", default="cpu", help="as PyTorch names it: %(default)s, cuda")
    group.add_argument("--start", type=Path, metavar="PT", help="state of a fit to start from")
    group.add_argument(
        "--further",
        type=Path,
        metavar="NPZ",
        help="weights' file to fit further (refinement, second, check); refinement: it teaches "
        "what is not rare, and export takes the mean of the weights before and after; check: half "
        "of its networks stay as they are",
    )
    group.add_argument("--truth-only", action="store_true", help="refinement: no teacher")
    group.add_argument(
        "--least-told",
        type=float,
        default=0.15,
        help="refinement: leave out frames whose costs are right in less of the patches: "
        "%(default)s",
    )
    return parser


def main(arguments: list[str] | None = None) -> None:
    """Run the steps of a task, one after the other."""
    parser = _parser()
    given = vars(parser.parse_args(arguments))
    task, steps = given.pop("task"), given.pop("steps")
    plan, folder = TASKS[task], given["folder"]
    for step in steps:
        if step not in plan.steps:
            parser.error(f"{task} has the steps {', '.join(plan.steps)}, not {step}")
    defaults = vars(plan) | {"weights": folder / plan.weights}
    for name in ("shards", "held_back", "minutes", "weights"):
        given[name] = defaults[name] if given[name] is None else given[name]
    for name in ("held_back", "shards"):
        if len(given[name]) % 2:
            parser.error(f"--{name.replace('_', '-')}: expected pairs, FIRST END")
        given[name] = tuple(expand_pairs(given[name]))
    given["shards"] = tuple(shard for shard in given["shards"] if shard not in given["held_back"])
    name = f"{task}_further" if given["further"] else task
    given["state"] = folder / "state" / f"{name}.pt"
    options = Options(**given)
    for step in steps:
        STEPS[step](plan, options)


if __name__ == "__main__":
    main()
