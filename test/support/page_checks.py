"""Checks of a page in a real browser: does it fit the window, and can everybody use it?"""

from pathlib import Path

_HERE = Path(__file__).parent
_FINDINGS = (_HERE / "page_findings.js").read_text("utf-8")
_BEYOND = (_HERE / "page_beyond.js").read_text("utf-8")


async def findings(page):
    """Return what keeps people from using a page, a line for each."""
    return await page.value(_FINDINGS)


async def beyond_the_window(page):
    """Return what is wider than the window, a line for each."""
    return await page.value(_BEYOND)


async def scrolls_down(page):
    """Return whether the page is higher than the window."""
    return await page.value("document.documentElement.scrollHeight > innerHeight")


async def set_display(page, width, height, scheme="light"):
    """Set size of the window, px, and the colours that the user prefers."""
    shape = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
    await page.ask("Emulation.setDeviceMetricsOverride", **shape)
    feature = {"name": "prefers-color-scheme", "value": scheme}
    await page.ask("Emulation.setEmulatedMedia", features=[feature])
