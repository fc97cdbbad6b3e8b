"""Loop of routine flight: propagation over IMU rows, with the observations between them applied at their own times."""

import math

from nav_pose_estimator.core.earth.ellipsoid import step_of
from nav_pose_estimator.core.filter import memory as at
from nav_pose_estimator.core.filter.layout import IMU_T, TIME
from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.vectors import load3
from nav_pose_estimator.core.routine import table
from nav_pose_estimator.core.routine.observations import act

AT_ROW, AT_TIME = 0, 1
"""State of the filter at the end: before a row, or at the time of an observation of which others of the same time have
already been applied."""


@kernel
def act_now(memory, events, begin, end, behind, settings, results):
    """Apply ``events`` from ``begin`` on that are due at the time of the filter and arrived by row ``behind``.

    Returns the index of the first one that was not applied: it is later, or not routine (see ``is_due``).
    """
    n = int(memory[at.STATES])
    nav, constants = memory[at.NAV : at.CONSTANTS], memory[at.CONSTANTS : at.ORIGIN]
    P = memory[at.HEAD : at.HEAD + n * n].reshape(n, n)
    k = begin
    while k < end and is_due(memory, events, k, behind) and act(nav, P, constants, events[k], settings, results[k]):
        results[k, table.RESULT_AHEAD] = behind
        k += 1
    return k


@kernel
def is_due(memory, events, k, behind):
    """Whether event ``k`` has arrived and is not later than the filter."""
    return events[k, table.EVENT_BEHIND] <= behind and events[k, table.EVENT_T] <= memory[at.NAV + TIME]


@kernel
def fly(memory, rows, begin, end, is_followed, events, settings, out, results):
    """Propagate the filter over IMU rows ``begin`` to ``end`` of ``rows`` (N, 7) and apply ``events`` (K, ...).

    There must be a row before ``begin``. An event arrives after ``EVENT_BEHIND`` of these rows. It is applied at its
    own time, but not before its arrival; at the time of the row before it, to the filter as that row left it. Events
    that arrive after the last row are applied only if it ``is_followed`` by another row, because until then more events
    may arrive. The loop ends before an event that is not routine, or before a row at which GNSS counts as lost. ``out``
    (end - begin, OUT_COLUMNS) receives the state after each row.

    Returns the numbers of processed rows and events, and the state of the filter (``AT_ROW`` or ``AT_TIME``).
    """
    done, k, count, size = 0, 0, len(events), end - begin
    while True:
        behind = int(events[k, table.EVENT_BEHIND]) if k < count else -1
        # at the time of the last row, and not at a time between rows at which an earlier call ended
        at_row = behind == done and events[k, table.EVENT_T] <= rows[begin + done - 1, IMU_T]
        if done == size and not (is_followed and at_row):
            return done, k, AT_ROW
        if at_row:
            first, last, due = done - 1, done, float(memory[at.NAV + TIME])
        else:
            last = min(behind, size) if behind > done else size
            first, last = done, _still_aided(rows, begin, done, last, settings)
            due = events[k, table.EVENT_T] if k < count and behind <= done else math.inf
            if last == done:
                return done, k, AT_ROW
        reached = at.run_block(memory, rows, begin + first, begin + last, due, out[: 0 if at_row else last]) - begin
        done = done if at_row else reached
        if at_row or reached < last:
            acted, k = k, act_now(memory, events, k, count, done, settings, results)
            if k == acted or (k < count and is_due(memory, events, k, done)):
                return done, k, AT_TIME if at_row and k > acted else AT_ROW
            if at_row:
                at.renew_checkpoint(memory)


@kernel
def sum_corrections(events, results, count, rows, begin, is_within, moves):
    """Sum the corrections of the position by the first ``count`` ``events`` of ``fly``, for each row they act behind.

    Events count one by one, or together where they came behind the row of their time. ``begin`` as in ``fly``;
    ``is_within``: it ended at ``AT_TIME``. Row k of ``moves`` (K, 4) has the number of rows before the k-th change of
    the sum, and the sum (3,) [m], ENU, until then; on entry, row 0 has that before all of them.

    Returns the number of changes, and the index of the first of the events at the time of the last row, where others
    of that time have not been applied; they do not count. -1 without such events.
    """
    k = changes = 0
    while k < count:
        first, t, ahead = k, events[k, table.EVENT_T], int(results[k, table.RESULT_AHEAD])
        k += 1
        if t == rows[begin + ahead - 1, IMU_T]:
            while k < count and events[k, table.EVENT_T] == t:
                k += 1
            if is_within and k == count:
                return changes, first
        lat0, lon0, h0 = load3(results[first], table.RESULT_BEFORE)
        lat, lon, h = load3(results[k - 1], table.RESULT_AFTER)
        if lat != lat0 or lon != lon0 or h != h0:
            moves[changes, 0] = ahead
            step = step_of(lat0, lon0, h0, lat, lon, h)
            for i in range(3):
                moves[changes + 1, 1 + i] = moves[changes, 1 + i] + step[i]
            changes += 1
    return changes, -1


@kernel
def _still_aided(rows, begin, done, stop, settings):
    """``stop``, or the first row from ``done`` on at which GNSS counts as lost."""
    used, patience = settings[table.FIX_USED], settings[table.LOST_AFTER]
    while stop > done:
        t = rows[begin + stop - 1, IMU_T]
        if t < used + patience and t - used < patience:
            break
        stop -= 1
    return stop
