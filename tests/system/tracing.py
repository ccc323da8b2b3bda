"""Coverage's tracer, taken away for a while: it makes pure computing three to five times as slow."""

import sys


def untraced(compute, *arguments):
    """What it gives, without the tracer: for thousands of ticks on lines that other tests reach too."""
    tracer = sys.gettrace()
    sys.settrace(None)
    try:
        return compute(*arguments)
    finally:
        sys.settrace(tracer)
