"""Property tests draw the same examples in every run, so that a change of outcome is a change of the code.

Ctrl-C is heard also where tests run in the background of a shell, which has it ignored, by them and what they start.
"""

import signal

from hypothesis import settings

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
