"""Make the stock models again: `python datasets/stock_models.py DATA [-o datasets/stock]`.

DATA is the folder of measured cells (see `registry.toml`). Every cell is identified by cellwise
itself from few logs; what is written is thinned to a small file whose `error` says how far another
cell of the kind may be from it. That spread is measured, not chosen: see :func:`ocv_spread`.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from cellwise.cell.effects import EFFECTS, Effect, TimeSkew
from cellwise.cell.model import TABLES, CellModel
from cellwise.cell.model_error import ModelError
from cellwise.cell.model_file import check_physical, model_to_dict, read_model
from cellwise.data import load_dataset
from cellwise.files import made_folder, write_atomically
from cellwise.identify import CellTests, IdentifySettings, identify_cell
from cellwise.identify.ocv.ocv_lowrate import ocv_from_low_rate
from cellwise.logs import CellLog, Stated, read_log
from cellwise.typing import FloatArray

HERE = Path(__file__).resolve().parent
POINTS = 101
LEAST_STEP_K = 9.0  # between rows of tables: straight lines there are within 3 % of Arrhenius
DIGITS = 5
LASTS_S = 3600.0  # how long another cell's difference persists: as long as the models allow
LOW_SOC = 0.05  # below, cells differ by where their maker ends the discharge
TEMPERATURE_C = 25.0


@dataclass(frozen=True)
class Recipe:
    """One stock model: its cell, in `registry.toml` under ``original``, and the logs it is from."""

    original: str
    nominal_Ah: float
    hppc: tuple[str, ...] = ()
    ocv: tuple[str, ...] = ()
    capacity: tuple[str, ...] = ()
    drive: tuple[str, ...] = ()
    prior: str = ""  # a stock model made before: for a cell without low-rate and pulse tests
    class_: str = "layered"


RECIPES = {
    "nca-18650": Recipe(
        "panasonic_18650pf",
        2.9,
        hppc=("hppc_p25@25", "hppc_p10@10", "hppc_p00@0", "hppc_n10@-10"),
        ocv=("ocv_c20_p25",),
        drive=("drive_p25_cycle_2@soc0=1", "drive_p00_cycle_4@soc0=1"),
    ),
    "nmc-18650": Recipe(
        "lg_18650hg2",
        3.0,
        ocv=("ocv_c20_p25_549",),
        capacity=("cap_0p5c_p25_549", "cap_1c_p25_551", "cap_2c_p25_549"),
        drive=("pauscycl_p10_571@soc0=1", "pauscycl_p00_590@soc0=1", "drive_us06_n10_601@soc0=1"),
    ),
    "lmo-pouch": Recipe(
        "nissan_leaf",
        33.1,
        hppc=("hppc_p10@10", "hppc_p25@25", "hppc_p40@40"),
        capacity=("cap_1c_p23@23",),
    ),
    "lfp-26650": Recipe(
        "plett_a123",
        2.3,
        ocv=("ocv_p25_s1@25", "ocv_p25_s3@25"),
        drive=(
            "dyn_p25_s1@temperature_C=25,soc0=1",
            "dyn_p05_s1@temperature_C=5,soc0=1",
            "dyn_p45_s1@temperature_C=45,soc0=1",
        ),
        class_="lfp",
    ),
    "lipo-pouch": Recipe(
        "lipo_5450",
        5.45,
        # Charged to 4.1 V only. Where that is nobody measured: the other layered oxides here have
        # this OCV at 0.92 to 0.95, less what a charge at 1C to 4C leaves to relax.
        drive=tuple(f"c{c}_cycle01@soc0=0.92" for c in (1, 2, 3, 4)),
        prior="nmc-18650",
    ),
}
# Low-rate discharges of further cells: what another cell of the class looks like.
OTHERS = {"layered": ("samsung_30q_ageing/fresh_s001_discharge_c10", "nmc/ocv_c20"),
          "lfp": ("lfp/ocv_c20",)}  # fmt: skip


def main() -> int:
    """Make every stock model."""
    parser = argparse.ArgumentParser(prog="stock_models", description=__doc__)
    parser.add_argument("data", type=Path, help="folder of the measured cells")
    parser.add_argument("-o", "--output", type=Path, default=HERE / "stock", metavar="DIR")
    parser.add_argument("--only", action="append", choices=RECIPES, help="leave the others")
    arguments = parser.parse_args()
    made_folder(arguments.output, "stock models")
    measured = {n: r for n, r in RECIPES.items() if not r.prior}
    models = {name: model_of(name, measured, arguments) for name in measured}
    resistance = resistance_spread(list(models.values()))
    curves = {c: ocv_curves(c, models, arguments.data) for c in OTHERS}
    # Where empty is differs by maker, not by slope: all cells know about it alike.
    empty = round(float(np.std([ocv[0] for c in curves.values() for ocv in c], ddof=1)), 3)
    # Those with a prior last: theirs is a stock model with its spread.
    for name in sorted(RECIPES, key=lambda n: bool(RECIPES[n].prior)):
        if arguments.only and name not in arguments.only:
            continue
        recipe = RECIPES[name]
        if recipe.prior:
            models[name] = model_of(name, RECIPES, arguments)
        soc, volt = ocv_spread(curves[recipe.class_])
        spread = {"soc": soc, "ocv_V": volt, "empty_V": empty, "ln_resistance": resistance}
        text = as_text(stock(name, models[name], recipe, spread))
        path = write_atomically(arguments.output / f"{name}.json", text)
        print(f"{path}: {len(text) / 1000:.0f} kB, spread {spread}")
    return 0


def model_of(name: str, recipes: Mapping[str, Recipe], arguments: argparse.Namespace) -> CellModel:
    """The cell's model: identified, or as it was made before."""
    place = arguments.output / f"{name}.json"
    if arguments.only and name not in arguments.only:
        return read_model(place)
    recipe = recipes[name]
    began = time.perf_counter()
    prior = read_model(arguments.output / f"{recipe.prior}.json") if recipe.prior else None
    model = identified(recipe, arguments.data, prior)
    print(f"{name}: {model!r}, {time.perf_counter() - began:.0f} s", file=sys.stderr)
    return model


def identified(recipe: Recipe, data: Path, prior: CellModel | None) -> CellModel:
    """The cell's model as `cellwise identify` gives it."""
    tests = tests_of(recipe, data)
    settings = IdentifySettings(
        nominal_Ah=recipe.nominal_Ah,
        prior=prior,
    )
    return identify_cell(tests, settings).model


def tests_of(recipe: Recipe, data: Path) -> CellTests:
    """The recipe's logs."""

    def log(text: str) -> tuple[CellLog, float | None]:
        name, at, stated = text.partition("@")
        whole = f"{data / recipe.original / name}.csv.gz{at}{stated}"
        return read_log(whole), Stated.parse(whole).temperature_C

    return CellTests(
        hppc=tuple(log(t) for t in recipe.hppc),
        ocv=tuple(log(t)[0] for t in recipe.ocv),
        capacity=tuple(log(t)[0] for t in recipe.capacity),
        drive=tuple(log(t) for t in recipe.drive),
    )


def ocv_curves(class_: str, models: Mapping[str, CellModel], data: Path) -> list[FloatArray]:
    """OCV of the class's cells over one SOC grid: own models without a prior, and others."""
    soc = np.linspace(0.0, 1.0, POINTS)
    curves = []
    for name, recipe in RECIPES.items():
        if recipe.class_ == class_ and not recipe.prior and name != "lmo-pouch":
            at = models[name].at_temperature(TEMPERATURE_C)
            curves.append(np.interp(soc, at.soc, at.ocv_V[0]))
    for other in OTHERS[class_]:
        folder, _, name = other.partition("/")
        known = data / folder / f"{name}.csv.gz"
        log = read_log(known) if known.is_file() else load_dataset(f"{folder}_{name}")
        curves.append(ocv_from_low_rate(log).function.evaluate(soc))
    return curves


def ocv_spread(curves: Sequence[FloatArray]) -> tuple[float, float]:
    """How far OCV curves of a class are apart: along SOC, and in volts whatever the slope.

    Maximum likelihood of the differences of all pairs, normal with the variance
    soc^2 slope^2 + volt^2.
    """
    soc = np.linspace(0.0, 1.0, POINTS)
    used = soc >= LOW_SOC
    slopes, squares = [], []
    for a, b in combinations(curves, 2):
        slopes.append(np.gradient(0.5 * (a + b), soc)[used] ** 2)
        squares.append((a - b)[used] ** 2)
    slope2, square = np.concatenate(slopes), np.concatenate(squares)

    def cost(logarithms: FloatArray) -> float:
        along, across = np.exp(logarithms)
        variance = along * slope2 + across
        return float(np.sum(np.log(variance) + square / variance))

    found = minimize(cost, np.log([0.03**2, 0.03**2]), method="Nelder-Mead").x
    return round(float(np.exp(0.5 * found[0])), 4), round(float(np.exp(0.5 * found[1])), 4)


def resistance_spread(models: Sequence[CellModel]) -> float:
    """Standard deviation over cells of ln(R0 Q), the voltage that R0 takes at 1C, at 25 degC."""
    drops = []
    for model in models:
        at = model.at_temperature(TEMPERATURE_C)
        drops.append(np.log(np.median(at.r0_ohm) * at.capacity_Ah))
    return round(float(np.std(drops, ddof=1)), 3)


def stock(name: str, model: CellModel, recipe: Recipe, spread: Mapping[str, float]) -> CellModel:
    """The model thinned, with its source, what it is valid for, and the spread as its error."""
    with (HERE / "registry.toml").open("rb") as file:
        entry = next(o for o in tomllib.load(file)["original"] if o["name"] == recipe.original)
    thin = thinned(model)
    slope = np.gradient(thin.at_temperature(TEMPERATURE_C).ocv_V[0], thin.soc)
    own = model.error.at(thin.soc)
    along = np.minimum(spread["soc"] * slope, spread["empty_V"])
    slow = np.sqrt(own**2 + along**2 + spread["ocv_V"] ** 2)
    logs = [*recipe.hppc, *recipe.ocv, *recipe.capacity, *recipe.drive]
    source = {key: entry.get(key, "") for key in ("lab", "doi", "licence")}
    return replace(
        thin,
        name=str(entry["cell"]),
        chemistry=str(entry["chemistry"]),
        voltage_min_V=float(entry["window_V"][0]),
        voltage_max_V=float(entry["window_V"][1]),
        error=ModelError.of_white_and_slow(
            white_V=float(model.error.white_V),
            slow_V=tuple(float(f"{v:.3g}") for v in slow[:: (POINTS - 1) // 50]),
            correlation_s=LASTS_S,
            resistance_share=float(np.hypot(spread["ln_resistance"], model.error.shown_share())),
        ),
        posterior=None,  # the spread of its kind says more
        provenance={
            "cellwise_version": model.provenance.get("cellwise_version", ""),
            "stock": {
                "name": name,
                "source": {"original": recipe.original, **source, "logs": logs},
                "validity": model.validity.to_dict(),
                "spread": dict(spread),
                "own_error_V": float(f"{np.median(own):.3g}"),
                **({"prior": recipe.prior} if recipe.prior else {}),
            },
        },
    )


def thinned(model: CellModel) -> CellModel:
    """Fewer SOC points and temperatures, five digits; without the delay of the tester's samples."""
    kept = [0]
    for row, temperature in enumerate(model.temperature_C):
        if temperature - model.temperature_C[kept[-1]] >= LEAST_STEP_K:
            kept.append(row)
    if kept[-1] != model.temperature_C.size - 1 and len(kept) > 1:
        kept[-1] = model.temperature_C.size - 1
    soc = np.linspace(0.0, 1.0, POINTS)

    def table(values: FloatArray, logarithm: bool) -> FloatArray:
        rows = np.broadcast_to(values, model.ocv_V.shape)[kept]
        rows = np.log(np.maximum(rows, 1e-12)) if logarithm else rows
        out = np.array([np.interp(soc, model.soc, row) for row in rows])
        return rounded(np.exp(out) if logarithm else out)

    ocv = table(model.ocv_V, False)
    others: dict[str, Any] = {n: table(getattr(model, n), True) for n in TABLES if n != "ocv_V"}
    return replace(
        model,
        **others,
        ocv_V=np.maximum.accumulate(ocv, axis=1),
        temperature_C=model.temperature_C[kept],
        effects=tuple(thin_effect(e, table) for e in model.effects if not isinstance(e, TimeSkew)),
    )


def thin_effect(effect: Effect, table: Any) -> Effect:
    """An effect's tables thinned, its numbers rounded."""
    values = {
        key: table(np.asarray(value), False) if np.ndim(value) else float(f"{value:.{DIGITS}g}")
        for key, value in vars(effect).items()
    }
    return EFFECTS[effect.name](**values)


def rounded(values: FloatArray) -> FloatArray:
    """Five significant digits."""
    return np.array([[float(f"{v:.{DIGITS}g}") for v in row] for row in values])


def as_text(model: CellModel) -> str:
    """The model file without a space too many."""
    check_physical(model, model.name)
    return json.dumps(model_to_dict(model), separators=(",", ":"), allow_nan=False) + "\n"


if __name__ == "__main__":
    sys.exit(main())
