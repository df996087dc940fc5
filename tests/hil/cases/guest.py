"""What the test files of this folder share. They run in the guest, as root, and end with guest.main()."""
import json
import os
import subprocess
import sys
import threading
import time
import traceback
from pathlib import Path

HOST = Path("/host")
BIN = HOST / "bin"
RESULTS = HOST / "results"
USB_CAMERA = "/dev/v4l/by-path/platform-vhci_hcd.0-usb-0:1:1.0-video-index0"  # on the first port

_tests = []
_figures = {}


class Skipped(Exception):
    """Raised by a test that can't run here; the message says why."""


def test(function):
    """Marks a test of the short set."""
    _tests.append((function, "short"))
    return function


def full(function):
    """Marks a test of the full set alone."""
    _tests.append((function, "full"))
    return function


def after_cut(function):
    """Marks a test that runs where cut_power names it."""
    _tests.append((function, "after cut"))
    return function


def cut_power(then):
    """The guest's power is cut at once; another guest runs the test `then`."""
    request = HOST / "cut.new"
    request.write_text(then)
    request.rename(HOST / "cut")
    time.sleep(30)
    raise AssertionError("the power was not cut")


def report(name, outcome, seconds, reason=""):
    """One result for the host. outcome: passed, failed or skipped."""
    global _figures
    with open(RESULTS, "a") as results:
        results.write(json.dumps({"name": name, "outcome": outcome, "seconds": round(seconds, 1), "reason": reason,
                                  "figures": _figures}) + "\n")
    _figures = {}


def figure(name, value):
    """Something measured that is shown with the test's result."""
    _figures[name] = value


def check(holds, what):
    """Fails the test with `what` where it does not hold."""
    if not holds:
        raise AssertionError(what)


def wait_until(holds, timeout_s, what):
    """Waits until holds() is true and returns what it is; fails the test after timeout_s."""
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        value = holds()
        if value:
            return value
        time.sleep(0.01)
    raise AssertionError(f"after {timeout_s} s: {what() if callable(what) else what}")


def run(*command, **options):
    """Runs a program and returns what it prints; fails the test where it fails."""
    done = subprocess.run([str(part) for part in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                          check=False, **options)
    check(done.returncode == 0, f"{command[0]} {' '.join(map(str, command[1:]))}: status {done.returncode}: {done.stdout.strip()}")
    return done.stdout


def gtest(program, select):
    """Runs cases of a GoogleTest program; each is a result of its own."""
    out = Path("/tmp/gtest.json")
    out.unlink(missing_ok=True)
    done = subprocess.run([BIN / program, f"--gtest_filter={select}", f"--gtest_output=json:{out}"], stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, text=True, check=False)
    print(done.stdout)
    check(out.exists(), f"{program} {select} wrote no results: status {done.returncode}: {done.stdout[-500:]}")
    cases = [case for suite in json.loads(out.read_text())["testsuites"] for case in suite["testsuite"]]
    check(cases, f"{program} has no test {select}")
    for case in cases:
        outcome = "skipped" if case["result"] == "SKIPPED" else "failed" if case.get("failures") else "passed"
        reason = "; ".join(failure["failure"] for failure in case.get("failures", []))
        if outcome == "skipped":
            reason = "; ".join(failure["message"] for failure in case.get("skipped", [])) or "it says so"
        report(f"{program}.{case['classname']}.{case['name']}", outcome, float(case["time"].rstrip("s")), reason)


def set_controls(device, **controls):
    run("v4l2-ctl", "-d", device, "--set-ctrl", ",".join(f"{name}={value}" for name, value in controls.items()))


def now_ns():
    return time.monotonic_ns()


class Chip:
    """A simulated GPIO chip."""

    def __init__(self, name, lines):
        self.config = Path("/sys/kernel/config/gpio-sim") / name
        bank = self.config / "bank0"
        bank.mkdir(parents=True)
        (bank / "num_lines").write_text(str(lines))
        (bank / "label").write_text(name)  # stays when the chip comes back under another name
        self.label = name
        self.make_live()

    def make_live(self):
        (self.config / "live").write_text("1")
        self.name = (self.config / "bank0/chip_name").read_text().strip()
        self.folder = Path("/sys/devices/platform") / (self.config / "dev_name").read_text().strip() / self.name

    def remove(self):
        """As if it were unplugged, whoever holds its lines."""
        (self.config / "live").write_text("0")

    def level(self, line):
        return int((self.folder / f"sim_gpio{line}/value").read_text())

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.remove()
        (self.config / "bank0").rmdir()
        self.config.rmdir()


class Lines:
    """A program that speaks JSON lines, and takes lines on standard input."""

    def __init__(self, program, *arguments, **options):
        self.process = subprocess.Popen([str(BIN / program), *map(str, arguments)], stdin=subprocess.PIPE,
                                        stdout=subprocess.PIPE, text=True, **options)
        self.lines = []
        self.reader = threading.Thread(target=self._read, daemon=True)
        self.reader.start()

    def _read(self):
        for line in self.process.stdout:
            self.lines.append(json.loads(line))

    def tell(self, line):
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def of(self, event, since=0):
        """What was said of an event, beginning at the since-th line."""
        return [line for line in self.lines[since:] if line["event"] == event]

    def wait_for(self, event, timeout_s=10, since=0, **values):
        """The first line of an event that has all these values."""
        def found():
            return next((line for line in self.of(event, since) if all(line.get(k) == v for k, v in values.items())), None)
        return wait_until(found, timeout_s, lambda: f"no {event} {values}; the last lines: "
                          f"{[line for line in self.lines if line['event'] != 'frame'][-4:]}")

    def end(self):
        """Ends the program and returns its last line."""
        if self.process.poll() is None:
            self.process.stdin.close()
            self.process.wait(20)
        self.reader.join(20)
        return self.lines[-1]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()


class Camera(Lines):
    """The emulated USB camera, plugged in where not said otherwise."""

    def __init__(self, plugged=True, port=0):
        super().__init__("usb_camera", f"--port={port}")
        if plugged:
            self.plug()
            device = USB_CAMERA.replace("usb-0:1:", f"usb-0:{port + 1}:")
            wait_until(Path(device).exists, 10, f"no {device}")

    def plug(self):
        since = len(self.lines)
        self.tell("plug")
        return self.wait_for("plugged", since=since)["time_ns"]

    def unplug(self):
        since = len(self.lines)
        self.tell("unplug")
        return self.wait_for("unplugged", since=since)["time_ns"]

    def status(self):
        since = len(self.lines)
        self.tell("status")
        return self.wait_for("status", since=since)


class Probe(Lines):
    """A camera opened through the product's driver: camera_probe."""

    def __init__(self, device, **options):
        arguments = [f"--{name.replace('_', '-')}={one}" for name, value in options.items()
                     for one in (value if isinstance(value, list) else [value])]
        super().__init__("camera_probe", device, *arguments)

    def frames(self, since=0):
        return self.of("frame", since)

    def status(self):
        """Its counters, now."""
        since = len(self.lines)
        self.tell("status")
        return self.wait_for("status", since=since)

    def wait_frames(self, count, timeout_s=20, since=None):
        """Waits for further frames and returns them."""
        since = len(self.lines) if since is None else since
        wait_until(lambda: len(self.frames(since)) >= count, timeout_s,
                   lambda: f"{len(self.frames(since))} of {count} frames; the last of the rest: "
                   f"{[line for line in self.lines if line['event'] != 'frame'][-3:]}")
        return self.frames(since)

    def wait_state(self, state, timeout_s=10, since=0):
        return self.wait_for("state", timeout_s, since, state=state)


def check_counted(status, *causes):
    """Of the counters of faults only `causes` may have counted; and what an emulated, busy machine is too slow for: frames
    that the driver leaves out, or stamps late."""
    names = ("damaged", "truncated", "undecodable", "stale", "undated", "reopened")
    others = {name: status[name] for name in names if status[name] and name not in causes}
    check(not others, f"counted without such a fault: {others}")


def check_frames_in_order(frames):
    """Numbers and times of delivered frames grow."""
    for before, after in zip(frames, frames[1:]):
        check(after["sequence"] > before["sequence"], f"number {after['sequence']} after {before['sequence']}")
        check(after["timestamp_ns"] > before["timestamp_ns"], f"time {after['timestamp_ns']} after {before['timestamp_ns']}")
        check(after["timestamp_ns"] <= after["arrival_ns"], "a frame from the future")


def check_pictures(frames):
    """Every frame is a whole picture, and none comes twice or earlier than the one before."""
    for frame in frames:
        check("picture" in frame or frame["corrupt"], f"no number in the pixels of frame {frame['sequence']}")
    numbers = [frame["picture"] for frame in frames if "picture" in frame]
    for before, after in zip(numbers, numbers[1:]):
        check(after > before, f"picture {after} after {before}")
    check_frames_in_order(frames)


def come_and_go(probe, leave, come, times, gone=("absent",)):
    """A camera leaves and comes back `times` times. leave() and come() do it and return when; `gone` are the states that count
    as noticed. Each is noticed and recovered from, nothing else is counted, and neither descriptors nor memory leak."""
    noticed_s = []
    recovered_s = []
    first = probe.status()
    for i in range(times):
        since = len(probe.lines)
        start = leave()
        seen = wait_until(lambda: next((line for line in probe.of("state", since) if line["state"] in gone), None), 10,
                          "nobody notices that it is gone")
        noticed_s.append((seen["time_ns"] - start) / 1e9)
        since = len(probe.lines)
        start = come()
        recovered_s.append((probe.wait_state("streaming", since=since, timeout_s=30)["time_ns"] - start) / 1e9)
        probe.wait_frames(3)
        if i == 1:
            second = probe.status()
    end = probe.end()
    figure("noticed after, s: mean, max", [round(sum(noticed_s) / times, 3), round(max(noticed_s), 3)])
    figure("recovered after, s: mean, max", [round(sum(recovered_s) / times, 2), round(max(recovered_s), 2)])
    figure("memory, kB: then, now", [second["resident_kb"], end["resident_kb"]])
    check(end["reopened"] == times, f"reopened {end['reopened']} times, not {times}")
    check(end["descriptors"] == first["descriptors"], f"descriptors: {first['descriptors']}, then {end['descriptors']}")
    check(end["resident_kb"] < second["resident_kb"] + 2000, f"memory: {second['resident_kb']} kB, then {end['resident_kb']} kB")
    check_counted(end, "reopened")


def main():
    """Runs the tests of the file: those of the short set, or with --full all; only those named, where names are given."""
    # Else the kernel makes huge pages of small ones by and by, and what a process holds resident grows by itself, the more the longer
    # a test takes.
    Path("/sys/kernel/mm/transparent_hugepage/enabled").write_text("never")
    everything = "--full" in sys.argv
    names = [argument for argument in sys.argv[1:] if argument != "--full"]
    for function, kind in _tests:
        name = function.__name__
        if name not in names if names else kind == "after cut" or (kind == "full" and not everything):
            continue
        print(f"--- {name}", flush=True)
        start = time.monotonic()
        try:
            told = function()
            if told != "reported":
                report(name, "passed", time.monotonic() - start)
        except Skipped as reason:
            report(name, "skipped", time.monotonic() - start, str(reason))
        except Exception as error:  # whatever a test raises is its failure
            traceback.print_exc(file=sys.stdout)
            print("kernel:", *subprocess.run(["dmesg"], capture_output=True, text=True).stdout.splitlines()[-12:], sep="\n  ")
            report(name, "failed", time.monotonic() - start, f"{type(error).__name__}: {error}")
        sys.stdout.flush()
    os.sync()
