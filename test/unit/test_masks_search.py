"""The search for masks: what it finds, that it goes on where it stood, and who does the work."""

import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from cli_scene import call
from waiting import scaled

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.scores.predict import MaskScorer
from coded_aperture_ros.design.scores.spectra import SceneConfig
from coded_aperture_ros.design.search.checkpoint import load_checkpoint, save_checkpoint
from coded_aperture_ros.design.search.search import (
    Front,
    SearchConfig,
    first_state,
    not_beaten,
    run_epoch,
    search_epochs,
)

SCENE = SceneConfig(levels=5)
CONFIG = SearchConfig(cells=7, islands=2, epochs=3, generations=3)
SHORT = ["--cells", "7", "--islands", "2", "--epochs", "2", "--generations", "2", "--levels", "4"]


def here(tasks):
    return [run_epoch(*task) for task in tasks]


def states(config=CONFIG, state=None):
    return list(search_epochs(config, SCENE, here, state))


def test_a_search_finds_better_masks_than_it_began_with():
    config = SearchConfig(cells=7, islands=1, epochs=4, generations=10)
    scorer = MaskScorer(SCENE)
    first = scorer.score_grids(first_state(config).islands[0].grids.astype(np.float32))
    last = states(config)[-1]
    best = scorer.score_grids(last.best[None].astype(np.float32))
    assert best.depth_error.mean() < 0.8 * np.median(first.depth_error.mean(axis=1))
    assert last.scored > 500


@pytest.mark.parametrize(
    "constraints",
    [
        {"carrier": "connected", "least_light": 0.3, "most_light": 0.5},
        {"symmetry": "point", "smallest_opening": 2},
    ],
)
def test_all_that_is_found_keeps_to_the_constraints(constraints):
    from coded_aperture_ros.design.search.grids import allowed

    config = SearchConfig(cells=8, islands=1, epochs=1, generations=4, **constraints)
    (state,) = states(config)
    grids = np.concatenate([state.front.grids, state.islands[0].grids])
    light = (config.least_light, config.most_light)
    assert allowed(grids, config.smallest_opening, light, config.carrier).all()
    if config.symmetry == "point":
        np.testing.assert_array_equal(grids, grids[:, ::-1, ::-1])


def test_impossible_constraints_are_named():
    with pytest.raises(InputError, match="almost no mask"):
        first_state(SearchConfig(cells=7, smallest_opening=4, least_light=0.0, most_light=0.1))
    with pytest.raises(InputError, match="least_light"):
        SearchConfig(least_light=0.5, most_light=0.4)


def test_the_front_keeps_what_is_not_beaten():
    scores = np.array([[1, 3, 0], [2, 2, 0], [2, 3, 0], [3, 1, 0], [3, 3, -1.0]])
    assert not_beaten(scores).tolist() == [True, True, False, True, True]
    grids = np.arange(5)[:, None, None] > np.arange(4).reshape(2, 2)
    front = Front.empty(2).with_masks(grids, scores, 3)
    assert len(front.grids) == 3
    assert front.scores[0, 0] == 1 and front.scores[:, 0].max() == 3
    again = front.with_masks(front.grids, front.scores, 3)
    np.testing.assert_array_equal(again.scores, front.scores)


def test_a_search_goes_on_where_it_stood(tmp_path):
    whole = states()
    save_checkpoint(tmp_path / "search.npz", whole[0], CONFIG, SCENE)
    loaded = load_checkpoint(tmp_path / "search.npz", CONFIG, SCENE)
    assert loaded.epoch == 1
    resumed = states(state=loaded)[-1]
    np.testing.assert_array_equal(resumed.best, whole[-1].best)
    np.testing.assert_array_equal(resumed.front.scores, whole[-1].front.scores)
    assert resumed.scored == whole[-1].scored


def test_a_checkpoint_of_another_search_is_refused(tmp_path):
    path = tmp_path / "search.npz"
    save_checkpoint(path, states()[0], CONFIG, SCENE)
    other = SearchConfig(cells=9, islands=2, epochs=3, generations=3)
    with pytest.raises(InputError, match="another search: cells 7 instead of 9"):
        load_checkpoint(path, other, SCENE)
    with pytest.raises(InputError, match="another search: levels 5 instead of 6"):
        load_checkpoint(path, CONFIG, SceneConfig(levels=6))
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(InputError, match=r"search\.npz"):
        load_checkpoint(path, CONFIG, SCENE)


def test_search_command(tmp_path, capsys):
    output, checkpoint = tmp_path / "mask.png", tmp_path / "search.npz"
    arguments = ["mask", "search", *SHORT, "-o", output, "--checkpoint", checkpoint, "--json"]
    alone = json.loads(call(capsys, *arguments, "--jobs", "1").out)
    picture = cv2.imread(str(output), cv2.IMREAD_UNCHANGED)
    rows = ["".join("#" if cell else "." for cell in row) for row in picture]
    assert rows == alone["best"]
    # Finished: nothing is left to do.
    assert json.loads(call(capsys, *arguments, "--jobs", "1").out) == alone
    other = call(capsys, *arguments, "--seed", "1")
    assert (other.status, other.out) == (1, "")
    assert "checkpoint of another search: seed 0 instead of 1" in other.err
    processes = ["mask", "search", *SHORT, "--jobs", "2", "--json"]
    assert json.loads(call(capsys, *processes).out) == alone


def test_a_scheduler_that_does_not_answer_is_named(capsys):
    pytest.importorskip("distributed")
    result = call(capsys, "mask", "search", *SHORT, "--scheduler", "nothing-here")
    assert result.status == 1
    assert "--scheduler nothing-here: no Dask scheduler answers" in result.err


@pytest.mark.slow
def test_nothing_is_lost_when_a_worker_is_killed(capsys):
    distributed = pytest.importorskip("distributed")
    root = Path(__file__).resolve().parents[2]  # workers need what the search is made of
    long = [*SHORT[:-4], "--epochs", "6", "--generations", "12", "--levels", "4"]
    alone = json.loads(call(capsys, "mask", "search", *long, "--jobs", "1", "--json").out)
    with distributed.LocalCluster(
        n_workers=0, dashboard_address=None, host="127.0.0.1", processes=True
    ) as cluster:
        address = cluster.scheduler_address
        workers = [
            subprocess.Popen(
                [sys.executable, "-m", "distributed.cli.dask_worker", address, "--no-nanny",
                 "--nthreads", "1", "--no-dashboard"],
                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                env=os.environ | {"PYTHONPATH": f"{root}{os.pathsep}{root / 'benchmarks'}"},
            )
            for _ in range(2)
        ]  # fmt: skip
        try:
            with distributed.Client(address) as client:
                client.wait_for_workers(2, timeout=scaled(60))

            def kill_one():
                time.sleep(0.5)
                workers[0].kill()

            killer = threading.Thread(target=kill_one)
            killer.start()
            result = call(capsys, "mask", "search", *long, "--scheduler", address, "--json")
            killer.join()
            assert workers[0].wait(scaled(10)) != 0
            assert workers[1].poll() is None
        finally:
            for worker in workers:
                worker.kill()
                worker.wait()
    assert json.loads(result.out) == alone
