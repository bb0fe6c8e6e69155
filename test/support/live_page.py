"""A real browser without a window, spoken to in its own protocol."""

import asyncio
import base64
import itertools
import shutil
import subprocess
import time
from contextlib import asynccontextmanager

import aiohttp
from waiting import scaled

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)


class Page:
    """One page of the browser."""

    def __init__(self, socket):
        self._socket, self._numbers = socket, itertools.count(1)

    async def ask(self, method, **params):
        number = next(self._numbers)
        await self._socket.send_json({"id": number, "method": method, "params": params})
        async for message in self._socket:
            answer = message.json()
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return answer["result"]
        raise AssertionError("the browser has gone")

    async def value(self, expression):
        """Return what an expression is on the page; promises are waited for."""
        answer = await self.ask(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    async def wait(self, expression, timeout_s=60.0):
        """Wait until an expression is true; return it."""
        deadline = time.monotonic() + scaled(timeout_s)
        while not (found := await self.value(expression)):
            assert time.monotonic() < deadline, expression
            await asyncio.sleep(0.05)
        return found

    async def click(self, selector, x=0.5, y=0.5):
        """Click on an element, at a share of its width and height."""
        box = await self.value(
            f"(() => {{ const b = document.querySelector({selector!r}).getBoundingClientRect();"
            " return [b.left, b.top, b.width, b.height]; })()"
        )
        at = {"x": box[0] + x * box[2], "y": box[1] + y * box[3]}
        await self.ask("Input.dispatchMouseEvent", type="mouseMoved", **at)
        for kind in ("mousePressed", "mouseReleased"):
            await self.ask("Input.dispatchMouseEvent", type=kind, button="left", clickCount=1, **at)

    async def picture(self, path):
        """Write what the page looks like."""
        answer = await self.ask("Page.captureScreenshot", format="png")
        path.write_bytes(base64.b64decode(answer["data"]))


@asynccontextmanager
async def page_at(address, folder, size=(1280, 900)):
    """Open a page in a browser of its own, whose files go to a folder."""
    command = [CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run"]
    command += ["--remote-debugging-port=0", f"--user-data-dir={folder}", "about:blank"]
    program = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        told = folder / "DevToolsActivePort"
        deadline = time.monotonic() + scaled(60)
        while not (told.exists() and told.read_text().count("\n")):
            assert program.poll() is None and time.monotonic() < deadline
            await asyncio.sleep(0.05)
        port = told.read_text().split()[0]
        async with aiohttp.ClientSession() as session:
            async with session.put(f"http://127.0.0.1:{port}/json/new?about:blank") as answer:
                socket_address = (await answer.json())["webSocketDebuggerUrl"]
            async with session.ws_connect(socket_address, max_msg_size=0) as socket:
                page = Page(socket)
                shape = {"width": size[0], "height": size[1]}
                scale = {"deviceScaleFactor": 1, "mobile": False}
                await page.ask("Emulation.setDeviceMetricsOverride", **shape, **scale)
                await page.ask("Page.navigate", url=address)
                yield page
    finally:
        program.terminate()
        program.wait(scaled(20))
