"""`microbot doctor`: what it finds of a machine, without a graph."""

import os
import threading

from microbot_ros.cli.doctor import _real_time


def test_whether_real_time_is_granted_is_said_and_not_kept(monkeypatch):
    def refused(*_):
        raise PermissionError

    before = os.sched_getscheduler(threading.get_native_id())
    assert _real_time().level in ('ok', 'warn')
    assert os.sched_getscheduler(threading.get_native_id()) == before
    monkeypatch.setattr(os, 'sched_setscheduler', refused)
    assert _real_time().level == 'warn'
    assert 'limits.conf' in _real_time().detail
