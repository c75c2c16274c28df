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
from cellwise.notices import Code, Notice
from cellwise.report.page.plot import Plot
from cellwise.report.page.section import Section, write_page
from cellwise.report.replay.page import replay_page
from cellwise.wording import place
from diagnosis_cases import diagnosis
from page_cases import KINDS, every_page
from report_cases import drive, replay, simulation

pytest.importorskip("tornado")
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt-get install chromium"),
    pytest.mark.slow,
]
TRACES = "document.documentElement.dataset.plots === 'ready'"
MILLION = 1_000_000
WITH_TRACES = ("identify", "replay", "diagnose", "export")
DRAWN = ("identify", "diagnose", "capacity-study")  # beside plots over time


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
    await browser.open(page, TRACES if kind in WITH_TRACES else "true")
    told = await browser.value(
        "({pictures: document.querySelectorAll('figure svg').length,"
        " canvases: document.querySelectorAll('div.trace canvas').length,"
        " finding: document.querySelector('h1').textContent,"
        " fits: document.documentElement.scrollWidth <= window.innerWidth})"
    )
    shot = await browser.screenshot(folder / f"{kind}.png")
    seen = float(matplotlib.image.imread(shot).std())
    return {**told, "seen": seen, "complaints": list(browser.complaints),
            "requests": list(browser.requests)}  # fmt: skip


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
        widths, unshaded, smallest = {}, {}, {}
        for kind, page in pages.items():
            await browser.open(page, TRACES if kind in WITH_TRACES else "true")
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
        return widths, unshaded, smallest

    widths, unshaded, smallest = in_browser(tmp_path, work)
    assert {kind: s for kind, s in smallest.items() if s is not None and s < 11.0} == {}
    assert {kind: w for kind, w in widths.items() if w > 390} == {}
    assert set(unshaded.values()) == {0}


def test_a_million_samples_open_in_three_seconds_and_zoom(tmp_path):
    log = spikes()
    section = Section("p", "p", (Plot("a-million", "a million", *log.panels()),))
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
    said = ("the voltage stands still (", place(range(3000, 3061)), ")")
    return replace(log, notices=(Notice(Code.CHANNEL_STUCK, said),))


def test_one_cursor_in_all_plots_of_a_log_and_an_alert_shows_its_rows(tmp_path):
    log, other = suspicious(), drive(3000, name="another")
    page = replay_page([replay(other), replay(log)], tmp_path / "p.html", [simulation(log)])
    traces = (
        "(name => [...document.querySelectorAll('div.trace')].filter(f => f.dataset.clock === name)"
        " .map(f => [f.dataset.pointer, f.dataset.from, f.dataset.to, f.dataset.marked]))"
    )

    async def work(browser):
        await browser.open(page, TRACES)
        box = await browser.value(
            "(() => { const f = document.querySelector('div.trace');"
            " f.scrollIntoView({behavior: 'instant'}); const b = f.getBoundingClientRect();"
            " return [b.left, b.top, b.width, f.dataset.clock]; })()"
        )
        left, top, wide, name = box
        for share in (0.4, 0.5):
            await browser.mouse("mouseMoved", left + 64 + share * (wide - 76), top + 60)
            await asyncio.sleep(0.3)
        pointed = await browser.value(f"{traces}({json.dumps(name)})")
        beside = await browser.value(f"{traces}('another')")
        # Away from it, then the alert's link.
        await browser.mouse("mouseMoved", 2, 2)
        await asyncio.sleep(0.3)
        left_over = await browser.value(f"{traces}({json.dumps(name)})")
        await browser.value("document.querySelector('button.jump').click()")
        await asyncio.sleep(0.5)
        looked = await browser.value(f"{traces}({json.dumps(name)})")
        whole = await browser.value(f"{traces}('another')")
        return pointed, beside, left_over, looked, whole, list(browser.complaints)

    pointed, beside, left_over, looked, whole, complaints = in_browser(tmp_path, work)
    assert complaints == []
    assert len(pointed) == 2, "the replay and the simulation of one log: one time"
    assert [float(t[0]) for t in pointed] == pytest.approx([60.0] * 2, abs=0.5)  # minutes
    assert {t[0] for t in (*beside, *left_over)} == {""}
    for _, low, high, marked in looked:
        assert float(low) < 50.0 < 51.0 < float(high) < float(low) + 10.0
        assert [float(t) for t in marked.split(",")] == pytest.approx([50.0, 51.0])
    assert [float(t[2]) for t in whole] == pytest.approx([2999.0 / 60.0]), "another log stays"
