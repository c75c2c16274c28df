"""The pages of packs and lives: whole, self-contained, with what was found in their first line."""

from __future__ import annotations

import re

import numpy as np
import pytest

from cellwise.cell.stock import stock_model
from cellwise.history.ageing import ageing_history
from cellwise.logs import CellLog
from cellwise.pack.pack_estimate import estimate_pack
from cellwise.report.history_page import history_page
from cellwise.report.pack_page import cells_over_time, pack_page
from emulated_packs import Fault, emulated_pack


@pytest.fixture(scope="module")
def weak():
    model, log = emulated_pack(8, Fault(cell=3, resistance=0.4), hours=1.0)
    return estimate_pack(model, [log])


def test_the_page_names_the_weak_cell_first(weak, tmp_path):
    text = pack_page(weak, tmp_path / "pack.html", figures=tmp_path / "figures").read_text()
    title = re.search(r"<h1>(.*?)</h1>", text, re.S)[1]
    assert "cell_04" in title
    assert "resistance" in title
    assert text.count("<figure") == 5
    before = text[: text.index("<figure")]
    assert "resistance" in before[before.index('<ul class="notices">') :], "alerts come first"
    assert before.count("<li>") - before[before.find("<details") :].count("<li>") <= 3
    assert not re.search(r'(?:src|href)="https?:', text)
    assert (tmp_path / "figures" / "pack_cells_over_time.png").stat().st_size > 5000


def test_the_picture_shows_what_was_measured(weak):
    image, edges, _ = cells_over_time(weak)
    assert image.shape[0] == 8
    assert edges == [0]
    mean = np.average(image, axis=1)
    np.testing.assert_allclose(mean, 1e3 * weak.days[0].log.difference_V.mean(axis=0), atol=0.05)


def test_a_pack_in_which_none_is_odd_says_so(tmp_path):
    model, log = emulated_pack(4, hours=0.5)
    text = pack_page(estimate_pack(model, [log]), tmp_path / "pack.html").read_text()
    assert "None of 4 cells is odd" in text


def test_a_life_is_drawn_from_its_logs(tmp_path):
    model = stock_model("nca-18650")
    time = np.arange(0.0, 1200.0, 5.0)
    rng = np.random.default_rng(0)
    logs = [
        CellLog(time, rng.uniform(0.0, 3.0, time.size), rng.normal(3.8, 0.02, time.size))
        for _ in range(3)
    ]
    text = history_page(ageing_history(model, logs), tmp_path / "life.html").read_text()
    assert text.count("<figure") == 2
    assert "complete discharge" in text
    # Three drives of a model's own noise: a loss within its deviation cannot be determined.
    assert re.search(r"<h1>Capacity .* by all 3 logs; no change shown", text)
