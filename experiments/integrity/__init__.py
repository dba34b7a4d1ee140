"""How far `registered` can be relied on: scenes with every fault at hand, solved at once and while people walk."""
