"""The thread of an executor: how it ends."""

import threading

import pytest

pytest.importorskip("rclpy")

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

from coded_aperture_ros.ros.running import ExecutorThread

NAME = "executor of a test"


class Watched(SingleThreadedExecutor):
    """An executor that knows whether its thread was alive when it was shut down."""

    alive = None

    def shutdown(self, timeout_sec=None):
        self.alive = any(thread.name == NAME for thread in threading.enumerate())
        return super().shutdown(timeout_sec)


@pytest.fixture
def executor():
    context = Context()
    rclpy.init(context=context)
    yield Watched(context=context)
    context.try_shutdown()


def test_thread_ends_before_the_executor(executor):
    ended = threading.Event()
    thread = ExecutorThread(executor, NAME, ended)
    thread.stop()
    assert executor.alive is False
    assert ended.is_set()
    assert not thread.failed


def test_callback_in_work_is_waited_for(executor):
    began, goes_on, done = threading.Event(), threading.Event(), threading.Event()

    def callback():
        began.set()
        goes_on.wait()
        done.set()

    thread = ExecutorThread(executor, NAME)
    executor.create_task(callback)
    assert began.wait(30.0)
    threading.Timer(0.2, goes_on.set).start()
    thread.stop()
    assert done.is_set()


def test_callback_that_fails_ends_the_thread(executor, capsys):
    ended = threading.Event()
    thread = ExecutorThread(executor, NAME, ended)
    executor.create_task(lambda: 1 // 0)
    assert ended.wait(30.0)
    thread.stop()
    assert thread.failed
    assert "ZeroDivisionError" in capsys.readouterr().err


def test_context_that_is_shut_down_ends_the_thread(executor):
    ended = threading.Event()
    thread = ExecutorThread(executor, NAME, ended)
    executor.context.try_shutdown()
    assert ended.wait(30.0)
    assert not thread.failed
    thread.stop()
