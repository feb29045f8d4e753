"""What the machine, and the part of it that we may use, has: cores and memory."""
