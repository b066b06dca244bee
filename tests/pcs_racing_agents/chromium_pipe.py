"""A browser without a display, driven through a pipe: frames need real time, which ``--dump-dom`` does not give."""

import base64
import fcntl
import io
import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
from PIL import Image

PATIENCE = 90.0  # seconds; other work may keep the machine busy


def chromium():
    """The program, or None."""
    return shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


class Browser:
    """One page of Chromium.

    ``complaints`` holds what it wrote to the console, frames included.
    """

    def __init__(self, profile):
        quiet = "--disable-gpu --disable-quic --no-first-run --disable-background-networking --disable-component-update"
        command = [
            chromium(),
            "--headless",
            "--no-sandbox",
            *quiet.split(),
            "--disable-sync",
            "--remote-debugging-pipe",
        ]
        command += [f"--user-data-dir={profile}", "about:blank"]
        read, self._out = os.pipe()
        self._in, write = os.pipe()

        def pipes():
            # Chromium reads from 3 and writes to 4. Either may be one of the two here, so both are copied away first.
            away = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (read, write)]
            os.dup2(away[0], 3)
            os.dup2(away[1], 4)

        self.process = subprocess.Popen(
            command, preexec_fn=pipes, close_fds=False, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL
        )
        os.close(read)
        os.close(write)
        self._buffer, self._count = b"", 0
        self.complaints = []
        # A page of its own: while Chromium starts, the first of its targets need not be one.
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self._listen(self._session)
        self.call("Page.enable", self._session)
        self.call("Performance.enable", self._session, timeDomain="threadTicks")

    def _listen(self, session):
        for method in ("Runtime.enable", "Log.enable"):
            self._send(method, session)
        self._send("Target.setAutoAttach", session, autoAttach=True, waitForDebuggerOnStart=False, flatten=True)

    def _send(self, method, session=None, **parameters):
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        if session:
            message["sessionId"] = session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        return self._count

    def call(self, method, session=None, **parameters):
        number = self._send(method, session, **parameters)
        while True:
            message = self._read()
            if message.get("id") == number:
                assert "error" not in message, message["error"]
                return message["result"]

    def _read(self):
        end = time.monotonic() + PATIENCE
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._in], [], [], max(0.0, end - time.monotonic()))
            assert ready, "the browser does not answer"
            received = os.read(self._in, 1 << 20)
            assert received, "the browser has ended"
            self._buffer += received
        text, self._buffer = self._buffer.split(b"\0", 1)
        message = json.loads(text)
        kind, told = message.get("method"), message.get("params", {})
        if kind == "Target.attachedToTarget":
            self._listen(told["sessionId"])
        elif kind == "Runtime.exceptionThrown":
            self.complaints.append(json.dumps(told["exceptionDetails"])[:400])
        elif kind == "Log.entryAdded" and told["entry"]["level"] in ("error", "warning"):
            self.complaints.append(told["entry"]["text"])
        elif kind == "Runtime.consoleAPICalled" and told["type"] in ("error", "warning"):
            self.complaints.append(json.dumps(told["args"])[:400])
        return message

    def open(self, address, width=1280, height=720):
        self.call("Emulation.setDeviceMetricsOverride", self._session, width=width, height=height,
                  deviceScaleFactor=1, mobile=False)  # fmt: skip
        self.call("Page.navigate", self._session, url="about:blank")
        self.call("Page.navigate", self._session, url=address if "://" in str(address) else Path(address).as_uri())
        self.wait("document.readyState === 'complete' && location.href !== 'about:blank'")

    def run(self, expression):
        result = self.call(
            "Runtime.evaluate", self._session, expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def thread_seconds(self):
        """Processor time of the page's main thread."""
        metrics = self.call("Performance.getMetrics", self._session)["metrics"]
        return next(metric["value"] for metric in metrics if metric["name"] == "TaskDuration")

    def wait(self, expression):
        end = time.monotonic() + PATIENCE
        while not (result := self.run(expression)):
            assert time.monotonic() < end, f"{expression} stays {result!r}"
            time.sleep(0.1)
        return result

    def press(self, key, text=""):
        kind = "keyDown" if text or len(key) == 1 else "rawKeyDown"
        self.call(
            "Input.dispatchKeyEvent", self._session, type=kind, key=key, text=text or (key if len(key) == 1 else "")
        )
        self.call("Input.dispatchKeyEvent", self._session, type="keyUp", key=key)

    def screenshot(self):
        """Pixels, shape (height, width, 3)."""
        data = base64.b64decode(self.call("Page.captureScreenshot", self._session, format="png")["data"])
        return np.array(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)

    def look(self, right):
        """Look until a picture is right: what a frame has drawn is on the screen a little later."""
        end = time.monotonic() + PATIENCE
        while not right(pixels := self.screenshot()):
            assert time.monotonic() < end, "the page never looks right"
            time.sleep(0.2)
        return pixels

    def close(self):
        self.process.terminate()
        self.process.wait(30)
        os.close(self._out)
        os.close(self._in)
