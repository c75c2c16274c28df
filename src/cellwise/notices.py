"""What a person should know of a log, a model or a result, as data.

A :class:`Notice` is made where something is found. Commands, pages and JSON render it; a program
goes by its code, its severity, the rows and the option that it names, and never by its text.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import Enum, StrEnum
from typing import Any

from cellwise.wording import Option, Piece, RowPlace, Text, Value, in_python, pieces_of


class Severity(StrEnum):
    """How much of what else is said rests on what a notice says."""

    CRITICAL = "critical"  # a channel cannot be what it is taken for: no other figure means much
    WARNING = "warning"  # figures are to be read with it
    NOTE = "note"  # what was done, and needs no answer


CRITICAL, WARNING, NOTE = Severity


class Code(Enum):
    """Every kind of notice: a stable word, how critical it is, what it means."""

    # ---- reading a log: what makes every figure about it nonsense
    SIGN_CONTRADICTED = "sign-contradicted", CRITICAL, "the voltage rises as the cell discharges"
    SIGN_UNCONFIRMED = "sign-unconfirmed", CRITICAL, "the tester's counter runs against the current"
    NO_SIGN = "no-sign", CRITICAL, "a current of one sign flows while the voltage rises and falls"
    TIME_UNIT = "time-unit", CRITICAL, "one load empties the cell within seconds"
    TIME_REPEATS = "time-repeats", CRITICAL, "many rows have the time of the row before"
    CHANNEL_MISSING = "channel-missing", CRITICAL, "many rows are without current or voltage"
    CURRENT_ZERO = "current-zero", CRITICAL, "the current is 0 throughout"
    IMPOSSIBLE_VALUE = "impossible-value", CRITICAL, "values that no cell has"
    VOLTAGE_STUCK = "voltage-stuck", CRITICAL, "the voltage stands still while the current moves"
    VOLTAGE_OF_PACK = "voltage-of-pack", CRITICAL, "the voltage is that of several cells in series"
    VOLTAGE_UNIT = "voltage-unit", CRITICAL, "the voltage of a pack's cell is none of a cell"
    CURRENT_UNIT = "current-unit", CRITICAL, "the current moves more charge than a cell holds"
    # ---- reading a log: sign
    SIGN_ASSUMED = "sign-assumed", WARNING, "nothing says what the sign means"
    SIGN_UNDETERMINED = "sign-undetermined", NOTE, "the data do not show what the sign means"
    SIGN_BY_VOLTAGE = "sign-by-voltage", NOTE, "the voltage gave the current its sign"
    SIGN_BY_STATE = "sign-by-state", NOTE, "the tester's state gave the current its sign"
    SIGN_INVERTED = "sign-inverted", NOTE, "positive current was read as charge"
    # ---- reading a log: counter, current, voltage, temperature
    COUNTER_EMPTY = "counter-empty", NOTE, "the counter holds no value"
    COUNTER_CONVERTED = "counter-converted", NOTE, "the counter was in another unit"
    COUNTER_JOINED = "counter-joined", NOTE, "the counter restarts and was joined up"
    COUNTER_LEFT_OUT = "counter-left-out", NOTE, "the counter does not follow the current"
    COUNTER_DIFFERS = "counter-differs", WARNING, "counter and summed current differ"
    COUNTER_INVERTED = "counter-inverted", NOTE, "the counter ran against the current"
    CURRENT_OF_COUNTER = "current-of-counter", NOTE, "the current was made of the counter's steps"
    CURRENT_OF_TWO = "current-of-two", NOTE, "the current is the difference of two columns"
    VOLTAGE_NEGATIVE = "voltage-negative", WARNING, "the voltage goes below zero"
    VOLTAGE_CONVERTED = "voltage-converted", NOTE, "the voltage was in millivolts"
    VOLTAGE_OF_ELECTRODES = "voltage-of-electrodes", NOTE, "the voltage is Ewe less Ece"
    TEMPERATURE_EMPTY = "temperature-empty", NOTE, "the temperature column holds no value"
    TEMPERATURE_CONVERTED = "temperature-converted", NOTE, "the temperature was in kelvin"
    TEMPERATURE_IMPOSSIBLE = "temperature-impossible", WARNING, "temperatures that were left out"
    # ---- reading a log: time, columns, files
    TIME_FROM_START = "time-from-start", NOTE, "the time is counted from the first row"
    TIME_OF_STEPS = "time-of-steps", NOTE, "the time of the steps was joined up"
    TIME_OF_DAYS = "time-of-days", NOTE, "a column of days and one of clocks are the time"
    TIME_PAST_MIDNIGHT = "time-past-midnight", NOTE, "a clock passes midnight and was taken on"
    TIME_OF_CLOCKS = "time-of-clocks", NOTE, "a column of numbers holds clocks or dates"
    ROWS_WITHOUT_TIME = "rows-without-time", NOTE, "rows without a time were left out"
    COLUMN_STATED = "column-stated", NOTE, "a column was taken as the user states"
    COLUMN_BY_NAME = "column-by-name", NOTE, "a column was taken by the words of its name"
    COLUMN_CONVERTED = "column-converted", NOTE, "a column was in another unit"
    COLUMN_UNUSED = "column-unused", NOTE, "columns that were not used"
    COLUMN_UNKNOWN = "column-unknown", NOTE, "columns that the format does not know"
    SIGNAL_CHOSEN = "signal-chosen", NOTE, "a signal was taken for a channel"
    SIGNAL_OUTSIDE = "signal-outside", WARNING, "values outside a signal's range were left out"
    SAMPLED_APART = "sampled-apart", NOTE, "voltage and current are sampled at other times"
    ROWS_WITHOUT_CURRENT = "rows-without-current", NOTE, "rows outside the current's time left out"
    DECIMAL_COMMAS = "decimal-commas", NOTE, "decimal commas were read as such"
    TEXT_AFTER_DATA = "text-after-data", NOTE, "what follows the data was left out"
    LINE_CUT_OFF = "line-cut-off", WARNING, "the last line is cut off and was left out"
    FILE_CUT_OFF = "file-cut-off", WARNING, "a recording has no end: it was read as far as it goes"
    FILE_DAMAGED = "file-damaged", WARNING, "what could not be read was passed over"
    LIBRARY_WARNING = "library-warning", WARNING, "what the library that reads the format says"
    SHEET_CHOSEN = "sheet-chosen", NOTE, "one of several sheets was read"
    LONG_TABLE = "long-table", NOTE, "each value of a long table holds until the next"
    SEVERAL_BATTERIES = "several-batteries", WARNING, "one of several batteries was read"
    NOT_CACHED = "not-cached", NOTE, "the log could not be kept in the cache"
    # ---- reading a log: packs
    CELLS_NOT_DIVIDED = "cells-not-divided", WARNING, "a pack was read as one cell"
    CELLS_DISAGREE = "cells-disagree", WARNING, "the file states another number of cells in series"
    PACK_DIVIDED = "pack-divided", NOTE, "a pack's voltage and current were divided"
    PACK_AS_MEAN_CELL = "pack-as-mean-cell", NOTE, "a table of cells was read as their mean cell"
    CELLS_CONVERTED = "cells-converted", NOTE, "the cells' voltages were in millivolts"
    CELL_MISSING = "cell-missing", WARNING, "a cell has no column, or rows without a voltage"
    CELL_DEAD = "cell-dead", WARNING, "a cell's voltage is none of a cell"
    CELL_FROZEN = "cell-frozen", WARNING, "a cell's voltage repeats while the others move"
    CELL_BALANCING = "cell-balancing", NOTE, "negative voltages are those of cells being balanced"
    CELLS_UNCOUNTED = "cells-uncounted", WARNING, "the pack has other cells than its columns"
    # ---- what is stated of a log
    START_HELD = "start-held", NOTE, "a stated SOC just beyond 0 to 1 was held"
    START_NOT_WRITTEN = "start-not-written", NOTE, "a file has no place for the stated start"
    TEMPERATURE_CONTRADICTED = "temperature-contradicted", WARNING, "measured and stated differ"
    # ---- an inspection
    GAP = "gap", NOTE, "a time without rows"
    DISCHARGE_CUT = (
        "discharge-cut",
        WARNING,
        "one log is shorter than others; all are cut",
    )
    MORE_GAPS = "more-gaps", NOTE, "gaps that are not listed"
    STAMPS_REPEAT = "stamps-repeat", NOTE, "rows with the time of the row before"
    ROWS_MISSING = "rows-missing", NOTE, "rows without a value of a channel"
    CHANNEL_STUCK = "channel-stuck", WARNING, "a channel stands still while another moves"
    SPIKES = "spikes", NOTE, "the voltage jumps away and back without the current"
    NO_REST = "no-rest", NOTE, "no rest of a minute or more"
    FIRST_ROW_LOADED = "first-row-loaded", NOTE, "the first voltage is no open-circuit voltage"
    # ---- a model on a log
    FAR_OFF = "far-off", WARNING, "many times as far off as the model states: another cell"
    OUTSIDE_DATA = "outside-data", WARNING, "rows outside what the model's data covered"
    TEMPERATURE_ASSUMED = "temperature-assumed", WARNING, "no temperature was measured"
    TOO_MUCH_CHARGE = "too-much-charge", WARNING, "more charge moves than the model's cell holds"
    SOC_OUTSIDE = "soc-outside", WARNING, "the SOC leaves 0 to 1"
    MODEL_OFF = "model-off", WARNING, "an error beyond what the model states"
    VOLTAGE_UNUSED = "voltage-unused", WARNING, "the filter used no voltage"
    VOLTAGE_REJECTED = "voltage-rejected", WARNING, "the filter rejects many voltages"
    START_CONTRADICTED = "start-contradicted", WARNING, "a stated start is not what voltages show"
    LONG_INNOVATION = "long-innovation", WARNING, "the voltage stays off, beyond what is stated"
    SOC_STEP = "soc-step", WARNING, "the SOC steps in one sample: another start explains it better"
    PAUSE_NOT_COUNTED = "pause-not-counted", WARNING, "a simulation begins again after a pause"
    POWER_LIMIT_ASSUMED = "power-limit-assumed", WARNING, "limits of the power that nobody stated"
    FORECAST_OUTSIDE_DATA = "forecast-outside-data", WARNING, "the forecast leaves the model's data"
    SENSOR_FAULT = "sensor-fault", WARNING, "rows of a channel that were wrong and left out"
    STATE_EMPTY = "state-empty", WARNING, "a file of a filter's state holds none: started again"
    STEP_NOT_DONE = "step-not-done", WARNING, "a step of a protocol did not go as asked"
    # ---- an identification
    PLAIN_MODEL = "plain-model", WARNING, "a plain model is better than the fit and is handed out"
    UPDATE_WORSE = "update-worse", WARNING, "a log of an update was followed better before it"
    DOES_NOT_FIT = "does-not-fit", WARNING, "the finished model is far from a log of its fit"
    TEMPERATURES_EXCHANGED = "temperatures-exchanged", WARNING, "a cold log resists less"
    TWO_CELLS = "two-cells", WARNING, "OCV test and pulse test are not of one cell"
    OTHER_CAPACITY = "other-capacity", WARNING, "a log is of a cell of another capacity"
    PART_OF_DISCHARGE = "part-of-discharge", WARNING, "a capacity test is far too small"
    NOT_NOMINAL = "not-nominal", WARNING, "the capacity is far from the nominal one"
    MORE_THAN_HELD = "more-than-held", WARNING, "a log moves more than the cell holds"
    EMPTY_EARLY = "empty-early", WARNING, "a pulse test is empty before its nominal capacity"
    NO_CAPACITY_TEST = "no-capacity-test", NOTE, "no capacity test was found, or none is used"
    CAPACITY_TEST_UNUSED = "capacity-test-unused", NOTE, "a capacity test was left out"
    CAPACITY_TEST_INCOMPLETE = "capacity-test-incomplete", NOTE, "it does not go from full to empty"
    CAPACITY_TEST_COOLED = "capacity-test-cooled", NOTE, "the temperature fell during the test"
    PULSE_TEST_TAKEN = "pulse-test-taken", NOTE, "its charge is taken for the capacity"
    PULSE_TEST_NO_CAPACITY = "pulse-test-no-capacity", NOTE, "it does not go from full to empty"
    OCV_SOURCE = "ocv-source", NOTE, "where the OCV came from"
    NO_OCV_OF_RESTS = "no-ocv-of-rests", NOTE, "rests gave no OCV"
    LATE_FIRST_ROW = "late-first-row", NOTE, "the first row after a switch comes late"
    LOG_LEFT_OUT = "log-left-out", WARNING, "a log was left out"
    START_FOUND = "start-found", NOTE, "where a log begins, by its voltages"
    OWN_LOG = "own-log", NOTE, "how a log of the fit was simulated back"
    OCV_OF_PRIOR = "ocv-of-prior", WARNING, "parts of the OCV that the logs do not show"
    # ---- an export
    OCV_OF_ONE_TEMPERATURE = "ocv-of-one-temperature", NOTE, "a format has no OCV over temperature"
    EFFICIENCY_LEFT_OUT = "efficiency-left-out", NOTE, "a format has no charge efficiency"
    # ---- packs and lives
    NO_STRETCH = "no-stretch", WARNING, "no stretch between pauses is long enough"
    CELLS_EXCHANGED = "cells-exchanged", WARNING, "cells have changed places"
    CELL_DRIFTS = "cell-drifts", WARNING, "a cell lost charge against the others"
    HALF_CYCLES = "half-cycles", NOTE, "a log of several half cycles, each followed by itself"
    CAPACITY_AT_LOAD = "capacity-at-load", NOTE, "a counted capacity is that at its load"
    NOT_NEW = "not-new", WARNING, "a life begins at another capacity than its model's"
    TEMPERATURES_DIFFER = "temperatures-differ", NOTE, "logs at clearly different temperatures"

    def __init__(self, word: str, severity: Severity, meaning: str) -> None:
        self.word, self.severity, self.meaning = word, severity, meaning


@dataclass(frozen=True, repr=False)
class Notice:
    """What a person should know.

    Parameters
    ----------
    code : Code             what kind it is
    said : str or tuple     its words, with the options that they propose and the rows that they
                            name; behind the name of ``log`` where that is given
    log : str               name of the log that the text begins with
    rows : range or None    of a log, counted from 0; of several in the text the first
    option : Option or None what it proposes; of several in the text the first
    size_V : float          about how far it moves a voltage: the largest is said first
    column : str            name of the file's column that it is of
    """

    code: Code
    said: str | tuple[Piece, ...]
    log: str = ""
    rows: range | None = None
    option: Option | None = None
    size_V: float = 0.0
    column: str = ""

    def __post_init__(self) -> None:
        if self.option is None:
            proposed = (p for p in self.pieces if isinstance(p, Option))
            object.__setattr__(self, "option", next(proposed, None))
        if self.rows is None:
            places = (p.rows for p in self.pieces if isinstance(p, RowPlace))
            object.__setattr__(self, "rows", next(places, None))

    @property
    def severity(self) -> Severity:
        """How much rests on it."""
        return self.code.severity

    @property
    def is_critical(self) -> bool:
        """A channel cannot be what it is taken for."""
        return self.severity is Severity.CRITICAL

    @property
    def argument(self) -> str:
        """The argument that it proposes; empty without one."""
        return "" if self.option is None else self.option.argument

    @property
    def value(self) -> Value | None:
        """The value that it proposes for it; None where only the reader knows it."""
        return None if self.option is None else self.option.value

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """The text in parts: words, and options."""
        return pieces_of(self.said) if isinstance(self.said, str) else Text(*self.said).pieces

    @property
    def text(self) -> Text:
        """For people who write Python."""
        return Text(self.before, *self.pieces)

    def rendered(self, of_option: Callable[[Option], str] = in_python) -> str:
        """The text, with options as ``of_option`` writes them."""
        return self.before + self.behind_name(of_option)

    @property
    def before(self) -> str:
        """The name of a log that the text begins with, in quotes; empty without one."""
        return f"'{self.log}'" if self.log else ""

    def behind_name(self, of_option: Callable[[Option], str] = in_python) -> str:
        """The text without the name that it begins with: the same for every log alike."""
        return Text(*self.pieces).rendered(of_option)

    @property
    def head(self) -> str:
        """The first part of the text: what was found, without what to do about it."""
        return replace(self, said=self.pieces[:1]).text

    def followed_by(self, *more: Piece) -> Notice:
        """The same with more words."""
        return replace(self, said=(*self.pieces, *more))

    def of_log(self, name: str) -> Notice:
        """The same as one of several logs: behind the name of its own where it has none."""
        return self if self.log or not name else replace(self, log=name, said=(": ", *self.pieces))

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        return f"Notice({self.code.word}: {self.text!r})"


def texts(notices: Iterable[Notice]) -> list[Text]:
    """The texts of notices, for JSON and tables."""
    return [notice.text for notice in notices]


def to_json(notice: Notice) -> dict[str, object]:
    """All of a notice as JSON values, for a file from which `from_json` makes it again."""

    def piece(one: Piece | None) -> object:
        if isinstance(one, RowPlace):
            return {"words": one.words, "rows": [one.rows.start, one.rows.stop]}
        return one._asdict() if isinstance(one, Option) else one

    rows = None if notice.rows is None else [notice.rows.start, notice.rows.stop]
    more = {name: getattr(notice, name) for name in ("log", "size_V", "column")}
    said, option = [piece(one) for one in notice.pieces], piece(notice.option)
    return {"code": notice.code.name, "said": said, "rows": rows, "option": option, **more}


def from_json(data: Mapping[str, Any]) -> Notice:
    """The notice that `to_json` gave."""

    def piece(one: Any) -> Any:
        if isinstance(one, str) or one is None:
            return one
        if "words" in one:
            return RowPlace(one["words"], range(*one["rows"]))
        value = one["value"]
        return Option(**one | {"value": tuple(value) if isinstance(value, list) else value})

    known = {name: data[name] for name in ("log", "size_V", "column")}
    rows = None if data["rows"] is None else range(*data["rows"])
    said, option = tuple(map(piece, data["said"])), piece(data["option"])
    return Notice(Code[data["code"]], said, rows=rows, option=option, **known)


def critical_first(notices: Iterable[Notice]) -> list[Notice]:
    """The same notices, the critical ones first, each once."""
    return sorted(dict.fromkeys(notices), key=lambda notice: not notice.is_critical)


def coded(notices: Iterable[Notice], *codes: Code) -> list[Notice]:
    """Those of some codes."""
    return [notice for notice in notices if notice.code in codes]
