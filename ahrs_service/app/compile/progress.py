"""Progress of kernel compilation: kernel n of m, on stderr, in any command that needs them.

A bar in a terminal, elsewhere a line every few seconds. Code loaded from the cache prints
nothing.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import CodeType, ModuleType
from typing import Any, Final

from numba.core import event
from numba.core.dispatcher import Dispatcher
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

LINE_EVERY_S: Final = 4.0
"""Time between two lines where there is no terminal [s]."""
_EVENT: Final = "numba:compile"


class CompileProgress(event.Listener):
    """Listens to the compiler; `compiled` counts this package's kernels, `spent_s` their time [s].

    The kernels ahead are those that the outermost one names, directly or not.
    """

    def __init__(self, console: Console) -> None:
        self.compiled = 0
        self.spent_s = 0.0
        self._console = console
        self._bar: Progress | None = None
        self._nested: list[Dispatcher] = []
        self._ahead: set[Any] = set()
        self._began_s = self._line_s = 0.0

    def on_start(self, event: Any) -> None:
        """Note that compilation of a function starts."""
        dispatcher = event.data["dispatcher"]
        if not self._nested:
            self._begin(dispatcher)
        self._nested.append(dispatcher)

    def on_end(self, event: Any) -> None:
        """Count it and report it when due; the outermost ends the display."""
        if not self._nested:
            # Another thread had begun it before this listener was there.
            return
        dispatcher = self._nested.pop()
        if _is_ours(dispatcher.py_func):
            self.compiled += 1
            self._done.add(dispatcher.py_func.__code__)
            self._show()
        if not self._nested:
            self._end()

    def _begin(self, outermost: Dispatcher) -> None:
        self._began_s, self._done = time.monotonic(), set[CodeType]()
        self._ahead = reachable(outermost)
        self._line_s = -LINE_EVERY_S
        if self._console.is_terminal:
            columns = (
                TextColumn("compiling kernel"),
                MofNCompleteColumn(),
                BarColumn(),
                TimeElapsedColumn(),
                TextColumn("(first start only)"),
            )
            self._bar = Progress(*columns, console=self._console, transient=True)
            self._bar.add_task("", total=len(self._ahead))
            self._bar.start()
        self._show()

    def _show(self) -> None:
        done = len(self._done & self._ahead)
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], completed=done)
            return
        now_s = time.monotonic()
        # The small ones are done before progress is worth showing.
        if len(self._ahead) > 1 and now_s - self._line_s >= LINE_EVERY_S:
            self._line_s = now_s
            number = min(done + 1, len(self._ahead))
            self._console.print(
                f"compiling kernel {number} of {len(self._ahead)} (first start only)"
            )

    def _end(self) -> None:
        self.spent_s += time.monotonic() - self._began_s
        if self._bar is not None:
            self._bar.stop()
            self._bar = None


@contextmanager
def telling(console: Console) -> Iterator[CompileProgress]:
    """Report everything that is compiled in the block."""
    listener = CompileProgress(console)
    with event.install_listener(_EVENT, listener):
        yield listener


def reachable(outermost: Dispatcher) -> set[CodeType]:
    """Return the code of `outermost` and of all kernels of this package that it may call.

    A call is `name(...)` of a global, or `module.name(...)`.
    """
    found: set[CodeType] = set()
    todo = [outermost.py_func]
    while todo:
        function = todo.pop()
        code = function.__code__
        if code in found:
            continue
        found.add(code)
        for name in code.co_names:
            value = function.__globals__.get(name)
            values = (
                [getattr(value, each, None) for each in code.co_names]
                if isinstance(value, ModuleType)
                else [value]
            )
            todo += [
                each.py_func
                for each in values
                if isinstance(each, Dispatcher) and _is_ours(each.py_func)
            ]
    return found


def _is_ours(function: Any) -> bool:
    return str(function.__module__).startswith("ahrs_service.")
