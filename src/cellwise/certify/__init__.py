"""What an exported filter will do on cells that vary and age: its own C over a virtual fleet."""

from cellwise.certify.certificate import Certificate, Limits
from cellwise.certify.exported import Exported, read_export
from cellwise.certify.run import certify
from cellwise.certify.virtual_cells import Sensor, read_sensor

__all__ = ["Certificate", "Exported", "Limits", "Sensor", "certify", "read_export", "read_sensor"]
