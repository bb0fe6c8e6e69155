"""The machine's speed, and who takes its processors."""

import os
import time

import pytest

from coded_aperture_ros.cli.demo_cores import OTHERS, SUBSCRIBER, SharedCores
from coded_aperture_ros.core.machine import BusyTime, processor_time_s, product_rates


def _work(seconds):
    ends_s = time.process_time() + seconds
    while time.process_time() < ends_s:
        sum(range(10_000))


def test_matrix_products_have_a_rate():
    rates = product_rates(1)
    assert len(rates) > 1 and all(0.1 < rate < 100_000 for rate in rates)


def test_processor_time_of_a_process_grows_with_its_work():
    before_s = processor_time_s(os.getpid())
    _work(0.2)
    assert processor_time_s(os.getpid()) - before_s == pytest.approx(0.2, abs=0.1)


def test_shares_are_told_apart():
    node_s = {"depth_node": 1.0}
    cores, busy = SharedCores(lambda: dict(node_s)), BusyTime.now()
    _work(0.3)
    node_s["depth_node"] += 0.03
    shares = cores.shares()
    assert list(shares) == ["depth_node", SUBSCRIBER, OTHERS]
    assert shares[SUBSCRIBER] > shares["depth_node"] > 0 <= shares[OTHERS]
    assert busy.cores() > 0
