"""Choosing rays, bandlimit and tolerance for a wanted error or time, from a pilot; and verifying what came of it."""
