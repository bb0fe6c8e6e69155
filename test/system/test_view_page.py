"""The viewer's page in a real browser: on a phone, before the first frame, and points in space."""

import asyncio

import numpy as np
import pytest

pytest.importorskip("aiohttp", reason="the viewer needs aiohttp")

from coded_aperture_viewer.inactive import inactive_settings
from coded_aperture_viewer.settings import LookConfig, RunConfig, Settings
from live_page import CHROMIUM, page_at
from live_viewer import BlockedSource, serving, viewer_options
from page_checks import beyond_the_window, set_display
from small_camera import FAR_M, NEAR_M, coded_wall, write_model

from coded_aperture_ros.deblur import DeblurConfig
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.likelihood.bank import DEFAULT_LEVEL_COUNT, learn_bank_for_camera, load_bank
from coded_aperture_ros.optics import load_camera
from coded_aperture_ros.pipeline import FramePipeline

needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
PHONE = 390, 844
DESKTOP = 1440, 900
HEADLINE = "document.querySelector('#cursor b').textContent"


def on_page(use, folder, options, source=None):
    """Run a coroutine function on a page in a browser."""

    async def main():
        (folder / "browser").mkdir()
        async with (
            serving(options, source) as served,
            page_at(f"http://localhost:{served.port}/", folder / "browser") as page,
        ):
            await use(page)

    asyncio.run(main())


async def touch(page, kind, *places):
    points = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(places)]
    await page.ask("Input.dispatchTouchEvent", type=kind, touchPoints=points)


async def middle_of(page, selector):
    """Scroll an element into the middle of the window; return where its middle is."""
    return await page.value(
        f"(() => {{ const e = document.querySelector('{selector}');"
        " e.scrollIntoView({ block: 'center' });"
        " const b = e.getBoundingClientRect();"
        " return [b.left + b.width / 2, b.top + b.height / 2]; })()"
    )


@pytest.mark.slow
@needs_browser
def test_on_a_phone_nothing_is_cut_off_and_the_reading_stays_in_sight(tmp_path):
    async def use(page):
        await set_display(page, *PHONE)
        await page.ask("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
        await page.wait("window.viewer && viewer.shown > 1")
        await page.wait("document.querySelector('#picture').width === 128")
        assert await beyond_the_window(page) == []
        await page.value("set('depth.confidence_threshold', 0)")
        await page.wait("viewer.frame.settings['depth.confidence_threshold'] === 0")
        for name in ("frame", "depth", "confidence", "picture"):
            await page.value(f"enlarge('{name}')")
            x, y = await middle_of(page, f"#{name}")
            await touch(page, "touchStart", (x, y))
            await touch(page, "touchEnd")
            await page.wait(f"/^[0-9.]+ m/.test({HEADLINE})")
            reading = await page.value(
                "(() => { const b = document.querySelector('#cursor').getBoundingClientRect();"
                " return [b.top, b.bottom, innerHeight]; })()"
            )
            assert 0 <= reading[0] < reading[1] < reading[2] / 3
        await page.wait("viewer.frame.settings['look.picture'] === 'refocused'")
        for change in ("enlarge('points')", "document.querySelector('#aid').open = true"):
            await page.value(change)
            assert await beyond_the_window(page) == []
        await page.wait("viewer.cloud && viewer.middle")
        x, y = await middle_of(page, "#points")
        closer = await page.value("viewer.closer")
        await touch(page, "touchStart", (x - 20, y), (x + 20, y))
        await touch(page, "touchMove", (x - 60, y), (x + 60, y))
        await touch(page, "touchEnd")
        assert await page.value("viewer.closer") > 1.5 * closer
        await page.value("resetView()")
        await touch(page, "touchStart", (x - 20, y), (x + 20, y))
        await touch(page, "touchMove", (x + 20, y + 40), (x + 60, y + 40))
        await touch(page, "touchEnd")
        assert min(await page.value("viewer.pan")) > 0.05

    on_page(use, tmp_path, viewer_options(tmp_path))


@pytest.mark.slow
@needs_browser
def test_points_stay_in_the_picture_wherever_they_are_turned(tmp_path):
    async def use(page):
        await page.wait("window.viewer && viewer.shown > 1")
        await page.value("enlarge('points')")
        await page.wait("viewer.cloud && viewer.cloud.isSharp")
        # Points of one frame from here on, in the colours of its all-in-focus picture.
        await page.value("set('run.paused', true)")
        await page.wait("viewer.frame.settings['run.paused'] && viewer.frame.parts.picture")
        await asyncio.sleep(0.3)
        view = "[viewer.yaw, viewer.pitch, viewer.closer, ...viewer.pan]"
        first = await page.value(view)
        for right, down in ((0, 0), (1.5, 0), (3, 0), (5, 0), (0, 99), (0, -99), (2, 99), (4, -99)):
            await page.value(f"resetView(); turn({right}, {down})")
            assert await page.value("viewer.inside / viewer.cloud.places.length") > 0.9
        await page.value("move(0.2, 0.1)")
        await page.value("zoom(1e-9)")
        assert await page.value("viewer.inside / viewer.cloud.places.length") > 0.9
        await page.value("document.querySelector('#reset').click()")
        assert await page.value(view) == first
        # The turning centre is in the middle of the picture, whatever the direction.
        await page.value("turn(0.4, 0.2)")
        x, y, *_ = await page.value("viewOf(viewer.cloud.size).project(...viewer.middle.centre)")
        assert (x, y) == (64, 48)

    on_page(use, tmp_path, viewer_options(tmp_path))


@needs_browser
def test_clicks_before_the_first_frame_are_answered(tmp_path):
    async def use(page):
        await page.wait("window.viewer && viewer.about")
        message = "document.querySelector('#message').textContent"
        for selector in ("#snapshot", "#record", "#frame", "#depth", "#confidence", "#picture"):
            await page.value("say('', '')")
            await page.value(f"document.querySelector('{selector}').click()")
            assert "no frame has come yet" in await page.value(message)
        await page.value("enlarge('points')")

    on_page(use, tmp_path, viewer_options(tmp_path), BlockedSource())


@needs_browser
def test_a_control_that_does_nothing_is_disabled_with_the_reason(tmp_path):
    async def use(page):
        state = (
            "(() => { const e = document.getElementById('depth.smoothness');"
            " return [e.disabled, e.parentElement.querySelector('small').textContent]; })()"
        )
        await page.wait("window.viewer && viewer.shown > 0")
        assert await page.value(state) == [True, "the learned network has none"]
        await page.value("set('depth.regularize', 'semiglobal')")
        await page.wait("!document.getElementById('depth.smoothness').disabled")
        assert await page.value(state) == [False, ""]
        assert await page.value("document.getElementById('depth.second_surface').disabled")

    on_page(use, tmp_path, viewer_options(tmp_path, bank=None))


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """Camera, a bank that the network was trained for, and one that it was not trained for."""
    files = write_model(tmp_path_factory.mktemp("model"))
    camera = load_camera(files["camera_file"])
    learned = learn_bank_for_camera(camera, NEAR_M, FAR_M, DEFAULT_LEVEL_COUNT)
    return camera, {"supported": learned, "unsupported": load_bank(files["bank"])}


@pytest.mark.parametrize("kind", ["supported", "unsupported"])
@pytest.mark.parametrize("regularize", ["learned", "semiglobal", "none", "tv"])
def test_reasons_are_true(model, regularize, kind):
    """A setting changes the estimate if and only if no reason is given why it does not."""
    camera, banks = model
    frame = coded_wall(camera)
    levels = []
    for smoothness in (0.2, 5.0):
        depth = DepthConfig(regularize=regularize, smoothness=smoothness)
        levels.append(FramePipeline(banks[kind], camera, depth)(frame).level)
    reasons = inactive_settings(Settings(depth, DeblurConfig()), [LookConfig()], banks[kind])
    assert np.array_equal(*levels) == ("depth.smoothness" in reasons)
    assert ("depth.second_surface" in reasons) == (regularize != "learned" or kind != "supported")


def test_reasons_follow_pages_and_pause(model):
    bank = model[1]["supported"]
    settings = Settings(DepthConfig(), DeblurConfig(), RunConfig(paused=True))
    none = LookConfig("none")
    assert set(inactive_settings(settings, [none], bank)) == {
        "depth.smoothness",
        "depth.temporal_frames",
        "deblur.smoothness",
        "look.opening_px",
    }
    refocused = settings.with_look(LookConfig("refocused"))
    assert set(inactive_settings(refocused, [none, refocused.look], bank)) == {
        "depth.smoothness",
        "depth.temporal_frames",
    }
