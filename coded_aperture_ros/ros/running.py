"""Executors of nodes: of a program until it is stopped, or in a thread beside one."""

import contextlib
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from coded_aperture_ros.core.errors import InputError

_Node = TypeVar("_Node", bound=Node)


def run_nodes(factories: Sequence[Callable[[], Any]]) -> int:
    """Run nodes in this process until SIGINT or SIGTERM; return the exit status.

    The callbacks of all nodes share one executor thread: they only hand over the newest message,
    the work is done in each node's own thread. At the end first the work stops, then the
    middleware, so that nothing is published on a context that has been shut down.

    Parameters
    ----------
    factories : sequence of callable
        Each makes one node, whose method `close` ends its own threads.

    Returns
    -------
    int
        0 after a signal; 1 if a node could not start (one line is on stderr), or a callback failed.
    """
    stop = _StopSignal()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop.on_signal)
    nodes: list[Any] = []
    try:
        try:
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        except RuntimeError as error:  # the base of rclpy's own errors, which are private
            raise InputError(f"cannot start ROS: {str(error).splitlines()[0]}") from error
        executor = SingleThreadedExecutor()
        for factory in factories:
            nodes.append(factory())
            executor.add_node(nodes[-1])
        stop.starting = False
        spinner = threading.Thread(target=_spin, args=(executor, stop), name="executor")
        spinner.start()
        stop.event.wait()
        for node in nodes:
            node.close()
        executor.shutdown()
        spinner.join()
    except InputError as error:
        program = Path(sys.argv[0]).name.removesuffix(".py")
        sys.stderr.write(f"{program}: error: {error}\n")
        stop.status = 1
    finally:
        stop.starting = False
        for node in nodes:
            node.close()
            node.destroy_node()
        rclpy.try_shutdown()
        # Python removes its handlers before it has ended: a second Ctrl-C would then look like a
        # crash.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
    return stop.status


@contextlib.contextmanager
def node_in_thread(make: Callable[[Context], _Node], thread: str) -> Iterator[_Node]:
    """Run a node in a thread and a context of its own; Ctrl-C is left to the program."""
    context = Context()
    with contextlib.ExitStack() as endings:
        endings.callback(context.try_shutdown)
        rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
        node = make(context)
        endings.callback(node.destroy_node)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)

        def spin() -> None:
            with contextlib.suppress(ExternalShutdownException):
                executor.spin()

        spinner = threading.Thread(target=spin, name=thread, daemon=True)
        spinner.start()
        endings.callback(spinner.join, 5.0)
        endings.callback(executor.shutdown)
        yield node


class _StopSignal:
    """Event that ends the program, and its exit status."""

    def __init__(self) -> None:
        self.event = threading.Event()
        self.status = 0
        self.starting = True

    def on_signal(self, *_: Any) -> None:
        self.event.set()
        if self.starting:  # do not wait for the nodes: learning a bank takes seconds
            self.starting = False  # a second signal must not interrupt the shutdown
            raise SystemExit(0)


def _spin(executor: SingleThreadedExecutor, stop: _StopSignal) -> None:
    try:
        executor.spin()
    except ExternalShutdownException:
        pass
    except Exception:
        traceback.print_exc()
        stop.status = 1
    finally:
        stop.event.set()
