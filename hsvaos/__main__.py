"""`python -m hsvaos` and the console script."""

from __future__ import annotations

import os
import sys


def main() -> None:
    """Run the command line; errors of input end in one line and exit code 2, Ctrl-C in 130."""
    # threads of NumPy's linear algebra only wait for each other on matrices of 15 x 15
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from hsvaos.cli import app

    try:
        app()
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        sys.exit(1)
    except Exception as error:
        expected = isinstance(error, (ValueError, TypeError, OSError, MemoryError))
        if not expected and type(error).__module__.partition(".")[0] != "cv2":
            raise  # a fault of ours: its trace is what a report of it needs
        text = " ".join(str(error).split()) or type(error).__name__
        print(f"error: {text}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
