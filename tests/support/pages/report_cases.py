"""A laboratory of plain numbers: an identification, simulations and replays made by hand."""

from __future__ import annotations

from html.parser import HTMLParser

import numpy as np

from cellwise.cell.effects import SlowDiffusion
from cellwise.cell.initial_soc.initial_soc import InitialSoc
from cellwise.cell.metrics import error_metrics
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import Simulation
from cellwise.estimate.replay import Replay
from cellwise.estimate.trace import Trace
from cellwise.fit.rows import BaseOcv
from cellwise.fit.solve import FitResult
from cellwise.fit.unknowns import layout_of
from cellwise.identify.capacity.capacity_test import CapacityTest
from cellwise.identify.hppc.pulse_quality import Pulse
from cellwise.identify.identification import (
    Identification,
    OwnLog,
    PulseSet,
    TemperatureResult,
)
from cellwise.identify.ocv.curve import curve_from_points
from cellwise.identify.pulse_fit.circuit import PulseFit, PulseParameters
from cellwise.logs.cell_log import CellLog
from cellwise.notices import Code, Notice

CAPACITY_AH = 3.0
POINTS = 41
VOID = {"meta", "br", "hr", "img", "link", "input"}
R0_ERROR, R1_ERROR, TAU1_ERROR = 0.03, 0.06, 0.08


def ocv_V(soc):
    return 3.3 + 0.6 * soc + 0.25 * soc**3 - 0.3 * np.exp(-20.0 * soc)


def model(temperatures=(25.0,), *, slow=True, name="test cell"):
    soc = np.linspace(0.0, 1.0, POINTS)
    shape = (len(temperatures), POINTS)

    def rows(values):
        return np.array([values * (1.0 + 0.3 * k) for k in range(len(temperatures))])

    effects = (SlowDiffusion(np.full(shape, 0.01), np.full(shape, 1500.0)),) if slow else ()
    return CellModel(
        capacity_Ah=CAPACITY_AH,
        ocv_V=np.tile(ocv_V(soc), (len(temperatures), 1)),
        r0_ohm=rows(0.03 + 0.02 * (1 - soc) ** 3),
        r1_ohm=rows(0.01 + 0.01 * (1 - soc) ** 3),
        tau1_s=rows(4.0 + 2.0 * soc),
        r2_ohm=rows(0.02 + 0.02 * (1 - soc) ** 3),
        tau2_s=rows(80.0 + 40.0 * soc),
        temperature_C=np.array(temperatures),
        effects=effects,
        name=name,
        provenance={"pulses": {"method": "varpro"}, "note": "<made by hand>"},
    )


def hppc(name="hppc"):
    """Rest, pulse, rest, charge pulse, rest, move at every fifth of SOC; rows of 1 s."""
    level = [(0.0, 60), (6.0, 10), (0.0, 40), (-4.5, 10), (0.0, 60), (3.0, 700)]
    current = np.concatenate([np.full(n, amp) for _ in range(5) for amp, n in level])
    time = np.arange(current.size, dtype=np.float64)
    charge = np.cumsum(current) / 3600.0
    soc = 1.0 - charge / CAPACITY_AH
    voltage = ocv_V(np.clip(soc, 0, 1)) - 0.045 * current
    return CellLog(time, current, voltage, charge_Ah=charge, name=name)


def pulses(log):
    """The ten pulses and five moves of :func:`hppc`; three of them not healthy."""
    found = []
    for k in range(5):
        start = 880 * k
        for first, length, role in ((60, 10, "pulse"), (110, 10, "pulse"), (180, 700, "move")):
            at = start + first
            quality = {(4, 60): "trimmed", (0, 110): "distorted", (4, 110): "spurious"}.get(
                (k, first), "healthy"
            )
            found.append(
                Pulse(
                    start=at,
                    stop=at + length,
                    cc_stop=at + length,
                    rest_before_start=at - 40,
                    relax_stop=min(at + length + 40, len(log)),
                    current_A=float(log.current_A[at]),
                    duration_s=float(length),
                    charge_Ah=float(log.current_A[at]) * length / 3600.0,
                    role=role,
                    quality=quality,
                    reason=f"because 1 < 2 & pulse {k}",
                )
            )
    return tuple(found)


def pulse_fit(pulse, soc, method="varpro"):
    value = PulseParameters(0.031, 0.011, 4.5, 0.021, 95.0, 3.7)
    error = PulseParameters(0.001, 0.001, 0.3, 0.02, 40.0, 0.001)
    if method == "segments":
        error = PulseParameters(*[float("nan")] * 6)
    return PulseFit(
        method=method,
        soc=soc,
        current_A=pulse.current_A,
        duration_s=10.0,
        value=value,
        error=error,
        rmse_V=1e-3,
        rows=60,
    )


def refinement(branches=3):
    layout = layout_of(branches, hysteresis=False)
    std = np.full(layout.size, 0.2)
    std[layout.r0 : layout.r0 + layout.knots] = R0_ERROR
    std[layout.r(0) : layout.r(0) + layout.knots] = R1_ERROR
    std[layout.tau(0) : layout.tau(0) + layout.knots] = TAU1_ERROR
    return FitResult(
        layout=layout,
        theta=np.zeros(layout.size),
        covariance=np.diag(std**2),
        base=BaseOcv(ocv_V(np.linspace(0.0, 1.0, 201))),
        capacity_Ah=CAPACITY_AH,
        rmse_V=(0.01,),
        residual_V=(np.zeros(3),),
        logs=(),
        reference_C=25.0,
        level_V=0.01,
        share=0.03,
        numbers=np.array([50.0]),
        log_evidence=0.0,
        iterations=3,
        seconds=0.1,
        grid_C=np.array([25.0]),
    )


def simulation(log, error_V=None, soc0=1.0):
    """A simulation that is wrong by ``error_V``."""
    soc = np.clip(soc0 - log.counted_charge_Ah() / CAPACITY_AH, 0.0, 1.0)
    error = 0.01 * np.sin(log.time_s / 50.0) if error_V is None else error_V
    return Simulation(log, soc0, log.voltage_V - error, soc)


def identification(
    temperatures=(25.0,), *, refined=True, name="hppc", method="varpro", with_pulses=True
):
    log = hppc(name)
    found = pulses(log)
    healthy = tuple(p for p in found if p.role == "pulse" and p.quality == "healthy")
    charge = log.counted_charge_Ah()
    fits = tuple(pulse_fit(p, 1.0 - charge[p.start] / CAPACITY_AH, method) for p in healthy)
    soc = np.linspace(0.0, 1.0, 201)
    ocv = curve_from_points(
        soc,
        ocv_V(soc),
        capacity_Ah=CAPACITY_AH,
        discharge_V=ocv_V(soc) - 0.01,
        charge_V=np.where(soc < 0.9, ocv_V(soc) + 0.01, np.nan),
        source=f"mean of both branches of {name}",
        notes=("a note & more",),
    )
    sets = (PulseSet(log, InitialSoc(1.0, 0.005, "full"), found, (), method),)
    vars(sets[0])["fits"] = fits  # as fitted by hand
    results = tuple(
        TemperatureResult(t, sets if with_pulses else (), refinement() if refined else None)
        for t in temperatures
    )
    sims = (simulation(log),)
    return Identification(
        model=model(temperatures, slow=refined),
        capacity_choice="rate:C/20",
        capacities={"nominal": 2.9, "cc-average": 2.95, "rate:C/20": 3.0, "rate:1C": 2.9},
        capacity_tests=(capacity_test(0.05, 3.0, 0.0), capacity_test(1.0, 2.9, 0.08)),
        ocv=ocv,
        temperatures=results,
        own_logs=tuple(
            OwnLog("hppc", True, s, InitialSoc(s.soc0, 0.01, "given"), None, {}, "") for s in sims
        ),
        decided=(),
        fit=error_metrics(sims[0].residual_V),
        notices=(Notice(Code.OWN_LOG, "a notice with <angle> brackets"),),
        seconds=1.5,
    )


def capacity_test(rate_C, cc_Ah, cv_Ah):
    return CapacityTest(
        name=f"cap {rate_C:g}C",
        rate_C=rate_C,
        current_A=3.0 * rate_C,
        cc_Ah=cc_Ah,
        cv_Ah=cv_Ah,
        temperature_C=25.0,
        notices=(Notice(Code.CAPACITY_TEST_INCOMPLETE, "ends <early>"),),
    )


def drive(rows=1200, name="drive"):
    time = np.arange(rows, dtype=np.float64)
    current = 1.5 + 2.0 * np.sin(time / 7.0)
    charge = np.cumsum(current) / 3600.0
    soc = np.clip(1.0 - charge / CAPACITY_AH, 0.0, 1.0)
    return CellLog(time, current, ocv_V(soc) - 0.04 * current, charge_Ah=charge, name=name)


def replay(log, *, off=-0.3, forget_s=50.0, estimator="ekf", reference=True, variance=True):
    """A replay whose SOC error is off exp(-t / forget_s)."""
    n = len(log)
    true = 1.0 - log.counted_charge_Ah() / CAPACITY_AH
    error = off * np.exp(-(log.time_s - log.time_s[0]) / forget_s)
    innovation = 0.01 * np.cos(log.time_s)
    spread = np.full(n, 1e-4) if variance else np.full(n, np.nan)
    trace = Trace(
        time_s=log.time_s,
        soc=true + error,
        soc_std=0.01 + 0.2 * np.exp(-log.time_s / 60.0),
        voltage_V=log.voltage_V - innovation,
        innovation_V=innovation,
        innovation_variance_V2=spread,
        test_ratio=innovation**2 / spread,
        status=np.zeros(n, dtype=np.int32),
    )
    start = InitialSoc(1.0 + off, 0.15, "given")
    return Replay(log, estimator, start, trace, 95.0, true if reference else None)


class Page(HTMLParser):
    """What a page holds: tags in order, ids, addresses, texts; complains of wrong nesting.

    ``scripts`` are the figures for machines, ``programs`` whatever else stands in a script.
    """

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.open, self.tags, self.ids, self.addresses = [], [], [], []
        self.scripts, self.programs, self.texts, self.references = [], [], [], []
        self.feed(text)
        self.close()
        assert self.open == [], f"left open: {self.open}"

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        for key, value in attrs:
            if key == "id":
                self.ids.append(value)
            if key in ("src", "href", "xlink:href", "srcset", "action", "poster", "data"):
                self.addresses.append(value)
            if key in ("clip-path", "style") and value and "url(" in value:
                self.references.append(value.split("url(")[1].split(")")[0])
        if tag == "script":
            self._scripts_of(dict(attrs)).append((dict(attrs), ""))
            self._last = dict(attrs)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> without a beginning"
        assert self.open[-1] == tag, f"</{tag}> closes <{self.open[-1]}>"
        self.open.pop()

    def handle_data(self, data):
        if self.open and self.open[-1] == "script":
            into = self._scripts_of(self._last)
            attrs, text = into[-1]
            into[-1] = (attrs, text + data)
        elif data.strip():
            self.texts.append((tuple(self.open), data.strip()))

    def _scripts_of(self, attrs):
        return self.scripts if attrs.get("type") == "application/json" else self.programs

    def text_in(self, tag):
        return " ".join(text for path, text in self.texts if tag in path)
