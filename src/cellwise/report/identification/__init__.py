"""Sections of the page of an identification: OCV, capacity, pulses, parameters, fit, provenance."""
