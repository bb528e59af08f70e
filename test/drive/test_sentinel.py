"""The sentinel, over pipes in the place of lines."""

import os
import signal
import subprocess
import sys
import time

import pytest

from bench._emulator import until
from microbot_ros.drive import last_resort, sentinel
from microbot_ros.drive.amplifiers.roboclaw import driver as roboclaw

pytestmark = pytest.mark.rig

DRIVING = (1.0, -1.0, 0.5, 0.2)


@pytest.fixture
def lines():
    """Two pipes in the place of lines: what can be read, and what is written to."""
    pipes = [os.pipe() for _ in range(2)]
    for reading, _ in pipes:
        os.set_blocking(reading, False)
    yield [reading for reading, _ in pipes], [writing for _, writing in pipes]
    for pipe in pipes:
        for end in pipe:
            os.close(end)


def said(reading):
    try:
        return os.read(reading, 65536)
    except BlockingIOError:
        return b''


WORDS = (b'zero\xff', b'nought')


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGHUP, signal.SIGTERM])
def test_the_sentinel_says_the_last_words_when_it_is_not_fed(lines, number):
    heard, writing = lines
    last = last_resort.LastResort(list(zip(writing, WORDS, strict=True)))
    process = last._process
    try:
        assert last.feed()
        until(lambda: said(heard[0]))  # nobody feeds it
        until(lambda: said(heard[1]))
        for _ in range(3):
            assert said(heard[0]) in (b'', *(n * WORDS[0] for n in range(1, 20)))
            until(lambda: said(heard[0]))  # and again
        process.send_signal(number)
        until(lambda: said(heard[0]))
        assert process.poll() is None
    finally:
        begin = time.monotonic()
        last.dismiss()
    assert process.returncode == 0
    assert time.monotonic() - begin < 8.0
    assert not last.feed() or not last._say(b'.')


def test_the_sentinel_is_quiet_while_it_is_fed(lines, monkeypatch):
    monkeypatch.setattr(last_resort, '_SILENCE_S', 1.5)
    heard, writing = lines
    last = last_resort.LastResort(list(zip(writing, WORDS, strict=True)))
    end = time.monotonic() + 2.5
    while time.monotonic() < end:
        assert last.feed()
        time.sleep(0.02)
    assert said(heard[0]) == said(heard[1]) == b''
    last.dismiss()
    assert said(heard[0]) == b''


def test_the_sentinel_is_fed_now_and_then_and_not_each_time(monkeypatch):
    last = last_resort.LastResort([])
    fed = []
    monkeypatch.setattr(last, '_say', lambda word: fed.append(word) or False)
    assert last.feed() is False
    assert last.feed() is True
    until(lambda: not last.feed())
    assert fed == [b'.', b'.']
    monkeypatch.undo()
    last.dismiss()


def test_the_sentinel_has_a_session_of_its_own_and_is_as_quick_as_the_watchdogs_of_devices():
    """What is sent to all of the host's group, of a terminal, is not sent to it."""
    last = last_resort.LastResort([])
    assert os.getsid(last._process.pid) == last._process.pid
    assert float(last._process.args[4]) <= roboclaw._WATCHDOG_S
    last.dismiss()
    assert last_resort._FEED_S <= last_resort._SILENCE_S / 4  # three that are lost are no end


@pytest.mark.parametrize('end', ['dismiss', 'abandon'])
def test_nothing_is_written_to_what_was_the_pipe_of_a_sentinel(tmp_path, end):
    last = last_resort.LastResort([])
    number = last._feed
    getattr(last, end)()
    last._process.wait(8.0)
    until(lambda: last._pipe.closed)
    with (tmp_path / 'other').open('wb') as other:
        os.dup2(other.fileno(), number)  # another file that got the number
        try:
            assert not last._say(b'.')
        finally:
            os.close(number) if number != other.fileno() else None
    assert (tmp_path / 'other').read_bytes() == b''


def test_a_sentinel_that_hangs_holds_nobody_up(monkeypatch, patience):
    patience(sentinel_s=0.05)
    monkeypatch.setattr(last_resort, '_FEED_S', 0.0)
    last = last_resort.LastResort([])
    os.kill(last._process.pid, signal.SIGSTOP)
    fed = 0
    while last.feed():
        fed += 1
    assert fed <= 4096  # a minute and a half, at fifty a second
    last.dismiss()
    assert last._process.returncode == -signal.SIGKILL


def test_the_sentinel_outlives_its_host_until_all_is_at_zero(lines):
    heard, writing = lines
    arguments = [f'{line}={word.hex()}' for line, word in zip(writing, WORDS, strict=True)]
    process = subprocess.Popen(
        [sys.executable, '-I', '-S', sentinel.__file__, '60', *arguments], stdin=subprocess.PIPE,
        pass_fds=writing)
    process.stdin.write(b'....')
    process.stdin.flush()
    time.sleep(0.05)
    assert said(heard[0]) == b''
    begin = time.monotonic()
    process.stdin.close()  # as when the host dies
    assert process.wait(10.0) == 0
    assert time.monotonic() - begin >= sentinel.REPEATS * sentinel.AGAIN_S
    assert said(heard[0]) == sentinel.REPEATS * WORDS[0]
    assert said(heard[1]) == sentinel.REPEATS * WORDS[1]


def test_an_abandoned_sentinel_zeroes_and_ends_and_leaves_no_zombie(lines):
    heard, writing = lines
    last = last_resort.LastResort(list(zip(writing, WORDS, strict=True)))
    assert last.feed()
    begin = time.monotonic()
    last.abandon()
    assert time.monotonic() - begin < sentinel.REPEATS * sentinel.AGAIN_S  # it does not wait
    until(lambda: last._process.returncode is not None)
    assert last._process.returncode == 0
    with pytest.raises(ChildProcessError):
        os.waitpid(last._process.pid, 0)  # reaped already
    # As often, or oftener where it was not fed for long before.
    said_s = [said(line) for line in heard]
    for word, words in zip(WORDS, said_s, strict=True):
        assert words == word * (len(words) // len(word))
        assert len(words) >= sentinel.REPEATS * len(word)


def test_an_abandoned_sentinel_that_hangs_holds_nobody_up_and_is_killed():
    last = last_resort.LastResort([])
    os.kill(last._process.pid, signal.SIGSTOP)
    last.abandon()
    assert last._process.returncode is None
    until(lambda: last._process.returncode == -signal.SIGKILL)


def test_the_sentinel_moves_before_it_watches(monkeypatch):
    did = []
    monkeypatch.setattr(sentinel, 'step_aside', lambda: did.append('aside'))
    monkeypatch.setattr(sentinel, 'watch', lambda silence_s, words, _: did.append(
        (silence_s, words)))
    monkeypatch.setattr(signal, 'signal', lambda *_: None)
    monkeypatch.setattr(sys, 'argv', ['sentinel.py', '0.5', '3=ff00'])
    with open(os.devnull, encoding='utf-8') as feed:
        monkeypatch.setattr(sys, 'stdin', feed)
        sentinel.main()
    assert did == ['aside', (0.5, [(3, b'\xff\x00')])]


@pytest.mark.parametrize(('group', 'aside'), [
    ('/user.slice/app.slice/microbot.service', '/user.slice/app.slice/microbot_sentinels'),
    ('/microbot.service', '/microbot_sentinels')])
def test_the_sentinel_moves_to_a_control_group_beside_that_of_its_host(tmp_path, group, aside):
    own = tmp_path / 'own'
    own.write_text(f'1:name=systemd:/old\n0::{group}\n')
    (tmp_path / group[1:]).mkdir(parents=True)
    for _ in range(2):
        assert sentinel.step_aside(str(tmp_path), str(own)) is True
        assert (tmp_path / aside[1:] / 'cgroup.procs').read_text() == str(os.getpid())


@pytest.mark.parametrize('group', ['0::/', '1:name=systemd:/old', ''])
def test_the_sentinel_stays_where_there_is_no_group_beside(tmp_path, group):
    own = tmp_path / 'own'
    own.write_text(group)
    assert sentinel.step_aside(str(tmp_path), str(own)) is False
    assert sentinel.step_aside(str(tmp_path), str(tmp_path / 'gone')) is False
    assert sorted(tmp_path.iterdir()) == [own]


def test_the_sentinel_stays_where_it_may_not_move(tmp_path):
    own = tmp_path / 'own'
    own.write_text('0::/a/b')
    (tmp_path / 'a').write_text('no folder')
    assert sentinel.step_aside(str(tmp_path), str(own)) is False


def test_a_line_that_is_gone_does_not_keep_the_others_from_being_zeroed(lines):
    heard, writing = lines
    gone = os.dup(writing[0])
    os.close(gone)
    sentinel.say([(gone, b'x'), (writing[1], b'y')])
    assert said(heard[1]) == b'y'
