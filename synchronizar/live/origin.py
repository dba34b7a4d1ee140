"""Which pages may speak to the server from a browser: its own. Others could use whatever the browser can reach."""

from __future__ import annotations

from urllib.parse import urlsplit


def is_own(origin: str | None, host: str, public_url: str | None = None, any_port: bool = False) -> bool:
    """Whether a page of this origin was served at `host`, or behind a proxy at `public_url`.

    Programs that are no browser say no origin; they could say any. `any_port`: for WebTransport, whose port is its own.
    """
    if origin is None:
        return True
    try:
        page, own = urlsplit(origin), [urlsplit(f"//{host}"), urlsplit(public_url or "")]
        if any_port:
            return page.hostname is not None and page.hostname in (place.hostname for place in own)
        return page.netloc != "" and page.netloc.lower() in (place.netloc.lower() for place in own)
    except ValueError:
        return False
