"""Threads that share the work on a frame."""

import threading
import time

import numpy as np
import pytest
from waiting import scaled

from coded_aperture_ros.core.workers import Workers, processors
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
from coded_aperture_ros.optics import Mask, render_psf_stack

two_threads = pytest.mark.skipif(processors() < 2, reason="one processor")


@pytest.fixture
def workers():
    pair = Workers(2)
    yield pair
    pair.close()


@two_threads
def test_what_is_summed_by_a_thread_is_always_the_same(workers):
    for _ in range(20):
        done = [[], []]
        workers.each(lambda item, thread, done=done: done[thread].append(item), range(9), sums=True)
        assert done == [[0, 2, 4, 6, 8], [1, 3, 5, 7]]


@two_threads
def test_whoever_is_free_takes_the_next(workers):
    done, begun = [[], []], threading.Event()

    def work(item, thread):
        done[thread].append(item)
        if item == 0:
            begun.wait(scaled(10))  # until the other one has done all the rest
        elif item == 5:
            begun.set()

    workers.each(work, range(6))
    assert sorted(map(len, done)) == [1, 5]


@two_threads
@pytest.mark.parametrize("failing", [0, 1])
def test_nobody_works_on_after_an_error_was_raised(workers, failing):
    busy = []

    def work(item, thread):
        if thread == failing:
            raise MemoryError("no room")
        busy.append(item)
        time.sleep(0.05)
        busy.remove(item)

    with pytest.raises(MemoryError):
        workers.each(work, range(4), sums=True)
    assert not busy

    def fails():
        raise MemoryError("no room")

    with pytest.raises(MemoryError):
        workers.both(fails, lambda: work(1, 1 - failing))
    assert not busy


@two_threads
@pytest.mark.parametrize("method", ["inverse", "cg"])
def test_the_same_frame_is_deblurred_to_the_same_bits(method):
    stack = render_psf_stack(Mask.named("levin"), np.arange(2.0, 9.0, 0.5))
    random = np.random.default_rng(0)
    frame = random.random((96, 128), np.float32)
    sizes = np.linspace(2, 8.5, 128, dtype=np.float32) + np.zeros((96, 1), np.float32)
    deblurrer = Deblurrer(stack, DeblurConfig(method=method, threads=2))
    first = deblurrer.deblur(frame, sizes)
    assert all(np.array_equal(first, deblurrer.deblur(frame, sizes)) for _ in range(4))
