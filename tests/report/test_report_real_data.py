"""The pages of a cell of the embedded data, through the whole pipeline."""

from __future__ import annotations

import json

import pytest

from cellwise import identify
from cellwise.cell.simulate import simulate
from cellwise.estimate.replay import replay
from cellwise.logs import read_log
from cellwise.report import demo_page, identify_page
from report_cases import Page


@pytest.mark.slow
def test_pages_of_the_embedded_nmc_cell(datasets, tmp_path):
    def log(name):
        return read_log(datasets / "nmc" / f"{name}.parquet")

    found = identify.identify_cell(
        identify.TestLogs(
            hppc=((log("hppc_c3"), None),),
            ocv=(log("ocv_c20"),),
            capacity=(log("cap_c20"), log("cap_c3")),
        ),
        identify.IdentifySettings(nominal_Ah=5.0, refine=False, name="LG M50"),
    )
    drive = log("drive_b")
    run = replay(
        found.model, drive, "ekf", soc0=0.7, reference_soc0=0.997, reference_capacity_Ah=5.1532
    )
    sims = [simulate(found.model, drive, 0.997)]
    for path in (
        identify_page(found, tmp_path / "identify.html"),
        demo_page(found, sims, [run], tmp_path / "demo.html"),
    ):
        text = path.read_text(encoding="utf-8")
        parsed = Page(text)
        assert len(text.encode()) < 2_000_000
        data = json.loads(parsed.scripts[0][1])
        figures = data.get("identification", data)
        assert figures["capacity_Ah"] == found.model.capacity_Ah
