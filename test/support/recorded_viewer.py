"""The viewer's server, of which a page asks for a recording and a snapshot; and checks of both."""

import asyncio
from collections import Counter

import numpy as np
from live_viewer import client, serving, viewer_options

from coded_aperture_ros.bags.reading import Bag
from coded_aperture_ros.io import read_image

_SNAPSHOT = {"coded.png", "depth.npy", "std_dev.npy", "confidence.npy", "points.ply"}
_FRAMES = 2
# Names of what was whole before.
_kept: set[str] = set()


def recorder(folder):
    """Return a program that records some frames, with a snapshot meanwhile."""
    options = viewer_options(folder, output=folder / "out")

    async def record():
        async with serving(options) as served, client(served) as page:
            await page.shown()
            await page.send({"do": "record"})
            await page.told(lambda message: (message.get("recorded") or 0) >= _FRAMES)
            await page.send({"do": "snapshot"})
            await page.told(lambda message: "snapshot" in message.get("said", ""))
            await page.send({"do": "record"})
            await page.told(lambda message: message.get("said", "").endswith(" frames"))

    def run():
        asyncio.run(record())
        return 0

    return run


def check_kept(output):
    """Raise an error unless every recording and snapshot is whole, and none is lost."""
    names = {path.name for path in output.iterdir() if not path.name.startswith(".")}
    assert _kept <= names, f"lost: {_kept - names}"
    for name in names - _kept:
        if name.startswith("recording-"):
            _check_recording(output / name)
        else:
            _check_snapshot(output / name)
    _kept.update(names)


def _check_recording(path):
    with Bag(path) as bag:
        counts = Counter(message.topic for message in bag.messages())
        assert not bag.damage, bag.damage
    assert counts["/image_raw"] == counts["/camera_info"] >= _FRAMES


def _check_snapshot(path):
    names = {each.name for each in path.iterdir()}
    assert names >= _SNAPSHOT, f"{path.name} has {names}"
    assert read_image(path / "coded.png").ndim >= 2
    for each in path.glob("*.npy"):
        assert np.load(each).ndim == 2
