"""Incremental tasks: generators with steps on the calling thread, and parallel work; no bpy."""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, TypeVar

from .background_task import BackgroundTask

ResultT = TypeVar("ResultT")
BUDGET = 0.008
"""Seconds of a piece in which anything is begun; the last thing may take as long again."""
Check = Callable[[], None]
"""Raises where the work is no longer wanted."""


@dataclass(frozen=True)
class ThreadCall:
    """What a generator yields to have a function called in a thread."""

    function: Callable[[Check], Any]
    sentence: str
    """What is under way meanwhile."""


Pieces = Generator[str | ThreadCall, Any, ResultT]
"""Work that yields after each piece how far it is, a sentence, and returns what came of it.

A piece on Blender's main thread is short: some hundredths of a second. `run_in_thread` takes what
is not. What has to be undone where the work is given up stands in `finally`.
"""


def run_in_thread(function: Callable[[Check], ResultT], sentence: str) -> Pieces[ResultT]:
    """Call a function in a thread; what it returns or raises is returned or raised here.

    Args:
        function: Must not touch bpy. Is given what raises where its result is no longer wanted.
        sentence: What is under way meanwhile.
    """
    return (yield ThreadCall(function, sentence))


class TaskRunner:
    """Work whose pieces are done one at a time, whenever its owner has time."""

    def __init__(self, pieces: Pieces[Any]) -> None:
        """Nothing is done yet."""
        self.sentence = ""
        """How far it is."""
        self.result: Any = None
        """What came of it, once it is done."""
        self._pieces = pieces
        self._task: BackgroundTask | None = None

    def step(self) -> bool:
        """Do the next piece, unless a thread is waited for; whether all is done.

        Raises:
            Whatever the work does; it is over then.
        """
        if self._task is not None and self._task.running:
            return False
        task, self._task = self._task, None
        try:
            if task is None:
                asked = next(self._pieces)
            elif task.error is not None:
                asked = self._pieces.throw(task.error)
            else:
                asked = self._pieces.send(task.result)
        except StopIteration as end:
            self.result = end.value
            return True
        if isinstance(asked, ThreadCall):
            self.sentence, function = asked.sentence, asked.function
            self._task = BackgroundTask(lambda task: function(task.check))
        else:
            self.sentence = asked
        return False

    def cancel(self) -> None:
        """Give it up."""
        if self._task is not None:
            self._task.cancel()
        self._pieces.close()


def run_blocking(pieces: Pieces[ResultT]) -> ResultT:
    """Do all of some work here and now, without a thread."""
    go_on: Callable[[], str | ThreadCall] = partial(next, pieces)
    try:
        while True:
            asked = go_on()
            waits = isinstance(asked, ThreadCall)
            go_on = _answered(pieces, asked) if waits else partial(next, pieces)
    except StopIteration as end:
        return end.value


def _answered(pieces: Pieces[Any], asked: ThreadCall) -> Callable[[], str | ThreadCall]:
    """How the work goes on with what comes of a function that is called here."""
    try:
        return partial(pieces.send, asked.function(lambda: None))
    except Exception as error:
        return partial(pieces.throw, error)


class Steps(Protocol):
    """Work that is written as an object instead."""

    @property
    def sentence(self) -> str:
        """How far it is."""

    def step(self) -> Any:
        """Do a small piece; what came of it once all is done, until then None."""

    def cancel(self) -> None:
        """Leave nothing."""


def stepped(steps: Steps) -> Pieces[Any]:
    """The same as `Pieces`; where it fails or is given up it leaves nothing."""
    done = False
    try:
        while (result := steps.step()) is None:
            yield steps.sentence
        done = True
        return result
    finally:
        if not done:
            steps.cancel()
