"""The figures of the hidden effects, for people."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.hidden_effects.tasks import NAMES as EFFECT_NAMES
from benchmarks.hidden_effects.tasks import Outcome

VERDICTS = (*EFFECT_NAMES, "none", "undetermined")
GOOD_PARAMETER, GOOD_SHARE = 0.2, 0.8


def print_report(outcomes: list[tuple[str, Outcome]]) -> None:
    """Each part: how many are right; for single effects the confusion matrix and what was found."""
    for part in dict.fromkeys(p for p, _ in outcomes):
        found = [o for p, o in outcomes if p == part]
        right = sum(o.right for o in found)
        seconds = np.array([o.seconds for o in found])
        print(
            f"\n{part}: {right} of {len(found)} right ({100 * right / len(found):.0f} %), "
            f"{np.median(seconds):.1f} s each, longest {seconds.max():.1f} s"
        )
        if part in ("single", "real"):
            _print_confusion(found)
            _print_quality(found)
        if part == "pairs":
            first = sum(bool(set(o.hidden) & set(o.causes)) for o in found)
            print(f"  at least one of the two named: {first} of {len(found)}")
        for outcome in found:
            if not outcome.right:
                print("  " + outcome.line())


def _print_confusion(found: list[Outcome]) -> None:
    """Rows: what was hidden; columns: the verdict, by number."""
    print("  verdicts: " + ", ".join(f"{k + 1} {name}" for k, name in enumerate(VERDICTS)))
    width = max(len(n) for n in VERDICTS)
    print(" " * (width + 4) + "".join(f"{k + 1:4d}" for k in range(len(VERDICTS))))
    for row in VERDICTS[:-1]:
        said = [o.verdict for o in found if (o.hidden[0] if o.hidden else "none") == row]
        if said:
            cells = "".join(f"{said.count(v) or '.':>4}" for v in VERDICTS)
            broken = len(said) - sum(said.count(v) for v in VERDICTS)
            cells += f"  and {broken} broken" if broken else ""
            print(f"  {row:>{width}}  {cells}")


def _print_quality(found: list[Outcome]) -> None:
    """For each effect that was named: parameter within 20 %, held-out gain at least 80 %."""
    print(f"  {'':24s}{'right':>8s}{'parameter':>22s}{'gain share':>24s}")
    for name in (*EFFECT_NAMES, "all"):
        cases = [o for o in found if o.hidden and name in (o.hidden[0], "all")]
        if not cases:
            continue
        named = [o for o in cases if o.right]
        error = np.array([o.parameter_error for o in named])
        share = np.array([o.gain_share for o in named])
        print(
            f"  {name:24s}{len(named):4d}/{len(cases):<4d}{_within(error <= GOOD_PARAMETER, error)}"
            f"{_within(share >= GOOD_SHARE, share)}"
        )


def _within(good: Any, values: Any) -> str:
    known = values[np.isfinite(values)]
    if not known.size:
        return f"{'-':>22s}"
    return f"{int(np.sum(good)):>8d} of {known.size:<3d} {np.median(known):7.3f}"


def print_limits(found: list[tuple[str, float, Any]], sizes_V: tuple[float, ...]) -> None:
    """The 90 % point of the smallest size found, and the parameter there."""
    if not found:
        return
    span = f"{1e3 * sizes_V[0]:g} to {1e3 * sizes_V[-1]:g} mV"
    print(f"\nsmallest size found in 90 % of cases, of {span}")
    for name in dict.fromkeys(n for n, _, _ in found):
        sizes = np.sort([s for n, s, _ in found if n == name])
        limit = sizes[int(np.ceil(0.9 * sizes.size)) - 1]
        print(
            f"  {name:24s} {1e3 * limit:6.1f} mV   half from {1e3 * np.median(sizes):.1f} mV"
            f"   ({sizes.size} cases: {', '.join(f'{1e3 * s:.1f}' for s in sizes)})"
        )
