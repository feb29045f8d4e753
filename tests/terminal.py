"""A pseudo terminal of a given width."""

import fcntl
import os
import pty
import struct
import subprocess
import termios


def run_in_terminal(arguments: list, columns: int, **streams: int) -> str:
    """All that a command, which must succeed, writes on a terminal so wide; `streams` go elsewhere."""
    leader, follower = pty.openpty()
    fcntl.ioctl(follower, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    process = subprocess.Popen(
        arguments,
        **{"stdin": follower, "stdout": follower, "stderr": follower, **streams},
        env={**environment, "TERM": "xterm"},
        start_new_session=True,
    )
    os.close(follower)
    written = b""
    while True:
        try:
            chunk = os.read(leader, 65536)
        except OSError:  # the other end is closed
            break
        if not chunk:
            break
        written += chunk
    os.close(leader)
    assert process.wait(timeout=60) == 0
    return written.decode(errors="replace")
