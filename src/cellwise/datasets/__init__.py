"""Public data sets: fetched with their checksums, imported into the tidy form with a catalogue."""

from __future__ import annotations

from cellwise.datasets.fetching import fetch_dataset
from cellwise.datasets.importing import import_dataset

__all__ = ["fetch_dataset", "import_dataset"]
