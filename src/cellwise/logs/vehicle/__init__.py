"""Recordings of vehicles: CAN frames, which signal is which, one clock for all."""
