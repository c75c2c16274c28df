"""export --page: the page estimates in Debian's Chromium, offline, with the bits of Python."""

from __future__ import annotations

import asyncio
import base64
import io
import shutil
import subprocess
import zipfile

import matplotlib.image
import numpy as np
import pytest

from browser import CHROMIUM, Browser
from cellwise.cell.simulate import simulate
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.fixed.layout import INPUT, OUTLOOK, OUTPUT
from cellwise.estimate.fixed.stepper import numba_stepper, start_state
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.forecast.remaining import cutoff_of
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell
from firmware_cases import full_model, noisy_samples

pytest.importorskip("tornado")
no_clang = shutil.which("clang") is None or shutil.which("wasm-ld") is None
needs_clang = pytest.mark.skipif(no_clang, reason="no clang, lld: apt-get install clang lld")
in_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt-get install chromium")
MOST_BYTES = 1_000_000
ROWS = 200_000


@pytest.fixture
def exported(export, tmp_path):
    """A page as the command writes it."""

    def run(model, *more):
        export("--page", tmp_path / "page.html", *more, model=model)
        return tmp_path / "page.html"

    return run


def looked_at(folder, page, work):
    """A coroutine with a browser in which the page has opened."""

    async def run():
        async with Browser(folder) as browser:
            await browser.open(page, "document.documentElement.dataset.page === 'ready'")
            told = await work(browser)
            assert browser.requests[0] == page.resolve().as_uri()
            assert all(r.startswith(("file:", "blob:", "data:")) for r in browser.requests)
            return told

    return asyncio.run(run())


async def given(browser, path, wanted="done"):
    """A file of this machine as a person would open it; what the page says then."""
    root = await browser.do("DOM.getDocument")
    found = await browser.do("DOM.querySelector", nodeId=root["root"]["nodeId"], selector="#file")
    await browser.do("DOM.setFileInputFiles", nodeId=found["nodeId"], files=[str(path)])
    return await ended(browser, wanted)


async def ended(browser, wanted):
    """What the page says once it is done, or has refused."""
    for _ in range(1200):
        state = await browser.value("document.documentElement.dataset.page")
        if state in ("done", "refused"):
            said = await browser.value("document.getElementById('said').textContent")
            assert state == wanted, said
            return said
        await asyncio.sleep(0.05)
    raise TimeoutError("the page did not end")


async def array(browser, expression, kind):
    """A typed array of the page as records."""
    text = await browser.value(
        f"(() => {{ const b = new Uint8Array(({expression}).buffer); let s = '';"
        " for (let k = 0; k < b.length; k += 9999)"
        " s += String.fromCharCode(...b.subarray(k, k + 9999));"
        " return btoa(s); })()"
    )
    return np.frombuffer(base64.b64decode(text), dtype=kind)


def python_rows(model, records, soc0, std):
    stepper = numba_stepper(fixed_step_tables(model, 1.0, remaining_V=cutoff_of(model, None)))
    state = start_state(stepper, soc0, std)
    return stepper, state, stepper.rows(state, records)


@needs_clang
@in_chromium
@pytest.mark.slow
def test_the_page_has_the_bits_of_python_over_200_000_samples(exported, tmp_path):
    model = full_model()
    page = exported(model)
    assert page.stat().st_size < MOST_BYTES
    records = noisy_samples(ROWS)
    lines = ["time_s,current_A,voltage_V,temperature_C"]
    for k, row in enumerate(records):
        volts = "" if np.isnan(row["voltage_V"]) else repr(float(row["voltage_V"]))
        lines.append(f"{k},{float(row['current_A'])!r},{volts},{float(row['temperature_C'])!r}")
    (tmp_path / "log.csv").write_text("\n".join(lines))

    async def work(browser):
        await browser.value("document.getElementById('soc0').value = '60'")
        await browser.value("document.getElementById('std0').value = '10'")
        said = await given(browser, tmp_path / "log.csv")
        ins = await array(browser, "page.samples.real", INPUT)
        outs = await array(browser, "page.result.real", OUTPUT)
        await browser.value("page.go(123456)")
        shown = await browser.value("document.getElementById('t-soc').textContent")
        left = await browser.value("page.left")
        assert browser.complaints == []
        return said, ins, outs, shown, left

    said, ins, outs, shown, left = looked_at(tmp_path, page, work)
    assert "200,000 samples" in said
    assert ins.tobytes() == records.tobytes()
    _, _, expected = python_rows(model, records, 0.6, 0.1)
    assert outs.tobytes() == expected.tobytes()
    assert shown == f"{100 * expected['soc'][123456]:.1f} %"
    stepper, state, _ = python_rows(model, records[:123457], 0.6, 0.1)
    load = float(np.mean(records["current_A"][123397:123457].astype(float)))
    ahead = stepper.answer("remaining", OUTLOOK, state, load, True)
    assert left == (float(ahead["time_s"][0]) if load > 0.02 * model.capacity_Ah else None)


@needs_clang
@in_chromium
@pytest.mark.slow
def test_a_million_samples_take_at_most_a_second(exported, tmp_path):
    page = exported(curved_cell())

    async def work(browser):
        return await browser.value(
            "(() => { const n = 1e6, t = Float64Array.from({length: n}, (_, k) => k),"
            " i = t.map((k) => 0.02 * (1 + Math.sin(k / 50))), v = i.map((x) => 3.7 - 0.02 * x);"
            " const samples = page.samplesOf(t, i, v, null);"
            " const once = () => page.estimate(samples, 0.6, 0.15).ms;"
            " return Math.min(...Array.from({length: 8}, once)); })()"
        )

    assert looked_at(tmp_path, page, work) < 1000.0


@needs_clang
@in_chromium
@pytest.mark.slow
def test_an_uneven_log_with_a_gap_becomes_the_samples_of_python_and_the_page_can_be_read(
    exported, tmp_path
):
    model = curved_cell()
    page = exported(model)
    rng = np.random.default_rng(3)
    step = rng.uniform(0.05, 0.4, 9000)
    step[5000] = 3600.0
    time_s = np.cumsum(step) - step[0]
    current = 0.6 + np.sin(time_s / 40.0)
    log = CellLog(time_s, current, np.full(time_s.size, 3.7), 20 + 0.001 * time_s)
    log = CellLog(time_s, current, simulate(model, log, 0.8).voltage_V, log.temperature_C)
    rows = zip(time_s, -1e3 * current, 1e3 * log.voltage_V, log.temperature_C, strict=True)
    text = "Time [s];I_mA;U_mV;T [degC]\n"
    text += "\n".join(";".join(repr(float(x)).replace(".", ",") for x in r) for r in rows)
    (tmp_path / "log.csv").write_text(text)

    async def work(browser):
        said = await given(browser, tmp_path / "log.csv")
        await browser.value("document.getElementById('charging').click()")
        ins = await array(browser, "page.samples.real", INPUT)
        fits = {}
        for wide in (1280, 390):
            await browser.do("Emulation.setDeviceMetricsOverride", width=wide, height=900,
                             deviceScaleFactor=1, mobile=wide < 500)  # fmt: skip
            await browser.value("dispatchEvent(new Event('resize'))")
            fits[wide] = await browser.value(
                "document.documentElement.scrollWidth <= window.innerWidth"
            )
            shot = await browser.screenshot(tmp_path / f"{wide}.png")
            fits[wide] = fits[wide] and float(matplotlib.image.imread(shot).std()) > 0.05
        refused = tmp_path / "notes.txt"
        refused.write_text("nothing of a cell\n")
        await browser.value("document.documentElement.dataset.page = ''")
        message = await given(browser, refused, "refused")
        return said, ins, fits, message, list(browser.complaints)

    said, ins, fits, message, complaints = looked_at(tmp_path, page, work)
    assert "estimated in" in said
    expected = samples_of(model, log, 1.0).records
    assert ins.size == expected.size
    np.testing.assert_array_equal(ins["sequence"], expected["sequence"])
    for name in ("current_A", "voltage_V", "temperature_C"):
        np.testing.assert_allclose(ins[name], expected[name], atol=2e-6, rtol=1e-6, err_msg=name)
    assert fits == {1280: True, 390: True}
    assert "expected" in message
    assert complaints == []


@needs_clang
@in_chromium
@pytest.mark.slow
def test_the_example_and_the_c_of_the_page_work(exported, tmp_path):
    page = exported(curved_cell(), "--prefix", "nmc")

    async def work(browser):
        await browser.value("document.getElementById('example').click()")
        dropped = "time_s,current_A,voltage_V\\n0,0,3.6\\n1,1,3.5\\n2,1,3.5\\n"
        await browser.value(
            "(() => { const t = new DataTransfer();"
            f" t.items.add(new File(['{dropped}'], 'dropped.csv'));"
            " document.documentElement.dataset.page = '';"
            " document.body.dispatchEvent(new DragEvent('drop', {dataTransfer: t, bubbles: true}));"
            " })()"
        )
        assert "dropped.csv: 3 samples" in await ended(browser, "done")
        await browser.value("document.getElementById('example').click()")
        soc = await browser.value("page.result.real[6 * (page.result.size - 1)]")
        left = await browser.value("page.result.left.filter((a) => a[0] > 0).length")
        return soc, left, await browser.value("page.data.package")

    soc, left, package = looked_at(tmp_path, page, work)
    assert 0.0 < soc < 0.9
    assert left > 10
    with zipfile.ZipFile(io.BytesIO(base64.b64decode(package))) as archive:
        archive.extractall(tmp_path)
    names = ("example", "ekf", "store", "cell_table")
    sources = [f"nmc_{name}.c" for name in names]
    built = ["gcc", "-std=c99", "-O2", "-ffp-contract=off", *sources, "-o", "example"]
    subprocess.run(built, cwd=tmp_path / "cellwise", check=True)
    program = tmp_path / "cellwise/example"
    assert (
        b"every bit as expected"
        in subprocess.run([program], capture_output=True, check=True).stdout
    )
