"""facetd with real cameras of the kernel: it starts without one, and lives through what happens to them."""
import json
import os
import signal
import subprocess
import time

import guest
from guest import BIN, Camera, Path, check, figure, full, run, test, wait_until

CAMERA = guest.USB_CAMERA
ASSETS = Path("/host/assets")
FOLDER = Path("/tmp/facet")
SEARCHED_FRAMES = 16  # by then the search for a face has been everywhere in a picture of 320x240
MOST_LEAK_KB = 100  # each time the camera is unplugged; one of its pictures has 300


class Daemon:
    """facetd, without refinement: there is no GPU in the guest."""

    def __init__(self, **source):
        if not (ASSETS / "default.facemodel").exists():
            raise guest.Skipped("the face model and the landmark nets are not there: packaging/prepare makes them")
        (FOLDER / "takes").mkdir(parents=True, exist_ok=True)
        keys = {"kind": "v4l2", "device": CAMERA, "width_px": 320, "height_px": 240, "rate_hz": 15.0, "stall_after_ms": 1500, **source}
        self.config = FOLDER / "facet.toml"
        self.config.write_text("\n".join(
            ["[source]", *(f"{key} = {json.dumps(value)}" for key, value in keys.items()), "[gpu]", 'device = "none"', "[stream]",
             f'socket = "{FOLDER}/stream.sock"', "[control]", f'socket = "{FOLDER}/control.sock"', "[takes]",
             f'folder = "{FOLDER}/takes"']))
        self.log = open(FOLDER / "log", "w+")
        self.start_ns = guest.now_ns()
        self.process = subprocess.Popen([BIN / "facetd", f"--config={self.config}"], stderr=self.log, stdout=self.log,
                                        env={**os.environ, "FACET_ASSETS": str(ASSETS)})

    def facet(self, *arguments):
        return run(BIN / "facet", *arguments, f"--config={self.config}")

    def status(self):
        """What `facet status` says; nothing while the daemon does not answer."""
        done = subprocess.run([BIN / "facet", "status", "--json", f"--config={self.config}"], capture_output=True, text=True, check=False)
        return json.loads(done.stdout) if done.returncode == 0 else None

    def wait_camera(self, state, timeout_s=120):
        """Waits for a state of the camera; the status."""
        last = {}

        def there():
            nonlocal last
            check(self.process.poll() is None, f"facetd ended with {self.process.poll()}: {self.said()}")
            last = self.status() or last
            return last if last.get("camera", {}).get("state") == state else None
        return wait_until(there, timeout_s, lambda: f"the camera is not {state}: {last}; {self.said()}")

    def wait_frames(self, more, timeout_s=60):
        """Waits until so many further frames were delivered."""
        before = self.status()["camera"]["frames"]["delivered"]
        return wait_until(lambda: (status := self.status())["camera"]["frames"]["delivered"] >= before + more and status, timeout_s,
                          lambda: f"no frames: {self.status()}")

    def wait_processed(self, frames, timeout_s=240):
        """Waits until so many frames were processed since the start. Asks seldom, for that takes time from the tracker."""
        def there():
            time.sleep(1)
            return self.status()["frames"]["processed"] >= frames
        wait_until(there, timeout_s, lambda: f"too few frames: {self.status()}")

    def said(self):
        return Path(self.log.name).read_text()[-1500:]

    def descriptors(self):
        return len(os.listdir(f"/proc/{self.process.pid}/fd"))

    def resident_kb(self):
        return int(next(line for line in Path(f"/proc/{self.process.pid}/status").read_text().splitlines()
                        if line.startswith("VmRSS")).split()[1])

    def stop(self):
        """Ends it as systemd does; it must end well."""
        self.process.send_signal(signal.SIGTERM)
        check(self.process.wait(30) == 0, f"facetd ended with {self.process.returncode}: {self.said()}")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        self.log.close()


@test
def starts_without_a_camera():
    """It serves in a reported state, and streams once there is one."""
    with Camera(plugged=False) as camera, Daemon() as daemon:
        status = daemon.wait_camera("absent")
        figure("answers after, s", round((guest.now_ns() - daemon.start_ns) / 1e9, 1))
        figure("it says", [status["state"], status["camera"]["reason"]])
        check("no such device" in status["camera"]["reason"], status)
        start = camera.plug()
        daemon.wait_camera("streaming")
        figure("streaming after the plug, s", round((guest.now_ns() - start) / 1e9, 1))
        status = daemon.wait_frames(10)
        check(status["state"] == "running", status["state"])
        daemon.stop()
        camera.end()


def unplug_and_plug(times):
    """Each time is noticed and recovered from; after the first one neither descriptors nor memory leak.

    What is resident must not depend on how busy the machine is. It is read first when what grows once has grown: the first unplugging
    has touched what faults alone need, and the nets and the search for a face have touched theirs, for which frames are waited for,
    however long they take. Huge pages, which grow with time, are off (guest.main). From then on it stays the same to some kB, unless
    each time leaves something behind."""
    noticed_s = []
    recovered_s = []
    with Camera() as camera, Daemon() as daemon:
        daemon.wait_camera("streaming")
        daemon.wait_frames(5)
        for i in range(times):
            start = camera.unplug()
            daemon.wait_camera("absent")
            noticed_s.append((guest.now_ns() - start) / 1e9)
            start = camera.plug()
            daemon.wait_camera("streaming")
            recovered_s.append((guest.now_ns() - start) / 1e9)
            daemon.wait_frames(3)
            if i == 0:
                daemon.wait_processed(SEARCHED_FRAMES)
                before = (daemon.descriptors(), daemon.resident_kb())
        after = (daemon.descriptors(), daemon.resident_kb())
        status = daemon.status()
        daemon.stop()
        camera.end()
    figure("absent, streaming as facet status says it, s: greatest", [round(max(noticed_s), 1), round(max(recovered_s), 1)])
    figure("descriptors and memory in kB: then, now", [before, after])
    check(status["camera"]["frames"]["reopened"] == times, status["camera"])
    check(after[0] == before[0], f"descriptors: {before[0]}, then {after[0]}")
    check(after[1] - before[1] < (times - 1) * MOST_LEAK_KB, f"memory: {before[1]} kB, then {after[1]} kB after {times - 1} times more")


@test
def unplugged_3_times():
    unplug_and_plug(3)


@full
def unplugged_20_times():
    unplug_and_plug(20)


@test
def records_while_the_camera_fails():
    """A take that spans an unplugging and a freeze can be read."""
    with Camera() as camera, Daemon() as daemon:
        daemon.wait_camera("streaming")
        daemon.facet("record", "start", "faults")
        daemon.wait_frames(10)
        camera.unplug()
        daemon.wait_camera("absent")
        camera.plug()
        daemon.wait_camera("streaming")
        daemon.wait_frames(10)
        camera.tell("freeze")
        daemon.wait_camera("stalled")
        camera.tell("resume")
        daemon.wait_camera("streaming")
        daemon.wait_frames(10)
        daemon.facet("record", "stop")
        daemon.stop()
        camera.end()
    summary = run(BIN / "facet", "summary", next((FOLDER / "takes").glob("faults*.take")))
    figure("summary", " ".join(summary.split())[:200])


@full
def frozen_for_five_seconds():
    """SIGSTOP and SIGCONT, as a suspended machine looks to it: no crash, and it goes on."""
    with Camera() as camera, Daemon() as daemon:
        daemon.wait_camera("streaming")
        daemon.wait_frames(5)
        daemon.process.send_signal(signal.SIGSTOP)
        time.sleep(5)
        daemon.process.send_signal(signal.SIGCONT)
        daemon.wait_camera("streaming")
        status = daemon.wait_frames(10)
        figure("frames", {name: count for name, count in status["camera"]["frames"].items() if count})
        daemon.stop()
        camera.end()


@full
def clock_of_the_day_jumps():
    with Camera() as camera, Daemon() as daemon:
        daemon.wait_camera("streaming")
        daemon.wait_frames(5)
        day = time.clock_gettime(time.CLOCK_REALTIME)
        for jump_s in (3600, -7200):
            time.clock_settime(time.CLOCK_REALTIME, time.clock_gettime(time.CLOCK_REALTIME) + jump_s)
            status = daemon.wait_frames(10)
        time.clock_settime(time.CLOCK_REALTIME, day)
        frames = status["camera"]["frames"]
        check(frames["reopened"] == 0 and frames["undated"] == 0 and frames["stale"] == 0, f"frames: {frames}")
        daemon.stop()
        camera.end()


@test
def a_wrong_configuration_names_what_the_camera_has():
    with Camera() as camera, Daemon(width_px=100) as daemon:
        check(daemon.process.wait(30) == 2, f"facetd ended with {daemon.process.returncode}")
        figure("it says", next((line for line in daemon.said().splitlines() if "source.format" in line), "nothing"))
        check("YUYV, MJPEG 640x480, 320x240, 1280x720 at 60, 30, 15 Hz" in daemon.said(), daemon.said())
        camera.end()


run("modprobe", "-a", "vhci_hcd", "uvcvideo")
guest.main()
