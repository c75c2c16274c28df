"""The adaptive filter: SOC together with sensor offset, resistances and capacity."""
