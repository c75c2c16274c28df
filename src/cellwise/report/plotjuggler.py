"""A layout of PlotJuggler for the rows of a replay: voltages, current, SOC, residual, one cursor.

`PlotJuggler <https://plotjuggler.io>`_ opens the layout with ``plotjuggler --layout F.xml``, and
the rows with it.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from xml.etree import ElementTree

from cellwise.files import write_atomically

PLOTS = (
    ("voltage [V]", ("measured_voltage_V", "voltage_V")),
    ("current [A]", ("current_A",)),
    ("SOC", ("soc", "reference_soc")),
    ("residual [V]", ("innovation_V",)),
)
COLORS = ("#77818d", "#0b67a3")
ALONE = "#0b67a3"
TIME = "time_s"


def write_layout(path: str | Path, rows: str | Path, columns: Collection[str]) -> Path:
    """Write the layout of a file of rows.

    Parameters
    ----------
    path : str or Path      of the layout (XML); it appears whole or not at all
    rows : str or Path      CSV with the rows, named relative to the layout where it can be
    columns : of str        that it has

    Raises
    ------
    InputError              the path cannot be written
    """
    target, source = Path(path).resolve(), Path(rows).resolve()
    beside = source.is_relative_to(target.parent)
    name = source.relative_to(target.parent).as_posix() if beside else str(source)
    root = ElementTree.Element("root")
    window = _in(root, "tabbed_widget", parent="main_window", name="Main Window")
    tab = _in(window, "Tab", containers="1", tab_name=source.name)
    plots = [(title, [n for n in names if n in columns]) for title, names in PLOTS]
    plots = [(title, names) for title, names in plots if names]
    share = ";".join(f"{1.0 / len(plots):.6f}" for _ in plots)
    column = _in(_in(tab, "Container"), "DockSplitter", orientation="-", count=str(len(plots)))
    column.set("sizes", share)
    for title, names in plots:
        area = _in(column, "DockArea", name=title)
        plot = _in(area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false")
        _in(plot, "limitY")
        for curve, color in zip(names, COLORS if len(names) > 1 else (ALONE,), strict=True):
            _in(plot, "curve", name=curve, color=color)
    _in(window, "currentTabIndex", index="0")
    _in(root, "use_relative_time_offset", enabled="1")
    file = _in(_in(root, "previouslyLoaded_Datafiles"), "fileInfo", filename=name, prefix="")
    _in(_in(file, "plugin", ID="DataLoad CSV"), "parameters", time_axis=TIME)
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return write_atomically(target, f"<?xml version='1.0' encoding='UTF-8'?>\n{text}\n")


def _in(element: ElementTree.Element, tag: str, /, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(element, tag, attributes)
