"""Logs of robots, receivers and autopilots as named channels: quantity, stamps, numbers in SI units.

A module per kind of file turns what it holds into `Channel`s, over the library that knows the kind
best, which is an extra and imported when such a file is read. What a problem makes of channels is
the problem's; nothing here knows one.
"""
