"""The battery's arithmetic, beside values worked out by hand."""

import pytest
from support.paths import REPOSITORY

from experiments.modules.battery import (
    RADIOS,
    SENT,
    Radio,
    awake_ma,
    nap_ma,
    radio_ma,
    registration_mah,
    room_hours,
    standby_days,
    tables,
    wifi_ma,
)

TYPICAL, AT_MOST = RADIOS
DOCUMENT = REPOSITORY / "firmware/BATTERY.md"


def test_a_member_sends_a_quarter_of_the_slots_and_receives_the_rest_of_the_time() -> None:
    # 234 us of 4 ms are 5.85 %: 0.0585 * 83 + 0.9415 * 118.
    assert radio_ma(TYPICAL, SENT) == pytest.approx(115.9525)
    # 468 us are 11.7 %: 0.117 * 83 + 0.883 * 118.
    assert radio_ma(TYPICAL, 2) == pytest.approx(113.905)


def test_a_radio_that_never_sends_only_receives() -> None:
    assert radio_ma(Radio("", receive=100.0, send=0.0), 0) == 100.0


def test_wifi_sends_an_eightieth_of_the_time() -> None:
    assert wifi_ma() == pytest.approx(190 / 80 + 100 * 79 / 80)


def test_the_charge_of_a_registration_is_that_of_its_three_parts() -> None:
    # 0.4 s * 68 + 2 s * 100 + 10 s * (115.9525 + 101.125) = 27.2 + 200 + 2170.775 = 2397.975 mAs.
    assert registration_mah(TYPICAL, SENT, 10.0) == pytest.approx(2397.975 / 3600)
    # 227.2 + 3 * (0.117 * 140 + 0.883 * 160 + 101.125) = 227.2 + 776.355 mAs.
    assert registration_mah(AT_MOST, 2, 3.0) == pytest.approx(1003.555 / 3600)


def test_standby_is_the_sum_of_three_currents() -> None:
    # 10 + 0.55 + 1.6 = 12.15 uA: 0.2916 mAh a day.
    assert standby_days(1.6) == pytest.approx(600 / 0.2916)
    # With ten registrations of 0.666104 mAh: 6.952642 mAh a day.
    assert standby_days(1.6, 10.0) == pytest.approx(86.298, abs=0.001)


def test_a_nap_is_a_start_a_moment_of_ranging_and_sleep() -> None:
    # 27.2 + 200 + 1.1 s * 217.0775 = 465.98525 mAs, and 16.5 s of 12.15 uA: 0.200475 mAs; in 20 s.
    assert nap_ma(20.0, 1.6) == pytest.approx(466.185725 / 20)
    assert room_hours(20.0, 1.6) == pytest.approx(600 * 20 / 466.185725)


def test_who_is_woken_is_awake_for_as_long_as_it_takes() -> None:
    # Six times 30 s are a twentieth of the time.
    assert awake_ma() == pytest.approx(217.0775)
    assert room_hours(20.0, 1.6, 6.0) == pytest.approx(600 / (0.05 * 217.0775 + 0.95 * 23.309286), rel=1e-6)


def test_the_document_has_the_tables_of_the_script() -> None:
    assert tables() in DOCUMENT.read_text()
