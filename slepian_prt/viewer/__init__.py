"""A page for any browser: transfer in its run-time format, lights and a program that draws them, in one file."""
