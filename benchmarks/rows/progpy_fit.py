"""progpy's BatteryElectroChemEOD identified on a cell's tests, in the order of its authors.

The charge; the positive electrode's equilibrium potential on the OCV (its Redlich-Kister
coefficients are linear in the model's own output); ohmic resistance, kinetics, diffusion and the
three lags by the model's own `estimate_params` on the drive that is nearest in temperature.
"""

import numpy as np
from progpy.models import BatteryElectroChemEOD
from progpy.models.battery_electrochem import calculate_temp_voltage
from serve import at_period

STEP_S, POINTS = 10.0, 60
STABLE_S = 5.0  # their Euler steps swing beyond: the ohmic lag is 6 s
TERMS, RIDGE = 13, 1e-4  # of the Redlich-Kister expansion; of its least squares
KINETIC = {"Ro": (1e-3, 1.0), "tDiffusion": (1e5, 2e8), "kn": (1e-2, 1e7), "kp": (1e-2, 1e7),
           "to": (STABLE_S, 300.0), "tsn": (STABLE_S, 2e3), "tsp": (STABLE_S, 2e3)}  # fmt: skip
DRIVE_ROWS, TRIES = 600, 400  # 100 min of a drive; simulations of their search
EDGE = 0.005  # of an electrode: their logarithms have no value at its ends


class Inside(BatteryElectroChemEOD):
    """The model; a state beyond an electrode is held at its end, as sigma points reach there."""

    def _held(self, x):
        p = self.parameters
        for part, most in (("S", p["qSMax"]), ("B", p["qBMax"])):
            for pole in "np":
                held = np.clip(x[f"q{pole}{part}"], EDGE * most, (1.0 - EDGE) * most)
                x[f"q{pole}{part}"] = held
        return x

    def next_state(self, x, u, dt):
        return super().next_state(self._held(x), u, dt)

    def output(self, x):
        return super().output(self._held(x))


class VoltageAlone(BatteryElectroChemEOD):
    """The model as it is fitted: an error of kelvins would outweigh one of volts."""

    outputs = ["v"]  # noqa: RUF012

    def output(self, x):
        p = self.parameters
        return self.OutputContainer({"v": calculate_temp_voltage(x, p, p["qSMax"])[1]})


def at_soc(model, soc, temperature_C):
    """The model's state at equilibrium."""
    p, x = model.parameters, {"tb": temperature_C + 273.15, "Vo": 0.0, "Vsn": 0.0, "Vsp": 0.0}
    negative, positive = soc * p["qnMax"], p["qMax"] - soc * p["qnMax"]
    for name, share in (("S", p["VolSFraction"]), ("B", 1.0 - p["VolSFraction"])):
        x[f"qn{name}"], x[f"qp{name}"] = share * negative, share * positive
    return {name: x[name] for name in model.states}  # their filters go by this order


def fitted_to(cell):
    """Parameters of the model that differ from its defaults."""
    warm = cell.temperature_C
    found = {"qMobile": 3600.0 * cell.capacity_Ah, "VEOD": 2.5}
    soc = np.linspace(0.02, 0.98, POINTS)
    ocv = np.interp(soc, cell.soc, cell.at(warm)["ocv_V"])

    def potential(u0p, coefficients):
        model = BatteryElectroChemEOD(**found, U0p=u0p, Ap=list(coefficients))
        states = (model.StateContainer(at_soc(model, s, warm)) for s in soc)
        return np.array([float(np.ravel(model.output(x)["v"])[0]) for x in states])

    none = np.zeros(TERMS)
    base, unit = potential(0.0, none), 1e5  # J/mol
    parts = [potential(1.0, none), *(potential(0.0, row) for row in unit * np.eye(TERMS))]
    design = np.column_stack([part - base for part in parts])
    square = design.T @ design + RIDGE * np.eye(TERMS + 1)
    solved = np.linalg.solve(square, design.T @ (ocv - base))
    found |= {"U0p": float(solved[0]), "Ap": [float(v) for v in unit * solved[1:]]}
    model = VoltageAlone(**found)
    loads = cell.of("drive") or cell.of("hppc")
    nearest = min(loads, key=lambda log: abs(float(np.mean(log["temperature_C"])) - warm))
    rows = at_period(nearest, STEP_S)
    rows = {name: values[:DRIVE_ROWS] for name, values in rows.items()}
    model.estimate_params(
        times=list(rows["time_s"]),
        inputs=[{"i": float(i)} for i in rows["current_A"]],
        outputs=[{"v": float(v)} for v in rows["voltage_V"]],
        keys=list(KINETIC),
        bounds=KINETIC,
        x0=model.StateContainer(at_soc(model, 0.999, warm)),
        dt=STABLE_S,
        options={"maxfev": TRIES, "fatol": 1e-7},
    )
    x, wrong = model.StateContainer(at_soc(model, 0.999, warm)), []
    for current_A, seen_V in zip(rows["current_A"], rows["voltage_V"], strict=True):
        for _ in range(round(STEP_S / STABLE_S)):
            x = model.next_state(x, model.InputContainer({"i": current_A}), STABLE_S)
        wrong.append(float(np.ravel(model.output(x)["v"])[0]) - seen_V)
    residual = float(np.sqrt(np.nanmean(np.square(wrong))))
    return residual, found | {name: float(model.parameters[name]) for name in KINETIC}
