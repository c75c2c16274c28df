"""The capacity choices: names of rates, the LFP paper's table, temperatures, what is refused."""

import pytest

from cellwise.errors import InputError
from cellwise.identify.capacity.capacity_choice import (
    capacity_choices,
    capacity_table,
    choose_capacity,
    default_choice,
    parse_rate,
    rate_name,
    usable_tests,
)
from cellwise.identify.capacity.capacity_test import CapacityTest, measure_capacities
from cellwise.logs import read_log
from cellwise.notices import Code, Notice


def measured(rate_C, cc_Ah, cv_Ah=0.0, **known):
    return CapacityTest(f"{rate_C:g}C", rate_C, 40.0 * rate_C, cc_Ah, cv_Ah, **known)


# The table of the LFP040AHA paper: rate, total, CC part, CV part.
LFP_PAPER = [
    ("C/2", 47.71, 46.30, 1.407),
    ("1C", 47.71, 45.78, 1.934),
    ("2C", 47.70, 45.21, 2.495),
    ("3C", 47.62, 45.41, 2.212),
]
LFP_TESTS = [measured(parse_rate(rate), cc, cv) for rate, _, cc, cv in LFP_PAPER]


def test_lfp_paper_table_and_choices():
    rows = capacity_table(LFP_TESTS)
    for row, (rate, total, cc, cv) in zip(rows, LFP_PAPER, strict=True):
        assert row.rate == rate
        assert (row.total_Ah, row.cc_Ah, row.cv_Ah) == pytest.approx((total, cc, cv), abs=6e-3)
    choices = capacity_choices(LFP_TESTS, nominal_Ah=40.0, hppc_total_Ah=50.71)
    # The four capacities that the paper compares.
    assert choices["cc-average"] == pytest.approx(45.7, abs=0.05)
    assert choices["cc-cv-average"] == pytest.approx(47.7, abs=0.05)
    assert choices["hppc-total"] == 50.71
    assert choices["nominal"] == 40.0
    assert choices["rate:2C"] == pytest.approx(47.70, abs=6e-3)


def test_average_over_rates_not_over_repeats():
    tests = [measured(1.0, 30.0), measured(1.0, 30.2), measured(1.0, 30.4), measured(2.0, 28.2)]
    (one, two) = capacity_table(tests)
    assert (one.n, two.n) == (3, 1)
    assert one.spread_Ah == pytest.approx(0.4)
    assert capacity_choices(tests)["cc-average"] == pytest.approx((30.2 + 28.2) / 2)


@pytest.mark.parametrize(
    ("rate_C", "name"),
    [
        (0.166 / 3.4, "C/20"),  # the three of the NCR18650B paper
        (0.675 / 3.4, "C/5"),
        (1.097 / 3.4, "C/3"),
        (30.6 / 33.1, "1C"),  # the Leaf cell, whose 33.1 Ah are 30.3 Ah
        (61.2 / 33.1, "2C"),
        (91.8 / 33.1, "3C"),
        (0.0767 / 2.3, "C/30"),
        (0.5, "C/2"),
        (0.7, "C/1.4"),
        (45.0, "45C"),
    ],
)
def test_rates_are_called_what_they_are_called(rate_C, name):
    assert rate_name(rate_C) == name
    assert parse_rate(name) == pytest.approx(rate_C, rel=0.12)


@pytest.mark.parametrize("text", ["", "20", "C/0", "0C", "C/x", "-1C"])
def test_what_is_no_rate_is_refused(text):
    with pytest.raises(InputError, match="rate"):
        parse_rate(text)


def test_a_capacity_is_chosen_by_its_name():
    choices = capacity_choices(LFP_TESTS, 40.0)
    assert choose_capacity(choices, "rate:0.5C") == choose_capacity(choices, "rate:C/2")
    assert choose_capacity(choices, "nominal") == ("nominal", 40.0)
    with pytest.raises(InputError, match=r"one of: nominal \(40.000 Ah\), cc-average"):
        choose_capacity(choices, "rate:C/20")
    with pytest.raises(InputError, match="one of"):
        choose_capacity(choices, "largest")


def test_default_is_the_slowest_then_hppc_then_nominal():
    assert default_choice(capacity_choices(LFP_TESTS, 40.0, 50.71)) == "rate:C/2"
    assert default_choice(capacity_choices((), 40.0, 50.71)) == "hppc-total"
    assert default_choice(capacity_choices((), 40.0)) == "nominal"
    assert choose_capacity(capacity_choices(LFP_TESTS))[0] == "rate:C/2"


def test_incomplete_tests_are_left_out():
    bad = measured(
        0.2,
        20.0,
        complete=False,
        notices=(Notice(Code.CAPACITY_TEST_INCOMPLETE, "stops at 3.100 V"),),
    )
    assert usable_tests([bad, *LFP_TESTS]) == tuple(LFP_TESTS)
    assert "stops at 3.100 V" in bad.left_out
    assert "rate:C/5" not in capacity_choices([bad, *LFP_TESTS])


def test_nothing_complete_or_nothing_at_all_is_refused():
    for tests in ((), [measured(1.0, 20.0, complete=False)]):
        with pytest.raises(InputError, match="no complete capacity test"):
            capacity_choices(tests)


def test_temperatures_are_kept_apart():
    def at(temperature_C, cc_Ah, **known):
        return measured(1.0, cc_Ah, temperature_C=temperature_C, **known)

    tests = [at(25.0, 3.0), at(28.0, 3.02), at(-10.0, 2.2), at(0.0, 2.4)]
    assert capacity_choices(tests)["rate:1C"] == pytest.approx(3.01)
    assert capacity_choices(tests, temperature_C=-12.0)["rate:1C"] == pytest.approx(2.2)
    moved = at(24.0, 2.5, cooled=True)  # while it ran: of no temperature
    assert moved not in usable_tests([*tests, moved])
    assert {t.cc_Ah for t in usable_tests(tests, temperature_C=60.0)} == {3.0, 3.02}


def test_lg_cell_at_six_temperatures(real_data):
    folder = real_data / "lg_18650hg2"
    tests = measure_capacities(
        [read_log(p) for kind in ("cap", "ocv") for p in sorted(folder.glob(f"{kind}_*"))],
        nominal_Ah=3.0,
    )
    assert len(tests) == 28
    slow, fast = [], []
    for temperature in (-20.0, -10.0, 0.0, 10.0, 25.0):
        used = usable_tests(tests, temperature_C=temperature)
        assert all(abs(t.temperature_C - temperature) < 6.0 for t in used)
        choices = capacity_choices(tests, 3.0, temperature_C=temperature)
        assert default_choice(choices) == "rate:C/20"
        assert choices["rate:C/20"] > choices["rate:C/2"] > choices["rate:2C"]
        slow.append(choices["rate:C/20"])
        fast.append(choices["rate:2C"])
    # Cold costs capacity, and far more of it at 2C.
    assert slow == sorted(slow)
    assert fast == sorted(fast)
    assert fast[0] / fast[-1] < 0.5 < 0.85 < slow[0] / slow[-1]
