"""The viewer's server: pages that misbehave, visitors without a token, several pages at once."""

import asyncio
import logging
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import suppress
from functools import partial
from types import SimpleNamespace

import pytest
from small_camera import coded_wall
from waiting import scaled

pytest.importorskip("aiohttp", reason="the viewer needs aiohttp")

from coded_aperture_viewer import guard, open_page, recording
from coded_aperture_viewer import server as server_module
from coded_aperture_viewer.keeping import Keeping
from live_viewer import BlockedSource, client, serving, viewer_options

from coded_aperture_ros.bags import Bag
from coded_aperture_ros.io import write_image
from coded_aperture_ros.optics import load_camera

NO_FRAME = "no frame has come yet"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("viewer")


@pytest.fixture
def options(folder, tmp_path):
    return lambda **changed: viewer_options(folder, **{"output": tmp_path / "kept"} | changed)


def run(use, options, source=None):
    """Run a coroutine function on a server; return what it returns."""

    async def main():
        async with serving(options, source) as served:
            return await use(served)

    return asyncio.run(main())


def recorded_frames(output):
    (path,) = output.glob("recording-*")
    with Bag(path) as bag:
        counts = Counter(message.topic for message in bag.messages())
    assert counts["/image_raw"] == counts["/camera_info"]
    return counts["/image_raw"]


@pytest.mark.parametrize("pages", [0, pytest.param(1, marks=pytest.mark.slow), 15])
def test_the_end_waits_for_no_page_and_keeps_the_recording(options, tmp_path, pages):
    async def use(served):
        stuck = [served.stuck_page() for _ in range(pages)]
        async with client(served) as page:
            await page.shown()
            await page.send({"do": "record"})
            await page.told(lambda message: (message.get("recorded") or 0) >= 3)
            await served.until(lambda: len(served.server._pages) == pages + 1)
            # Every one has what it does not take.
            await served.until(
                lambda: sum(each._buffered() > 0 for each in served.server._pages) >= pages
            )
            count = served.server._keeping.recorded
            took_s = await served.end()
        for each in stuck:
            each.close()
        return count, took_s

    count, took_s = run(use, options())
    assert took_s < scaled(2)
    assert recorded_frames(tmp_path / "kept") >= count >= 3


def test_the_end_waits_for_no_camera(options):
    async def use(served):
        async with client(served) as page:
            await page.told()
            return await served.end()

    assert run(use, options(), BlockedSource()) < scaled(2)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_end_the_program_with_its_recording(options, tmp_path, number):
    """As a user starts it; with a page that takes nothing."""
    chosen = options()
    command = [sys.executable, "-m", "coded_aperture_ros", "view", "--no-browser", "--port", "0"]
    command += ["--camera", chosen.camera, "--bank", chosen.bank, "--output", str(chosen.output)]
    program = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # Where the tests run under nohup, hanging up is ignored, by what they start, too.
        preexec_fn=partial(signal.signal, number, signal.SIG_DFL),
    )
    port = int(re.search(r":(\d+)/", program.stdout.readline())[1])

    served = SimpleNamespace(host="127.0.0.1", port=port, token="")

    async def use():
        async with client(served) as page:
            await page.shown()
            await page.send({"do": "record"})
            await page.told(lambda message: (message.get("recorded") or 0) >= 3)
            began = time.monotonic()
            program.send_signal(number)
            await asyncio.to_thread(program.wait, scaled(30))
            return time.monotonic() - began

    took_s = asyncio.run(use())
    _, error = program.communicate()
    assert took_s < scaled(2)
    assert "Traceback" not in error
    assert re.search(r"recorded .*: \d+ frames", error)
    assert recorded_frames(chosen.output) >= 3


@pytest.mark.slow
def test_a_page_that_takes_nothing_is_dropped_and_a_slow_one_is_not(options, monkeypatch):
    monkeypatch.setattr(open_page, "_STUCK_S", 0.3)

    async def use(served):
        stuck, slow = served.stuck_page(), served.stuck_page()
        slow.setblocking(False)
        async with client(served) as page:
            await served.until(lambda: len(served.server._pages) == 3)
            for _ in range(2000):
                await asyncio.sleep(0.02)
                with suppress(BlockingIOError):
                    slow.recv(4096)
                if len(served.server._pages) < 3:
                    break
            await asyncio.sleep(0.7)
            slow.recv(4096)
            await page.shown()
            count = len(served.server._pages)
        stuck.close()
        slow.close()
        return count

    assert run(use, options()) == 2


def test_a_page_hears_from_a_paused_viewer(options, monkeypatch, tmp_path):
    monkeypatch.setattr(open_page, "HEARTBEAT_S", 0.1)

    async def use(served):
        async with client(served) as page:
            await page.send({"set": {"run.paused": True}})
            await page.told(lambda message: message.get("settings", {}).get("run.paused"))
            await asyncio.sleep(0.5)
            for _ in range(5):
                await page.told()

    run(use, options())


def test_of_too_many_visitors_the_oldest_are_cut_off(options, monkeypatch):
    monkeypatch.setattr(guard, "_REQUEST_S", 1000.0)

    async def use(served):
        idle = [
            await asyncio.open_connection("127.0.0.2", served.port)
            for _ in range(2 * guard._MOST_WAITING)
        ]

        def is_cut_off():
            return [reader.at_eof() or reader.exception() is not None for reader, _ in idle]

        # Those that come at one time are counted later.
        await served.until(lambda: sum(is_cut_off()) >= guard._MOST_WAITING / 2)
        assert is_cut_off()[0] and not is_cut_off()[-1]
        for _, writer in idle:
            writer.close()

    run(use, options(host="127.0.0.2"))


def test_visitors_without_the_token_take_no_connection_of_pages(options, monkeypatch):
    monkeypatch.setattr(guard, "_REQUEST_S", 2.0)

    async def use(served):
        async with client(served) as page:
            await page.shown()
            idle = [
                await asyncio.open_connection("127.0.0.2", served.port)
                for _ in range(3 * guard._MOST_WAITING)
            ]
            for number, (_, writer) in enumerate(idle):
                writer.write([b"", b"GET /", b"GET / HTTP/1.1\r\nHost:"][number % 3])
            assert (await served.request(f"/?token={served.token}"))[0] == 200
            assert len(served.server.connections()) == 1
            await served.until(
                lambda: all(reader.at_eof() or reader.exception() for reader, _ in idle)
            )
            await page.shown()
            for _, writer in idle:
                writer.close()

    run(use, options(host="127.0.0.2"))


_REQUESTS = {
    "garbage": b"\x16\x03\x01\x02\x00\x01\xfc\x03\x03" + bytes(200) + b"\r\n\r\n",
    "host": b"GET / HTTP/1.1\r\nHost: [\r\n\r\n",
    "no host": b"GET / HTTP/1.1\r\n\r\n",
    "origin": b"GET / HTTP/1.1\r\nHost: localhost\r\nOrigin: http://[\r\n\r\n",
    "null origin": b"GET / HTTP/1.1\r\nHost: localhost\r\nOrigin: null\r\n\r\n",
    "origin bytes": b"GET / HTTP/1.1\r\nHost: localhost\r\nOrigin: \xff\xfe\r\n\r\n",
    "token bytes": b"GET /?token=%ff%ed%a0%80 HTTP/1.1\r\nHost: [::\r\n\r\n",
    "long header": b"GET / HTTP/1.1\r\nHost: " + b"a" * 20_000 + b"\r\n\r\n",
    "long path": b"GET /" + b"a" * 20_000 + b" HTTP/1.1\r\n\r\n",
    "method": b"BREW / HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "no upgrade": b"GET /live HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "path": b"GET /../../etc/passwd HTTP/1.1\r\nHost: localhost\r\n\r\n",
}


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.2"])
def test_malformed_requests_are_refused_and_hardly_logged(options, caplog, host):
    async def use(served):
        lines = {}
        for name, data in _REQUESTS.items():
            reader, writer = await asyncio.open_connection(host, served.port)
            writer.write(data)
            line = await asyncio.wait_for(reader.readline(), scaled(10))
            lines[name] = line.decode().split(" ")[1]
            writer.close()
        return lines

    with caplog.at_level(logging.INFO):
        lines = run(use, options(host=host))
    assert {name for name, status in lines.items() if status[0] != "4"} == set()
    assert len(caplog.records) <= 1
    assert not any(record.exc_info for record in caplog.records)


_MESSAGES = {
    "no JSON": "{",
    "number": "7",
    "deep": "[" * 60_000,
    "digits": "1" * 10_000,
    "list": '{"set": []}',
    "null": '{"set": null}',
    "name": '{"set": {"depth.magic": 1}}',
    "surrogate": '{"set": {"\\ud800": 1}}',
    "value null": '{"set": {"depth.smoothness": null}}',
    "value list": '{"set": {"depth.smoothness": [1]}}',
    "value object": '{"set": {"depth.regularize": {"a": 1}}}',
    "value bool": '{"set": {"depth.smoothness": true}}',
    "value text": '{"set": {"depth.smoothness": "1"}}',
    "huge": '{"set": {"depth.smoothness": 1' + "0" * 400 + "}}",
    "infinite": '{"set": {"depth.smoothness": 1e999}}',
    "nan": '{"set": {"depth.smoothness": NaN}}',
    "choice": '{"set": {"look.picture": ["sharp"]}}',
    "focus": '{"set": {"look.focus_m": 0}}',
    "layer": '{"layer": "magic"}',
    "layer list": '{"layer": []}',
}


def test_malformed_messages_get_a_reason(options, caplog):
    async def use(served):
        problems = {}
        async with client(served) as page:
            before = served.server._switches.chosen
            for name, text in _MESSAGES.items():
                await page.send_text(text)
                problems[name] = await page.problem()
            await page.send_bytes(b"\0")
            await page.send({"do": ["snapshot"], "other": 1})
            assert served.server._switches.chosen == before
            await page.shown()
        async with client(served) as page:
            await page.send_text("x" * 100_000)
            assert await page.closed() == 1009
        return problems

    problems = run(use, options())
    assert all(0 < len(text) < 300 and "\n" not in text for text in problems.values())
    assert caplog.records == []


@pytest.mark.parametrize(
    "name",
    [
        "depth.stride_px", "depth.threads", "depth.backend", "depth.noise", "depth.__class__",
        "deblur.rank", "deblur.method", "deblur.threads", "run.__init__", "look.made_from", "depth",
    ],
)  # fmt: skip
def test_only_settings_with_a_control_are_set(options, name):
    async def use(served):
        async with client(served) as page:
            await page.send({"set": {"depth.smoothness": 2.0, name: 1}})
            problem = await page.problem()
            assert served.server._switches.chosen.depth.smoothness == 1.0
            return problem

    assert f"there is no {name}" in run(use, options(), BlockedSource())


def test_read_only_pages_only_look(options, tmp_path):
    async def use(served):
        async with client(served) as page:
            assert (await page.told())["read_only"]
            await page.shown()
            for wanted in (
                {"set": {"depth.smoothness": 2}},
                {"set": {"run.paused": True}},
                {"set": {"look.picture": "none", "deblur.smoothness": 2}},
                {"do": "snapshot"},
                {"do": "record"},
            ):
                await page.send(wanted)
                assert "read-only" in await page.problem()
            await page.send({"set": {"look.picture": "none"}, "layer": "free_space"})
            head = await page.shown(lambda head: head["settings"]["look.picture"] == "none")
            assert head["settings"]["depth.free_space_risk"] == 0
            head = await page.shown()
            assert "free_space" not in head["parts"]

    run(use, options(read_only=True))
    assert not (tmp_path / "kept").exists()


def test_every_answer_has_the_headers_that_protect_it(options):
    async def use(served):
        return [
            await served.request(path, **headers)
            for path, headers in (
                ("/", {}), ("/nothing", {}), ("/", {"Host": "example.org"}),
                ("/", {"Origin": "http://example.org"}), ("/live", {}),
            )
        ]  # fmt: skip

    answers = run(use, options(), BlockedSource())
    assert [status for status, *_ in answers] == [200, 404, 403, 403, 400]
    for _, headers, _ in answers:
        assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert headers["X-Frame-Options"] == "DENY"
        assert headers["Referrer-Policy"] == "no-referrer"
    assert "unsafe" not in answers[0][1]["Content-Security-Policy"].split("script-src")[1]


def test_a_page_too_many_is_told_so(options, monkeypatch):
    monkeypatch.setattr(server_module, "_MOST_PAGES", 1)

    async def use(served):
        async with client(served) as first:
            await first.told()
            async with client(served) as second:
                assert "pages are open already" in await second.problem()
                assert await second.closed() == 1013
            await first.shown()
        await served.until(lambda: not served.server._pages)
        async with client(served) as third:
            await third.shown()

    run(use, options())


def test_snapshots_of_one_second_are_not_mixed(options, tmp_path):
    async def use(served):
        async with client(served) as page:
            await page.shown(lambda head: "picture" in head["parts"])
            keep = served.server._keeping.snapshot
            looks = [next(iter(served.server._pages)).look] * 4
            return await asyncio.gather(*(asyncio.to_thread(keep, look) for look in looks))

    folders = run(use, options())
    assert len(set(folders)) == 4
    names = [sorted(path.name for path in each.iterdir()) for each in (tmp_path / "kept").iterdir()]
    assert len(names) == 4 and names[0].count("depth.npy") == 1
    assert all(each == names[0] for each in names)


def test_a_snapshot_whose_name_was_just_taken_gets_another(options, tmp_path, monkeypatch):
    names = iter(["taken", "free"])
    monkeypatch.setattr(recording, "new_path", lambda output, kind: output / next(names))
    (tmp_path / "kept" / "taken").mkdir(parents=True)
    (tmp_path / "kept" / "taken" / "coded.png").write_text("of another")

    async def use(served):
        async with client(served) as page:
            await page.shown(lambda head: "picture" in head["parts"])
            look = next(iter(served.server._pages)).look
            return served.server._keeping.snapshot(look)

    assert run(use, options()) == str(tmp_path / "kept" / "free")
    assert (tmp_path / "kept" / "taken" / "coded.png").read_text() == "of another"
    assert sorted(path.name for path in (tmp_path / "kept").iterdir()) == ["free", "taken"]


def test_recordings_of_two_viewers_do_not_replace_each_other(options, tmp_path):
    """Both begin in the same second, in one folder."""
    (tmp_path / "kept").mkdir()

    async def use(served):
        async with client(served) as page:
            await page.shown()
            ours = served.server._keeping
            other = Keeping(tmp_path / "kept", served.server._camera, "")
            await served.until(lambda: ours._complete is not None)
            other._complete = ours._complete
            for each in (ours, other):
                each.toggle_recording()
            for each in (ours, other):
                each.add(ours._complete, True)
            return [each.toggle_recording().split(": ")[0] for each in (ours, other)]

    paths = run(use, options())
    assert len(set(paths)) == 2
    assert len(list((tmp_path / "kept").iterdir())) == 2


def test_nothing_is_kept_before_the_first_frame(options, tmp_path):
    async def use(served):
        async with client(served) as page:
            for kind in ("snapshot", "record"):
                await page.send({"do": kind})
                assert NO_FRAME in await page.problem()

    run(use, options(), BlockedSource())
    assert not (tmp_path / "kept").exists()


def test_a_layer_is_computed_while_a_page_shows_it(options):
    risk, second = "depth.free_space_risk", "depth.second_surface"

    async def use(served):
        async with client(served) as one:
            async with client(served) as other:
                for page in (one, other):
                    await page.send({"layer": "free_space"})
                await one.shown(lambda head: "free_space" in head["parts"])
                await one.send({"layer": "second"})
                head = await one.shown(lambda head: "second" in head["parts"])
                assert head["settings"][risk] == 0.01 and head["settings"][second] is True
                # Another regularisation has no such layers, and comes without a complaint.
                await one.send({"set": {"depth.regularize": "none"}})
                await one.shown(lambda head: not {"second", "free_space"} & head["parts"].keys())
                await one.send({"set": {"depth.regularize": "learned", risk: 0.005}})
                await one.shown(lambda head: head["settings"][risk] == 0.005)
            # The other page has gone.
            await one.shown(lambda head: head["settings"][risk] == 0)
            await one.send({"layer": ""})
            head = await one.shown(lambda head: head["settings"][second] is False)
            assert not {"second", "free_space"} & head["parts"].keys()
            # What is chosen by its control stays.
            await one.send({"set": {risk: 0.002}, "layer": "free_space"})
            await one.send({"layer": ""})
            await one.told(lambda message: message.get("settings", {}).get(risk) == 0.002)
            await asyncio.sleep(0.3)
            return served.server._switches.settings.depth.free_space_risk

    assert run(use, options()) == 0.002


def test_pages_share_settings_and_have_a_look_of_their_own(options):
    async def use(served):
        async with client(served) as one, client(served) as other:
            await other.told(lambda message: message.get("pages") == 2)
            await one.send({"set": {"look.picture": "refocused", "look.focus_m": 1.7}})
            await one.send({"set": {"depth.confidence_threshold": 0.25}})
            found = await other.told(
                lambda m: m.get("settings", {}).get("depth.confidence_threshold") == 0.25
            )
            assert found["settings"]["look.picture"] == "sharp"
            head = await one.shown(
                lambda head: head["settings"]["look.focus_m"] == 1.7 and "picture" in head["parts"]
            )
            sharp = await other.shown(lambda head: "picture" in head["parts"])
            assert sharp["settings"]["look.picture"] == "sharp"
            assert head["settings"]["look.picture"] == "refocused"

    run(use, options())


def test_a_look_is_made_of_a_paused_frame_too(options, tmp_path):
    """One that only the second page wants."""
    wall = coded_wall(load_camera(options().camera))
    write_image(tmp_path / "a.png", wall)

    async def use(served):
        async with client(served) as one:
            await one.shown()
            async with client(served) as other:
                await other.send({"set": {"look.picture": "refocused"}})
                await other.shown(
                    lambda head: (
                        head["settings"]["look.picture"] == "refocused"
                        and "picture" in head["parts"]
                    )
                )

    run(use, options(source=str(tmp_path / "a.png")))
