"""A free-running clock that wraps, as time steps and sequence numbers."""

from __future__ import annotations

import shutil

import pytest

from firmware_cases import compile_and_run, tables_of

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")

PROGRAM = """
#include <stdio.h>
#include "cellwise_cell.h"
#include "cellwise_clock.h"
#define CHECK(c) do { if (!(c)) { printf("line %d: %s\\n", __LINE__, #c); return 1; } } while (0)
int main(void)
{
    static const uint32_t begins[] = {0u, 400u, 0xFFFFFFF0u, 0xFFFFFC18u, 0x7FFFFFFFu};
    for (uint32_t b = 0u; b < sizeof begins / sizeof begins[0]; b++) {
        cellwise_clock clock;
        uint32_t random = 1u;
        cellwise_clock_begin(&clock, begins[b], 1000u);
        CHECK(clock.sequence == 0u);
        for (uint32_t k = 1u; k < 5000u; k++) { /* each call up to 499 ticks early or late */
            random = (1664525u * random) + 1013904223u;
            const uint32_t jitter = (random >> 8u) % 999u;
            CHECK(cellwise_clock_steps(&clock, begins[b] + (1000u * k) + jitter - 499u) == 1u);
            CHECK(clock.sequence == k);
            CHECK(cellwise_clock_steps(&clock, begins[b] + (1000u * k) + 499u) == 0u);
        }
        CHECK(cellwise_clock_steps(&clock, begins[b] + 5002400u) == 3u); /* two samples missing */
        CHECK(clock.sequence == 5002u);
        CHECK(cellwise_clock_steps(&clock, begins[b] + 5002000u + 4000000000u) == 4000000u);
    }
    /* Polled at odd times through four wraps of the clock: no tick is lost. */
    cellwise_clock clock;
    uint64_t now = 0xFFFF0000u;
    const uint64_t begun = now;
    cellwise_clock_begin(&clock, (uint32_t)now, 32768u);
    while (now < 0x500000000u) {
        now += 1234567u;
        (void)cellwise_clock_steps(&clock, (uint32_t)now);
        CHECK(clock.sequence == (uint32_t)((now - begun + 16384u) / 32768u));
    }
    cellwise_clock_begin(&clock, 5u, 0u); /* no period: one tick, and no division by zero */
    CHECK(cellwise_clock_steps(&clock, 7u) == 2u);
    return 0;
}
"""


def test_no_step_is_lost_or_counted_twice_where_the_clock_wraps(tmp_path):
    """CW-016."""
    compile_and_run(tables_of("lean"), tmp_path, PROGRAM)
