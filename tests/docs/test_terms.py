"""Terms of the field: words that were retired do not come back in the package, docs and README.

To extend it: add a row to `RETIRED`.
"""

from __future__ import annotations

import re

from doc_blocks import DOCS, REPOSITORY

PACKAGE = REPOSITORY / "src" / "cellwise"
# What is not to be said, as a pattern without regard to case, and the term to use.
RETIRED = {
    r"foret(ell|old)": "predict",
    r"\b(un)?(taught|teach)|\blearn": "calibrate on a baseline, estimate",
    r"(?<![a-z])(told|tells?|telling)(?![a-z])": "detect, determine, state, report",
    r"\bmend(s|ed|ing)?\b": "correct, extend",
    r"(?<![a-z_])anew\b": "again, re-initialise",
    r"\bhonest": "consistent",
    r"\bleaks?\b": "self-discharge current",
    r"\bset free\b|\bfree(s|d) (no|its|the|a) ": "estimate, widen the prior",
    r"\bcontest": "model comparison",
    r"\bpeers?\b": "reference implementation",
    r"instrument('s)? skew|\bthe skew\b": "sampling delay",
    r"what is left": "remaining time and energy, residual",
    r"\brivals?\b": "alternative, candidate",
    r"\bforeign": "outside the model's temperatures, of another kind",
    r"\bdoubt": "uncertain",
    r"\bowns? up": "state",
    r"\bblam": "attribute, diagnose",
    r"yardstick": "reference",
    r"\bstart soc\b": "initial SOC",
    r"\blasting\b|error that stays": "persistent (model error)",
    r"sentence": "text, line, statement",
    r"thinkable": "possible",
    r"turned round": "inverted",
    r"\bjudge?ment": "decision, outcome",
}
# Names that other programs rely on, and calls of other libraries.
KEPT = ("leak_A", "AdaptiveSettings(learn", "file.tell()", "leak=", "leak: int", '"leak"', "LEAK")
KEPT += ("self.learn", "`learn`", "learn: tuple", "learn : tuple", '"lasting": ')
FILES = [
    *sorted(PACKAGE.rglob("*.py")),
    *sorted(PACKAGE.rglob("*.toml")),
    *sorted(DOCS.rglob("*.md")),
    REPOSITORY / "README.md",
]
CODE = re.compile(r"^```.*?^```\s*?$|`[^`\n]*`", re.S | re.M)


def text_of(path):
    """A module as it stands; of a page the prose, since code has names of its own."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        text = CODE.sub(lambda code: "\n" * code[0].count("\n"), text)
    for name in KEPT:
        text = text.replace(name, "")
    return text


def test_no_retired_term():
    found = [
        f"{path}:{text[: hit.start()].count(chr(10)) + 1}: '{hit[0]}', say {instead}"
        for path, text in ((path, text_of(path)) for path in FILES)
        for pattern, instead in RETIRED.items()
        for hit in re.finditer(pattern, text, re.IGNORECASE)
    ]
    assert not found, "\n".join(found)


def test_a_retired_term_is_found():
    assert all(
        any(re.search(pattern, text, re.IGNORECASE) for pattern in RETIRED)
        for text in ("It FORETELLS the voltage.", "value = told_by(x)", "The start SOC.")
    )
    assert not any(re.search(p, "metal, retell, learner_of"[:5], re.IGNORECASE) for p in RETIRED)
