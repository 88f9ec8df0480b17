"""Training poller: updates of trainings by the poll timer, and their end when Blender quits."""

from ..process import poll_timer
from . import display, lookups, registry
from .launch import released_at_quit


def _collect() -> bool:
    """Run one task of milliseconds per poll: read events, show a picture, import splats.

    Reading and display alternate, because continuous redraws leave so few polls that each one
    finds new events.
    """
    stale = False
    for job in registry.jobs():
        shown = job.has_events and display.update(job)
        job.has_events = not shown and job.poll()
        if job.has_events and job.state.ended:
            lookups.runs.expire()
            lookups.depth_runs.expire()
        stale |= shown or job.has_events or display.update(job)
    return stale


def _waits() -> bool:
    return any(display.waits(job) for job in registry.jobs())


APPENDED = (
    (poll_timer.POLLERS, poll_timer.Poller(_collect, _waits, display.is_importing)),
    (poll_timer.POLLERS, poll_timer.Poller(lookups.collect, lookups.busy)),
)
on_register, on_unregister = released_at_quit(registry.release_all)
