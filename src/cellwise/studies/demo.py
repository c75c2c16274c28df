"""The main job on embedded data: identify, simulate a held-out drive, estimate SOC."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cellwise.cell.model_file import write_model
from cellwise.cell.simulate import Simulation, simulate
from cellwise.data import list_datasets, load_dataset
from cellwise.estimate.replay import Replay, replay
from cellwise.files import made_folder
from cellwise.fit.start import InitialSoc, initial_soc
from cellwise.identify import CellTests, Identification, IdentifySettings, identify_cell

HELD_OUT = "nmc_drive_b"
START_ERROR = 0.3


@dataclass(frozen=True, eq=False)
class Demo:
    """What the demo made, and where its page belongs."""

    identification: Identification
    simulations: tuple[tuple[Simulation, InitialSoc], ...]
    replays: tuple[Replay, ...]
    model: Path
    page: Path

    def to_dict(self) -> dict[str, Any]:
        """The figures as JSON values."""
        return {
            "identify": self.identification.to_dict(),
            "simulate": [
                {"log": s.log.name, "soc0": start.to_dict(), **s.to_dict()}
                for s, start in self.simulations
            ],
            "replay": [{"log": r.log.name, **r.to_dict()} for r in self.replays],
            "model": str(self.model),
            "page": str(self.page),
        }


def run_demo(
    folder: Path,
    progress: Callable[[str], None] | None = None,
) -> Demo:
    """Identify the embedded NMC cell, judge it on a drive it has not seen; the model is written.

    Raises
    ------
    InputError        the folder cannot be made
    """
    say = progress or (lambda _: None)
    made_folder(folder)
    say("reading")
    tests = CellTests(
        hppc=((load_dataset("nmc_hppc"), None),),
        ocv=(load_dataset("nmc_ocv_c20"),),
        capacity=tuple(load_dataset(f"nmc_cap_{rate}") for rate in ("c20", "c5", "c3")),
        drive=((load_dataset("nmc_drive_a"), None),),
    )
    settings = IdentifySettings(nominal_Ah=5.0, name="LG M50 (simulated)", chemistry="NMC")
    found = identify_cell(tests, settings, say)
    model_path = folder / "nmc.json"
    write_model(found.model, model_path)
    say(f"simulating {HELD_OUT}")
    log = load_dataset(HELD_OUT)
    start = initial_soc(found.model, log)
    simulation = simulate(found.model, log, start.soc)
    say("EKF")
    truth = next(e for e in list_datasets() if e["name"] == HELD_OUT)
    replays = tuple(
        replay(
            found.model,
            log,
            "ekf",
            soc0=soc0,
            reference_soc0=float(truth["initial_soc"]),
            reference_capacity_Ah=float(truth["true_capacity_Ah"]),
        )
        for soc0 in (max(float(truth["initial_soc"]) - START_ERROR, 0.0), None)
    )
    return Demo(found, ((simulation, start),), replays, model_path, folder / "index.html")
