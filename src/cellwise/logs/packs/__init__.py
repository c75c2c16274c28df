"""Logs of packs: one current, many cell voltages."""
