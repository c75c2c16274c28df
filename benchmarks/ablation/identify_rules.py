"""Every rule of the identification that decides something, and what is set so that it is off."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

IDENTIFY = "cellwise.identify"
PLATEAUS, PHASES = f"{IDENTIFY}.hppc.plateaus", f"{IDENTIFY}.hppc.phases"
PULSES, QUALITY = f"{IDENTIFY}.hppc.pulses", f"{IDENTIFY}.hppc.pulse_quality"
MISFIT, WINDOW = f"{IDENTIFY}.hppc.passive_misfit", f"{IDENTIFY}.pulse_fit.pulse_window"
DATA, FIT = f"{IDENTIFY}.pulse_fit.pulse_data", f"{IDENTIFY}.pulse_fit.fit_pulse"
VARPRO = f"{IDENTIFY}.pulse_fit.variable_projection.varpro"
CURVE, RESTS, LOW = (f"{IDENTIFY}.ocv.{m}" for m in ("curve", "ocv_rests", "ocv_lowrate"))
SPLINE, POINTS = f"{IDENTIFY}.ocv.ocv_spline", f"{IDENTIFY}.ocv.ocv_points"
TESTED, HALVES = f"{IDENTIFY}.capacity.capacity_test", f"{IDENTIFY}.capacity.half_cycles"
CHOICE, OF_HPPC = f"{IDENTIFY}.capacity.capacity_choice", f"{IDENTIFY}.capacity.hppc_capacity"
PIPELINE, BY_TEMPERATURE = f"{IDENTIFY}.pipeline", f"{IDENTIFY}.by_temperature"


class Rule(NamedTuple):
    """A name, what is set, and whether it acts only after the joint fit has begun."""

    name: str
    names: tuple[tuple[str, str, Any], ...]
    late: bool = False


def _first(x: Any, *_: Any, **__: Any) -> Any:
    return x


def _second(_: Any, x: Any, *__: Any) -> Any:
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
    from cellwise.identify.hppc.pulse_quality import _commonest

    kind = np.array([f"{x.role} {x.current_A > 0.0}" for x in loads])
    return np.array([_commonest(durations[kind == k]) for k in kind])


def _plain_mean(discharge_V: Any, charge_V: Any) -> Any:
    return np.nanmean([discharge_V, charge_V], axis=0)


def _by_gap(phases: Any) -> float:
    from cellwise.identify.hppc.pulses import _widest_gap

    return _widest_gap(np.sort([p.duration_s for p in phases if p.kind == "cc"]))


def _by_segments(pulses: Any, _: Any) -> Any:
    from cellwise.identify.pulse_fit.fit_pulse import fit_pulses

    return fit_pulses(pulses, "segments")


def _as_it_ends(t: Any, v: Any) -> Any:
    from cellwise.identify.ocv.ocv_rests import _Relaxed

    return _Relaxed(float(v[-1]), 0.0)


RULES = (
    Rule("nothing", ()),
    Rule("levels noisier than the log", ((PLATEAUS, "_level_noise", _one_noise),)),
    Rule("smoothed where noisy", ((PLATEAUS, "MAX_SMOOTHING_ROWS", 1),)),
    Rule("last row of a drift", ((PLATEAUS, "_drifted", _second),)),
    Rule("neighbours of one level joined", ((PLATEAUS, "_merge_level", _first),)),
    Rule("flat ends of a drift", ((PLATEAUS, "_flat_head", lambda *_: 0),)),
    Rule("resolution", ((PLATEAUS, "_resolution", lambda *_: 0.0),)),
    Rule("white noise only", ((PLATEAUS, "WHITE_GROWTH", np.inf),)),
    Rule("rises", ((PHASES, "without_ramps", _first),)),
    Rule("single rows that are felt", ((PHASES, "_with_spikes", _first),)),
    Rule("constant voltage joined", ((PHASES, "_join_cv", _first),)),
    Rule("drives joined", ((PHASES, "_join_dynamic", _first),)),
    Rule("slow single rows", ((PHASES, "SLOW_ROW_S", np.inf),)),
    Rule("plan per rate", ((QUALITY, "_expected", _planned),)),
    Rule("siblings' misfit", ((QUALITY, "ABOVE_SIBLINGS", 0.0),)),
    Rule("distorted", ((QUALITY, "_border", lambda *_: np.inf),)),
    Rule("spurious", ((QUALITY, "_spurious", _none),)),
    Rule("trimmed", ((QUALITY, "_trimmed", _none),)),
    Rule("way back is a pulse", ((PULSES, "_giving_back_are_pulses", lambda x, _: tuple(x)),)),
    Rule("border of moves", ((PULSES, "_role_border", lambda _: 600.0),)),
    Rule("border by plans", ((PULSES, "_role_border", _by_gap),)),
    Rule("pulses of a drive", ((PULSES, "DRIVE_SHARE", np.inf),)),
    Rule("smallest pulse", ((PULSES, "SMALLEST_OF_RANGE", 0.0),)),
    Rule("level without its rise", ((PULSES, "_level", lambda x: float(np.median(x))),)),
    Rule("moves as pulses", ((PULSES, "MANY_MOVES", 10**9),)),
    Rule("edges of a misfit", ((MISFIT, "SETTLING_ROWS", 0), (MISFIT, "EDGE_SIGMAS", 0.0))),
    Rule("switch by the counter", ((PIPELINE, "with_switch_current", _first),)),
    Rule("settling rows", ((DATA, "EDGE_PART", np.inf),)),
    Rule("balanced rows", ((DATA, "BALANCE_LIMITS", (1.0, 1.0)),)),
    Rule("minutes of a move", ((WINDOW, "STEP_SHOWN_S", np.inf),)),
    Rule("trend", ((FIT, "local_trends", lambda fits: [None] * len(fits)),)),
    Rule("bends", ((VARPRO, "_with_bends", lambda _, __, x, ___: x),)),
    Rule("held at the start", ((VARPRO, "_with_initial", lambda _, __, x, ___, ____: x),)),
    Rule("errors along the valley", ((VARPRO, "profile_errors", lambda *x: x[-1]),)),
    Rule("rows thinned", ((VARPRO, "thinned", _first),)),
    Rule(
        "variable projection",
        ((PIPELINE, "fit_pulses", _by_segments),),
    ),
    Rule("stretch of the low rate", ((CURVE, "_choose_correction", lambda *_: (1.0, 1.0)),)),
    Rule("stiffness chosen", ((CURVE, "_stiffness", lambda *_: 1.0),)),
    Rule("rests weighed by slope", ((CURVE, "_weights", lambda r: r.points_weight),)),
    Rule("one cell", ((PIPELINE, "sample_notice", _none),)),
    Rule("unrelaxed rests", ((RESTS, "UNRELAXED_V", np.inf),)),
    Rule("short rests", ((RESTS, "MIN_REST_S", 0.0),)),
    Rule("relaxation extrapolated", ((RESTS, "_relaxation", _as_it_ends),)),
    Rule("climbs short of full", ((RESTS, "_climbs_short_of_full", _no),)),
    Rule("smoothing chosen", ((SPLINE, "CLEAR_GAIN", 0.0),)),
    Rule("points condensed", ((POINTS, "MAX_POINTS", 10**9),)),
    Rule("steeper to empty", ((SPLINE, "beyond_ends", lambda *_: (np.zeros(0), np.zeros(0))),)),
    Rule("mean by soundness", ((LOW, "_mean_of_branches", _plain_mean),)),
    Rule("filled to", ((LOW, "_filled_to", lambda *_: 1.0),)),
    Rule("whole by charge", ((LOW, "NEARLY_ALL", np.inf),)),
    Rule(
        "current offset",
        ((BY_TEMPERATURE, "without_current_offset", lambda logs, *_, **__: (tuple(logs), ())),),
    ),
    Rule("HPPC reaches empty", ((OF_HPPC, "hppc_reaches_empty", _no),)),
    Rule("looks like an end", ((TESTED, "looks_like_end", _yes), (LOW, "looks_like_end", _yes))),
    Rule("full at the start", ((TESTED, "_full_at_start", lambda *_: ("assumed", [])),)),
    Rule("capacity test", ((TESTED, "_is_capacity_test", lambda _, h: h.charge_Ah > 0.0),)),
    Rule("settled end", ((TESTED, "settled_end", lambda _, h, k: h[k].stop - 1),
                         (LOW, "settled_end", lambda _, h, k: h[k].stop - 1))),
    Rule("nearest temperature", ((CHOICE, "SAME_TEMPERATURE_C", np.inf),)),
    Rule("charge runs that count", ((HALVES, "RUN_OF_CHARGE", 0.0),)),
)  # fmt: skip
