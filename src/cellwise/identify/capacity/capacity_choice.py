"""Which charge is called the capacity: the table of the tests, and every choice by name.

SOC, OCV and every parameter table refer to one capacity. The LFP paper of the two that cellwise
starts from shows how much hangs on it: the same model misses the voltage by 43 or by 167 mV.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress, groupby

import numpy as np

from cellwise.errors import InputError
from cellwise.fit.model_error import SAME_TEMPERATURE_K
from cellwise.identify.capacity.capacity_test import CapacityTest
from cellwise.identify.identification import REFERENCE_C
from cellwise.wording import arg

# What laboratories write before C or below it, beside powers of ten (below it whole numbers); a
# measured rate within so much takes the nearest: a cell hardly ever has its nominal capacity.
USUAL, NEAR = np.outer((1.0, 10.0, 100.0), (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)), 0.1


@dataclass(frozen=True)
class CapacityRow:
    """What the tests at one rate say: means over ``n`` tests, and the spread of their totals.

    ``cc_Ah`` flowed until the limit was met, ``cv_Ah`` while it was held, ``total_Ah`` is both;
    ``spread_Ah`` is largest less smallest total; ``coulombic_efficiency`` discharged over charged.
    """

    rate: str
    cc_Ah: float
    cv_Ah: float
    total_Ah: float
    spread_Ah: float
    n: int
    coulombic_efficiency: float | None


def rate_name(rate_C: float) -> str:
    """Name of a rate as it is spoken: ``C/20``, ``C/3``, ``1C``, ``2C``.

    A measured rate takes the nearest usual name within a tenth, because cells hardly ever have
    their nominal capacity; else its own value, two digits.
    """
    over = rate_C if rate_C >= 1.0 else 1.0 / rate_C
    usual = USUAL if rate_C >= 1.0 else USUAL[np.floor(USUAL) == USUAL]
    value = float(usual.flat[np.argmin(np.abs(np.log(usual / over)))])
    said = f"{value:g}" if abs(np.log(over / value)) <= NEAR else _two_digits(over)
    return f"{said}C" if rate_C >= 1.0 or said == "1" else f"C/{said}"


def _two_digits(value: float) -> str:
    """Two significant digits, never with an exponent: 7.1, 65, 130."""
    return f"{float(f'{value:.2g}'):.12g}"


def parse_rate(name: str) -> float:
    """Rate in 1/h from any way to write it: ``C/2``, ``0.5C``, ``C``, ``2C``, ``1.5 C``.

    Raises
    ------
    InputError        not a rate
    """
    text = name.strip().upper().replace(" ", "")
    fraction = re.fullmatch(r"1?C/(\d+(?:\.\d+)?)", text)
    multiple = re.fullmatch(r"(\d+(?:\.\d+)?)?C", text)
    if fraction and float(fraction[1]) > 0.0:
        return 1.0 / float(fraction[1])
    if multiple and float(multiple[1] or 1.0) > 0.0:
        return float(multiple[1] or 1.0)
    raise InputError(f"the rate '{name}'", "a rate such as C/20, C/3, 0.5C or 2C", "Correct it.")


def usable_tests(
    tests: Iterable[CapacityTest], *, temperature_C: float = REFERENCE_C
) -> tuple[CapacityTest, ...]:
    """The complete tests at one temperature; none where none is complete.

    Parameters
    ----------
    tests : of CapacityTest
    temperature_C : float        of the model; the tests nearest to it are taken. Tests of
                                 unknown temperature count as being at it.
    """
    whole = [t for t in tests if t.complete]
    steady = [t for t in whole if not t.cooled] or whole
    at = [temperature_C if t.temperature_C is None else t.temperature_C for t in steady]
    nearest = min(at, key=lambda one: abs(one - temperature_C), default=temperature_C)
    near = [abs(one - nearest) <= SAME_TEMPERATURE_K for one in at]
    return tuple(compress(steady, near))


def capacity_table(tests: Iterable[CapacityTest]) -> tuple[CapacityRow, ...]:
    """Means per rate over the complete tests, from slow to fast: the LFP paper's table.

    Give it :func:`usable_tests` where several temperatures are mixed.
    """
    whole = sorted((t for t in tests if t.complete), key=lambda t: t.rate_C)
    rows = []
    for rate, group in groupby(whole, lambda t: rate_name(t.rate_C)):
        alike = list(group)
        totals = [t.total_Ah for t in alike]
        efficiencies = [e for t in alike if (e := t.coulombic_efficiency) is not None]
        row = CapacityRow(
            rate=rate,
            cc_Ah=float(np.mean([t.cc_Ah for t in alike])),
            cv_Ah=float(np.mean([t.cv_Ah for t in alike])),
            total_Ah=float(np.mean(totals)),
            spread_Ah=max(totals) - min(totals),
            n=len(alike),
            coulombic_efficiency=float(np.mean(efficiencies)) if efficiencies else None,
        )
        rows.append(row)
    return tuple(rows)


def format_capacity_table(rows: Sequence[CapacityRow]) -> str:
    """The table as text: rate, total, CC part, CV part, number, spread, coulombic efficiency."""
    lines = ["rate    total Ah  CC part  CV part  tests  spread Ah  efficiency"]
    for r in rows:
        efficiency = "" if r.coulombic_efficiency is None else f"{r.coulombic_efficiency:10.4f}"
        lines.append(
            f"{r.rate:<6} {r.total_Ah:9.3f} {r.cc_Ah:8.3f} {r.cv_Ah:8.3f} {r.n:6d}"
            f" {r.spread_Ah:10.3f}  {efficiency}".rstrip()
        )
    return "\n".join(lines)


def capacity_choices(
    tests: Iterable[CapacityTest] = (),
    nominal_Ah: float | None = None,
    hppc_total_Ah: float | None = None,
    *,
    temperature_C: float = REFERENCE_C,
) -> dict[str, float]:
    """Every capacity that the data offer, by the name of the choice [Ah].

    ``nominal``; ``hppc-total``; ``cc-average`` and ``cc-cv-average``, means over the rates of the
    CC part and of the total; ``rate:C/20`` and so on, the total at one rate.

    Parameters
    ----------
    tests : of CapacityTest        as measured; incomplete ones and other temperatures drop out
    nominal_Ah, hppc_total_Ah : float or None
    temperature_C : float          of the model

    Raises
    ------
    InputError        neither a complete test nor another capacity is given
    """
    choices: dict[str, float] = {}
    if nominal_Ah is not None:
        choices["nominal"] = float(nominal_Ah)
    rows = capacity_table(usable_tests(tests, temperature_C=temperature_C))
    if rows:
        choices["cc-average"] = float(np.mean([r.cc_Ah for r in rows]))
        choices["cc-cv-average"] = float(np.mean([r.total_Ah for r in rows]))
        choices |= {f"rate:{r.rate}": r.total_Ah for r in rows}
    if hppc_total_Ah is not None:
        choices["hppc-total"] = float(hppc_total_Ah)
    if not choices:
        raise InputError(
            "nothing that says how large the cell is: no complete capacity test, HPPC log or "
            "nominal capacity",
            "one of them",
            "Add "
            + arg("capacity", letter="LOG")
            + ", "
            + arg("hppc", letter="LOG")
            + " or "
            + arg("nominal_Ah", letter="X")
            + ".",
        )
    return choices


def default_choice(choices: Mapping[str, float]) -> str:
    """Name of the capacity taken by default.

    The slowest complete discharge: what a slow current takes out is nearest to the charge between
    full and empty, which is what SOC means and what the OCV spans. Without a capacity test the
    charge of the whole HPPC test; without that the nominal value.
    """
    rates = [name for name in choices if name.startswith("rate:")]
    if rates:
        return min(rates, key=lambda name: parse_rate(name.removeprefix("rate:")))
    return next(name for name in ("hppc-total", "nominal", *choices) if name in choices)


def choose_capacity(choices: Mapping[str, float], name: str | None = None) -> tuple[str, float]:
    """One of the choices: its name as in ``choices``, and the capacity [Ah].

    ``rate:0.5C`` and ``rate:C/2`` are the same. None takes :func:`default_choice`.

    Raises
    ------
    InputError        there is no such choice; the message lists those there are
    """
    wanted = default_choice(choices) if name is None else name.strip()
    if wanted in choices:
        return wanted, choices[wanted]
    if wanted.startswith("rate:"):
        rate = parse_rate(wanted.removeprefix("rate:"))
        for key in (k for k in choices if k.startswith("rate:")):
            if abs(rate / parse_rate(key.removeprefix("rate:")) - 1.0) <= 0.01:
                return key, choices[key]
    there = ", ".join(f"{key} ({value:.3f} Ah)" for key, value in choices.items())
    raise InputError(
        f"the capacity choice '{name}'",
        f"one of: {there}",
        "Choose one of these, or add the test that measures it.",
    )
