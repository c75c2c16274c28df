"""The SOC at a log's first row, when nobody says it: from a rest, a short fit or the whole log."""
