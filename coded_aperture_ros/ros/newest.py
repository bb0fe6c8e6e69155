"""Work on the newest item only: what a real-time node does instead of queueing."""

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Item = TypeVar("Item")


class NewestWorker(Generic[Item]):
    """A thread that always works on the newest item offered.

    There is room for one waiting item. A newer one replaces it, and the replaced one is lost:
    a node slower than its input falls behind by one item at most, never by a queue.

    `work` is called with an item, in the worker's thread, and must not raise; `dropped` in the
    thread that offers, whenever an item is replaced.
    """

    def __init__(
        self, work: Callable[[Item], None], dropped: Callable[[], None], name: str = "worker"
    ) -> None:
        self._work = work
        self._dropped = dropped
        self._change = threading.Condition()
        self._waiting: Item | None = None
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def offer(self, item: Item) -> None:
        """Leave an item for the worker and return at once."""
        with self._change:
            replaced = self._waiting is not None
            self._waiting = item
            self._change.notify()
        if replaced:
            self._dropped()

    def stop(self, timeout_s: float | None = None) -> bool:
        """Forget what waits; wait for the item in work, or for some time; return if it is done."""
        with self._change:
            self._stopping = True
            self._waiting = None
            self._change.notify()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while True:
            with self._change:
                self._change.wait_for(lambda: self._stopping or self._waiting is not None)
                if self._stopping:
                    return
                item, self._waiting = self._waiting, None
            assert item is not None  # the condition above waits for it
            self._work(item)
