"""Headless Chromium for the tests, driven with the DevTools protocol through two pipes."""

import itertools
import json
import os
import shutil
import subprocess
import tempfile
import threading

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--force-color-profile=srgb",
    "--remote-debugging-pipe",
)
# Longer than any page takes, also on a busy machine.
PATIENCE_S = 120


class Browser:
    """One page at a time. `complaints` holds its errors and console messages, `requests` the URLs it fetched."""

    def __init__(self):
        program = next(filter(None, map(shutil.which, PROGRAMS)), None)
        if program is None:
            raise RuntimeError(f"no browser: none of {', '.join(PROGRAMS)}; `apt-get install chromium`, or run tests/run")
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        to_browser, self._write = os.pipe()
        self._read, from_browser = os.pipe()
        # Chromium reads commands from descriptor 3 and writes to 4.
        command = f'exec "$@" 3<&{to_browser} 4>&{from_browser}'
        self.process = subprocess.Popen(
            ["bash", "-c", command, "bash", program, *FLAGS, f"--user-data-dir={self._folder.name}"],
            pass_fds=(to_browser, from_browser),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_browser)
        os.close(from_browser)
        self._numbers = itertools.count(1)
        self._news = threading.Condition()
        self._answers, self._events, self._ended = {}, [], False
        self.complaints, self.requests = [], []
        threading.Thread(target=self._listen, daemon=True).start()
        target = self._ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.ask(f"{domain}.enable")

    def _listen(self):
        with os.fdopen(self._read, "rb") as pipe:
            rest = b""
            while piece := pipe.read1(1 << 16):
                *messages, rest = (rest + piece).split(b"\0")
                for message in map(json.loads, messages):
                    with self._news:
                        self._take(message)
                        self._news.notify_all()
        with self._news:
            self._ended = True
            self._news.notify_all()

    def _take(self, message):
        if "id" in message:
            self._answers[message["id"]] = message
            return
        method, params = message["method"], message["params"]
        self._events.append(method)
        if method == "Runtime.exceptionThrown":
            details = params["exceptionDetails"]
            self.complaints.append(details.get("exception", {}).get("description", details["text"]))
        elif method == "Runtime.consoleAPICalled":
            self.complaints.append(" ".join(str(part.get("value", part.get("description"))) for part in params["args"]))
        elif method == "Log.entryAdded":
            self.complaints.append(params["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])

    def _wait(self, what):
        with self._news:
            if not self._news.wait_for(lambda: self._ended or what(), PATIENCE_S) or not what():
                raise RuntimeError("no answer from the browser")

    def _ask(self, method, session=None, **params):
        number = next(self._numbers)
        request = {"id": number, "method": method, "params": params}
        if session:
            request["sessionId"] = session
        os.write(self._write, json.dumps(request).encode() + b"\0")
        self._wait(lambda: number in self._answers)
        answer = self._answers.pop(number)
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']['message']}")
        return answer["result"]

    def ask(self, method, **params):
        """Sends the page a DevTools command and returns its result."""
        return self._ask(method, self._session, **params)

    def open(self, page, width=1400, height=900, dark=False, scripts=True):
        """Opens a file or a URL in a viewport of the given size in pixels."""
        # The page before may still complain, such as about a server that has ended.
        self._navigate("about:blank")
        self.complaints.clear()
        self.requests.clear()
        self.ask("Emulation.setScriptExecutionDisabled", value=not scripts)
        self.ask("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.ask("Emulation.setEmulatedMedia", features=[scheme])
        self._navigate(page if isinstance(page, str) else page.resolve().as_uri())

    def _navigate(self, url):
        with self._news:
            self._events.clear()
        self.ask("Page.navigate", url=url)
        self._wait(lambda: "Page.loadEventFired" in self._events)

    def value(self, expression):
        """Evaluates a JavaScript expression in the page and returns its value."""
        result = self.ask("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in result:
            raise RuntimeError(result["exceptionDetails"]["exception"]["description"])
        return result["result"].get("value")

    def until(self, condition):
        """Evaluates a condition at each animation frame until it holds; returns its value."""
        wait = """new Promise((done, failed) => {
            const begun = performance.now();
            const look = () => {
                let value = null;
                try { value = CONDITION; } catch (error) { value = null; }
                if (value) done(value);
                else if (performance.now() - begun > 45000) failed(new Error("the condition never held"));
                else requestAnimationFrame(look);
            };
            look();
        })"""
        return self.value(wait.replace("CONDITION", f"({condition})"))

    def frame(self):
        """Waits until the page has drawn pending changes."""
        self.value("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))")

    def mouse(self, kind, x, y, **params):
        self.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, **params)

    def picture(self, path, clip=None):
        """Writes a screenshot as PNG, of the rectangle `clip` if given."""
        import base64

        options = {"clip": {**clip, "scale": 1}} if clip else {}
        data = self.ask("Page.captureScreenshot", captureBeyondViewport=True, **options)["data"]
        path.write_bytes(base64.b64decode(data))

    def close(self):
        if self.process.poll() is None:
            self.process.terminate()
            self.process.wait(10)
        os.close(self._write)
        self._folder.cleanup()
