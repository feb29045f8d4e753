"""Many scenes with one command, and the files of other people's data sets."""
