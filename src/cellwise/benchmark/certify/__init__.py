"""What an exported filter, or anybody's gauge, will do on cells that vary and age: its own C."""

from cellwise.benchmark.certify.certificate import Certificate, Limits
from cellwise.benchmark.certify.exported import Exported, read_export
from cellwise.benchmark.certify.gauge import Gauge
from cellwise.benchmark.certify.lives import measured_log
from cellwise.benchmark.certify.run import certify

__all__ = [
    "Certificate",
    "Exported",
    "Gauge",
    "Limits",
    "certify",
    "measured_log",
    "read_export",
]
