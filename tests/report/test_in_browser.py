"""Pages in Debian's Chromium: no complaint, nothing from the network, plots that zoom."""

from __future__ import annotations

import asyncio
import json

import matplotlib.image
import numpy as np
import pytest

from browser import CHROMIUM, Browser
from cellwise.logs import CellLog
from cellwise.report.page.interactive import trace_section
from cellwise.report.page.section import write_page
from diagnosis_cases import diagnosis
from page_cases import KINDS, every_page

pytest.importorskip("tornado")
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt-get install chromium"),
    pytest.mark.slow,
]
TRACES = "document.documentElement.dataset.plots === 'ready'"
PICTURES = "document.documentElement.dataset.pictures === 'ready'"
MILLION = 1_000_000
WITH_TRACES = ("identify", "replay", "diagnose", "export")


def in_browser(folder, work):
    """Run a coroutine with a browser."""

    async def run():
        async with Browser(folder) as browser:
            return await work(browser)

    return asyncio.run(run())


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    return every_page(tmp_path_factory.mktemp("pages"), diagnosis("current_offset"))


async def looked_at(browser, kind, page, folder):
    """What is on a page, in words and numbers."""
    traces = kind in WITH_TRACES
    await browser.open(page, f"{PICTURES} && ({TRACES} || {json.dumps(not traces)})")
    told = await browser.value(
        "({pictures: document.querySelectorAll('figure svg').length,"
        " canvases: document.querySelectorAll('div.trace canvas').length,"
        " finding: document.querySelector('h1').textContent,"
        " fits: document.documentElement.scrollWidth <= window.innerWidth})"
    )
    shot = await browser.screenshot(folder / f"{kind}.png")
    seen = float(matplotlib.image.imread(shot).std())
    zoomed = await zoomed_by_a_drag(browser)
    return {**told, "seen": seen, "zoomed": zoomed, "complaints": list(browser.complaints),
            "requests": list(browser.requests)}  # fmt: skip


async def zoomed_by_a_drag(browser):
    """Drags over the first picture's first axes, twice: to zoom in, and back by a double click."""
    figure = "document.querySelector('figure[data-axes]')"
    box = await browser.value(
        f"(() => {{ const f = {figure}, s = f.querySelector('svg');"
        " f.scrollIntoView({behavior: 'instant'});"
        " const [x, y, w, h] = JSON.parse(f.dataset.axes)[0].box, m = s.getScreenCTM();"
        " return [m.a * x + m.e, m.d * y + m.f, m.a * w, m.d * h]; })()"
    )
    left, top, wide, tall = box
    drawn = (
        f"[...{figure}.querySelectorAll('[data-plot=\"0\"] [clip-path]')]"
        ".filter((e) => !e.closest('[data-tick]')).map((e) => e.outerHTML).join('')"
    )
    before = await browser.value(drawn)
    y = top + 0.5 * tall
    await browser.mouse("mouseMoved", left + 0.2 * wide, y)
    await browser.mouse("mousePressed", left + 0.25 * wide, y, button="left", clickCount=1)
    await browser.mouse("mouseMoved", left + 0.75 * wide, y, button="left")
    await browser.mouse("mouseReleased", left + 0.75 * wide, y, button="left", clickCount=1)
    await asyncio.sleep(0.3)
    views = json.loads(await browser.value(f"{figure}.dataset.views"))
    after = await browser.value(drawn)
    own = await browser.value(
        f"{figure}.querySelectorAll('.tick').length"
        f" + {figure}.querySelectorAll('[data-tick][transform]').length"
    )
    for count in (1, 2):
        for kind in ("mousePressed", "mouseReleased"):
            await browser.mouse(kind, left + 0.5 * wide, y, button="left", clickCount=count)
    await asyncio.sleep(0.3)
    again = json.loads(await browser.value(f"{figure}.dataset.views"))
    return {"x": views[0]["x"], "y": views[0]["y"], "moved": before != after, "ticks": own,
            "back": again[0]}  # fmt: skip


@pytest.fixture(scope="module")
def found(pages, tmp_path_factory):
    """Every page in one browser: starting it takes longer than looking."""
    folder = tmp_path_factory.mktemp("browser")

    async def work(browser):
        return {kind: await looked_at(browser, kind, pages[kind], folder) for kind in KINDS}

    return in_browser(folder, work)


@pytest.mark.parametrize("kind", KINDS)
def test_a_page_opens_without_complaint_and_loads_nothing(pages, found, kind):
    told = found[kind]
    assert told["complaints"] == []
    assert told["requests"] == [pages[kind].resolve().as_uri()]
    assert told["pictures"] >= 1
    assert told["canvases"] >= (3 if kind in WITH_TRACES else 0)
    assert any(c.isdigit() for c in told["finding"])
    assert told["fits"], "the page is wider than its window"
    assert told["seen"] > 0.05, "there is nothing to see"


@pytest.mark.parametrize("kind", KINDS)
def test_a_picture_zooms_and_comes_back(found, kind):
    told = found[kind]["zoomed"]
    assert told["x"] == pytest.approx([0.25, 0.75], abs=0.01)
    assert told["y"] == [0, 1]  # a level drag is of x alone
    assert told["moved"]
    assert told["ticks"] > 0, "an axis without numbers"
    assert told["back"] == {"x": [0, 1], "y": [0, 1]}


def spikes():
    """A million samples with one peak of a single sample, and times that are not even."""
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.05, 0.15, MILLION))
    voltage = 3.7 + 0.01 * np.sin(time / 3000.0)
    voltage[612_345] = 4.2
    return CellLog(time, np.sin(time / 700.0), voltage)


def test_a_million_samples_open_in_three_seconds_and_zoom(tmp_path):
    log = spikes()
    section = trace_section([("a million", log)])
    page = write_page(tmp_path / "big.html", "A million samples", "test", [section], {"n": 1})
    trace = "document.querySelector('div.trace')"

    async def work(browser):
        seconds = await browser.open(page, TRACES)

        async def view():
            # A drawing waits for the next frame.
            await asyncio.sleep(0.5)
            return await browser.value(
                f"[{trace}.dataset.from, {trace}.dataset.to, {trace}.dataset.drawMs].map(Number)"
            )

        async def ink():
            """Highest pixel with the line's colour in the voltage's panel."""
            return await browser.value(
                "(() => { const c = document.querySelector('div.trace canvas'),"
                " p = c.getContext('2d').getImageData(70, 0, c.width - 90, c.height).data,"
                " w = c.width - 90;"
                " for (let i = 0; i < p.length; i += 4)"
                "  if (p[i + 3] > 80 && p[i + 2] - p[i] > 60) return Math.floor(i / 4 / w);"
                " return -1; })()"
            )

        whole, top = await view(), await ink()
        box = await browser.value(
            f"(() => {{ const b = {trace}.getBoundingClientRect();"
            " return [b.left, b.top, b.width]; })()"
        )
        left, y, width = box[0] + 64, box[1] + 60, box[2] - 76
        share = (log.time_s[612_345] - log.time_s[0]) / log.duration_s
        middle = left + share * width
        await browser.mouse("mouseMoved", middle, y)
        await browser.mouse("mouseWheel", middle, y, deltaX=0, deltaY=-100)
        idle = await view()
        await browser.value(f"{trace}.focus()")
        for _ in range(12):
            await browser.mouse("mouseWheel", middle, y, deltaX=0, deltaY=-100)
        near = await view()
        read = await browser.value(f"{trace}.querySelector('.readout').textContent")
        await browser.mouse("mousePressed", left + 0.25 * width, y, button="left", clickCount=1)
        await browser.mouse("mouseMoved", left + 0.75 * width, y, button="left")
        await browser.mouse("mouseReleased", left + 0.75 * width, y, button="left", clickCount=1)
        dragged = await view()
        await browser.value(f"void {trace}.dispatchEvent(new MouseEvent('dblclick'))")
        again = await view()
        await browser.screenshot(tmp_path / "big.png")
        return seconds, whole, top, idle, near, read, dragged, again, list(browser.complaints)

    seconds, whole, top, idle, near, read, dragged, again, complaints = in_browser(tmp_path, work)
    assert complaints == []
    assert whole[:2] == pytest.approx([log.time_s[0] / 3600, log.time_s[-1] / 3600], rel=1e-6)
    assert 0 <= top < 20, "the peak of one sample in a million is drawn"
    span = whole[1] - whole[0]
    assert idle[:2] == whole[:2], "the wheel scrolls the page until a plot was clicked"
    assert near[1] - near[0] == pytest.approx(span * 0.8**12, rel=0.02)
    assert near[0] < log.time_s[612_345] / 3600 < near[1]
    assert "voltage" in read
    assert dragged[1] - dragged[0] == pytest.approx(0.5 * (near[1] - near[0]), rel=0.02)
    assert again[:2] == whole[:2]
    assert seconds < 3.0
    assert whole[2] < 500.0, "a drawing of all samples takes [ms]"
