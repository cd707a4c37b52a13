"""Health, status and metrics of a flight over HTTP, and a full disk."""

import json
import re
import resource
import signal
import urllib.error
import urllib.request

import pytest

from conftest import fly_arguments


@pytest.fixture
def flight(program, hover, crazyflie, tmp_path):
    """Starts `downwash fly` with metrics on a simulated vehicle; returns the program and its URL."""

    def start(**options):
        arguments = fly_arguments(hover, crazyflie().peer_url(), tmp_path, "--metrics=127.0.0.1:0")
        one = program(*arguments, **options)
        line = one.lines[one.says("metrics at http") - 1]
        return one, re.search(r"http://[0-9.:]+", line).group(0)

    return start


def get(url):
    try:
        with urllib.request.urlopen(url, timeout=5) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def value(metrics, name):
    return float(re.search(rf"^downwash_{re.escape(name)} (\S+)$", metrics, re.M).group(1))


def in_flight(program, url):
    """Waits until the flight is under way; returns its metrics."""
    program.says("take_off: armed")
    while True:
        status, metrics = get(f"{url}/metrics")
        assert status == 200
        if "downwash_setpoints_total" in metrics and value(metrics, "setpoints_total") > 300:
            return metrics


def test_a_flight_serves_health_status_and_metrics(flight):
    program, url = flight()
    metrics = in_flight(program, url)
    assert value(metrics, "link_connected") == 1 and value(metrics, "armed") == 1
    assert value(metrics, "log_failures_total") == 0
    assert value(metrics, "status_age_seconds") < 2
    states = dict(re.findall(r'^downwash_flight_state\{state="(\w+)"\} (\d)$', metrics, re.M))
    assert sorted(states.values()).count("1") == 1
    for line in metrics.splitlines():
        assert re.fullmatch(r'# (HELP|TYPE) downwash_\w+ .+|downwash_\w+(\{\w+="[\w.]+"\})? -?[\d.e-]+', line), line
    status, text = get(f"{url}/status")
    report = json.loads(text)
    assert status == 200 and report["schema"] == "downwash.status" and report["armed"]
    assert get(f"{url}/health") == (200, "ok\n")
    # A brief stop of the process does not end the flight.
    program.signal(signal.SIGSTOP)
    program.signal(signal.SIGCONT)
    assert program.finish()[0] == 0, program.err


def test_a_full_disk_ends_the_log_and_not_the_flight(flight):
    def small_files():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))

    program, url = flight(preexec_fn=small_files, restore_signals=False)
    program.says("the flight continues without a log")
    metrics = in_flight(program, url)
    assert value(metrics, "log_failures_total") == 1
    status, text = get(f"{url}/health")
    assert status == 200 and "log is not written" in text
    code, _ = program.finish()
    # The flight is complete, but exit code 1 reports the missing log.
    assert code == 1, program.err
    assert "done: disarmed" in program.err
