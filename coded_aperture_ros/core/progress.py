"""How those who compute let others show how far they are."""

from collections.abc import Callable, Iterable
from typing import Any

# Takes the steps of something that takes long, and yields them one by one; `iter` shows nothing.
Progress = Callable[[Iterable[Any]], Iterable[Any]]
