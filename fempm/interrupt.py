"""An orderly end of runs that are told to stop by Ctrl-C or SIGTERM."""

import signal
import sys
import threading


class Interrupted(SystemExit):
    """A run that was told to stop: ends the program with status 130 and no traceback.

    Attributes
    ----------
    path : checkpoint to go on from
    """

    def __init__(self, path, time, steps):
        super().__init__(130)
        self.path = path
        self.message = (
            f"stopped at time {time:.6g}, step {steps}; the state is in {path}, "
            f"the same command with --restart {path} goes on from there"
        )


class StopRequests:
    """Notes SIGINT and SIGTERM while it is entered, and says at the end how to go on after Interrupted.

    Outside the main thread, where Python has no signal handlers, nothing is noted.
    """

    def __init__(self, ranks):
        self.ranks = ranks

    def __enter__(self):
        self.received, self._before = False, {}
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._before[number] = signal.signal(number, self._note) or signal.SIG_DFL
        return self

    def __exit__(self, kind, error, traceback):
        for number, handler in self._before.items():
            signal.signal(number, handler)
        if isinstance(error, Interrupted):  # together, as the first rank to end may end all
            self.ranks.broadcast(lambda: print(error.message, file=sys.stderr, flush=True))

    def _note(self, number, frame):
        self.received = True
        if number == signal.SIGINT:  # a second Ctrl-C does not wait for the end of the step
            signal.signal(number, self._before[number])
