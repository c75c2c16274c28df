"""Numbers in words: digits, units, minus signs."""

from __future__ import annotations

import pytest

from cellwise.report.page import numerals as n

NAN = float("nan")
SAID = {
    n.significant: {
        123456.7: "123000", 1234.5: "1230", 3.0: "3", 2.9973: "3.00", -0.01234: "−0.0123",
        1e-7: "1.00e−07", 0.0: "0", NAN: "–", None: "–", 9.999: "10.0",
    },
    n.millivolt: {0.0089: "8.9 mV", 0.1234: "123 mV", -0.00047: "−0.47 mV", float("inf"): "–"},
    n.percent: {0.0026: "0.26 %", 0.123: "12.3 %", 1.0: "100 %", None: "–"},
    n.points: {0.997: "99.7 %", 0.7: "70 %"},
    n.celsius: {-10.0: "−10 °C"},
    n.counted: {1234567: "1 234 567"},
    n.duration: {0.5: "0.50 s", 12.0: "12 s", 230.0: "230 s", 299.9: "5 min", 4500.0: "75 min",
                 16_000.0: "4.4 h", None: "–"},
    n.ohm_unit: {5e-5: (1e6, "µΩ"), 0.02: (1e3, "mΩ"), 3.0: (1.0, "Ω")},
    n.time_unit: {7201.0: (3600.0, "h")},
    n.listed: {("a",): "a", ("a", "b", "c"): "a, b and c"},
}  # fmt: skip
SEVERAL = {
    n.duration_between: {
        (287.0, 30.0, 390.0): "4.8 min (0.5 to 6.5)", (5.0, 0.0, 100.0): "5 s (0 to 100)",
        (5.0, 5.0, NAN): "5 s",
    },
    n.plural: {(1, "log"): "1 log", (2, "log"): "2 logs"},
    n.ampere_hours: {(0.08, 2.98): "0.080 Ah"},
}  # fmt: skip
CASES = [(say, (value,), said) for say, known in SAID.items() for value, said in known.items()]
CASES += [(say, values, said) for say, known in SEVERAL.items() for values, said in known.items()]


def plain(said):
    spaces = str.maketrans("\N{NO-BREAK SPACE}\N{NARROW NO-BREAK SPACE}", "  ")
    return said.translate(spaces) if isinstance(said, str) else said


@pytest.mark.parametrize(("say", "values", "said"), CASES)
def test_numbers_are_printed_to_what_their_deviation_shows(say, values, said):
    assert plain(say(*values)) == said
