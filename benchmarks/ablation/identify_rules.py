"""Every rule of the identification that decides something, and what is set so that it is off."""

from __future__ import annotations

from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from cellwise.identify.capacity import half_cycles
from cellwise.identify.hppc import pulse_quality, pulses
from cellwise.identify.ocv import curve, ocv_rests
from cellwise.identify.pulse_fit import pulse_data

IDENTIFY = "cellwise.identify"
PHASES = f"{IDENTIFY}.hppc.phases"
PULSES, QUALITY = f"{IDENTIFY}.hppc.pulses", f"{IDENTIFY}.hppc.pulse_quality"
RESTS = f"{IDENTIFY}.ocv.ocv_rests"
TESTED = f"{IDENTIFY}.capacity.capacity_test"
CHOICE = f"{IDENTIFY}.capacity.capacity_choice"
MEASURED_CAPACITY, MEASURED_OCV = f"{IDENTIFY}.measured_capacity", f"{IDENTIFY}.measured_ocv"


class Rule(NamedTuple):
    """A name, what is set, and whether it acts only after the joint fit has begun."""

    name: str
    names: tuple[tuple[str, str, Any], ...]
    late: bool = False


def _first(x: Any, *_: Any, **__: Any) -> Any:
    return x


def _none(*_: Any, **__: Any) -> None:
    return None


def _no(*_: Any, **__: Any) -> bool:
    return False


def _yes(*_: Any, **__: Any) -> bool:
    return True


def _planned(_: Any, pulses: Any) -> Any:
    from cellwise.identify.hppc.pulse_quality import _commonest

    kind = np.array([f"{p.role} {p.sign}" for p in pulses])
    duration = np.array([p.duration_s for p in pulses])
    return np.array([_commonest(duration[kind == k]) for k in kind])


def _by_gap(phases: Any) -> float:
    from cellwise.identify.hppc.pulses import _widest_gap

    return _widest_gap(np.sort([p.duration_s for p in phases if p.kind == "cc"]))


def _by_segments(data: Any, *_: Any) -> Any:
    from cellwise.identify.pulse_fit.fit_pulse import fit_pulse

    return fit_pulse(data, "segments")


def _record(module: ModuleType, name: str, **changes: Any) -> tuple[tuple[str, str, Any], ...]:
    """A record of thresholds with some of them changed."""
    return ((module.__name__, name, getattr(module, name)._replace(**changes)),)


RULES = (
    Rule("nothing", ()),
    Rule("constant voltage joined", ((PHASES, "_join_cv", _first),)),
    Rule("drives joined", ((PHASES, "_join_dynamic", _first),)),
    Rule("plan per rate", ((QUALITY, "_planned_s", _planned),)),
    Rule("siblings' misfit", _record(pulse_quality, "LIMITS", siblings=10**9)),
    Rule("distorted", ((QUALITY, "_border", lambda *_: np.inf),)),
    Rule("spurious", ((QUALITY, "_spurious", _none),)),
    Rule("trimmed", ((QUALITY, "_trimmed", _none),)),
    Rule("way back is a pulse", ((PULSES, "_giving_back_are_pulses", lambda x: tuple(x)),)),
    Rule("border of moves", ((PULSES, "_role_border", lambda _: 600.0),)),
    Rule("border by plans", ((PULSES, "_role_border", _by_gap),)),
    Rule("pulses of a drive", _record(pulses, "KINDS", drive=np.inf)),
    Rule("smallest pulse", _record(pulses, "KINDS", smallest=0.0)),
    Rule("moves as pulses", _record(pulses, "KINDS", many_moves=10**9)),
    Rule("edges of a misfit", _record(pulse_quality, "WINDOW", settling_rows=0)),
    Rule("settling rows", _record(pulse_data, "SETTLING", edge=np.inf)),
    Rule("what was before a pulse", _record(pulse_data, "WINDOW", before_s=0.0)),
    Rule("balanced rows", _record(pulse_data, "WINDOW", balance=(1.0, 1.0))),
    Rule(
        "variable projection",
        ((f"{IDENTIFY}.identification", "fit_pulse", _by_segments),),
    ),
    Rule("one cell", ((MEASURED_OCV, "sample_notice", _none),)),
    Rule("unrelaxed rests", _record(ocv_rests, "LIMITS", unrelaxed_V=np.inf)),
    Rule("short rests", _record(ocv_rests, "LIMITS", rest_s=0.0)),
    Rule("relaxation extrapolated", ((RESTS, "_relaxed_V", lambda _, v: float(v[-1])),)),
    Rule("climbs short of full", ((RESTS, "_climbs_short_of_full", _no),)),
    Rule("points condensed", _record(curve, "POINTS", most=10**9)),
    Rule("HPPC reaches empty", ((MEASURED_CAPACITY, "hppc_reaches_empty", _no),)),
    Rule("looks like an end", ((TESTED, "_looks_like_end", _yes),)),
    Rule("full at the start", ((TESTED, "_not_full", lambda *_: ()),)),
    Rule("capacity test", ((TESTED, "_is_capacity_test", lambda _, h: h.charge_Ah > 0.0),)),
    Rule("settled end", _record(half_cycles, "LIMITS", dither=-1.0)),
    Rule("nearest temperature", ((CHOICE, "SAME_TEMPERATURE_K", np.inf),)),
    Rule("charge runs that count", _record(half_cycles, "LIMITS", run=0.0)),
)  # fmt: skip
