"""An orderly end of runs that are told to stop by Ctrl-C or SIGTERM."""

import signal
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
    """Notes SIGINT and SIGTERM while it is entered; does nothing outside the main thread."""

    def __enter__(self):
        self.received, self._before = False, {}
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._before[number] = signal.signal(number, self._note) or signal.SIG_DFL
        return self

    def __exit__(self, *exc):
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number, frame):
        self.received = True
        if number == signal.SIGINT:  # a second Ctrl-C does not wait for the end of the step
            signal.signal(number, self._before[number])
