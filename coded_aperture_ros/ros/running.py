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
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
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
        spinner = ExecutorThread(executor, "executor", ended=stop.event)
        stop.event.wait()
        for node in nodes:
            node.close()
        spinner.stop()
        if spinner.failed:
            stop.status = 1
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
        endings.callback(ExecutorThread(executor, thread).stop)
        yield node


class ExecutorThread:
    """Thread that runs the callbacks of an executor until `stop`, or until one of them fails.

    `Executor.shutdown` of another thread takes away what `Executor.spin` is about to wait for, and
    it does not wait for the callback in work. So here the thread ends first.

    Parameters
    ----------
    executor : rclpy.executors.Executor
    name : str
        Of the thread.
    ended : threading.Event, optional
        Set when the thread ends.

    Attributes
    ----------
    failed : bool
        Whether a callback raised an error, which is then on stderr.
    """

    def __init__(self, executor: Executor, name: str, ended: threading.Event | None = None) -> None:
        self.failed = False
        self._executor = executor
        self._stopped = False
        self._ended = ended or threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Wait for the callback in work, end the thread and shut the executor down."""
        self._executor.create_task(self._set_stopped)
        self._thread.join()
        self._executor.shutdown()

    def _set_stopped(self) -> None:
        self._stopped = True

    def _run(self) -> None:
        try:
            while self._executor.context.ok() and not self._stopped:
                self._executor.spin_once()
        except ExternalShutdownException:
            pass
        except Exception:
            traceback.print_exc()
            self.failed = True
        finally:
            self._ended.set()


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
