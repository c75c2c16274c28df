"""Debian's Chromium without a window, driven through its own protocol."""

from __future__ import annotations

import asyncio
import base64
import json
import shutil
import subprocess
import time
from pathlib import Path

CHROMIUM = next((p for n in ("chromium", "chromium-browser") if (p := shutil.which(n))), None)
SIZE = (1200, 900)


class Browser:
    """One page at a time: what it logs, what it asks the network for, what is on it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self._number = 0

    async def __aenter__(self) -> Browser:
        from tornado.websocket import websocket_connect

        self._process = subprocess.Popen(
            [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
             "--remote-debugging-port=0", "--remote-allow-origins=*",
             f"--user-data-dir={self.folder / 'profile'}",
             f"--window-size={SIZE[0]},{SIZE[1]}", "about:blank"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        port = await self._port()
        from tornado.httpclient import AsyncHTTPClient

        answer = await AsyncHTTPClient().fetch(f"http://127.0.0.1:{port}/json/list")
        page = next(t for t in json.loads(answer.body) if t["type"] == "page")
        self._socket = await websocket_connect(
            page["webSocketDebuggerUrl"], max_message_size=1 << 28
        )
        for domain in ("Page", "Runtime", "Log", "Network"):
            await self.do(f"{domain}.enable")
        return self

    async def __aexit__(self, *what: object) -> None:
        self._socket.close()
        self._process.terminate()
        self._process.wait(20)

    async def _port(self) -> int:
        place = self.folder / "profile" / "DevToolsActivePort"
        for _ in range(1800):
            if place.exists() and place.read_text().strip():
                return int(place.read_text().split()[0])
            await asyncio.sleep(0.1)
        raise TimeoutError("Chromium did not start")

    async def do(self, method: str, **params: object) -> dict:
        """One command, and its answer; events that come meanwhile are looked at."""
        self._number += 1
        number = self._number
        await self._socket.write_message(
            json.dumps({"id": number, "method": method, "params": params})
        )
        while True:
            told = json.loads(await asyncio.wait_for(self._socket.read_message(), 60))
            if told.get("id") == number:
                if "error" in told:
                    raise RuntimeError(f"{method}: {told['error']}")
                return told["result"]
            self._event(told)

    def _event(self, told: dict) -> None:
        name, params = told.get("method"), told.get("params", {})
        if name == "Runtime.exceptionThrown":
            self.complaints.append(str(params["exceptionDetails"].get("exception", params)))
        elif name == "Runtime.consoleAPICalled" and params["type"] in ("error", "warning"):
            self.complaints.append(str(params["args"]))
        elif name == "Log.entryAdded" and params["entry"]["level"] in ("error", "warning"):
            self.complaints.append(params["entry"]["text"])
        elif name == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])

    async def value(self, expression: str):
        """What an expression is on the page."""
        told = await self.do("Runtime.evaluate", expression=expression, returnByValue=True)
        if "exceptionDetails" in told:
            raise RuntimeError(str(told["exceptionDetails"]))
        return told["result"].get("value")

    async def open(self, path: Path, ready: str = "document.readyState === 'complete'") -> float:
        """Seconds until a page is there."""
        self.complaints.clear()
        self.requests.clear()
        began = time.perf_counter()
        await self.do("Page.navigate", url=path.resolve().as_uri())
        while not await self.value(f"document.readyState === 'complete' && ({ready})"):
            if time.perf_counter() - began > 60:
                raise TimeoutError(f"{path.name} is not ready: {self.complaints}")
            await asyncio.sleep(0.02)
        return time.perf_counter() - began

    async def mouse(self, kind: str, x: float, y: float, **more: object) -> None:
        """One event of the mouse, in pixels of the window."""
        await self.do("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    async def screenshot(self, path: Path) -> Path:
        """The whole page as a PNG."""
        told = await self.do("Page.captureScreenshot", captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(told["data"]))
        return path
