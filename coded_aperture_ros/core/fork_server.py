"""The process that others are forked from."""

import multiprocessing
from multiprocessing import forkserver


def load_in_fork_server(module: str) -> None:
    """Begin to load a module into the process that others are forked from, without waiting for it.

    Its imports take a second or two: whoever is going to need processes says so first.

    Parameters
    ----------
    module : str
        Of what the processes will do.
    """
    multiprocessing.set_forkserver_preload([module])
    forkserver.ensure_running()
