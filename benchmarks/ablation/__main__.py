"""What is lost without each mechanism of a filter, on the panel, with an interval over logs.

python -m benchmarks.ablation [--keep DIR] [--only "mismatch,recovery"] [-o TABLE.md]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.ablation.switches import SWITCHES, switch_of
from benchmarks.ablation.table import as_markdown, losses


def main(arguments: list[str] | None = None) -> int:
    """Run what is not kept yet, each switch in its own process, and print the table."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--keep", type=Path, default=Path("build/ablation"))
    parser.add_argument("--only", default="", help="comma-separated names of switches")
    parser.add_argument("-o", "--output", type=Path, help="write the table here as well")
    chosen = parser.parse_args(arguments)
    chosen.keep.mkdir(parents=True, exist_ok=True)
    names = [s.name for s in SWITCHES]
    wanted = ["nothing", *(chosen.only.split(",") if chosen.only else names[1:])]
    for unknown in set(wanted) - set(names):
        parser.error(f"no switch '{unknown}': one of {', '.join(names)}")
    found = {}
    # What sets no constant of a kernel shares the compiled ones.
    compiled = tempfile.TemporaryDirectory()
    for name in wanted:
        file = chosen.keep / f"without {name}.json"
        if not file.exists():
            print(f"  {name} ...", file=sys.stderr, flush=True)
            worker = [sys.executable, "-m", "benchmarks.ablation.run", name]
            shared = {} if switch_of(name).names else {"NUMBA_CACHE_DIR": compiled.name}
            command = [*worker, str(chosen.keep), str(file)]
            subprocess.run(command, check=True, env=os.environ | shared)
        found[name] = json.loads(file.read_text(encoding="utf-8"))
    text = as_markdown(losses(found.pop("nothing"), found))
    if chosen.output:
        chosen.output.write_text(text, encoding="utf-8")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
