"""A headless Chromium, driven over its DevTools protocol through a pair of pipes."""

import base64
import io
import json
import os
import selectors
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

NAMES = ("chromium-headless-shell", "chrome-headless-shell", "chromium", "google-chrome")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--hide-scrollbars",
    "--force-color-profile=srgb",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--remote-debugging-pipe",
)
PATIENCE = 120.0
"""Seconds after which a browser that says nothing has failed."""


def find_browser() -> str | None:
    """The program that CLGS_CHROMIUM names, or one of NAMES."""
    return os.environ.get("CLGS_CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """One page in a browser of its own; ``errors``: what its console and scripts complain of."""

    def __init__(self, program: str, folder: Path) -> None:
        ours, theirs = os.pipe(), os.pipe()  # (to read, to write): commands, answers
        command = [program, *FLAGS, f"--user-data-dir={folder}", "about:blank"]

        def join_pipes() -> None:
            keep = os.dup(ours[0]), os.dup(theirs[1])
            os.dup2(keep[0], 3)
            os.dup2(keep[1], 4)

        self._process = subprocess.Popen(
            command, preexec_fn=join_pipes, close_fds=False, stderr=subprocess.DEVNULL
        )
        os.close(ours[0])
        os.close(theirs[1])
        self._to, self._from, self._rest, self._number = ours[1], theirs[0], b"", 0
        self.errors: list[str] = []
        self._waiting = selectors.DefaultSelector()
        self._waiting.register(self._from, selectors.EVENT_READ)
        self._session: str | None = None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Runtime", "Page", "Log"):
            self.call(f"{domain}.enable")

    def close(self) -> None:
        """End the browser."""
        os.close(self._to)
        os.close(self._from)
        self._process.terminate()
        self._process.wait()

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The result of a DevTools command."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while (answer := self._read()).get("id") != self._number:
            self._note(answer)
        assert "error" not in answer, answer
        return answer["result"]

    def open(self, page: Path | str, width: int = 800, height: int = 600) -> None:
        """Go to a file or an address in a window of this size."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **size)
        self.call("Page.navigate", url=page if isinstance(page, str) else page.resolve().as_uri())

    def load(self, page: Path | str, size: int, until: str = "s.ready || s.failed") -> Any:
        """Open a scene's page in a square window; its state ``s`` once ``until`` holds of it."""
        self.open(page, size, size)
        self.wait(f"window.clgs && ((s) => {until})(clgs.state())")
        return self.value("clgs.state()")

    def value(self, expression: str) -> Any:
        """The value of a JavaScript expression."""
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def wait(self, expression: str, done: Callable[[Any], bool] = bool) -> Any:
        """The first value of the expression that is ``done``."""
        for _ in range(int(PATIENCE / 0.05)):
            if done(value := self.value(expression)):
                return value
            time.sleep(0.05)
        raise AssertionError(f"{expression}: still {value}; {self.errors}")

    def screenshot(self, width: int, height: int) -> np.ndarray:
        """The picture (height, width, 3) uint8 at the window's upper left."""
        data = self.call("Page.captureScreenshot", format="png")["data"]
        whole = Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")
        return np.asarray(whole.crop((0, 0, width, height)))

    def _read(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            assert self._waiting.select(PATIENCE), "the browser does not answer"
            data = os.read(self._from, 1 << 20)
            assert data, "the browser is gone"
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\0")
        return json.loads(line)

    def _note(self, event: dict[str, Any]) -> None:
        """Keep what is an error."""
        method, what = event.get("method"), event.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(what["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and what["type"] in ("error", "warning"):
            self.errors.append(json.dumps(what["args"]))
        elif method == "Log.entryAdded" and what["entry"]["level"] in ("error", "warning"):
            self.errors.append(what["entry"]["text"])
