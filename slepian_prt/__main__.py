"""The command's entry: an interrupt is one line also while the imports run."""

import sys


def main() -> None:
    """Run the command and exit with its status."""
    try:
        from slepian_prt.cli import main as run
        from slepian_prt.machine.threads import start_with_one_blas_thread

        start_with_one_blas_thread()
    except KeyboardInterrupt:
        sys.stderr.write("slepian-prt: interrupted; nothing was written\n")
        sys.exit(130)
    sys.exit(run())


if __name__ == "__main__":
    main()
