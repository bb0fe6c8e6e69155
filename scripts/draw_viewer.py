"""Draw the pictures of docs/viewer.md: the viewer's page in twelve states, in Chromium.

    python scripts/draw_viewer.py [docs/images]

The source is the simulator, and the page is paused, so that all pictures show one frame.
"""

import asyncio
import dataclasses
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).parents[1]
sys.path += [str(ROOT), str(ROOT / "viewer"), str(ROOT / "test" / "support")]

from coded_aperture_viewer.show import Options  # noqa: E402
from live_page import page_at  # noqa: E402
from live_viewer import serving  # noqa: E402
from page_checks import set_display  # noqa: E402

from coded_aperture_ros.depth import DepthConfig  # noqa: E402
from coded_aperture_ros.frames import PixelFormat  # noqa: E402

DESKTOP = 1440, 900
PHONE = 390, 844
# Width of the pictures of a desktop, px, and largest file, bytes.
WIDTH = 960
LARGEST = 60_000
ENDS = "addEnd([0.24, 0.3]); addEnd([0.62, 0.75])"
PRESETS = "document.querySelectorAll('#presets button')"


@dataclasses.dataclass(frozen=True)
class State:
    """What is done on the page, and what then holds; `size` is that of the window, px."""

    name: str
    script: str
    ready: str = "true"
    size: tuple[int, int] = DESKTOP
    scheme: str = "light"


STATES = (
    State("depth", "enlarge('depth')"),
    State("phone", "document.querySelector('#hint').hidden = true", size=PHONE),
    State(
        "refocused",
        "enlarge('picture'); clicked([0.62, 0.75])",
        "viewer.frame.settings['look.picture'] === 'refocused' && viewer.frame.parts.picture",
    ),
    State("deviation", "enlarge('confidence'); trust.value = 'deviation'; trust.onchange()"),
    State(
        "free_space",
        "choose('sharp'); enlarge('depth'); map.value = 'free_space'; map.onchange()",
        "viewer.frame.layers.free_space",
    ),
    State("points", "map.value = ''; map.onchange(); enlarge('points'); zoom(1.6)"),
    State("distance", f"enlarge('depth'); setTool('distance'); {ENDS}"),
    State("distance_points", "enlarge('points')"),
    State("profile", f"enlarge('depth'); setTool('profile'); {ENDS}"),
    State(
        "setting_up", "setTool('read'); enlarge('frame'); document.querySelector('#aid').open = 1"
    ),
    State("help", "document.querySelector('#aid').open = false; help.showModal()"),
    State(
        "dark",
        f"help.close(); {PRESETS}[2].click(); {ENDS}; document.querySelector('#record').click()",
        "viewer.recorded !== null && viewer.frame.settings['depth.temporal_frames'] === 10",
        scheme="dark",
    ),
)


def main() -> None:
    """Write the pictures."""
    output = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "images"
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        asyncio.run(_draw(output, Path(folder)))


async def _draw(output: Path, folder: Path) -> None:
    options = Options(
        source="simulator",
        camera=None,
        bank=None,
        depth_range=None,
        output=folder / "kept",
        host="127.0.0.1",
        port=0,
        rate=15.0,
        browser=False,
        pixels=PixelFormat(),
        depth=DepthConfig(temporal_frames=4.0),
    )
    (folder / "browser").mkdir()
    async with (
        serving(options) as served,
        page_at(f"http://localhost:{served.port}/", folder / "browser") as page,
    ):
        await page.wait("window.viewer && viewer.shown > 12 && viewer.cloud", 300)
        await page.value("set('run.paused', true)")
        await page.wait("viewer.frame.settings['run.paused'] && viewer.cloud.isSharp", 120)
        for state in STATES:
            await _draw_state(page, state, folder, output)


async def _draw_state(page, state: State, folder: Path, output: Path) -> None:
    await set_display(page, *state.size, state.scheme)
    await page.value(f"(() => {{ {state.script} }})()")
    await page.wait(state.ready, 120)
    await asyncio.sleep(3)  # for what is drawn with the next message
    await page.value("drawPoints()")
    path = folder / "state.png"
    await page.picture(path)
    picture = cv2.imread(str(path))
    if picture.shape[1] > WIDTH:
        height = round(picture.shape[0] * WIDTH / picture.shape[1])
        picture = cv2.resize(picture, (WIDTH, height), interpolation=cv2.INTER_AREA)
    _write(output / f"viewer_{state.name}.webp", picture)


def _write(path: Path, picture: np.ndarray) -> None:
    """Write a picture in the best quality that keeps it below `LARGEST`."""
    for quality in range(85, 20, -5):
        data = cv2.imencode(".webp", picture, (cv2.IMWRITE_WEBP_QUALITY, quality))[1]
        if len(data) < LARGEST:
            break
    path.write_bytes(data.tobytes())
    print(f"{path}: {len(data) / 1000:.0f} kB, quality {quality}")


if __name__ == "__main__":
    main()
