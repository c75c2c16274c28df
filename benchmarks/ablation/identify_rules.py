"""Every rule of the identification that decides something, and what is set so that it is off."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from cellwise.identify.hppc import pulse_quality, pulses
from cellwise.identify.ocv import ocv_lowrate, ocv_rests
from cellwise.identify.pulse_fit import pulse_window
from cellwise.identify.pulse_fit.fit_pulse import PulseFit, fit_pulses
from cellwise.identify.pulse_fit.pulse_data import PulseData

IDENTIFY = "cellwise.identify"
PLATEAUS, PHASES = f"{IDENTIFY}.hppc.plateaus", f"{IDENTIFY}.hppc.phases"
PULSES, QUALITY = pulses.__name__, pulse_quality.__name__
DATA, WINDOW = f"{IDENTIFY}.pulse_fit.pulse_data", pulse_window.__name__
VARPRO, SPLINE = f"{IDENTIFY}.pulse_fit.varpro", f"{IDENTIFY}.ocv.ocv_spline"
RESTS, LOW = ocv_rests.__name__, ocv_lowrate.__name__
TESTED = f"{IDENTIFY}.capacity.capacity_test"
CHOICE, OF_HPPC = f"{IDENTIFY}.capacity.capacity_choice", f"{IDENTIFY}.capacity.hppc_capacity"
MEASURED_OCV, BY_TEMPERATURE = f"{IDENTIFY}.measured_ocv", f"{IDENTIFY}.by_temperature"
FITTED_PULSES = f"{IDENTIFY}.fitted_pulses"


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


def _one_noise(x: Any, rest: Any, broken: Any, scale: Any) -> Any:
    return np.full(x.size, scale.noise_A)


def _planned(v: Any, loads: Any, durations: Any) -> Any:
    kind = np.array([f"{x.role} {x.current_A > 0.0}" for x in loads])
    return np.array([pulse_quality._commonest(durations[kind == k]) for k in kind])


def _plain_mean(discharge_V: Any, charge_V: Any) -> Any:
    return np.nanmean([discharge_V, charge_V], axis=0)


def _by_gap(phases: Any) -> float:
    return pulses._widest_gap(np.sort([p.duration_s for p in phases if p.kind == "cc"]))


def _by_segments(cut: Sequence[PulseData], _: Any) -> list[PulseFit]:
    return fit_pulses(cut, "segments")


def _as_given(logs: Any, *_: Any) -> Any:
    return tuple(logs), ()


def _own_end(_: Any, halves: Any, k: int) -> int:
    return int(halves[k].stop - 1)


def _kinds(**changes: Any) -> tuple[tuple[str, str, Any], ...]:
    return ((PULSES, "KINDS", pulses.KINDS._replace(**changes)),)


def _rests(**changes: Any) -> tuple[tuple[str, str, Any], ...]:
    return ((RESTS, "LIMITS", ocv_rests.LIMITS._replace(**changes)),)


RULES = (
    Rule("nothing", ()),
    Rule("levels noisier than the log", ((PLATEAUS, "_level_noise", _one_noise),)),
    Rule("flat ends of a drift", ((PLATEAUS, "_flat_head", lambda *_: 0),)),
    Rule("neighbours of one level joined", ((PLATEAUS, "_merge_level", _first),)),
    Rule("resolution", ((PLATEAUS, "_resolution", lambda *_: 0.0),)),
    Rule("constant voltage joined", ((PHASES, "_join_cv", _first),)),
    Rule("drives joined", ((PHASES, "_join_dynamic", _first),)),
    Rule("plan per rate", ((QUALITY, "_expected", _planned),)),
    Rule(
        "distorted", ((QUALITY, "LIMITS", pulse_quality.LIMITS._replace(distorted=np.inf)),)
    ),
    Rule("spurious", ((QUALITY, "_spurious", _none),)),
    Rule("trimmed", ((QUALITY, "_trimmed", _none),)),
    Rule("way back is a pulse", ((PULSES, "_giving_back_are_pulses", lambda x, _: tuple(x)),)),
    Rule("border of moves", ((PULSES, "_role_border", lambda _: 600.0),)),
    Rule("border by plans", ((PULSES, "_role_border", _by_gap),)),
    Rule("pulses of a drive", _kinds(drive=np.inf)),
    Rule("smallest pulse", _kinds(smallest=0.0)),
    Rule("moves as pulses", _kinds(many_moves=10**9)),
    Rule("rows that hold a switch", ((DATA, "STILL_PART", np.inf),)),
    Rule("balanced rows", ((DATA, "BALANCE_LIMITS", (1.0, 1.0)),)),
    Rule("minutes of a move", ((WINDOW, "LIMITS", pulse_window.LIMITS._replace(step_s=1e9)),)),
    Rule("held at the start", ((VARPRO, "RESTED_TAUS", 0.0),)),
    Rule("errors along the valley", ((VARPRO, "_spread", lambda *_: np.zeros(7)),)),
    Rule("variable projection", ((FITTED_PULSES, "fit_pulses", _by_segments),)),
    Rule("one cell", ((MEASURED_OCV, "sample_notice", _none),)),
    Rule("unrelaxed rests", _rests(unrelaxed_V=np.inf)),
    Rule("short rests", _rests(rest_s=0.0)),
    Rule("relaxation extrapolated", ((RESTS, "_relaxed_V", lambda _, v: float(v[-1])),)),
    Rule("climbs short of full", ((RESTS, "_climbs_short_of_full", _no),)),
    Rule("steeper to empty", ((SPLINE, "beyond_ends", lambda *_: (np.zeros(0), np.zeros(0))),)),
    Rule("mean by soundness", ((LOW, "_mean_of_branches", _plain_mean),)),
    Rule("filled to", ((LOW, "_filled_to", lambda *_: 1.0),)),
    Rule(
        "whole by charge", ((LOW, "LIMITS", ocv_lowrate.LIMITS._replace(nearly_all=np.inf)),)
    ),
    Rule("current offset", ((BY_TEMPERATURE, "without_current_offset", _as_given),)),
    Rule("HPPC reaches empty", ((OF_HPPC, "hppc_reaches_empty", _no),)),
    Rule("looks like an end", ((TESTED, "looks_like_end", _yes), (LOW, "looks_like_end", _yes))),
    Rule("full at the start", ((TESTED, "_full_at_start", lambda *_: ("assumed", [])),)),
    Rule("capacity test", ((TESTED, "_is_capacity_test", lambda _, h: h.charge_Ah > 0.0),)),
    Rule("settled end", ((TESTED, "settled_end", _own_end), (LOW, "settled_end", _own_end))),
    Rule("nearest temperature", ((CHOICE, "SAME_TEMPERATURE_C", np.inf),)),
)  # fmt: skip
