"""The pages of the documentation and their fenced blocks."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
DOCS = REPOSITORY / "docs"
PAGES = tuple(sorted((*DOCS.rglob("*.md"), REPOSITORY / "README.md")))

FENCE = re.compile(r"^```(\w*)\s*$")
MARK = re.compile(r"^<!--\s*(.*?)\s*-->$")


@dataclass(frozen=True)
class Block:
    """One fenced block: its language, text, first line in the page, and the mark above it."""

    language: str
    text: str
    line: int
    mark: str

    @property
    def needs_data(self) -> bool:
        return self.mark == "needs data"

    @property
    def exit_code(self) -> int:
        """What each of the block's commands returns."""
        found = re.fullmatch(r"exits (\d+)", self.mark)
        return int(found[1]) if found else 0

    def commands(self) -> list[list[str]]:
        """Arguments of every ``$ cellwise`` line, continued lines joined."""
        joined = re.sub(r"\\\n\s*", " ", self.text)
        lines = [line.strip() for line in joined.splitlines()]
        return [shlex.split(line[2:])[1:] for line in lines if line.startswith("$ cellwise ")]


def page_blocks(page: Path) -> list[Block]:
    """Fenced blocks of a page, in order."""
    found: list[Block] = []
    language, start, mark, kept = "", 0, "", list[str]()
    inside = False
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), start=1):
        fence = FENCE.match(line)
        if fence and not inside:
            inside, language, start, kept = True, fence[1], number + 1, []
        elif fence:
            found.append(Block(language, "\n".join(kept) + "\n", start, mark))
            inside, mark = False, ""
        elif inside:
            kept.append(line)
        elif line.strip():
            said = MARK.match(line.strip())
            mark = said[1] if said else ""
    if inside:
        raise ValueError(f"{page.name}: the block from line {start} is not closed")
    return found


def prose(page: Path) -> str:
    """A page without its fenced blocks."""
    return re.sub(r"^```.*?^```\s*$", "", page.read_text(encoding="utf-8"), flags=re.S | re.M)


def page_name(page: Path) -> str:
    return page.relative_to(REPOSITORY).as_posix()
