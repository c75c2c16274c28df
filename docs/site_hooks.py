"""Hooks of the documentation site: equations as MathML, the API's page from the public face.

A browser draws MathML by itself, so the site needs no script of others and no network.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

import latex2mathml.converter
from mkdocs.structure.files import File, Files

from cellwise.notices import Code

REPOSITORY = Path(__file__).resolve().parents[1]
FACE = REPOSITORY / "src" / "cellwise" / "__init__.py"
INSERTED = re.compile(r"^<!-- code: (\S+) -->$", re.M)
NOTICES = "<!-- notices -->"
CODE = re.compile(r"(^```.*?^```\s*?$|`[^`\n]*`)", re.S | re.M)
DISPLAY = re.compile(r"\$\$(.+?)\$\$", re.S)
INLINE = re.compile(r"(?<![\\$])\$(?!\s)([^$\n]+?)(?<!\s)\$(?!\d)")
GROUPS = {
    "Logs": "cellwise.logs",
    "Model": "cellwise.cell",
    "Identification": "cellwise.identify",
    "Estimators": "cellwise.estimate",
    "Forecast": "cellwise.forecast",
    "Diagnosis": "cellwise.diagnose",
    "AgeingHistory": "cellwise.history",
    "Packs": "cellwise.pack",
    "Streams": "cellwise.live",
    "Export": "cellwise.export",
    "Pages": "cellwise.report",
    "Workflows": "cellwise.workflows",
    "Data": "cellwise.data",
    "Progress": "cellwise.progress",
    "Errors": "cellwise.errors",
}
MORE = {
    "Streams of samples": ("cellwise.live.run_live",),
    "Fleets": ("cellwise.fleet.run_fleet", "cellwise.fleet.ReplayTask",
               "cellwise.fleet.DiagnoseTask", "cellwise.fleet.PackTask",
               "cellwise.fleet.HistoryTask"),
    "Public data sets": ("cellwise.datasets.fetch_dataset", "cellwise.datasets.import_dataset"),
}  # fmt: skip


def on_files(files: Files, config: Any) -> Files:
    """Add the API's page."""
    files.append(File.generated(config, "api.md", content=api_page()))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Scripts and the table of notices in place of their marks; equations to MathML."""
    markdown = INSERTED.sub(inserted, markdown).replace(NOTICES, notices_table())
    parts = CODE.split(markdown)
    for k in range(0, len(parts), 2):  # the odd ones are code
        parts[k] = DISPLAY.sub(lambda m: "\n" + mathml(m[1], "block") + "\n", parts[k])
        parts[k] = INLINE.sub(lambda m: mathml(m[1], "inline"), parts[k])
    return "".join(parts)


def inserted(mark: re.Match[str]) -> str:
    """A script as a block of code."""
    return f"```python\n{(REPOSITORY / mark[1]).read_text(encoding='utf-8')}```"


def notices_table() -> str:
    """Every kind of notice: code, severity, what it says."""
    rows = (f"| `{code.word}` | {code.severity} | {code.meaning} |" for code in Code)
    return "\n".join(("| code | severity | it says |", "|---|---|---|", *rows))


def mathml(tex: str, display: str) -> str:
    """One equation; on one line, so that Markdown leaves it alone."""
    markup = latex2mathml.converter.convert(" ".join(tex.split()), display=display)
    return markup.replace("\n", " ")


def homes() -> dict[str, str]:
    """Public name to the module that it comes from, as the face says."""
    for node in ast.parse(FACE.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "_NAMES":
            names = ast.literal_eval(node.value).items()
            return {name: home for home, listed in names for name in listed.split()}
    raise LookupError("no _NAMES in the public face")


def api_page() -> str:
    """Every public name under its group; what has none under the last."""
    lines = ["# API", "", "`import cellwise as cw` has the names of the first groups; the others "
             "are imported from where they stand.", ""]  # fmt: skip
    left = dict(sorted(homes().items()))
    for group, package in (*GROUPS.items(), ("Others", "cellwise")):
        lines += [f"## {group}", ""]
        for name in [n for n, home in left.items() if f"{home}.".startswith(f"{package}.")]:
            lines += [f"::: {left.pop(name)}.{name}", ""]
    for group, names in MORE.items():
        lines += [f"## {group}", "", *(f"::: {name}\n" for name in names)]
    return "\n".join(lines)
