"""The viewer's page in every state: it fits the window, everybody can use it, and it measures."""

import asyncio
import itertools

import cv2
import numpy as np
import pytest

pytest.importorskip("aiohttp", reason="the viewer needs aiohttp")

from coded_aperture_viewer.live import Shown
from coded_aperture_viewer.presets import PRESETS
from coded_aperture_viewer.ray_grid import ray_grid
from coded_aperture_viewer.settings import LookConfig, Settings
from live_page import CHROMIUM, page_at
from live_viewer import BlockedSource, client, serving, viewer_options
from page_checks import beyond_the_window, findings, scrolls_down, set_display
from small_camera import FAR_M, NEAR_M
from waiting import scaled

from coded_aperture_ros.deblur import DeblurConfig
from coded_aperture_ros.depth import DepthConfig, DepthEstimate
from coded_aperture_ros.io import read_image
from coded_aperture_ros.optics import Intrinsics
from coded_aperture_ros.sources import Capture, open_source

needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
TWO_ENDS = "addEnd([0.3, 0.5]); addEnd([0.7, 0.6])"
STATES = {
    "depth": "enlarge('depth')",
    "frame": "enlarge('frame')",
    "confidence": "enlarge('confidence')",
    "deviation": "trust.value = 'deviation'; trust.onchange()",
    "picture": "enlarge('picture')",
    "points": "enlarge('points')",
    "distance": f"enlarge('depth'); setTool('distance'); {TWO_ENDS}",
    "profile": f"setTool('profile'); {TWO_ENDS}",
    "message": "say('recorded /a/very/long/path' + '/folder'.repeat(30), 'told')",
    "warning": "say('the frames do not fit the bank: ' + 'cause '.repeat(40), 'warning')",
    "setting up": "document.querySelector('#aid').open = true",
    "help": "document.querySelector('#help-open').click()",
}


def on_page(use, folder, options):
    """Run a coroutine function on a page in a browser, and on its server."""

    async def main():
        (folder / "browser").mkdir()
        async with (
            serving(options) as served,
            page_at(f"http://localhost:{served.port}/", folder / "browser") as page,
        ):
            await page.wait("window.viewer && viewer.shown > 1 && viewer.cloud")
            await use(page, served)

    asyncio.run(main())


async def paused(page):
    """Keep one frame; its picture comes a moment after it."""
    await page.value("set('run.paused', true)")
    await page.wait("viewer.frame.settings['run.paused'] && viewer.frame.parts.picture")
    await asyncio.sleep(0.5)


@pytest.mark.slow
@needs_browser
@pytest.mark.parametrize("size", [(390, 844), (1440, 900)])
def test_every_state_fits_the_window_and_everybody_can_use_it(tmp_path, size):
    async def faults(page):
        found = [*await findings(page), *await beyond_the_window(page)]
        if size[0] > 600 and await scrolls_down(page):
            found.append("scrolls down")
        return found

    async def use(page, _):
        found = []
        for scheme in ("light", "dark"):
            await set_display(page, *size, scheme)
            for name, change in STATES.items():
                await page.value(change)
                found += [(scheme, name, fault) for fault in await faults(page)]
                assert await page.value("document.querySelectorAll('.large').length") == 1
            await page.value("document.querySelector('#help').close(); setTool('read')")
            groups = "document.querySelectorAll('#settings details')"
            for index in range(await page.value(f"{groups}.length")):
                await page.value(f"{groups}[{index}].open = true")
                found += [(scheme, index, fault) for fault in await faults(page)]
        assert found == []

    on_page(use, tmp_path, viewer_options(tmp_path))


@needs_browser
def test_a_distance_is_that_of_the_points_with_the_deviation_of_both(tmp_path):
    """Against positions and errors computed here, and on the picture and in space alike."""

    async def use(page, _):
        await page.value("set('depth.confidence_threshold', 0)")
        await page.wait("viewer.frame.settings['depth.confidence_threshold'] === 0")
        await paused(page)
        await page.value("enlarge('depth')")
        await page.value("document.querySelector('[data-tool=distance]').click()")
        for place in ((0.3, 0.4), (0.75, 0.7)):
            await page.click("#depth", *place)
        text = await page.value("document.querySelector('#cursor b').textContent")
        found = await page.value("(({ distance, deviation }) => [distance, deviation])(measured())")
        pixels = await page.value("viewer.ends.map(pixelAt)")
        read = "metresAt(end, viewer.frame.{})"
        depths = await page.value(f"viewer.ends.map(end => {read.format('depth')})")
        deviations = await page.value(f"viewer.ends.map(end => {read.format('deviation')})")
        focal, size = await page.value(
            "[(({ slopes, columns }) => (viewer.frame.size[1] - 1) / (slopes[2 * columns - 2] -"
            " slopes[0]))(viewer.frame.rays), viewer.frame.size]"
        )
        rays = [
            np.array([(x - (size[1] - 1) / 2) / focal, (y - (size[0] - 1) / 2) / focal, 1.0])
            for x, y in pixels
        ]
        between = depths[1] * rays[1] - depths[0] * rays[0]
        distance = np.linalg.norm(between)
        deviation = np.hypot(*(
            ray @ between / distance * each for ray, each in zip(rays, deviations, strict=True)
        ))  # fmt: skip
        assert found == pytest.approx([distance, deviation], rel=1e-3)
        assert (
            text
            == f"{distance:.3f} m ± {await page.value('measured().deviation.toPrecision(2)')} m"
        )
        assert await page.value("document.querySelectorAll('#overlay line').length") == 1
        # In space: a press on the pixel of a point gives the point's place.
        await page.value("setTool('distance'); enlarge('points')")
        await page.value("(collectPoints(viewer.frame, false), drawPoints())")
        await page.click("#points", 0.45, 0.5)
        await page.click("#points", 0.55, 0.55)
        assert await page.value("viewer.ends.length") == 2
        assert await page.value("measured().distance") > 0

    on_page(use, tmp_path, viewer_options(tmp_path))


@needs_browser
def test_histogram_and_profile_are_those_of_the_map(tmp_path):
    async def use(page, _):
        await paused(page)
        counted = await page.value("histogram()")
        known = await page.value(
            "viewer.frame.depth.filter(step => step).length / viewer.frame.depth.length"
        )
        assert sum(counted["counts"]) == pytest.approx(counted["known"], abs=1e-6)
        assert counted["known"] == pytest.approx(known, abs=0.02)
        await page.value(f"setTool('profile'); {TWO_ENDS}")
        line = await page.value("profile().map(({ z }) => Number.isNaN(z) ? null : z)")
        middle = await page.value(
            "(z => Number.isFinite(z) ? z : null)(metresAt(viewer.ends[0], viewer.frame.depth))"
        )
        assert line[0] == middle and len(line) > 20
        assert await page.value("document.querySelector('#plot').ariaLabel.includes('line')")
        assert await page.value("document.querySelector('#plot-title').textContent") == (
            "Depth along the line"
        )

    on_page(use, tmp_path, viewer_options(tmp_path))


@needs_browser
def test_keys_presets_and_reset(tmp_path):
    async def press(page, key):
        await page.ask("Input.dispatchKeyEvent", type="keyDown", key=key, text=key)
        await page.ask("Input.dispatchKeyEvent", type="keyUp", key=key)

    async def use(page, _):
        assert await page.value("!document.querySelector('#hint').hidden")
        await page.click("#hint-close")
        assert await page.value("document.querySelector('#hint').hidden")
        for key, panel in (("1", "frame"), ("3", "confidence"), ("2", "depth")):
            await press(page, key)
            assert await page.value("viewer.large") == panel
        await press(page, "d")
        assert await page.value("viewer.tool") == "distance"
        await press(page, "?")
        assert await page.value("document.querySelector('#help').open")
        assert await page.value("document.querySelectorAll('#keys tr').length") > 12
        await page.click("#help-close")
        before = await page.value("viewer.settings")
        await page.value("[...document.querySelectorAll('#presets button')][0].click()")
        await page.wait("viewer.frame.settings['depth.free_space_risk'] === 0.01")
        await page.value("[...document.querySelectorAll('#presets button')].at(-1).click()")
        await page.wait("viewer.frame.settings['depth.free_space_risk'] === 0")
        assert await page.value("viewer.settings") == before
        # Keys of a control are left to it.
        await page.value("document.getElementById('depth.unknown').focus()")
        await press(page, "1")
        assert await page.value("viewer.large") == "depth"

    on_page(use, tmp_path, viewer_options(tmp_path))


@needs_browser
def test_the_hint_comes_once(tmp_path):
    async def use(page, served):
        await page.click("#hint-close")
        await page.ask("Page.navigate", url=f"http://localhost:{served.port}/?again")
        await page.wait("location.search && window.viewer && viewer.shown > 0")
        assert await page.value("document.querySelector('#hint').hidden")

    on_page(use, tmp_path, viewer_options(tmp_path))


def moving_frames(count=6):
    """Results of colour frames of 640x480, each with a picture."""
    random = np.random.default_rng(0)
    settings = Settings(DepthConfig(), DeblurConfig())
    noise = random.random((480, 640, 3), dtype=np.float32)
    smooth = cv2.GaussianBlur(noise, None, 3)
    for index in range(count):
        light = np.roll(smooth, 20 * index, axis=1)
        depth = (NEAR_M + (FAR_M - NEAR_M) * light[..., 0]).astype(np.float32)
        depth[noise[..., 1] < 0.1] = np.nan
        estimate = DepthEstimate(depth, depth, depth, light[..., 1], 0.01, 0.05 * depth)
        pictures = {LookConfig("sharp"): light}
        yield Shown(settings, Capture(light), light, estimate, light, pictures, rate_hz=12.0)


@pytest.mark.slow
@needs_browser
@pytest.mark.parametrize("panel", ["depth", "points"])
def test_frames_of_vga_are_shown_at_eight_hertz(tmp_path, panel):
    """Whatever estimates their depth; every frame has a picture, so points are drawn each time."""

    async def use():
        (tmp_path / "browser").mkdir()
        frames = list(moving_frames())
        async with (
            serving(viewer_options(tmp_path), BlockedSource()) as served,
            page_at(f"http://localhost:{served.port}/", tmp_path / "browser", (1440, 900)) as page,
        ):
            feeding = asyncio.create_task(feed(served.server, frames))
            await page.wait("window.viewer && viewer.shown > 3 && viewer.cloud")
            await page.value(f"enlarge('{panel}')")
            before = await page.value("[viewer.shown, performance.now()]")
            await asyncio.sleep(8)
            after = await page.value("[viewer.shown, performance.now()]")
            feeding.cancel()
        return 1000 * (after[0] - before[0]) / (after[1] - before[1])

    async def feed(server, frames):
        for frame in itertools.cycle(frames):
            server.show(frame)
            await asyncio.sleep(1 / 12)

    rate_hz = asyncio.run(use())
    print(f"{panel}: {rate_hz:.1f} Hz")
    assert rate_hz > 8 / scaled(1)


def test_presets_are_settings_that_exist():
    settings = Settings(DepthConfig(), DeblurConfig())
    for preset in PRESETS:
        changed = settings.changed(preset.values)
        assert changed.as_values().items() >= preset.values.items()


def test_rays_of_the_page_are_those_of_the_lens():
    """With distortion, at pixels between those of the grid."""
    matrix = (300.0, 0.0, 150.0, 0.0, 310.0, 118.0, 0.0, 0.0, 1.0)
    lens = Intrinsics(320, 240, matrix, (-0.2, 0.05, 0.001, 0.0, 0.0))
    grid = ray_grid(lens)
    slopes = np.array(grid["slopes"]).reshape(grid["rows"], grid["columns"], 2)
    rays = lens.rays(240, 320)
    for row, column in ((0, 0), (239, 319), (101, 57), (200, 300)):
        u = column / 319 * (grid["columns"] - 1)
        v = row / 239 * (grid["rows"] - 1)
        left = min(int(u), grid["columns"] - 2)
        top = min(int(v), grid["rows"] - 2)
        corners = slopes[top : top + 2, left : left + 2]
        across = np.array([1 - (u - left), u - left])
        down = np.array([1 - (v - top), v - top])
        found = np.einsum("r,c,rca->a", down, across, corners)
        assert np.abs(found - rays[row, column]).max() < 0.2 / 300  # a fifth of a pixel


def test_frames_are_recorded_as_png_and_read_back(tmp_path):
    async def use():
        async with serving(options) as served, client(served) as page:
            await page.shown()
            await page.send({"do": "record", "form": "avi"})
            assert "form: 'avi' is none of bag, png" in await page.problem()
            await page.send({"do": "record", "form": "png"})
            await page.told(lambda message: (message.get("recorded") or 0) >= 3)
            await page.send({"do": "record"})
            await page.told(lambda message: message.get("said", "").endswith(" frames"))

    options = viewer_options(tmp_path)
    asyncio.run(use())
    (folder,) = (tmp_path / "kept").iterdir()
    source = open_source(str(folder), None, 15.0)
    times = (folder / "times.csv").read_text().splitlines()
    assert times[0] == "file,time_ns" and len(times) == 1 + len(source.files)
    assert len(source.files) >= 3
    first, second = (read_image(path) for path in source.files[:2])
    assert first.shape[:2] == (96, 128) and 0 < first.mean() < 1
    assert not np.array_equal(first, second)
    stamps = [int(line.split(",")[1]) for line in times[1:]]
    assert stamps == sorted(stamps)


def test_the_end_keeps_a_recording_as_png_that_every_page_has_seen(tmp_path):
    async def use():
        async with serving(options) as served, client(served) as page, client(served) as other:
            await page.shown()
            await page.send({"do": "record", "form": "png"})
            for each in (page, other):
                await each.told(lambda message: (message.get("recorded") or 0) >= 2)
            count = served.server._keeping.recorded
            await served.end()
        return count

    options = viewer_options(tmp_path)
    count = asyncio.run(use())
    (folder,) = (tmp_path / "kept").iterdir()
    names = [line.split(",")[0] for line in (folder / "times.csv").read_text().splitlines()[1:]]
    assert len(names) >= count >= 2
    assert sorted(path.name for path in folder.glob("*.png")) == names
