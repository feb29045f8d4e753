"""The command's entry: an interrupt is one line also while the imports run."""

import sys


def main() -> None:
    try:
        from slepian_prt.cli import main as run
    except KeyboardInterrupt:
        sys.stderr.write("slepian-prt: interrupted; nothing was written\n")
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
