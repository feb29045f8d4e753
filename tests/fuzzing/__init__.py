"""Damaged files of every kind that is read: what comes of them is the right thing, or one line."""
