"""A headless Chromium, spoken to over a pipe, without a package or a network."""

import base64
import contextlib
import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

_PATIENCE_S = 60.0


class Page:
    """One page of a browser, and what it has complained of.

    Attributes:
        complaints: Errors and warnings of the console, exceptions and refusals.
        requests: Addresses that the page has asked for.
    """

    def __init__(self, process, send_to, read_from):
        self._process, self._send_to, self._read_from = process, send_to, read_from
        self._count, self._buffer, self._session = 0, b"", None
        self.complaints, self.requests = [], []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for area in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{area}.enable")

    def call(self, method, **parameters):
        """Return the answer to one command of the DevTools protocol."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._send_to, json.dumps(message).encode() + b"\0")
        return self._until(lambda found: found.get("id") == message["id"])["result"]

    def open(self, path, *, width=1100, height=900, dark=False, media="screen"):
        """Load a file in a window of that size, theme and medium."""
        self.complaints.clear()
        self.requests.clear()
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=width < 500,
        )  # fmt: skip
        theme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", media=media, features=[theme])
        self.call("Page.navigate", url=path.as_uri())
        self._until(lambda found: found.get("method") == "Page.loadEventFired")
        self.settle()

    def settle(self):
        """Wait until what was asked for has been drawn."""
        wait = "new Promise(r => requestAnimationFrame(() => setTimeout(r, 50)))"
        self.value(wait)

    def value(self, expression):
        """Return what a piece of script gives."""
        found = self.call(
            "Runtime.evaluate",
            expression=expression, returnByValue=True, awaitPromise=True,
        )  # fmt: skip
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def mouse(self, kind, x, y, **more):
        """Move or press the mouse at a place of the window."""
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)
        self.settle()

    def screenshot(self, path, *, box=None):
        """Write the window as it is seen, or a box of the page: x, y, width, height."""
        options = {}
        if box is not None:
            clip = dict(zip(("x", "y", "width", "height"), box, strict=True), scale=1)
            options = {"clip": clip, "captureBeyondViewport": True}
        data = self.call("Page.captureScreenshot", **options)["data"]
        path.write_bytes(base64.b64decode(data))

    def pdf(self):
        """Return the page printed on A4."""
        self.call("Emulation.setEmulatedMedia", media="")
        found = self.call("Page.printToPDF", paperWidth=8.27, paperHeight=11.69)
        return base64.b64decode(found["data"])

    def _until(self, is_it):
        end = time.monotonic() + _PATIENCE_S
        while True:
            while b"\0" in self._buffer:
                text, _, self._buffer = self._buffer.partition(b"\0")
                found = json.loads(text)
                self._note(found)
                assert "error" not in found, found
                if is_it(found):
                    return found
            assert time.monotonic() < end and self._process.poll() is None
            self._buffer += os.read(self._read_from, 1 << 20)

    def _note(self, event):
        name, about = event.get("method"), event.get("params", {})
        if name == "Runtime.consoleAPICalled" and about["type"] in ("error", "warning"):
            self.complaints.append(str(about["args"]))
        elif name == "Runtime.exceptionThrown":
            self.complaints.append(str(about["exceptionDetails"]))
        elif name == "Log.entryAdded":
            self.complaints.append(about["entry"]["text"])
        elif name == "Network.requestWillBeSent":
            self.requests.append(about["request"]["url"])


@contextlib.contextmanager
def browser(folder: Path) -> Iterator[Page]:
    """Start Chromium with its data in a folder; skip the test where there is none."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("no chromium is installed: the page cannot be tried in a browser")
    command_in, command_out = os.pipe()
    answer_in, answer_out = os.pipe()
    # The browser reads its commands from descriptor 3 and answers on 4.
    shell = 'exec "$0" "$@" 3<&$IN 4>&$OUT'
    process = subprocess.Popen(
        [
            "bash", "-c", shell, program, "--headless=new", "--no-sandbox",
            "--disable-gpu", "--remote-debugging-pipe", "--no-first-run",
            f"--user-data-dir={folder}", "--disable-background-networking",
            "--disable-component-update", "--disable-dev-shm-usage",
        ],
        pass_fds=(command_in, answer_out),
        env={**os.environ, "IN": str(command_in), "OUT": str(answer_out)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )  # fmt: skip
    os.close(command_in)
    os.close(answer_out)
    try:
        yield Page(process, command_out, answer_in)
    finally:
        os.close(command_out)
        os.close(answer_in)
        process.terminate()
        process.wait(20)
