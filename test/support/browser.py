"""A real browser without a window, for pages that compute."""

import re
import shutil

import pytest
from waiting import run_program

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--no-first-run",
    "--no-default-browser-check", "--disable-dev-shm-usage",
)  # fmt: skip


class Browser:
    """Chromium with a profile of its own, cut off from the network."""

    def __init__(self, program, profile):
        self._command = [program, *_OPTIONS, f"--user-data-dir={profile}"]
        # Whatever a page asks for over the network, this proxy, which is not there, refuses.
        self._command += ["--proxy-server=127.0.0.1:1", "--virtual-time-budget=3000"]

    def page_after_scripts(self, address):
        """Return the page's HTML once its scripts have run."""
        return self._run("--dump-dom", address).stdout

    def screenshot(self, address, width, height, path):
        self._run(f"--window-size={width},{height}", f"--screenshot={path}", address)

    def _run(self, *arguments):
        result = run_program(*self._command, *arguments, timeout_s=90)
        assert result.returncode == 0, result.stderr
        return result


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    program = next(filter(None, map(shutil.which, _NAMES)), None)
    if program is None:
        pytest.skip("needs a browser: sudo apt install chromium")
    return Browser(program, tmp_path_factory.mktemp("browser"))


def values_of(html):
    """Return the numbers behind the outputs of a page, and what the page says about them."""
    found = re.findall(r'<output id="(\w+)" data-value="([^"]*)">', html)
    values = {name: float(text.replace("null", "nan").replace("I", "i")) for name, text in found}
    (message,) = re.findall(r'<p id="message"[^>]*>(.*?)</p>', html, re.DOTALL)
    return values, message
