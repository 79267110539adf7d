"""A headless Chromium that opens a file and is looked at in real time, by the DevTools protocol."""

import base64
import io
import json
import shutil
import subprocess
import time
import urllib.request
from contextlib import contextmanager

import numpy as np

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
OPTIONS = [
    "--headless=new",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
]


class BrowserError(Exception):
    """What the browser could not do."""


class Page:
    """An open page: pictures of it, clicks on it, what it wrote on the console and what it
    asked for."""

    def __init__(self, connection):
        self.connection, self.number, self.events = connection, 0, []

    def call(self, method, **parameters):
        self.number += 1
        self.connection.send(
            json.dumps({"id": self.number, "method": method, "params": parameters})
        )
        while True:
            answer = json.loads(self.connection.recv(timeout=60))
            if answer.get("id") == self.number:
                if "error" in answer:
                    raise BrowserError(f"{method}: {answer['error']}")
                return answer["result"]
            self.events.append(answer)

    def picture(self, seconds=60):
        """The pixels (height, width, 3), between 0 and 1."""
        from matplotlib.image import imread

        end = time.monotonic() + seconds
        while True:
            try:
                data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
                break
            except BrowserError:
                # as long as a frame takes longer to draw than the browser waits for it
                if time.monotonic() > end:
                    raise
                time.sleep(0.5)
        return imread(io.BytesIO(data), format="png")[..., :3]

    def drawn(self, seconds=120):
        """The first picture that shows more than controls on white."""
        end = time.monotonic() + seconds
        while np.mean((picture := self.picture()).min(-1) < 0.6) < 0.03:
            assert time.monotonic() < end, f"nothing was drawn within {seconds} s"
            time.sleep(0.5)
        return picture

    def value(self, expression):
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)[
            "result"
        ].get("value")

    def click(self, x, y):
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def wait_for(self, condition, seconds=60):
        """Wait until a JavaScript expression is true."""
        end = time.monotonic() + seconds
        while not self.value(condition):
            assert time.monotonic() < end, f"{condition} did not come true within {seconds} s"
            time.sleep(0.2)

    @property
    def errors(self):
        """Errors on the console and exceptions."""
        self.call("Runtime.evaluate", expression="0")  # receives what is pending
        found = [
            event["params"] for event in self.events if event["method"] == "Runtime.exceptionThrown"
        ]
        found += [
            e["params"]
            for e in self.events
            if e["method"] == "Log.entryAdded" and e["params"]["entry"]["level"] == "error"
        ]
        return found + [
            e["params"]
            for e in self.events
            if e["method"] == "Runtime.consoleAPICalled" and e["params"]["type"] == "error"
        ]

    @property
    def requests(self):
        """Addresses that it asked for."""
        return [
            event["params"]["request"]["url"]
            for event in self.events
            if event["method"] == "Network.requestWillBeSent"
        ]


@contextmanager
def opened(path, folder, size=(900, 600)):
    """A page that shows a file; the folder holds the browser's own files."""
    from websockets.sync.client import connect

    command = [
        CHROMIUM,
        *OPTIONS,
        "--remote-debugging-port=0",
        f"--user-data-dir={folder}",
        f"--window-size={size[0]},{size[1]}",
    ]
    process = subprocess.Popen(
        [*command, "about:blank"], stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
    )
    try:
        address = (
            next(line for line in process.stderr if "DevTools listening on" in line)
            .split(" on ")[1]
            .strip()
        )
        pages = json.load(urllib.request.urlopen(f"http://{address.split('/')[2]}/json"))
        with connect(
            next(page for page in pages if page["type"] == "page")["webSocketDebuggerUrl"],
            max_size=None,
        ) as connection:
            page = Page(connection)
            for domain in ("Page", "Runtime", "Network", "Log"):
                page.call(f"{domain}.enable")
            page.call(
                "Emulation.setDeviceMetricsOverride",
                width=size[0],
                height=size[1],
                deviceScaleFactor=1,
                mobile=False,
            )
            page.call("Page.navigate", url=path.as_uri())
            yield page
    finally:
        process.terminate()
        process.wait(timeout=30)


def difference(one, other):
    """The share of pixels that differ."""
    return float(np.mean(np.abs(one - other).max(-1) > 0.1))
