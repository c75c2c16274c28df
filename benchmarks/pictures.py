"""The pictures of README.md and of the gallery.

python -m benchmarks.pictures [--gallery]

At the head of README.md a hard case, an EKF of filterpy's beside ours: a drive at -10 degC that
took no part in the fit, cut under load in the middle of the SOC, with a start that is 30 points
wrong. The gallery's are drawn by the code on its page, from embedded data.
"""

from __future__ import annotations

import re
import sys
from contextlib import chdir
from pathlib import Path
from shutil import copy
from tempfile import TemporaryDirectory

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from benchmarks.ablation.panel import of_all_temperatures
from benchmarks.accuracy.cold import PLAIN, cases_at
from benchmarks.measured_data import HOW, REPOSITORY, data_folder
from cellwise.estimate.estimators import make_estimator

PICTURES = REPOSITORY / "docs" / "pictures"
PICTURE = PICTURES / "hero.png"
GALLERY = REPOSITORY / "docs" / "gallery.md"
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.S | re.M)
TAG = "n10"  # -10 degC
WIDTH_IN, HEIGHT_IN, DPI = 9.0, 3.4, 120
LINES = ((PLAIN, "a plain EKF (filterpy)", "tab:orange"), ("ekf", "cellwise, EKF", "tab:blue"))


def draw_gallery() -> list[Path]:
    """Run the code of the gallery's page and keep what it draws.

    Returns
    -------
    list of Path      the pictures
    """
    source = "".join(BLOCK.findall(GALLERY.read_text(encoding="utf-8")))
    with TemporaryDirectory() as place, chdir(place), plt.rc_context():
        exec(compile(source, str(GALLERY), "exec"), {"__name__": "gallery"})
        return [Path(copy(path, PICTURES)) for path in sorted(Path(place).glob("gallery_*.png"))]


def draw_hard_case() -> int:
    """Draw the picture of README.md.

    Returns
    -------
    int       1 where there are no measured cells
    """
    data = data_folder()
    if data is None:
        print(f"no measured cells: {HOW}", file=sys.stderr)
        return 1
    model = of_all_temperatures(data)
    _, case, *_ = cases_at(data, model, TAG)  # of the two cuts of NN the harder one
    hours = (case.log.time_s - case.log.time_s[0]) / 3600.0
    figure, ax = plt.subplots(figsize=(WIDTH_IN, HEIGHT_IN), layout="constrained")
    for name, called, colour in LINES:
        trace = make_estimator(name, model).run(case.log, case.soc0, case.std)
        at_h = (trace.time_s - case.log.time_s[0]) / 3600.0
        soc, band = 100.0 * trace.soc, 200.0 * trace.soc_std
        ax.fill_between(at_h, soc - band, soc + band, color=colour, alpha=0.2, linewidth=0)
        ax.plot(at_h, soc, color=colour, label=called)
    ax.plot(hours, 100.0 * case.truths[1], color="black", linestyle="--", label="tester's counter")
    ax.set(xlabel="time [h]", ylabel="SOC [%]", xlim=(0.0, hours[-1]), ylim=(0.0, 100.0))
    ax.legend(loc="upper right", frameon=False)
    figure.savefig(PICTURE, dpi=DPI)
    return 0


def main(arguments: list[str] | None = None) -> int:
    """Draw the gallery, and without ``--gallery`` the picture of README.md, too."""
    for path in draw_gallery():
        print(path.name)
    chosen = sys.argv[1:] if arguments is None else arguments
    return 0 if "--gallery" in chosen else draw_hard_case()


if __name__ == "__main__":
    sys.exit(main())
