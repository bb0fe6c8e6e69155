"""The environment for programs that run in another Python than the wheels of rclpy here."""

import os
import sys
from collections.abc import Callable
from pathlib import Path


def clean_environment() -> dict[str, str]:
    """Return the environment for a program that runs in *another* Python environment.

    The wheels point LD_LIBRARY_PATH at their own libraries and leave a guard variable that keeps
    the other environment's wheels from doing so; AMENT_PREFIX_PATH names this environment. What
    the user put into these variables stays.
    """
    environment = dict(os.environ)
    if environment.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None) is not None:
        _remove(environment, "LD_LIBRARY_PATH", _is_inside_this_environment)
    _remove(environment, "AMENT_PREFIX_PATH", lambda entry: entry == sys.prefix)
    return environment


def _is_inside_this_environment(entry: str) -> bool:
    prefix = Path(sys.prefix)
    return Path(entry) == prefix / "lib" or (
        Path(entry).is_relative_to(prefix.resolve()) and Path(entry).name.startswith("ros_")
    )


def _remove(environment: dict[str, str], name: str, unwanted: Callable[[str], bool]) -> None:
    kept = [entry for entry in _split(environment.get(name)) if not unwanted(entry)]
    if kept:
        environment[name] = os.pathsep.join(kept)
    else:
        environment.pop(name, None)


def _split(variable: str | None) -> list[str]:
    return [entry for entry in (variable or "").split(os.pathsep) if entry]
