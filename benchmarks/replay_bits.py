"""SHA-256 of every replay: what a change of structure must leave as it is, bit for bit.

    python -m benchmarks.replay_bits --record before.json
    python -m benchmarks.replay_bits --against before.json

Bits depend on the machine's library of mathematics, so a record is compared on the machine that
made it and is never committed. Models carry each effect alone and all together; logs have gaps,
repeated stamps, missing and impossible readings, frozen voltages and wrong starts; measured drives
join in where $CELLWISE_DATA names them. With --against, what differs is listed with the largest
difference of SOC (`--tolerance 1e-9` accepts that much).
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import cellwise as cw
from benchmarks.measured_data import data_folder
from cellwise.cell import effects as effect
from cellwise.cell.model_file import model_from_dict, model_to_dict

ESTIMATORS = ("coulomb", "ekf", "ukf", "adaptive", "fixed-step", "firmware")
ROWS = 4000
CHANNELS = ("time_s", "current_A", "voltage_V", "temperature_C")
DRIVES = (
    "panasonic_18650pf/drive_p25_us06",
    "panasonic_18650pf/drive_n10_cycle_1",
    "plett_a123/dyn_p25_s1",
)
EFFECTS = (
    effect.SlowDiffusion(r3_ohm=0.015, tau3_s=1500.0),
    effect.Hysteresis(m_V=0.02, gamma=40.0),
    effect.TemperatureDependence(activation_K=2500.0, reference_C=25.0),
    effect.TimeSkew(skew_s=0.4),
    effect.RateDependence(rate_h=0.08),
    effect.ChargeTransfer(asinh_per_V=60.0),
    effect.SurfaceSoc(depth_h=0.06, tau_s=200.0, activation_K=1500.0),
    effect.ChargeAsymmetry(charge_scale=1.2),
    effect.SelfHeating(rth_K_per_W=6.0, thermal_s=500.0),
    effect.SelfDischarge(leak_A=0.01),
)


def cell(effects: tuple = (), temperatures: int = 1, **changes: object) -> cw.CellModel:
    """A curved cell; colder rows have larger resistances and time constants."""
    s = np.linspace(0.0, 1.0, 101)
    cold = np.linspace(2.0, 1.0, temperatures)[:, None] if temperatures > 1 else np.ones((1, 1))
    return cw.CellModel(
        capacity_Ah=3.0,
        ocv_V=np.broadcast_to(
            3.3 + 0.55 * s + 0.35 * s**3 - 0.5 * np.exp(-20.0 * s), (temperatures, 101)
        ),
        r0_ohm=cold * (0.028 + 0.02 * (1.0 - s) ** 4),
        r1_ohm=cold * (0.010 + 0.02 * (1.0 - s) ** 3),
        tau1_s=cold * (4.0 + 4.0 * s),
        r2_ohm=cold * (0.018 + 0.03 * (1.0 - s) ** 5),
        tau2_s=cold * (70.0 + 50.0 * s),
        temperature_C=np.linspace(-10.0, 25.0, temperatures) if temperatures > 1 else [25.0],
        effects=effects,
        **changes,
    )


def models() -> Iterator[tuple[str, cw.CellModel]]:
    yield "plain", cell()
    for e in EFFECTS:
        yield e.name, cell((e,))
    yield "efficiency", cell(charge_efficiency=0.98)
    yield "temperatures", cell((), 3)
    yield "all", cell(EFFECTS, 3, charge_efficiency=0.99)


def drive(rng: np.random.Generator, model: cw.CellModel, dt_s: float) -> cw.CellLog:
    """Steps of random current, rests and charging, with the model's own noisy voltage."""
    time = dt_s * np.arange(ROWS)
    levels = rng.choice([0.0, 0.0, 1.5, 3.0, -1.5, 6.0], ROWS // 40 + 1) * rng.uniform(
        0.5, 1.2, ROWS // 40 + 1
    )
    current = np.repeat(levels, 40)[:ROWS] + 0.05 * rng.standard_normal(ROWS)
    current[:60] = 0.0
    temperature = 10.0 + 15.0 * np.sin(time / (900.0 * dt_s))
    flat = cw.CellLog(
        time_s=time, current_A=current, voltage_V=np.full(ROWS, 3.7), temperature_C=temperature
    )
    voltage = cw.simulate(model, flat, soc0=0.85).voltage_V + 0.003 * rng.standard_normal(ROWS)
    return cw.CellLog(time_s=time, current_A=current, voltage_V=voltage, temperature_C=temperature)


def spoiled(rng: np.random.Generator, log: cw.CellLog) -> cw.CellLog:
    """The same with gaps, repeated stamps, and readings missing, impossible or frozen."""
    time, current, voltage, warm = (
        np.array(x) for x in (log.time_s, log.current_A, log.voltage_V, log.temperature_C)
    )
    time[1500:] += 900.0
    time[2600:] += 40000.0
    time[700:703] = time[700]
    current[rng.integers(1, ROWS, 40)] = np.nan
    current[1000:1200] = np.nan
    current[rng.integers(1, ROWS, 5)] = 1e6
    voltage[rng.integers(1, ROWS, 40)] = np.nan
    voltage[2000:2150] = voltage[2000]
    voltage[3000] = 40.0
    voltage[3100:3400] = np.nan
    voltage[3500:3600] += 0.4
    warm[rng.integers(0, ROWS, 30)] = np.nan
    return cw.CellLog(time_s=time, current_A=current, voltage_V=voltage, temperature_C=warm)


def cases() -> Iterator[tuple[str, cw.CellModel, cw.CellLog, float, float]]:
    for name, model in models():
        rng = np.random.default_rng(7)
        clean = drive(rng, model, 1.0)
        yield f"{name}/clean", model, clean, 0.85, 0.02
        yield f"{name}/wrong start", model, clean, 0.45, 0.15
        yield f"{name}/spoiled", model, spoiled(rng, clean), 0.6, 0.15
        yield f"{name}/10 Hz", model, drive(rng, model, 0.1), 0.8, 0.1
    nmc = cw.identify_cell(
        cw.TestLogs(
            hppc=((cw.load_dataset("nmc_hppc"), None),), ocv=(cw.load_dataset("nmc_ocv_c20"),)
        ),
        cw.IdentifySettings(nominal_Ah=5.0),
    ).model
    # A stored model has the same bits, whatever has become of the identification.
    for name in ("nmc_drive_b", "nmc_leo", "nmc_flight"):
        log = cw.load_dataset(name)
        yield f"nmc/{name}", nmc, log, 0.7, 0.15
    folder = data_folder()
    for name in DRIVES if folder else ():
        log = cw.read_log(folder / f"{name}.csv.gz")
        for kind, model in (("plain", cell()), ("all", cell(EFFECTS, 3))):
            yield f"{kind}/{name}", model, log, 0.7, 0.15


def digest(*arrays: object) -> str:
    sha = hashlib.sha256()
    for a in arrays:
        values = np.ascontiguousarray(a)
        if values.dtype.kind == "f":
            values = np.where(np.isnan(values), np.nan, values) + 0.0  # one NaN, one zero
        sha.update(values.tobytes())
    return sha.hexdigest()


def lockstep(model: cw.CellModel, log: cw.CellLog, soc0: float, std: float) -> tuple:
    dt = float(np.median(np.diff(log.time_s)))
    fleet = cw.LockstepEkf(model, 20, dt)
    state = fleet.init(soc0, std)
    rows = []
    warm = log.temperature_C if log.temperature_C is not None else np.full(len(log), 25.0)
    shift = 0.01 * np.arange(20)
    for k in range(min(len(log), 1500)):
        state, info = fleet.step(
            state, log.current_A[k] + shift, log.voltage_V[k] + shift / 10.0, float(warm[k])
        )
        rows.append(np.concatenate((info.soc, info.soc_std, info.status)))
    return np.array(rows)[:, :20].copy(), digest(np.array(rows), state.blocks)


def stored(old: dict[str, np.ndarray], name: str, log: cw.CellLog) -> cw.CellLog:
    """The log that the earlier record was made of."""
    channels = {c: old[f"log/{name}/{c}"] for c in CHANNELS if f"log/{name}/{c}" in old}
    return cw.CellLog(**channels)


def record(
    models_json: dict[str, str], old: dict[str, np.ndarray], say=lambda text: None
) -> tuple[dict[str, str], dict[str, np.ndarray]]:
    """Digests of every replay, and SOC; logs and identified models are those of ``old``, if any."""
    found: dict[str, str] = {}
    socs: dict[str, np.ndarray] = {}
    for name, made, log, soc0, std in cases():
        say(name)
        model = made
        if name.startswith("nmc/"):
            text = models_json.setdefault("nmc", json.dumps(model_to_dict(made)))
            model = model_from_dict(json.loads(text))
        if old:
            log = stored(old, name, log)
        for c in CHANNELS:
            if getattr(log, c) is not None:
                socs[f"log/{name}/{c}"] = getattr(log, c)
        simulated = cw.simulate(model, log, soc0=soc0)
        found[f"simulate/{name}"] = digest(simulated.voltage_V, simulated.soc)
        for estimator in ESTIMATORS:
            trace = cw.replay(model, log, estimator, soc0=soc0, soc0_std=std).trace
            found[f"{estimator}/{name}"] = digest(
                *(v for v in vars(trace).values() if isinstance(v, np.ndarray))
            )
            socs[f"{estimator}/{name}"] = np.asarray(trace.soc)
        if "clean" in name or "10 Hz" in name or "wrong" in name:
            socs[f"lockstep/{name}"], found[f"lockstep/{name}"] = lockstep(model, log, soc0, std)
    return found, socs


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--record", type=Path, help="write digests and SOC there")
    parser.add_argument("--against", type=Path, help="compare with an earlier record")
    parser.add_argument("--tolerance", type=float, default=0.0, help="difference of SOC to accept")
    options = parser.parse_args(arguments)
    before, old = {}, {}
    if options.against:
        before = json.loads(options.against.read_text())
        old = dict(np.load(options.against.with_suffix(".npz")))
    models_json = before.pop("models", {})
    found, socs = record(models_json, old, lambda text: print(text, file=sys.stderr, flush=True))
    if options.record:
        options.record.write_text(json.dumps({**found, "models": models_json}, indent=1))
        np.savez_compressed(options.record.with_suffix(".npz"), **socs)
    if not options.against:
        return 0
    bad = 0
    for name in sorted({*before, *found}):
        if before.get(name) == found.get(name):
            continue
        apart = np.nan
        if name in socs and name in old and socs[name].shape == old[name].shape:
            apart = float(np.nanmax(np.abs(socs[name] - old[name])))
        accepted = apart <= options.tolerance and options.tolerance > 0.0
        bad += not accepted
        print(f"{name}: differs, SOC by at most {apart:.3g}{' (accepted)' if accepted else ''}")
    print(f"{len(found)} replays, {bad} not as before")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
