"""Worker processes that end by themselves: the program says so, and does not wait for ever."""

import pytest
from lost_worker import killed_in_between

from coded_aperture_ros.bags.engine import WorkerLostError, in_order
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.processes import map_in_processes


@pytest.mark.timeout(60)
def test_a_worker_that_is_killed_while_it_sends_a_frame_is_told():
    tasks = zip(range(9), range(9), strict=True)
    with pytest.raises(WorkerLostError, match="ended by itself"):
        list(in_order(killed_in_between, tasks, processes=2, window=4))
    # The next ones have other workers.
    done = in_order(killed_in_between, [(0, 0), (1, 1)], processes=2, window=4)
    assert [item for item, _ in done] == [0, 1]


@pytest.mark.timeout(60)
def test_a_process_that_is_killed_while_it_sends_a_result_is_told():
    with pytest.raises(InputError, match="a process died"):
        map_in_processes(killed_in_between, range(9), 2, "item")
