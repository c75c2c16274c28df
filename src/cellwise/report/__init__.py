"""Pictures and self-contained pages (needs the extra ``report``: matplotlib)."""

from __future__ import annotations

from cellwise.report.demo_page import demo_page
from cellwise.report.diagnosis.page import diagnose_page
from cellwise.report.export_page import export_page
from cellwise.report.history_page import history_page
from cellwise.report.identification.page import identify_page
from cellwise.report.pack_page import pack_page
from cellwise.report.page.picture import FigureFiles, Picture, save_figure, save_figures
from cellwise.report.replay.page import replay_page

__all__ = [
    "FigureFiles",
    "Picture",
    "demo_page",
    "diagnose_page",
    "export_page",
    "history_page",
    "identify_page",
    "pack_page",
    "replay_page",
    "save_figure",
    "save_figures",
]
