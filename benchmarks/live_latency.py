"""Latency per sample and missed deadlines of `cellwise live` on a virtual CAN bus.

python -m benchmarks.live_latency [--seconds 20] [--json]

One thread plays the vehicle: current and voltage in one frame, at 100 Hz and 1 kHz, on an absolute
schedule. The other one is what `cellwise live` runs: decode, filter, one JSON line to a file, SOC
back on the bus ten times a second, state kept once a second. A sample is late when its state is
there only after the next sample was due. A python-can virtual bus lives in one process, so the
vehicle's own work (encoding, copying, sleeping) is in these figures too.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import threading
import time
import uuid
from pathlib import Path

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.example_cell import three_branches
from benchmarks.figures import describe_machine, machine_lines

DBC = """VERSION ""

BU_: BMS

BO_ 256 BMS_Pack: 8 BMS
 SG_ PackCurrent : 0|32@1- (0.001,0) [-300|300] "A" BMS
 SG_ PackVoltage : 32|32@1+ (0.0001,0) [0|6] "V" BMS

BO_ 257 Cellwise: 2 BMS
 SG_ Soc : 0|16@1+ (0.01,0) [0|100] "%" BMS
"""


def play(channel: str, dbc: Path, rate_Hz: float, samples: int, sent: list[float]) -> None:
    """Send frames on an absolute schedule; ``sent`` gets how far each was behind it [s]."""
    import can
    import cantools

    message = cantools.database.load_file(str(dbc)).get_message_by_name("BMS_Pack")
    frames = [
        message.encode({"PackCurrent": 2.0 + (k // 50) % 3, "PackVoltage": 3.8}) for k in range(150)
    ]
    with can.Bus(interface="virtual", channel=channel) as bus:
        while len(bus.channel) < 2:
            time.sleep(0.01)
        begin = time.perf_counter()
        for k in range(samples):
            due = begin + k / rate_Hz
            while (left := due - time.perf_counter()) > 0:
                time.sleep(left)
            sent.append(time.perf_counter() - due)
            bus.send(can.Message(arbitration_id=256, data=frames[k % 150], is_extended_id=False))


def follow(rate_Hz: float, seconds: float) -> dict[str, float]:
    """Figures of one rate."""
    from cellwise.cli.live import LineWriter
    from cellwise.forecast.outlook import Outlook
    from cellwise.live import Counts, LiveFilter, open_source, run_live
    from cellwise.live.can_stream import SocSender
    from cellwise.live.followed import FollowedFilter
    from cellwise.live.run import LatencyMeter
    from cellwise.live.source import BUS_EVERY_S, Sending
    from cellwise.logs.files.source import ReadOptions

    samples = round(rate_Hz * seconds)
    with tempfile.TemporaryDirectory() as folder:
        dbc = Path(folder) / "bms.dbc"
        dbc.write_text(DBC)
        channel = uuid.uuid4().hex
        source = open_source(f"can:virtual:{channel}", ReadOptions(dbc=dbc))
        live = LiveFilter(three_branches())
        outlook = Outlook(live.model, 3.0)
        sender = SocSender(source, "Cellwise.Soc")
        to = Sending(lambda update, _: sender.send(update.info.soc), lambda: None, BUS_EVERY_S)
        behind: list[float] = []
        vehicle = threading.Thread(target=play, args=(channel, dbc, rate_Hz, samples, behind))
        with (Path(folder) / "out.jsonl").open("w") as file:
            write = LineWriter(file, FollowedFilter(live, outlook))

            def take(update):
                outlook.take(update)
                to.take(update, dict)
                write(update)

            def begin(counts):  # called while nothing comes yet
                if not vehicle.ident:
                    vehicle.start()

            began = time.process_time()
            counts = run_live(
                source,
                live,
                take,
                look=begin,
                counts=Counts(latency=LatencyMeter(1.0 / rate_Hz)),
                state=Path(folder) / "state.json",
                save_every_s=1.0,
                most_samples=samples,
                idle_s=5.0,
            )
            cpu_s = time.process_time() - began
        vehicle.join()
    latency = counts.latency.to_dict()
    return {
        "rate_Hz": rate_Hz,
        "samples": counts.samples,
        "p50_ms": latency["p50_ms"],
        "p99_ms": latency["p99_ms"],
        "max_ms": latency["max_ms"],
        "missed_deadlines": latency["missed_deadlines"],
        "missed_share": latency["missed_deadlines"] / max(counts.samples, 1),
        "sender_late_max_ms": 1e3 * max(behind),
        "cpu_share": cpu_s / seconds,
        "soc_frames_sent": sender.sent,
    }


def main(arguments: list[str] | None = None) -> int:
    """Both rates, printed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args(arguments)
    machine = describe_machine()
    rows = [follow(rate_Hz, chosen.seconds) for rate_Hz in (100.0, 1000.0)]
    if chosen.json:
        print(json.dumps({"machine": machine, "live": rows}))
        return 0
    for row in rows:
        print(
            f"{row['rate_Hz']:5.0f} Hz, {row['samples']} samples: {row['p50_ms']:.3f} ms, 99 % "
            f"{row['p99_ms']:.3f} ms, longest {row['max_ms']:.2f} ms; "
            f"{row['missed_deadlines']} late ({100 * row['missed_share']:.2f} %); sender up to "
            f"{row['sender_late_max_ms']:.2f} ms behind; {100 * row['cpu_share']:.0f} % of a core"
        )
    print("\n".join(machine_lines(machine)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
