"""Loops over the states, written out: what numba compiles and what C is printed from."""

from __future__ import annotations

import ast
import textwrap

import pytest

from cellwise.cell.description import BRANCHES, CELL, SOC, V3, H, triangle
from cellwise.cell.unrolled import THERE, write_out

SCOPE = {"BRANCHES": BRANCHES, "CELL": CELL, "SOC": SOC, "V3": V3, "H": H, "triangle": triangle}


def written(body, by_option=False):
    """The sentences that a body becomes."""
    text = f"def f(p, x, d, t, w):\n{textwrap.indent(body, '    ')}"
    made = write_out(ast.parse(text).body[0], SCOPE | {"THERE": THERE}, by_option)
    return [ast.unparse(s) for s in made.body]


@pytest.mark.parametrize(
    ("body", "sentences"),
    [
        (
            "k = {}\nfor i in (SOC, V3, H):\n    k[i] = d.row[i] * t.a[i] + x.state[i]",
            ["ks = d.s * 1.0 + x.soc", "k3 = d.v3 * t.a3 + x.v3_V", "kh = d.h * t.ah + x.h"],
        ),
        (
            "for i, j in triangle((SOC, V3)):\n"
            "    if i != j:\n        x.p[j, i] = p[i, j]\n"
            "    else:\n        x.p[i, j] = 0",
            ["x.ss = 0", "x.s3 = p.s3", "x.p33 = 0"],
        ),
        (
            "f(*(w[i] if i in BRANCHES else 0 for i in CELL), sum(x.r[j] for j in BRANCHES[1:]))",
            ["f(0, w1, w2, w3, 0, x.r2_ohm + x.r3_ohm)"],
        ),
        (
            "r = {}\nfor i in BRANCHES[1:]:\n    r[i] *= t.tau[i]\n"
            "    if i.option:\n        if p.r[i] != 0.0:\n            r[i] = d.d[i]",
            [
                "r2_ohm *= t.tau2_s",
                "r3_ohm *= t.tau3_s",
                "if p.r3_ohm != 0.0:\n    r3_ohm = d.d3_V",
            ],
        ),
        (
            "for k in range(3):\n    for i in (V3,):\n        p[k] = x.carry[i]",
            ["for k in range(3):\n    p[k] = x.v3_carry_V"],
        ),
    ],
)
def test_a_loop_over_states_is_a_sentence_for_each(body, sentences):
    assert written(body) == sentences


def test_a_sentence_stands_under_the_options_of_its_states_once():
    assert written(
        "for i in (SOC, V3):\n"
        "    c[i] = x.state[i] if THERE else ZERO\n"
        "    if x.soc > ZERO:\n        for j in (V3, H):\n            x.p[i, j] = c[i]",
        by_option=True,
    ) == [
        "cs = x.soc",
        "if x.soc > ZERO:\n    if SLOW:\n        x.s3 = cs\n    if HYSTERESIS:\n        x.sh = cs",
        "c3 = x.v3_V if SLOW else ZERO",
        "if SLOW:\n    if x.soc > ZERO:\n        x.p33 = c3\n        if HYSTERESIS:\n"
        "            x.p3h = c3",
    ]
