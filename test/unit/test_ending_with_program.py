"""Processes that share work end with their program, however that ends."""

import subprocess
import sys
from pathlib import Path

import pytest
from waiting import wait_until

PROGRAM = """
import multiprocessing, time
from concurrent.futures import ProcessPoolExecutor
from coded_aperture_ros.core.processes import {set_up}
if __name__ == "__main__":
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context, {set_up}) as pool:
        pool.submit(int).result()
        print(multiprocessing.active_children()[0].pid, flush=True)
        time.sleep(60)
"""


@pytest.mark.parametrize("set_up", ["end_with_program", "_set_up"])
def test_a_process_of_a_killed_program_ends(tmp_path, set_up):
    file = tmp_path / "program.py"
    file.write_text(PROGRAM.format(set_up=set_up))
    program = subprocess.Popen([sys.executable, file], stdout=subprocess.PIPE, text=True)
    worker = int(program.stdout.readline())
    assert Path(f"/proc/{worker}").exists()
    program.kill()
    program.communicate()
    assert wait_until(lambda: not Path(f"/proc/{worker}").exists())
