"""Columns and settings that nobody reads, and names in the ranges that nobody has."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import Path

from synchronizar.data.findings import Code, Finding
from synchronizar.io.ranges_csv import OPTIONAL, REQUIRED, unknown_columns
from synchronizar.io.recording_toml import SETTINGS
from synchronizar.io.text import quoted

MEANT = {
    "variance": "write its square root as a column sigma (m, 1 sigma)",
    "var": "write its square root as a column sigma (m, 1 sigma)",
    "cov": "write its square root as a column sigma (m, 1 sigma)",
    "std": "call it sigma (m, 1 sigma)",
    "stddev": "call it sigma (m, 1 sigma)",
    "std_dev": "call it sigma (m, 1 sigma)",
    "sigma_m": "call it sigma (m, 1 sigma)",
    "rssi": "call it rx_power where it is the received power in dBm",
    "rx": "call it rx_power where it is the received power in dBm",
    "fp": "call it fp_power where it is the power of the first path in dBm",
    "fp_rssi": "call it fp_power where it is the power of the first path in dBm",
    "los": "write its contrary as a column nlos (1 where the line of sight is blocked)",
}
"""What is probably meant by columns that other programs write."""


def unknown_column_findings(path: Path) -> list[Finding]:
    """Of each named column of ranges.csv that nobody reads."""
    return [
        Finding(
            Code.UNKNOWN_COLUMN,
            None,
            f"{path.name} has a column {quoted(name)}, which is not read",
            MEANT.get(name.lower()) or _similar(name, REQUIRED + OPTIONAL) or "remove it if it says nothing of use",
        )
        for name in unknown_columns(path)
    ]


def unknown_setting_findings(path: Path, settings: list[str]) -> list[Finding]:
    """Of each setting of recording.toml that nobody reads; `register` refuses it."""
    found = []
    for setting in settings:
        parts = setting.split(".")
        user = parts[1] if len(parts) > 2 else None
        remedy = _similar(parts[-1], SETTINGS if user is not None else ("up", "users")) or "remove it"
        found.append(
            Finding(Code.UNKNOWN_SETTING, user, f"{path.name} has a setting {setting}, which is not read", remedy)
        )
    return found


def unknown_user_finding(name: str, ranges: int, users: list[str]) -> Finding:
    """Of a name that ranges have and nobody else; `register` refuses it."""
    return Finding(
        Code.UNKNOWN_USER,
        name,
        f"{ranges} ranges name {name}, which has no track tracks/{name}.tum and no settings",
        _similar(name, users, "in ranges.csv")
        or f"if it is a radio that stands still, write `static = true` under [users.{name}] in recording.toml",
    )


def _similar(name: str, known: list[str] | tuple[str, ...], where: str = "") -> str | None:
    """The known name that is the same but for capitals, blanks or a slip."""
    by_letters = {k.lower(): k for k in known}
    plain = name.strip().lower().replace("-", "_").replace(" ", "_")
    near = [plain] if plain in by_letters else get_close_matches(plain, by_letters, n=1, cutoff=0.85)
    return f"call it {by_letters[near[0]]}{' ' if where else ''}{where}" if near else None
