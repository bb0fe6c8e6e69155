"""Whether a frame follows the one before it in time."""

# An earlier stamp than this is not a frame that was overtaken: time itself has gone back.
_JUMP_NS = 1_000_000_000


class StampOrder:
    """Tells frames that came late from a clock that was set back, as when a bag begins again."""

    def __init__(self) -> None:
        self._newest_ns: int | None = None

    def forget(self) -> None:
        """Take the next frame for the first."""
        self._newest_ns = None

    def follow(self, stamp_ns: int) -> str:
        """Say what a frame with this stamp is, and remember it.

        That is "next", also for the first frame, and for one without a stamp; "late" if it is older
        than the newest one by less than a second; "restart" if it is older than that.
        """
        if not stamp_ns:
            return "next"
        newest_ns, self._newest_ns = self._newest_ns, stamp_ns
        if newest_ns is None or stamp_ns >= newest_ns:
            return "next"
        if newest_ns - stamp_ns >= _JUMP_NS:
            return "restart"
        self._newest_ns = newest_ns
        return "late"
