"""The viewer: what it computes, its server over real HTTP, and its page in a real browser."""

import asyncio
import base64
import json
import re
import struct
import subprocess
import sys
from collections import Counter
from contextlib import asynccontextmanager

import cv2
import numpy as np
import pytest
import yaml
from small_camera import CAMERA, FAR_M, NEAR_M
from waiting import scaled, wait_until

aiohttp = pytest.importorskip("aiohttp", reason="the viewer needs aiohttp")

from coded_aperture_viewer.packet import BEYOND, NEARER, steps  # noqa: E402
from coded_aperture_viewer.refocus import refocused  # noqa: E402
from coded_aperture_viewer.settings import LookConfig, Settings  # noqa: E402
from coded_aperture_viewer.setup_figures import find_wall, setup_figures  # noqa: E402
from coded_aperture_viewer.show import Options, make_server  # noqa: E402
from live_page import CHROMIUM, page_at  # noqa: E402

from coded_aperture_ros.bags import Bag  # noqa: E402
from coded_aperture_ros.cli.main import main  # noqa: E402
from coded_aperture_ros.core.errors import InputError  # noqa: E402
from coded_aperture_ros.deblur import DeblurConfig  # noqa: E402
from coded_aperture_ros.depth import DepthConfig, DepthEstimate  # noqa: E402
from coded_aperture_ros.frames import PixelFormat  # noqa: E402
from coded_aperture_ros.io import read_depth, read_image, write_image  # noqa: E402
from coded_aperture_ros.optics import Camera, Mask  # noqa: E402

TOKEN = re.compile(r"http://\S+")


def small_camera():
    values = {name: CAMERA[name] for name in CAMERA if name != "mask"}
    return Camera(**values, mask=Mask.named("levin"))


@pytest.fixture(scope="module")
def started(tmp_path_factory):
    """Start viewers as users do; give each one's address and the folder of what it keeps."""
    folder = tmp_path_factory.mktemp("view")
    camera = folder / "camera.yaml"
    wide = CAMERA | {"image_width": 320, "image_height": 240, "focal_length_px": 500.0}
    camera.write_text(yaml.safe_dump(wide))
    programs = []

    def start(*options):
        output = folder / str(len(programs))
        command = [sys.executable, "-m", "coded_aperture_ros", "view", "--camera", str(camera)]
        command += ["--depth-range", str(NEAR_M), str(FAR_M), "--port", "0", "--no-browser"]
        command += ["--output", str(output), *options]
        program = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        programs.append(program)
        return TOKEN.search(program.stdout.readline())[0], output

    yield start
    for program in programs:
        program.terminate()
        program.stdout.close()
        program.wait(scaled(30))


@pytest.fixture(scope="module")
def viewer(started):
    return started()


@asynccontextmanager
async def connected(address):
    live = f"{address.rstrip('/')}/live"
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(live, max_msg_size=0) as found,
    ):
        yield found


async def told(socket, wanted=lambda message: True):
    """Return the next message in words for which something holds, and what was sent before."""
    while True:
        message = await socket.receive(timeout=scaled(60))
        assert message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY), message
        if message.type == aiohttp.WSMsgType.TEXT and wanted(found := message.json()):
            return found


async def shown(socket, wanted=lambda head, part: True):
    """Return header and parts of the next frame for which something holds."""
    while True:
        message = await socket.receive(timeout=scaled(60))
        if message.type != aiohttp.WSMsgType.BINARY:
            continue
        length = struct.unpack_from("<I", message.data)[0]
        head = json.loads(message.data[8 : 8 + length])

        def part(name, kind, head=head, data=message.data, begin=8 + length):
            at, size = head["parts"][name]
            values = np.frombuffer(data, kind, size // np.dtype(kind).itemsize, begin + at)
            return values.reshape(head["size"])

        if wanted(head, part):
            return head, part


def test_what_is_in_focus_stays_sharp_and_the_rest_does_not():
    random = np.random.default_rng(0)
    sharp = random.random((120, 160, 3), dtype=np.float32)
    depth = np.full((120, 160), 4.0, np.float32)
    depth[:, :80] = 1.0
    depth[10, 10] = np.nan  # has the depth of what is around it
    near, far = (refocused(sharp, depth, metres, 6.0) for metres in (1.0, 4.0))
    assert np.abs(near - sharp)[:, :70].max() < 1e-3 < 0.15 < np.abs(near - sharp)[:, 90:].mean()
    assert np.abs(far - sharp)[:, 95:].max() < 1e-3 < 0.15 < np.abs(far - sharp)[:, :70].mean()
    # Light is neither lost nor made, but for what hides what.
    assert abs(near.mean() - sharp.mean()) < 0.01 and abs(far.mean() - sharp.mean()) < 0.01
    assert refocused(sharp, np.full_like(depth, np.nan), 1.0, 6.0) is sharp
    grey = refocused(sharp[..., 0], depth, 1.0, 0.0)
    np.testing.assert_allclose(grey, sharp[..., 0], atol=1e-6)


def test_a_wall_is_measured_and_clutter_is_none():
    camera = small_camera()
    rows, columns = camera.image_height, camera.image_width
    focal = camera.intrinsics.camera_matrix[0]
    x = (np.arange(columns) - (columns - 1) / 2) / focal
    y = (np.arange(rows) - (rows - 1) / 2) / focal
    right, lower = np.deg2rad([8.0, -3.0])
    wall = 2.0 / (1 + np.tan(right) * x + np.tan(lower) * y[:, None])
    random = np.random.default_rng(0)
    depth = (wall * (1 + 0.02 * random.standard_normal(wall.shape))).astype(np.float32)
    depth[: rows // 4, : columns // 2] = 1.2  # somebody stands before it
    depth[:, -columns // 6 :] = np.nan
    found = find_wall(depth, camera)
    assert found.distance_m == pytest.approx(2.0, rel=0.01)
    assert found.right_nearer_deg == pytest.approx(8.0, abs=0.8)
    assert found.lower_nearer_deg == pytest.approx(-3.0, abs=0.8)
    assert found.uneven == pytest.approx(0.67 * 0.02, rel=0.4)
    assert find_wall(random.uniform(1, 3, wall.shape).astype(np.float32), camera) is None
    assert find_wall(np.full_like(depth, np.nan), camera) is None


def test_sharpness_is_largest_in_focus():
    random = np.random.default_rng(0)
    page = (random.random((180, 240)) < 0.5).astype(np.float32)
    page = cv2.resize(page, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)
    noise = 0.01 * random.standard_normal(page.shape).astype(np.float32)
    found = []
    for blur in (0.6, 1.2, 2.4):
        light = 0.2 + 0.5 * cv2.GaussianBlur(page, None, blur) + noise
        maps = np.full(page.shape, np.nan, np.float32)
        nothing = DepthEstimate(maps, maps, None, np.zeros_like(maps), 0.01)
        aid = setup_figures(light, nothing, small_camera())
        assert (aid.wall, aid.known, aid.clipped) == (None, 0, 0) and 0.4 < aid.light < 0.5
        found.append(aid.sharpness)
    assert found == sorted(found, reverse=True) and found[2] < 0.3 * found[0]
    dark = np.zeros_like(page) + noise
    assert setup_figures(dark, nothing, small_camera()).sharpness < 0.05


def test_depths_are_sent_in_steps():
    metres = np.array([[np.nan, np.inf, -np.inf, 2.0, 1e-9, 1e9]], np.float32)
    assert steps(metres, 1e-3).tolist() == [[0, BEYOND, NEARER, 2000, 1, NEARER - 1]]


def test_only_settings_that_exist_are_taken():
    settings = Settings(DepthConfig(), DeblurConfig())
    other = settings.changed({"depth.confidence_threshold": 1, "look.picture": "refocused"})
    assert other.depth.confidence_threshold == 1.0 and other.look.picture == "refocused"
    assert other.deblur is settings.deblur
    assert {each["name"] for each in settings.controls()} <= set(settings.as_values())
    for wanted, said in (
        ({"depth.confidence_threshold": 2}, "confidence_threshold: 2.0 is out of range"),
        ({"depth.regularize": "magic"}, "regularize: 'magic' is not allowed"),
        ({"depth.__class__": 1}, "there is no depth.__class__"),
        ({"changed.depth": 1}, "there is no changed.depth"),
        ([], "expected names and values"),
    ):
        with pytest.raises(InputError, match=re.escape(said)):
            settings.changed(wanted)


def test_a_client_sees_frames_changes_settings_and_keeps_what_it_sees(viewer):
    address, output = viewer

    async def use():
        async with connected(address) as socket:
            about = await told(socket)
            assert about["range_m"] == [NEAR_M, FAR_M] and len(about["colours"]) == 256
            head, part = await shown(socket, lambda head, _: "picture" in head["parts"])
            assert head["size"] == [240, 320] and head["problem"] == ""
            for name in ("frame", "picture"):
                at, size = head["parts"][name]
                assert size > 1000 and at % 8 == 0
            depth = part("depth", "<u2") * head["unit_m"]
            known = (depth > 0) & (depth < 2 * FAR_M)
            assert 0.2 < known.mean() < 1 and 0.9 * NEAR_M < np.median(depth[known]) < 1.1 * FAR_M
            assert part("confidence", "u1")[known].min() >= 255 * 0.45 - 1
            assert "free_space" not in head["parts"]

            await socket.send_json({"set": {"depth.confidence_threshold": 0.0}})
            _, part = await shown(
                socket, lambda head, _: not head["settings"]["depth.confidence_threshold"]
            )
            assert (part("depth", "<u2") > 0).mean() > known.mean() + 0.02
            for wrong in ("{", "7", '{"set": {"depth.magic": 1}}', '{"set": 3}'):
                await socket.send_str(wrong)
                assert (await told(socket, lambda m: "problem" in m))["problem"]

            await socket.send_json({"set": {"depth.free_space_risk": 0.01}})
            head, part = await shown(
                socket, lambda head, _: {"free_space", "picture"} <= head["parts"].keys()
            )
            assert part("free_space", "<u2").min() * head["unit_m"] > 0.9 * NEAR_M

            await socket.send_json({"do": "snapshot"})
            folder = (await told(socket, lambda m: "said" in m))["said"]
            await socket.send_json({"set": {"depth.free_space_risk": 0.0}})
            await socket.send_json({"do": "record"})
            await told(socket, lambda m: (m.get("recorded") or 0) >= 3)
            await socket.send_json({"do": "record"})
            finished = await told(socket, lambda m: m.get("said", "").endswith(" frames"))
            return folder, finished["said"]

    folder, recorded = asyncio.run(use())
    names = {path.name for path in output.joinpath(folder.split("/")[-1]).iterdir()}
    assert {"coded.png", "all_in_focus.png", "depth.npy", "std_dev.npy", "points.ply"} <= names
    assert "free_space.npy" in names
    assert read_image(f"{folder}/coded.png").shape == (240, 320, 3)
    assert read_depth(f"{folder}/depth.npy").shape == (240, 320)
    path, count = re.fullmatch(r"(.+): (\d+) frames", recorded).groups()
    with Bag(path) as bag:
        recorded = Counter(message.topic for message in bag.messages())
    assert recorded == {"/image_raw": int(count), "/camera_info": int(count)} and int(count) >= 3


def test_only_the_page_itself_is_answered(viewer, started):
    async def status(address, **headers):
        async with (
            aiohttp.ClientSession() as session,
            session.get(address, headers=headers) as answer,
        ):
            return answer.status

    async def ask():
        address, _ = viewer
        assert await status(address) == 200
        assert await status(address, Host="example.org") == 403
        assert await status(f"{address}live", Origin="http://example.org") == 403
        assert await status(f"{address}etc") == 404
        outside, _ = started("--host", "127.0.0.2")
        bare = outside.split("?")[0]
        assert outside != bare
        assert await status(outside) == 200
        assert await status(bare) == 403
        assert await status(f"{bare}?token=guess") == 403

    asyncio.run(ask())


def test_wrong_use_is_told_in_one_line(viewer, capsys, tmp_path):
    port = viewer[0].rstrip("/").split(":")[-1]
    assert main(["view", "--port", port, "--no-browser"]) == 1
    assert f"cannot listen on 127.0.0.1, port {port}" in capsys.readouterr().err
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(CAMERA))
    (tmp_path / "video.avi").touch()
    camera = ["--camera", str(tmp_path / "camera.yaml")]
    missing = "no such file"
    for options, said in (
        ([str(tmp_path / "video.avi")], "required: --camera"),
        # What is missing is named, in the order source, camera, bank, and nothing else.
        (["nope.png"], f"error: cannot read nope.png: {missing}"),
        (["nope.npz"], f"error: cannot read nope.npz: {missing}"),
        (["bag:nope.mcap#/image"], f"error: cannot read nope.mcap: {missing}"),
        (["nope.png", *camera, "--bank", "no.npz"], f"error: cannot read nope.png: {missing}"),
        (["nope/", "--camera", "no.yaml"], f"error: cannot read nope/: {missing}"),
        (["--camera", "no.yaml", "--bank", "no.npz"], "error: cannot read camera file no.yaml"),
        ([*camera, "--bank", "no.npz"], "error: no.npz: no such file"),
        (["--bank", "no.npz"], "error: no.npz: no such file"),
        ([str(tmp_path / "camera.yaml")], "has no frames: write --camera"),
        (["--camera", "no.yaml", "--depth-range", "1", "2"], "no.yaml"),
        (["--camera", "no.yaml"], "required: --depth-range or --bank"),
    ):
        try:
            status = main(["view", "--port", "0", "--no-browser", *options])
        except SystemExit as error:
            status = error.code
        assert status in (1, 2)
        assert said in capsys.readouterr().err


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
def test_a_browser_shows_and_changes_what_is_seen(viewer, tmp_path):
    address, _ = viewer
    seen = "viewer.frame.depth.reduce((n, step) => n + (step > 0), 0) / viewer.frame.depth.length"

    async def use(page):
        await page.wait("window.viewer && viewer.shown > 2")
        await page.wait("document.querySelector('#picture').width === 320")
        assert await page.value("message.className") == ""
        await page.picture(tmp_path / "page.png")

        # A slider changes the map.
        await slide(page, "depth.confidence_threshold", 0.0)
        # The simulator's scene begins at 1.12 m before this camera, the bank at 1.3 m.
        assert await page.value(seen) > 0.8
        await slide(page, "depth.confidence_threshold", 0.99)
        assert await page.value(seen) < 0.2
        await slide(page, "depth.confidence_threshold", 0.0)

        # A click changes the focus, and the picture with it.
        await page.click("#depth", 0.2, 0.9)
        near = await focused(page)
        of_near = await picture(page)
        await page.click("#depth", 0.2, 0.05)
        far = await focused(page, near)
        assert near > NEAR_M * 0.8 and far < FAR_M * 1.2
        assert np.abs(await picture(page) - of_near).mean() > 1
        assert "confidence" in await page.value("document.querySelector('#cursor').textContent")

        # How far nothing is, in place of the depth, and under the cursor.
        assert await page.value("viewer.frame.layers.free_space === undefined")
        surfaces = await page.value("document.querySelector('#depth').toDataURL()")
        await page.value("map.value = 'free_space'; map.onchange()")
        await page.wait(
            "viewer.frame.layers.free_space"
            " && viewer.frame.settings['depth.free_space_risk'] === 0.01"
        )
        assert await page.value("viewer.frame.layers.free_space.every((step, at) => step > 0)")
        assert await page.value(
            "viewer.frame.layers.free_space.every((step, at) => !viewer.frame.depth[at] ||"
            " step <= viewer.frame.depth[at] + 1)"
        )
        assert await page.value("document.querySelector('#depth').toDataURL()") != surfaces
        text = await page.value("drawCursor(), document.querySelector('#cursor').textContent")
        assert "free up to" in text
        await page.picture(tmp_path / "free.png")
        # It is computed for as long as a page shows it.
        await page.value("map.value = ''; map.onchange()")
        await page.wait("viewer.frame.settings['depth.free_space_risk'] === 0")

        # A second surface, where there is one.
        assert await page.value("viewer.frame.layers.second === undefined")
        await page.value("map.value = 'second'; map.onchange()")
        await page.wait(
            "viewer.frame.layers.second && viewer.frame.settings['depth.second_surface'] === true"
        )
        assert await page.value("viewer.frame.layers.second.length === viewer.frame.depth.length")
        assert await page.value("document.querySelector('#depth').toDataURL()") != surfaces
        await page.picture(tmp_path / "second.png")
        await page.value("map.value = ''; map.onchange()")
        await page.wait("viewer.frame.layers.second === undefined")

        await page.value("document.querySelector('#aid').open = true")
        await page.wait("document.querySelector('#numbers').textContent.includes('Sharpness')")
        numbers = await page.value("document.querySelector('#numbers').textContent")
        assert "of full" in numbers and "Wall" in numbers

        await page.value("enlarge('points')")
        await page.wait("document.querySelector('#points').width === 320")
        await page.wait("viewer.settings['look.picture'] === 'sharp'")
        before = await page.value("document.querySelector('#points').toDataURL()")
        await page.value("viewer.yaw = -0.5; drawPoints()")
        assert await page.value("document.querySelector('#points').toDataURL()") != before
        await page.value("pause.onclick()")
        await page.wait("viewer.frame.settings['run.paused']")

    async def slide(page, name, value):
        await page.value(
            f"(() => {{ const s = document.getElementById('{name}'); s.value = {value};"
            " s.dispatchEvent(new Event('input')); })()"
        )
        await page.wait(f"Math.abs(viewer.frame.settings['{name}'] - {value}) < 0.01")

    async def focused(page, but=0.0):
        await page.wait(
            "viewer.frame.settings['look.picture'] === 'refocused' && viewer.frame.parts.picture"
            f" && Math.abs(viewer.frame.settings['look.focus_m'] - {but}) > 0.05"
        )
        # A frame is there before its picture is decoded and drawn; the next one counts after that.
        begun = await page.value("viewer.shown")
        await page.wait(f"viewer.shown > {begun}")
        return await page.value("viewer.frame.settings['look.focus_m']")

    async def picture(page):
        text = await page.value("document.querySelector('#picture').toDataURL()")
        data = np.frombuffer(base64.b64decode(text.split(",")[1]), np.uint8)
        return cv2.imdecode(data, cv2.IMREAD_COLOR).astype(float)

    async def run():
        async with page_at(address, tmp_path / "browser") as page:
            await use(page)

    (tmp_path / "browser").mkdir()
    asyncio.run(run())
    assert cv2.imread(str(tmp_path / "page.png")).shape == (900, 1280, 3)


def test_frames_of_another_size_are_refused_and_kept_in_snapshots(tmp_path):
    """The same blur in other pixels is another depth."""
    camera, picture = tmp_path / "camera.yaml", tmp_path / "large.png"
    camera.write_text(yaml.safe_dump(CAMERA))
    shape = 2 * CAMERA["image_height"], 2 * CAMERA["image_width"]
    light = np.random.default_rng(0).uniform(0.2, 0.8, shape).astype(np.float32)
    write_image(picture, light)
    options = Options(
        source=str(picture),
        camera=str(camera),
        bank=None,
        depth_range=(NEAR_M, FAR_M),
        output=tmp_path / "kept",
        host="127.0.0.1",
        port=0,
        rate=15.0,
        browser=False,
        pixels=PixelFormat(),
        depth=DepthConfig(temporal_frames=4.0),
    )
    server, _ = make_server(options)
    shown = []
    show = server.live._show
    server.live._show = lambda each: (show(each), shown.append(each))
    server.live.start()
    server.live.watch(True)
    assert wait_until(lambda: shown)
    server.live.stop()
    assert shown[0].estimate is None
    assert "the same blur in pixels would be another depth" in shown[0].problem
    kept = read_image(server._keeping.snapshot(LookConfig()) + "/coded.png")
    assert kept.shape[:2] == shape
