"""The command `inteco-abs`. Data goes to stdout, messages to stderr.

Exit codes: 0 done, 1 failed, 2 wrong usage or configuration, 3 done with losses, overruns, red findings or a design's
advice to look at, 4 replay or sessions differ, 5 safety stop, 130 interrupted.
"""

import os
import sys


def main() -> None:
    """Entry point of the command; an interrupt while it is being loaded or left leaves no traceback either."""
    # numpy's OpenBLAS takes memory for a thread per CPU, which no matrix here is large enough for, and where it gets no
    # thread it raises SIGINT, which would end the command as interrupted
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        from inteco_abs.cli.command import main as verbs

        verbs()
    except KeyboardInterrupt:
        sys.exit(130)
    except RuntimeError as error:
        if not isinstance(error.__cause__, KeyboardInterrupt):
            raise
        sys.exit(130)  # so Python 3.11 calls an interrupt that comes while a class is being made
