"""Registration while people walk: how soon, how true."""
