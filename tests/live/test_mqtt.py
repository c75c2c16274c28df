"""MQTT through a real broker in loopback: samples in, a device of Home Assistant out."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import socket
import subprocess
import threading
import time
from pathlib import Path

import pytest

from cellwise.cli import main
from cellwise.errors import InputError
from cellwise.live import Sample, open_source
from cellwise.live.mqtt import MqttSender, broker_of, discovery
from cellwise.logs import read_log
from cellwise.logs.files.source import ReadOptions

paho = pytest.importorskip("paho.mqtt.client")
MOSQUITTO = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")


@pytest.fixture(scope="module")
def port(tmp_path_factory):
    """A broker that admits one user, on a port of its own."""
    if MOSQUITTO is None:
        pytest.skip("no broker here: Debian's package mosquitto has one")
    folder = tmp_path_factory.mktemp("broker")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        number = taken.getsockname()[1]
    passwords = folder / "passwords"
    tool = MOSQUITTO.replace("sbin", "bin") + "_passwd"
    make = [tool, "-b", "-c", str(passwords), "me", "se:cret@"]
    subprocess.run(make, check=True, capture_output=True)
    passwords.chmod(0o644)
    folder.chmod(0o755)
    (folder / "conf").write_text(
        f"listener {number} 127.0.0.1\nallow_anonymous false\npassword_file {passwords}\n"
        "user root\n"
    )
    broker = subprocess.Popen([MOSQUITTO, "-c", str(folder / "conf")], stderr=subprocess.DEVNULL)
    for _ in range(100):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", number)) == 0:
                break
        time.sleep(0.05)
    yield number
    broker.terminate()
    broker.wait(10)


@pytest.fixture
def listener(port, monkeypatch):
    """A client of the test, and what it has heard: topic to payloads."""
    monkeypatch.setenv("MQTT_PASSWORD", "se:cret@")
    heard: dict[str, list[bytes]] = {}
    client = paho.Client(paho.CallbackAPIVersion.VERSION2)
    client.username_pw_set("me", "se:cret@")
    client.on_message = lambda _c, _d, m: heard.setdefault(m.topic, []).append(m.payload)
    client.connect("127.0.0.1", port)
    client.subscribe("#")
    client.loop_start()
    yield client, heard
    client.disconnect()
    client.loop_stop()


def within(seconds, true):
    until = time.monotonic() + seconds
    while not true() and time.monotonic() < until:
        time.sleep(0.02)
    assert true()


def taken(source, count):
    found = []
    for item in source:
        found += [] if item is None else [item]
        if len(found) == count:
            source.close()
            return found
    return found


def documented(port):
    """The command of docs/live.md, on the test's broker and with a stock model."""
    page = (Path(__file__).parents[2] / "docs" / "live.md").read_text(encoding="utf-8")
    (command,) = re.findall(r"^cellwise (live .*mqtt://(?:.*\\\n)*.*)$", page, re.M)
    words = shlex.split(command.replace("\\\n", " "))
    return [
        w.replace("broker/", f"127.0.0.1:{port}/").replace("m50.json", "lipo-pouch") for w in words
    ]


def test_a_sensor_s_objects_in_and_a_device_out(port, listener, capsys):
    client, heard = listener
    over = threading.Event()

    def sensor():
        k = 0
        while not over.wait(0.01):
            row = {"time_s": k, "current_A": 4.0, "voltage_V": 15.6, "temperature_C": 25.0}
            client.publish("shed/bms/all", json.dumps(row))
            k += 1

    thread = threading.Thread(target=sensor)
    thread.start()
    try:
        code = main([
            *documented(port), "--send-every", "0", "--samples", "60", "--idle", "20", "--json"
        ])  # fmt: skip
    finally:
        over.set()
        thread.join()
    printed = capsys.readouterr()
    assert code == 0, printed.err
    end = json.loads(printed.out)
    within(5, lambda: heard.get("cellwise/shed/available", [])[-1:] == [b"offline"])
    assert heard["cellwise/shed/available"][0] == b"online"
    said = json.loads(heard["cellwise/shed/state"][-1])
    assert said["soc"] == pytest.approx(100 * end["soc"], abs=0.006)
    assert said["measured_voltage_V"] == 3.9
    assert said["remaining_s"] == pytest.approx(end["remaining_s"], abs=0.6)
    configs = {t: json.loads(v[0]) for t, v in heard.items() if t.startswith("homeassistant/")}
    assert configs == discovery("cellwise/shed")


def test_a_measured_drive_by_a_broker_is_the_same_as_by_a_file(
    port, listener, real_data, tmp_path, capsys
):
    """A thousand rows of a Panasonic drive: start and end are the same to the last digit."""
    client, _ = listener
    log = read_log(real_data / "panasonic_18650pf" / "drive_p25_us06.csv.gz").part(0, 1000)
    names = ("time_s", "current_A", "voltage_V", "temperature_C")
    columns = (getattr(log, name).tolist() for name in names)
    lines = [json.dumps(dict(zip(names, row, strict=True))) for row in zip(*columns, strict=True)]
    stream = tmp_path / "drive.jsonl"
    stream.write_text("".join(f"{line}\n" for line in lines))
    given = ("live", "--model", "nca-18650", "--capacity-ah", "2.9", "--json", "--source")
    assert main([*given, f"json:{stream}"]) == 0
    by_file = json.loads(capsys.readouterr().out)
    retained = threading.Timer(3.0, lambda: [client.publish("drive/all", x, 1) for x in lines])
    retained.start()
    source = f"mqtt://me@127.0.0.1:{port}/drive/all"
    assert main([*given, source, "--samples", "1000", "--idle", "60"]) == 0
    by_broker = json.loads(capsys.readouterr().out)
    for key in ("soc0", "soc", "soc_std", "voltage_V", "samples"):
        assert by_broker[key] == by_file[key], key


def test_what_home_assistant_asks_of_a_discovery_message():
    """One device, unique ids, templates on keys that are sent, classes with one of their units."""
    units = {"battery": "%", "duration": "s", "energy_storage": "Wh", "current": "A",
             "voltage": "V", "temperature": "°C"}  # fmt: skip
    found = discovery("home/pack 1")
    assert len({json.dumps(v["device"]) for v in found.values()}) == 1
    assert len({v["unique_id"] for v in found.values()}) == len(found)
    for topic, said in found.items():
        prefix, component, node, _, last = topic.split("/")
        assert (prefix, component, last) == ("homeassistant", "sensor", "config")
        assert node.replace("_", "").isalnum()
        assert said["availability_topic"] == "home/pack 1/available"
        if "device_class" in said:
            assert said["unit_of_measurement"] == units[said["device_class"]]


def test_a_program_that_dies_is_not_available(port, listener):
    _, heard = listener
    sender = MqttSender(f"mqtt://me@127.0.0.1:{port}/cellwise/dying")
    within(5, lambda: heard.get("cellwise/dying/available") == [b"online"])
    sender.client._sock_close()  # no goodbye
    within(5, lambda: b"offline" in heard["cellwise/dying/available"])
    sender.close()


def test_numbers_of_one_topic_each(port, listener):
    client, _ = listener
    options = ReadOptions(series=4, channels={"current_A": "amps"})
    source = open_source(f"mqtt://me@127.0.0.1:{port}/bms/+", options)

    def subscribed():
        client.publish("bms/mode", "0", qos=1).wait_for_publish(5)
        return not source._came.empty()

    within(5, subscribed)
    while next(iter(source)) is not None:
        pass  # until nothing comes any more
    for name, value in (("amps", "2.5"), ("voltage_V", "16.0"), ("mode", "3"), ("voltage_V", "on")):
        client.publish(f"bms/{name}", value, qos=1).wait_for_publish(5)
    sample, other, garbage = taken(source, 3)
    assert isinstance(sample, Sample)
    assert sample[1:3] == (2.5, 4.0)
    assert other.reason == "a number of another topic"
    assert garbage.reason == "not JSON"


def test_a_broker_that_does_not_admit_is_refused(port, monkeypatch):
    monkeypatch.setenv("MQTT_PASSWORD", "wrong")
    with pytest.raises(InputError, match=r"Not authorized|Bad user name"):
        open_source(f"mqtt://me@127.0.0.1:{port}/a")


@pytest.mark.parametrize("url", ["mqtt://", "mqtt://h", "mqtt:///t", "mqtt://u:secret@h:x/t"])
def test_a_url_that_names_no_topic_is_refused(url):
    with pytest.raises(InputError, match="TOPIC") as refused:
        broker_of(url)
    assert "secret" not in str(refused.value)


def test_nobody_at_the_port_is_refused():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        free = taken.getsockname()[1]
    with pytest.raises(InputError, match="no MQTT broker"):
        open_source(f"mqtt://127.0.0.1:{free}/a")
