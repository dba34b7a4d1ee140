"""The README as a package index shows it: what it leads to in the repository is reached from there too.

A build takes the repository's address from SYNCHRONIZAR_REPOSITORY, which the workflow of a release sets, or from the
source distribution that it is made of (its PKG-INFO), and says it in the metadata (`Project-URL`). Links lead to the
tag of a release, and to the newest commit otherwise. Where no address is known the README stays as it is.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from email import message_from_bytes
from pathlib import Path
from typing import Any

_RELATIVE_LINK = re.compile(r"(!?)(\[[^\]]*\]\()(?![a-z]+:|#)([^)\s]+\))")


def dynamic_metadata(_settings: Mapping[str, Any], project: Mapping[str, Any]) -> dict[str, Any]:
    """`urls` and `readme` of the project, whose version is known."""
    text, address = Path("README.md").read_text(encoding="utf-8"), _repository()
    if address:
        is_release = re.fullmatch(r"\d+\.\d+\.\d+", project["version"]) is not None
        text = absolute(text, address, f"v{project['version']}" if is_release else "HEAD")
    urls = {"Repository": address} if address else {}
    return {"urls": urls, "readme": {"text": text, "content-type": "text/markdown"}}


def absolute(text: str, address: str, ref: str) -> str:
    """A Markdown text whose relative links and pictures lead into a repository at a ref."""

    def link(found: re.Match[str]) -> str:
        kind = "raw" if found[1] else "blob"
        return f"{found[1]}{found[2]}{address}/{kind}/{ref}/{found[3]}"

    return _RELATIVE_LINK.sub(link, text)


def _repository() -> str:
    """Empty where nobody says it."""
    if said := os.environ.get("SYNCHRONIZAR_REPOSITORY"):
        return said.rstrip("/")
    told = Path("PKG-INFO")
    urls = message_from_bytes(told.read_bytes()).get_all("Project-URL", []) if told.is_file() else []
    return next((url.partition(", ")[2] for url in urls if url.startswith("Repository, ")), "")
