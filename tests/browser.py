"""Headless Chromium, for the tests that look at pages."""

import shutil
import subprocess

import matplotlib.image
import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")

needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="Chromium is not installed"
)

# A proxy that nobody answers, and no name resolves: what a page without network sees.
OFFLINE = ("--proxy-server=127.0.0.1:9", "--host-resolver-rules=MAP * ~NOTFOUND")


def open_page(url, folder, *options, milliseconds=5000):
    """Open a page for some of its own time, and return what Chromium printed."""
    return subprocess.run(
        [
            CHROMIUM,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
            "--disable-background-networking",
            "--no-first-run",
            f"--user-data-dir={folder / 'profile'}",
            f"--virtual-time-budget={milliseconds}",
            *options,
            url,
        ],
        check=True,
        capture_output=True,
        text=True,
        timeout=120,
    ).stdout


def screenshot(url, folder, *options, size=(800, 500)):
    """Return a picture of a page, shape (height, width, 3), from 0 to 1."""
    path = folder / "screenshot.png"
    width, height = size
    open_page(
        url,
        folder,
        "--hide-scrollbars",
        f"--window-size={width},{height}",
        f"--screenshot={path}",
        *options,
    )
    return matplotlib.image.imread(path)[..., :3]
