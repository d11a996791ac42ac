"""Log of exceptions, once for each line of code that raises them: a stream may meet one with every frame."""

from __future__ import annotations

import logging


class FirstErrors:
    """Log of exceptions with their traceback; of those from one line of code only the first."""

    def __init__(self, log: logging.Logger) -> None:
        self._log, self._known = log, set[tuple[object, ...]]()

    def log(self, what: str, error: BaseException) -> None:
        """Log an exception unless one of its kind from the same line was; `what` names the failure."""
        place = error.__traceback__
        while place is not None and place.tb_next is not None:
            place = place.tb_next
        kind = type(error), place and (place.tb_frame.f_code.co_filename, place.tb_lineno)
        if kind not in self._known:
            self._known.add(kind)
            self._log.error("%s; the next ones like this are only counted", what, exc_info=error)
