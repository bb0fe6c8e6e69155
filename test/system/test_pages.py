"""Pages that are files, in a real browser: demo, bag report, design and field report."""

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("aiohttp", reason="the browser is spoken to with aiohttp")

from live_page import CHROMIUM, page_at
from page_checks import beyond_the_window, findings, scrolls_down, set_display
from small_camera import CAMERA, FAR_M, NEAR_M

from coded_aperture_ros.bags.page import html_page, wide_table
from coded_aperture_ros.cli.demo_page import Picture, demo_page
from coded_aperture_ros.cli.field_report import field_page
from coded_aperture_ros.design.page import write_page
from coded_aperture_ros.design.setting import DesignConfig
from coded_aperture_ros.optics import Camera, Mask

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
TITLES = ("Coded frame", "Depth", "All in focus", "Error", "True depth", "Sharp scene")
STREAM = {
    "rate_hz": 9.5,
    "latency_median_s": 0.1,
    "latency_p99_s": 0.2,
    "latency_max_s": None,
    "dropped": 3,
}
SUMMARY = {
    "camera": STREAM,
    "deblur": STREAM,
    "depth": STREAM | {"coverage": 0.8, "median_relative_error": 0.01},
    "depth_alone": STREAM | {"seconds": 5.0},
    "cores": {"depth_node": 1.2, "other programs": 0.3},
    "machine": {"gflop_s": 50.0, "threads": 2},
    "psnr_coded_db": 21.0,
    "psnr_all_in_focus_db": None,
}


def demo():
    pixels = np.zeros((48, 64, 3), np.uint8)
    pictures = [Picture(title, "What it is.", pixels, (0.6, 1.5)) for title in TITLES]
    return demo_page(pictures, SUMMARY)


def bag():
    names = [f"<tr><th>{'a long name ' * 9}</th>{'<td>0.12345</td>' * 12}</tr>"]
    return html_page("Depth of /a/very/long/path" + "/folder" * 20, [wide_table(names)])


def field():
    thirds = np.array([[4.0, 4.1, 0.02, 0.9], [4.0, 5.0, 0.3, 0.05], [4.0, 4.1, np.nan, 0.0]])
    found = SimpleNamespace(names=["wall_1m.png"], depths_m=[1.0], by_thirds=[thirds])
    return field_page(found, "field: [1, 2, 3]", {"PSFs": np.eye(600)}, ["The wall <moved>."])


def design(folder):
    values = {name: CAMERA[name] for name in CAMERA if name != "mask"}
    camera = Camera(**values, mask=Mask.named("levin"))
    path = folder / "made.html"
    write_page(camera, NEAR_M, FAR_M, [], DesignConfig(), (0.5, 5.0), (2.0, 20.0), path)
    return path.read_text("utf-8")


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    texts = {"demo": demo(), "bag": bag(), "field": field(), "design": design(folder)}
    for name, text in texts.items():
        (folder / f"{name}.html").write_text(text, "utf-8")
    return folder, tuple(texts)


def on_pages(use, folder, names, tmp_path):
    """Run a coroutine function on pages, in one browser."""

    async def main():
        (tmp_path / "browser").mkdir()
        async with page_at("about:blank", tmp_path / "browser") as page:
            for name in names:
                await page.ask("Page.navigate", url=(folder / f"{name}.html").as_uri())
                ready = f"location.pathname.endsWith('{name}.html')"
                await page.wait(f"{ready} && document.readyState === 'complete'")
                await use(page, name)

    asyncio.run(main())


def test_pages_fit_a_phone_and_everybody_can_use_them(pages, tmp_path):
    async def use(page, name):
        for size in ((390, 844), (1440, 900)):
            for scheme in ("light", "dark"):
                await set_display(page, *size, scheme)
                assert await beyond_the_window(page) == [], (name, size)
                assert await findings(page) == [], (name, size, scheme)

    on_pages(use, *pages, tmp_path)


def test_pages_share_one_style_and_need_no_other_file(pages):
    folder, names = pages
    for name in names:
        text = (folder / f"{name}.html").read_text("utf-8")
        assert text.count("prefers-color-scheme: dark") == 1, name
        assert "/*STYLE*/" not in text and "http" not in text


def test_pictures_of_the_demo_are_enlarged_one_at_a_time(pages, tmp_path):
    async def press(page, key):
        await page.ask("Input.dispatchKeyEvent", type="keyDown", key=key)
        await page.ask("Input.dispatchKeyEvent", type="keyUp", key=key)

    async def use(page, _):
        await set_display(page, 390, 844)
        title = "document.querySelector('#shown-title').textContent"
        await page.click("figure:nth-of-type(2) button")
        assert await page.value(title) == "2 of 6: Depth"
        assert await beyond_the_window(page) == [] and await findings(page) == []
        await press(page, "ArrowRight")
        assert await page.value(title) == "3 of 6: All in focus"
        for _ in range(3):
            await press(page, "ArrowLeft")
        assert await page.value(title) == "6 of 6: Sharp scene"
        image = "document.querySelectorAll('#zoomed img')"
        small = await page.value(f"{image}[0].clientWidth")
        await press(page, "+")
        assert await page.value(f"{image}[0].clientWidth") > 1.5 * small
        assert await page.value(f"{image}.length") == 1
        await page.click("#close")
        assert not await page.value("document.querySelector('#zoom').open")
        assert await scrolls_down(page)

    on_pages(use, pages[0], ["demo"], tmp_path)


def test_faults_are_found(tmp_path):
    (tmp_path / "bad.html").write_text(
        "<meta name=viewport content='width=device-width'><title>a</title>"
        "<body style='width: 900px'><h1>a</h1><button></button><input>"
        "<p style='color: #999; background: #fff'>pale</p><img src='data:,'>"
    )

    async def use(page, _):
        await set_display(page, 390, 844)
        found = " ".join(await findings(page))
        for fault in ("no language", "no main", "no name", "contrast of 2.8", "no alternative"):
            assert fault in found
        assert await beyond_the_window(page)

    on_pages(use, tmp_path, ["bad"], tmp_path)
