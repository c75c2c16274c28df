"""Pages in Debian's Chromium: no complaint, nothing from the network, plots that zoom."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest

from browser import CHROMIUM, Browser
from cellwise.logs import CellLog
from cellwise.report import replay_page
from cellwise.report.page.section import trace_section, write_page
from diagnosis_cases import diagnosis
from page_cases import KINDS, every_page
from report_cases import drive, replay, simulation

pytest.importorskip("tornado")
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt-get install chromium"),
    pytest.mark.slow,
]
TRACES = "document.documentElement.dataset.plots === 'ready'"
PICTURES = "document.documentElement.dataset.pictures === 'ready'"
MILLION = 1_000_000
WITH_TRACES = ("identify", "replay", "diagnose", "export")
DRAWN = tuple(kind for kind in KINDS if kind != "export")  # costs stand in tables


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
    pictures = PICTURES if kind in DRAWN else "true"
    await browser.open(page, f"{pictures} && ({TRACES} || {json.dumps(not traces)})")
    told = await browser.value(
        "({pictures: document.querySelectorAll('figure svg').length,"
        " canvases: document.querySelectorAll('div.trace canvas').length,"
        " finding: document.querySelector('h1').textContent,"
        " fits: document.documentElement.scrollWidth <= window.innerWidth})"
    )
    shot = await browser.screenshot(folder / f"{kind}.png")
    seen = float(matplotlib.image.imread(shot).std())
    zoomed = await zoomed_by_a_drag(browser) if kind in DRAWN else None
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
    asked = [address for address in told["requests"] if not address.startswith("data:image/png")]
    assert asked == [pages[kind].resolve().as_uri()]
    assert told["pictures"] >= (1 if kind in DRAWN else 0)
    assert told["canvases"] >= (3 if kind in WITH_TRACES else 0)
    assert any(c.isdigit() for c in told["finding"])
    assert told["fits"], "the page is wider than its window"
    assert told["seen"] > 0.05, "there is nothing to see"


@pytest.mark.parametrize("kind", DRAWN)
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


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_page_fits_a_phone_and_what_is_wider_is_shaded_at_its_edge(pages, tmp_path, scheme):
    async def work(browser):
        await browser.do("Emulation.setEmulatedMedia",
                         features=[{"name": "prefers-color-scheme", "value": scheme}])  # fmt: skip
        await browser.do("Emulation.setDeviceMetricsOverride", width=390, height=844,
                         deviceScaleFactor=1, mobile=True)  # fmt: skip
        widths, unshaded, smallest, stacked = {}, {}, {}, {}
        for kind, page in pages.items():
            await browser.open(page, PICTURES if kind in DRAWN else "true")
            widths[kind] = await browser.value("document.documentElement.scrollWidth")
            unshaded[kind] = await browser.value(
                "[...document.querySelectorAll('.scroll, figure > div')].filter(e =>"
                " e.scrollWidth > e.clientWidth + 1 &&"
                " getComputedStyle(e).backgroundImage === 'none').length"
            )
            smallest[kind] = await browser.value(
                "Math.min(...[...document.querySelectorAll('body *:not(script):not(style)')]"
                ".filter(e => e.getBoundingClientRect().height"
                " && [...e.childNodes].some(n => n.nodeType === 3 && n.data.trim()))"
                ".map(e => [parseFloat(getComputedStyle(e).fontSize),"
                " e.getScreenCTM ? e.getScreenCTM() : {a: 1, b: 0}])"
                ".map(([size, m]) => size * Math.hypot(m.a, m.b)))"  # however it is turned
            )
            stacked[kind] = await browser.value(
                "[...document.querySelectorAll('figure[data-axes]')].every(f =>"
                " JSON.parse(f.dataset.axes).every(({at: [x, y, w, h]}, k, all) => x >= 0 &&"
                " x + w <= 390 && (k === 0 || y >= all[k - 1].at[1] + all[k - 1].at[3])))"
            )
        return widths, unshaded, smallest, stacked

    widths, unshaded, smallest, stacked = in_browser(tmp_path, work)
    assert stacked == dict.fromkeys(KINDS, True), "axes one below the other"
    assert {kind: s for kind, s in smallest.items() if s is not None and s < 11.0} == {}
    assert {kind: w for kind, w in widths.items() if w > 390} == {}
    assert set(unshaded.values()) == {0}


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


def suspicious():
    """A drive of two hours with an alert about rows 3000 to 3060."""
    log = drive(7200)
    return replace(log, notices=("the voltage stands still (rows 3001 to 3061)",))


def test_one_cursor_in_all_plots_of_a_log_and_an_alert_shows_its_rows(tmp_path):
    log, other = suspicious(), drive(3000, name="another")
    page = replay_page([replay(other), replay(log)], tmp_path / "p.html", [simulation(log)])
    # Where every visible cursor of a log stands [s from its first row], by kind of plot.
    lines = (
        "(name => [...document.querySelectorAll('figure')].filter(f => f.dataset.clock === name)"
        " .flatMap(f => { const all = JSON.parse(f.dataset.axes);"
        " const s = {s: 1, min: 60, h: 3600}[all.find(a => a.share === all[0].share && a.x.label)"
        "  .x.label.match(/\\[(.*)\\]/)[1]];"
        " return [...f.querySelectorAll('line.cursor')].map((line, k) => [line, all[k]])"
        "  .filter(([line, a]) => line.style.display !== 'none' && a.share === all[0].share)"
        "  .map(([line, a]) => { const [low, high] = a.x.limits;"
        "   return s * (low + (high - low) * (line.x1.baseVal.value - a.box[0]) / a.box[2]); });"
        "}))"
    )
    traces = (
        "(name => [...document.querySelectorAll('div.trace')].filter(f => f.dataset.clock === name)"
        " .map(f => f.dataset.pointer ? 3600 * f.dataset.pointer : null))"
    )

    async def work(browser):
        await browser.open(page, f"{PICTURES} && {TRACES}")
        box = await browser.value(
            "(() => { const f = document.querySelector('figure[id*=-soc]'),"
            " s = f.querySelector('svg'); f.scrollIntoView({behavior: 'instant'});"
            " const a = JSON.parse(f.dataset.axes)[0], [x, y, w, h] = a.box, m = s.getScreenCTM();"
            " return [m.a * x + m.e, m.d * (y + h / 2) + m.f, m.a * w, f.dataset.clock]; })()"
        )
        left, y, wide, name = box
        for share in (0.4, 0.5):
            await browser.mouse("mouseMoved", left + share * wide, y)
            await asyncio.sleep(0.3)
        found = await browser.value(f"{lines}({json.dumps(name)})")
        read = await browser.value(f"{traces}({json.dumps(name)})")
        beside = await browser.value(f"{lines}('another')")
        # Away from it, then the alert's link.
        await browser.mouse("mouseMoved", 2, 2)
        await asyncio.sleep(0.3)
        left_over = await browser.value(f"{lines}({json.dumps(name)})")
        await browser.value("document.querySelector('a.jump').click()")
        await asyncio.sleep(0.5)
        view = await browser.value(
            f"[...document.querySelectorAll('div.trace')].filter(f => f.dataset.clock ==="
            f" {json.dumps(name)}).map(f => [3600 * f.dataset.from, 3600 * f.dataset.to])"
        )
        alarms = await browser.value(
            "[...document.querySelectorAll('rect.alarm')]"
            ".filter((r) => r.style.display !== 'none' && r.width.baseVal.value > 2).length"
        )
        whole = await browser.value(
            "[...document.querySelectorAll('div.trace')].filter(f => f.dataset.clock === 'another')"
            ".map(f => 3600 * f.dataset.to)"
        )
        return found, read, beside, left_over, view, alarms, whole, list(browser.complaints)

    found, read, beside, left_over, view, alarms, whole, complaints = in_browser(tmp_path, work)
    assert complaints == []
    # Above and below in SOC, in innovation and in voltage, current, residual: one time.
    assert len(found) >= 7
    assert found == pytest.approx([3600.0] * len(found), abs=20.0)
    assert len(read) == 2, "the replay's samples and the log's"
    assert read == pytest.approx([3600.0] * 2, abs=20.0)
    assert beside == [], "another log has another time"
    assert left_over == []
    for low, high in view:
        assert low < 3000.0 < 3060.0 < high < low + 600.0
    assert alarms >= 7
    assert whole == pytest.approx([2999.0] * 2, abs=1.0), "the other log stays as it is"
