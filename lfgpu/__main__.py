"""The command line, as `lfgpu` and as `python -m lfgpu`."""

import sys


def main() -> None:
    """Load the commands and run the one that the arguments name."""
    try:
        from lfgpu.cli import main as run
    except KeyboardInterrupt:  # it takes a moment
        print("lfgpu: interrupted; nothing was done.", file=sys.stderr)
        raise SystemExit(130) from None
    run()


if __name__ == "__main__":
    main()
