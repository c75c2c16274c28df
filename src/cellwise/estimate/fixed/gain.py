"""What a gain of the fixed step is worth: judged by the slope where it leads."""

from __future__ import annotations

from cellwise.estimate.fixed.arithmetic import (
    LARGE,
    SMALL_MOVE,
    TWO,
    Flag,
    Float,
    State,
    apart,
    magnitude,
    size_within,
)
from cellwise.estimate.fixed.covariance import Column, rejudge_covariance, rejudged
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.lookup import Place, Point, Slopes, look_up, slopes_of


@apart
def rejudge(
    m: Model,
    place: Place,
    x: State,
    p: Point,
    w: Slopes,
    d: Column,
    inverse: Float,
    innovation: Float,
    seen: Float,
) -> Flag:
    """Judge the gain by the slope where it leads, if that is flatter; whether anything was learnt.

    The gain itself was that of the slope here: on a plateau nothing is learnt, and the covariance
    stays as it is.
    """
    ks = d.s * inverse
    move = ks * innovation
    flat = p.slope_V if p.slope_V < w.slope_V else w.slope_V
    if magnitude(move) > (SMALL_MOVE * w.spread):
        landed = look_up(m, place, x.soc + move, seen)
        there = slopes_of(m, place, x.soc + move, w.spread, seen, landed)
        flat = there.slope_V if there.slope_V < landed.slope_V else landed.slope_V
        flat = flat if flat < w.slope_V else w.slope_V
    less = flat - w.slope_V
    e = less * ((TWO * d.s) + (less * x.ss))
    wider = rejudged(ks, ks, less * x.ss, less * x.ss, e)
    learnt = False
    if size_within(wider, LARGE) and wider < (ks * d.s):
        learnt = True
        rejudge_covariance(x, d, inverse, less, e, wider)
    return learnt
