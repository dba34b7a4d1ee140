"""Registrations and standby time of a battery, computed from data sheets; nothing is measured.

`python -m experiments.modules.battery` prints the tables of firmware/BATTERY.md.
"""

from __future__ import annotations

from typing import NamedTuple

from synchronizar.parameters import SleepParameters

BATTERY_MAH = 600.0
PAPER_REGISTRATIONS = 720
"""SynchronizAR's own figures: of a module with this battery."""

ESP32_CPU_MA = 68.0
"""ESP32 data sheet, power by modes: at 240 MHz without radio, 30 to 68."""
ESP32_WIFI_RX_MA = 100.0
"""ESP32 data sheet, RF: receiving or listening, 95 to 100. Without modem sleep it always does."""
ESP32_WIFI_TX_MA = 190.0
"""ESP32 data sheet, RF: sending 802.11g at 16 dBm."""
ESP32_SLEEP_UA = 10.0
"""ESP32 data sheet: deep sleep with RTC timer and memory; 5 with the timer alone."""
RADIO_SLEEP_UA = 0.55
"""Deep sleep of the module, as the paper has it; the chip alone 0.05 (DW1000 data sheet)."""


class Radio(NamedTuple):
    """Currents of the radio, mA."""

    name: str
    receive: float
    send: float


RADIOS = (
    Radio("typical", receive=118.0, send=83.0),  # DW1000 data sheet 2.12, channel 5: demodulating; sending a preamble
    Radio("at most", receive=160.0, send=140.0),  # DWM1000 data sheet
)

REGULATORS_UA = {"MCP1700": 1.6, "AP2112K": 55.0, "AMS1117, as on most development boards": 5000.0}
"""Quiescent currents, typical, by their data sheets."""
LEAST_UA = min(REGULATORS_UA.values())

SLOTS, SLOT_US = 4, 1000.0
"""Of a round, one to n with two partners."""
SENT = 1
"""Frames a round, by a member; a coordinator sends two, which costs less than receiving."""
AIRTIME_US = 234.0
"""60 bytes at 6.8 Mb/s, preamble of 128 symbols."""
WIFI_TX_SHARE = 50 * 250e-6
"""A datagram every 20 ms, 0.25 ms each with its acknowledgement."""
START_S, JOIN_S = 0.4, 2.0
"""Assumed: to the first instruction of ours; to an address on Wi-Fi. The radio sleeps meanwhile."""
ANSWER_S = 0.1
"""Assumed: until the order to sleep is there."""
WOKEN_S, WOKEN_AN_HOUR = 10.0, 6.0
"""Assumed: s until a joiner or whoever is doubted is registered; how often that happens."""
NAPS_S = (10.0, 20.0, 60.0, 300.0)
RANGING_S = (10.0, 5.0, 3.0)
"""The first is the paper's."""


def radio_ma(radio: Radio, sent: int) -> float:
    """Mean while ranging: it receives whenever it does not send."""
    share = sent * AIRTIME_US / (SLOTS * SLOT_US)
    return share * radio.send + (1.0 - share) * radio.receive


def wifi_ma() -> float:
    """Mean while ranges are told."""
    return WIFI_TX_SHARE * ESP32_WIFI_TX_MA + (1.0 - WIFI_TX_SHARE) * ESP32_WIFI_RX_MA


def registration_mah(radio: Radio, sent: int, ranging_s: float) -> float:
    """Charge of one registration: start, join, range."""
    before = START_S * ESP32_CPU_MA + JOIN_S * ESP32_WIFI_RX_MA
    return (before + ranging_s * (radio_ma(radio, sent) + wifi_ma())) / 3600.0


def standby_days(regulator_ua: float, registrations_a_day: float = 0.0) -> float:
    """Until the battery is empty; registrations are a member's, typical, of 10 s."""
    mah_a_day = (ESP32_SLEEP_UA + RADIO_SLEEP_UA + regulator_ua) * 24.0 / 1000.0
    mah_a_day += registrations_a_day * registration_mah(RADIOS[0], SENT, RANGING_S[0])
    return BATTERY_MAH / mah_a_day


def awake_ma() -> float:
    """Mean of a member that ranges, typical."""
    return radio_ma(RADIOS[0], SENT) + wifi_ma()


def nap_ma(nap_s: float, regulator_ua: float) -> float:
    """Mean while a module naps in a room: it starts, joins Wi-Fi, ranges for a moment, sleeps until the next end."""
    ranging_s = SleepParameters().glance + ANSWER_S
    asleep_ma = (ESP32_SLEEP_UA + RADIO_SLEEP_UA + regulator_ua) / 1000.0
    asleep_s = nap_s - START_S - JOIN_S - ranging_s
    return (3600.0 * registration_mah(RADIOS[0], SENT, ranging_s) + asleep_s * asleep_ma) / nap_s


def room_hours(nap_s: float, regulator_ua: float, woken_an_hour: float = 0.0) -> float:
    """Until the battery is empty in a room; whoever is woken ranges until all have been settled again."""
    woken = woken_an_hour * (WOKEN_S + SleepParameters().settled) / 3600.0
    return BATTERY_MAH / (woken * awake_ma() + (1.0 - woken) * nap_ma(nap_s, regulator_ua))


def tables() -> str:
    """All, as Markdown."""
    lines = [
        "| radio | ranging s | radio mA | ESP32 mA | mAh each | registrations |",
        "|---|---|---|---|---|---|",
        f"| the paper | 10 | | | {BATTERY_MAH / PAPER_REGISTRATIONS:.2f} | {PAPER_REGISTRATIONS} |",
    ]
    for radio in RADIOS:
        currents = f"{radio_ma(radio, SENT):.0f} | {wifi_ma():.0f}"
        for seconds in RANGING_S:
            mah = registration_mah(radio, SENT, seconds)
            lines.append(f"| {radio.name} | {seconds:g} | {currents} | {mah:.2f} | {int(BATTERY_MAH / mah)} |")
    lines += [
        "",
        "| regulator | uA in all | days of standby | days with 10 registrations each |",
        "|---|---|---|---|",
    ]
    for name, regulator_ua in REGULATORS_UA.items():
        in_all = ESP32_SLEEP_UA + RADIO_SLEEP_UA + regulator_ua
        days = f"{standby_days(regulator_ua):.0f} | {standby_days(regulator_ua, 10.0):.0f}"
        lines.append(f"| {name} | {in_all:.1f} | {days} |")
    lines += [
        "",
        "| in a room | nap, s | mA on average | hours | woken 6 times an hour: hours |",
        "|---|---|---|---|---|",
    ]
    lines.append(f"| awake | | {awake_ma():.0f} | {BATTERY_MAH / awake_ma():.1f} | |")
    for nap_s in NAPS_S:
        hours = [f"{room_hours(nap_s, LEAST_UA, often):.1f}" for often in (0.0, WOKEN_AN_HOUR)]
        lines.append(f"| napping | {nap_s:g} | {nap_ma(nap_s, LEAST_UA):.1f} | {' | '.join(hours)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(tables())
