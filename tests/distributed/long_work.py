"""A command that has two workers busy for a minute; says who they are when the first of them has finished something."""

import logging
import os
import signal

from slepian_prt.distributed.crew import open_crew
from tests.distributed import tasks


def main() -> None:
    """As the command line, with a task that takes long after short ones."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # shells have what they put in the background ignore it
    logging.basicConfig(level=logging.WARNING)
    with open_crew(workers=2) as crew:
        workers = crew.client.run(os.getpid).values()
        for number, _ in crew.results(crew.submit(tasks.wait, [0.0] + [30.0] * 4)):
            if number == 0:
                print(*workers, flush=True)


if __name__ == "__main__":
    main()
