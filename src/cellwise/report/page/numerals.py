"""Numbers as people say them: three digits, the unit that fits, a true minus sign."""

from __future__ import annotations

import math

NONE = "–"
SPACE = "\N{NO-BREAK SPACE}"


def significant(value: float | None, digits: int = 3) -> str:
    """A number with so many digits, without an exponent where that can be avoided.

    A whole number has no zeros after its point.
    """
    if value is None or not math.isfinite(value):
        return NONE
    if value == 0.0:
        return "0"
    # The power of ten after rounding: 9.999 has two digits before its point then.
    power = int(f"{value:.{digits - 1}e}".split("e")[1])
    if not -4 <= power <= 6:
        return _minus(f"{value:.{digits - 1}e}")
    rounded = round(value, digits - 1 - power)
    if rounded == int(rounded) and abs(value - rounded) < 1e-9 * abs(value):
        return _minus(f"{rounded:.0f}")
    return _minus(f"{rounded:.{max(digits - 1 - power, 0)}f}")


def banded(value: float, std: float) -> str:
    """A value and two deviations: ``3.124 ± 0.021``."""
    if not math.isfinite(value):
        return NONE
    return f"{significant(value, 4)} ± {significant(2.0 * std, 2)}"


def millivolt(volt: float | None) -> str:
    """A voltage error as ``8.9 mV``."""
    if volt is None or not math.isfinite(volt):
        return NONE
    size = abs(1e3 * volt)
    return _minus(f"{1e3 * volt:.{0 if size >= 99.95 else 1 if size >= 0.95 else 2}f}{SPACE}mV")


def percent(share: float | None, digits: int = 2) -> str:
    """A share as ``0.26 %``: so many digits after the point, one less from ten on."""
    if share is None or not math.isfinite(share):
        return NONE
    size = abs(100.0 * share)
    places = max(digits - (1 if size >= 9.995 else 0) - (1 if size >= 99.95 else 0), 0)
    return _minus(f"{100.0 * share:.{places}f}{SPACE}%")


def points(share: float) -> str:
    """A SOC as whole per cent where it is one: ``70 %``, ``99.7 %``."""
    return _minus(f"{round(100.0 * share, 1):g}{SPACE}%")


def ampere_hours(charge_Ah: float | None, like_Ah: float | None = None) -> str:
    """A charge with four digits, or with the digits after the point that another one has."""
    if charge_Ah is None or not math.isfinite(charge_Ah):
        return NONE
    if like_Ah is None or like_Ah <= 0.0:
        return f"{significant(charge_Ah, 4)}{SPACE}Ah"
    places = max(3 - math.floor(math.log10(like_Ah)), 0)
    return _minus(f"{charge_Ah:.{places}f}{SPACE}Ah")


def duration(seconds: float | None) -> str:
    """A time in seconds, minutes or hours, whichever says it in few digits."""
    if seconds is None or not math.isfinite(seconds):
        return NONE
    if seconds < 294.5:
        return f"{significant(seconds, 2) if seconds < 9.95 else f'{seconds:.0f}'}{SPACE}s"
    if seconds < 7170.0:
        minutes = seconds / 60.0
        return f"{round(minutes, 1 if minutes < 9.95 else None):g}{SPACE}min"
    return f"{significant(seconds / 3600.0, 2 if seconds < 36e4 else 3)}{SPACE}h"


def duration_between(value_s: float, low_s: float, high_s: float) -> str:
    """A time and its band in the unit that fits the band's upper end: ``4.8 min (0.5 to 6.5)``."""
    if not (math.isfinite(low_s) and math.isfinite(high_s)):
        return duration(value_s)
    scale, unit = time_unit(high_s)
    shown = significant(value_s / scale, 2)
    return f"{shown}{SPACE}{unit} ({spanned(low_s / scale, high_s / scale, 2)})"


def spanned(low: float, high: float, digits: int = 3) -> str:
    """Two numbers as ``0.1 to 6.7``: so many digits of the larger one, the other no finer."""
    larger = max(abs(low), abs(high))
    power = math.floor(math.log10(larger)) if 0.0 < larger < math.inf else 0
    places = max(digits - 1 - power, 0)
    return _minus(f"{round(low, places):g} to {round(high, places):g}")


def celsius(temperature_C: float) -> str:
    """A temperature as ``−10 °C``."""
    return _minus(f"{round(temperature_C, 1):g}{SPACE}°C")


def time_unit(seconds: float) -> tuple[float, str]:
    """Divisor and name of the unit for a time axis of this length."""
    if seconds < 300.0:
        return 1.0, "s"
    if seconds < 7200.0:
        return 60.0, "min"
    return 3600.0, "h"


def ohm_unit(typical_ohm: float) -> tuple[float, str]:
    """Factor and name of the unit that suits a resistance."""
    if typical_ohm < 1e-4:
        return 1e6, "µΩ"
    return (1e3, "mΩ") if typical_ohm < 1.0 else (1.0, "Ω")


def counted(count: int) -> str:
    """A large number with its thousands apart."""
    return f"{count:,}".replace(",", "\N{NARROW NO-BREAK SPACE}")


def plural(count: int, one: str) -> str:
    """``1 log``, ``3 logs``."""
    return f"{count}{SPACE}{one if count == 1 else one + 's'}"


def spoken_name(name: str) -> str:
    """A name of the contract, of a cause or an effect, for people."""
    return name.replace("_", " ").replace("ocv", "OCV").replace("soc", "SOC")


def listed(words: list[str]) -> str:
    """Items as text lists them: ``a, b and c``."""
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} and {words[-1]}"


def capitalised(text: str) -> str:
    """The first letter large, the others as they are."""
    return text[:1].upper() + text[1:]


def _minus(text: str) -> str:
    return text.replace("-", "−")
