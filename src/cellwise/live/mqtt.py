"""MQTT: samples from a broker, and state to one, as Home Assistant finds devices by itself.

Discovery is laid out at https://www.home-assistant.io/integrations/mqtt/#mqtt-discovery.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import queue
import re
import time
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple
from urllib.parse import unquote, urlsplit

from cellwise.errors import InputError
from cellwise.live.samples import HELD_S, POLL_S, ObjectReader, Readings, Sample, Stray
from cellwise.logs.files.format import need
from cellwise.logs.files.source import ReadOptions

CONNECT_S = 10.0
MOST_WAITING = 100_000  # messages that came and were not read yet
PORTS = {"mqtt": 1883, "mqtts": 8883}
DISCOVERY = "homeassistant"  # the prefix that Home Assistant listens to


class EntityOfValue(NamedTuple):
    """A value as Home Assistant shows it: key of the row, name, factor, unit, class, digits."""

    key: str
    name: str
    factor: float = 1.0
    unit: str = ""
    kind: str = ""
    digits: int = 3


SHOWN = (
    EntityOfValue("soc", "Charge", 100.0, "%", "battery", 2),
    EntityOfValue("soc_std", "Charge deviation", 100.0, "%", "", 2),
    EntityOfValue("remaining_s", "Remaining time", 1.0, "s", "duration", 0),
    EntityOfValue("remaining_Wh", "Remaining energy of a cell", 1.0, "Wh", "energy_storage"),
    EntityOfValue("current_A", "Current of a cell", 1.0, "A", "current"),
    EntityOfValue("measured_voltage_V", "Voltage of a cell", 1.0, "V", "voltage"),
    EntityOfValue("temperature_C", "Temperature", 1.0, "°C", "temperature", 1),
)


class Broker(NamedTuple):
    """Where a broker is and what is said there."""

    host: str
    port: int
    topic: str
    user: str
    password: str
    encrypted: bool


def broker_of(url: str) -> Broker:
    """Parts of ``mqtt://[USER[:PASSWORD]@]HOST[:PORT]/TOPIC``; ``mqtts`` is encrypted.

    A password that is not in it is that of the environment's ``MQTT_PASSWORD``.

    Raises
    ------
    InputError        no host, port or topic
    """
    try:
        parts = urlsplit(url.replace("#", "%23"))  # a wildcard of topics
        port = parts.port or PORTS[parts.scheme]
        if not parts.hostname or not parts.path.strip("/"):
            raise ValueError("no host or no topic")
    except (ValueError, KeyError) as error:
        shown = re.sub(r"//[^@/]*@", "//...@", url)
        raise InputError(
            f"'{shown}' ({error})", "mqtt://HOST[:PORT]/TOPIC, or mqtts://...", "Correct it."
        ) from None
    user, password = unquote(parts.username or ""), unquote(parts.password or "")
    topic = unquote(parts.path).strip("/")
    password = password or os.environ.get("MQTT_PASSWORD", "")
    return Broker(parts.hostname, port, topic, user, password, parts.scheme == "mqtts")


class _Link:
    """A connection of paho-mqtt that comes up again by itself."""

    def __init__(self, broker: Broker, purpose: str) -> None:
        self._paho = need("paho.mqtt.client", purpose, "paho-mqtt")
        self.broker = broker
        self.client = self._paho.Client(self._paho.CallbackAPIVersion.VERSION2)
        if broker.user:
            self.client.username_pw_set(broker.user, broker.password or None)
        if broker.encrypted:
            self.client.tls_set()
        self._answers: queue.Queue[Any] = queue.Queue()
        self.client.on_connect = self._connected

    def open(self) -> None:
        """Connect and wait for the broker's answer.

        Raises
        ------
        InputError        nobody there, or no admission
        """
        try:
            self.client.connect(self.broker.host, self.broker.port, keepalive=30)
            self.client.loop_start()
            answer = self._answers.get(timeout=CONNECT_S)
        except (OSError, queue.Empty) as error:
            self.close()
            raise self._refused(str(error) or "no answer") from error
        if answer.is_failure:
            self.close()
            raise self._refused(str(answer))

    def close(self) -> None:
        """Say goodbye."""
        with contextlib.suppress(Exception):
            self.client.disconnect()
        self.client.loop_stop()

    def on_up(self) -> None:
        """What is to be done whenever the connection is there."""

    def _connected(self, *found: Any) -> None:
        reason = found[3]
        self._answers.put(reason)
        if not reason.is_failure:
            self.on_up()

    def _refused(self, why: str) -> InputError:
        return InputError(
            f"no MQTT broker at {self.broker.host}:{self.broker.port} ({why})",
            "one that runs and admits this user",
            "Check host, port, user and password (MQTT_PASSWORD).",
        )


class MqttStream(_Link):
    """Samples of a topic: JSON objects with tidy names, or a number in a topic of each quantity.

    ``mqtt://host/shed/battery`` reads objects; ``mqtt://host/shed/battery/+`` numbers, too, whose
    name is the last level (``.../voltage_V``, or as ``channels`` says): a sample for each voltage.

    Parameters
    ----------
    url : str               as :func:`broker_of`; ``+`` and ``#`` stand for levels of the topic
    options : ReadOptions   pack, channels
    sign : str              ``charge-positive`` turns the current round
    cells : int             voltages of so many cells; 0: none

    Raises
    ------
    InputError              the library is missing, no such broker
    """

    def __init__(self, url: str, options: ReadOptions, sign: str, cells: int = 0) -> None:
        super().__init__(broker_of(url), "MQTT")
        self.name = f"MQTT {self.broker.topic} of {self.broker.host}"
        readings = Readings(options, sign, cells, held_s=HELD_S)
        self._reader = ObjectReader(readings, options.channels)
        self._came: queue.Queue[tuple[str, bytes, float]] = queue.Queue(MOST_WAITING)
        self.client.on_message = self._message
        self.open()

    def on_up(self) -> None:
        """Ask for the topic, also after a break."""
        self.client.subscribe(self.broker.topic, qos=1)

    def __iter__(self) -> Iterator[Sample | Stray | None]:
        while True:
            try:
                topic, payload, arrived_s = self._came.get(timeout=POLL_S)
            except queue.Empty:
                yield None
                continue
            yield self._read(topic, payload, arrived_s)

    def _message(self, client: Any, data: Any, message: Any) -> None:
        with contextlib.suppress(queue.Full):
            self._came.put_nowait((message.topic, message.payload, time.time()))

    def _read(self, topic: str, payload: bytes, arrived_s: float) -> Sample | Stray | None:
        try:
            found = json.loads(payload)
        except (ValueError, RecursionError):
            return Stray("not JSON")
        if isinstance(found, bool) or not isinstance(found, (int, float)):
            return self._reader.read(found, arrived_s)
        name = topic.rpartition("/")[2]
        if name not in self._reader.names:
            return Stray("a number of another topic")
        field, unit = self._reader.names[name]
        readings = self._reader.readings
        readings.take(field, found * unit.factor + unit.offset, arrived_s)
        return readings.sample(arrived_s, arrived_s) if field == "voltage_V" else None


class MqttSender(_Link):
    """State as a device of Home Assistant: one for the topic, which is the pack's name.

    ``TOPIC/state`` holds a JSON object, ``TOPIC/available`` says ``online``, and ``offline`` when
    the program ends or the broker hears nothing of it any more (its last will).

    Parameters
    ----------
    url : str       as :func:`broker_of`

    Raises
    ------
    InputError      the library is missing, no such broker, a wildcard as topic
    """

    def __init__(self, url: str) -> None:
        super().__init__(broker_of(url), "MQTT")
        self._topic = self.broker.topic
        if set("+#") & set(self._topic):
            raise InputError(
                f"a topic '{self._topic}' to send to", "one without + and #", "Name the pack."
            )
        self.client.will_set(f"{self._topic}/available", "offline", qos=1, retain=True)
        self.open()

    def on_up(self) -> None:
        """Say what there is and that it is there; a broker keeps both."""
        for place, said in discovery(self._topic).items():
            self.client.publish(place, json.dumps(said), qos=1, retain=True)
        self.client.publish(f"{self._topic}/available", "online", qos=1, retain=True)

    def send(self, row: Mapping[str, Any]) -> None:
        """One row of `cellwise live`; what is not known is null."""
        said: dict[str, Any] = {"flags": ", ".join(row["flags"]) or "none"}
        for one in SHOWN:
            value = row.get(one.key)
            shown = math.nan if value is None else one.factor * value
            said[one.key] = round(shown, one.digits) if math.isfinite(shown) else None
        self.client.publish(f"{self._topic}/state", json.dumps(said), qos=0, retain=True)

    def close(self) -> None:
        """Not available from now on."""
        last = self.client.publish(f"{self._topic}/available", "offline", qos=1, retain=True)
        with contextlib.suppress(ValueError, RuntimeError):
            last.wait_for_publish(timeout=2.0)
        super().close()


def discovery(topic: str) -> dict[str, dict[str, Any]]:
    """Topic and content of the discovery message of each value of one device."""
    own = "cellwise_" + re.sub(r"\W+", "_", topic)
    device = {"identifiers": [own], "name": topic, "manufacturer": "cellwise"}
    found = {}
    for one in (*SHOWN, EntityOfValue("flags", "Flags")):
        said: dict[str, Any] = {
            "name": one.name,
            "unique_id": f"{own}_{one.key}",
            "state_topic": f"{topic}/state",
            "value_template": f"{{{{ value_json.{one.key} }}}}",
            "availability_topic": f"{topic}/available",
            "device": device,
        }
        if one.unit:
            said |= {"unit_of_measurement": one.unit, "state_class": "measurement"}
        else:
            said["entity_category"] = "diagnostic"
        if one.kind:
            said["device_class"] = one.kind
        found[f"{DISCOVERY}/sensor/{own}/{one.key}/config"] = said
    return found
