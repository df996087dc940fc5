"""Cameras of libcamera, each in a process of its own: the emulated USB camera through libcamera's uvcvideo handler."""
import json
import os
import signal
import subprocess
import time

import guest
from guest import BIN, Camera, Path, Probe, check, check_counted, check_pictures, come_and_go, figure, full, run, test, wait_until

# libcamera names a camera after the controller in the firmware (firmware_path), its port and what it is.
ID = "\\_SB.VHCI-1:1.0-1d6b:0102"
FOLDER = Path("/tmp/facet")


def camera_id(port=0):
    return ID.replace("VHCI-1:", f"VHCI-{port + 1}:")


def listed():
    return run(BIN / "facet-camera-host", "--list")


def probe(rate=30, width=320, height=240, port=0, **options):
    return Probe(camera_id(port), kind="libcamera", rate=rate, width=width, height=height, **options)


def streaming(**options):
    started = probe(**options)
    started.wait_frames(5, since=0, timeout_s=40)
    return started


def host_of(started):
    """The process that the probe's camera is in."""
    children = Path(f"/proc/{started.process.pid}/task")
    pids = [int(pid) for task in children.iterdir() for pid in (task / "children").read_text().split()]
    check(len(pids) == 1, f"{len(pids)} processes")
    return pids[0]


def check_undisturbed(started, end):
    """It streamed all along."""
    reasons = [line["reason"] for line in started.of("state") if line["reason"]]
    check(end["reopened"] == 0 and not reasons, f"reopened {end['reopened']} times: {reasons}")
    check_counted(end)


@test
def lists_what_it_offers():
    check(listed() == "", f"without a camera: {listed()}")
    with Camera() as camera:
        text = listed()
        figure("listed", text.strip())
        check(text.startswith(camera_id() + "\t"), text)
        check("YUYV" in text and "640x480" in text and "exposure_us" in text, text)
        doctor = subprocess.run([BIN / "facet", "doctor"], capture_output=True, text=True, check=False).stdout
        check(f"id = '{camera_id()}'" in doctor, doctor)
        camera.end()


@test
def streams_640x480():
    with Camera() as camera, streaming(rate=60, width=640, height=480) as started:
        frames = started.wait_frames(240, timeout_s=60)
        device = camera.status()
        end = started.end()
        camera.end()
    check_pictures(frames)
    lags_ms = sorted((frame["arrival_ns"] - frame["timestamp_ns"]) / 1e6 for frame in frames)
    seconds = (frames[-1]["timestamp_ns"] - frames[0]["timestamp_ns"]) / 1e9
    figure("frames per second", round(len(frames[1:]) / seconds, 1))
    figure("of the device: taken, sent, missed", [device[name] for name in ("taken", "sent", "missed")])
    figure("delivered, skipped, lost, omitted", [end[name] for name in ("delivered", "skipped", "lost", "omitted")])
    figure("time stamp to delivery, ms: median, max", [round(lags_ms[len(lags_ms) // 2], 1), round(lags_ms[-1], 1)])
    check_undisturbed(started, end)


@test
def first_frame():
    with Camera() as camera:
        start = guest.now_ns()
        with probe() as started:
            first = started.wait_frames(1, since=0, timeout_s=40)[0]
            figure("program started to first frame, s", round((first["arrival_ns"] - start) / 1e9, 2))
            started.end()
        camera.end()


@test
def controls_reach_the_device():
    with Camera() as camera:
        with streaming(exposure_us=5000, gain=1) as started:
            status = camera.status()
            started.end()
        for name, value in {"exposure_mode": 1, "exposure_100us": 50}.items():
            check(status[name] == value, f"the device has {name} {status[name]}, not {value}")
        with streaming() as started:
            status = camera.status()
            started.end()
        check(status["exposure_mode"] == 8, f"the device has exposure_mode {status['exposure_mode']}")
        camera.end()


@test
def what_it_cannot_do():
    with Camera() as camera:
        for options, reason in (({"exposure_us": 9_000_000}, "source.exposure_us = 9000000: the camera takes 100 to 500000"),
                                ({"width": 321}, "at 321x240 px is not among what the camera has: "),
                                ({"format": "NV12"}, '"NV12" at 320x240 px is not among'),
                                ({"white_balance_k": 5600}, "source.white_balance_k can't be set; the camera lets set: exposure_us")):
            with probe(**options) as started:
                refused = started.wait_for("refused", timeout_s=30)["error"]
            check(reason in refused, refused)
        figure("a refusal", refused)
        camera.end()


@test
def motion_jpeg():
    with Camera() as camera, streaming(format="MJPEG") as started:
        frames = started.wait_frames(20)
        end = started.end()
        camera.end()
    check_pictures(frames)
    check_undisturbed(started, end)


@test
def two_cameras_are_apart():
    """What happens to one's process and plug does not reach the other."""
    with Camera() as camera, Camera(port=1) as other_camera:
        with streaming(rate=15) as started, streaming(rate=15, port=1) as other:
            for _ in range(2):
                since = len(started.lines)
                os.kill(host_of(started), signal.SIGKILL)
                started.wait_state("failing", since=since)
                started.wait_state("streaming", since=since, timeout_s=30)
                since = len(started.lines)
                camera.unplug()
                wait_until(lambda: [line for line in started.of("state", since) if line["state"] != "streaming"], 10, "it goes on")
                camera.plug()
                started.wait_state("streaming", since=since, timeout_s=30)
            other.wait_frames(5)
            end = other.end()
            started.end()
        check_pictures(started.frames())
        check_pictures(other.frames())
        check_undisturbed(other, end)
        camera.end()
        other_camera.end()


@test
def facetd_is_killed():
    """facetd with such a camera; when it is killed, the camera's process ends, and the next facetd can have the camera."""
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / "takes").mkdir(exist_ok=True)
    config = FOLDER / "facet.toml"
    config.write_text(f"""mode = "frames"
[[camera]]
name = "usb"
kind = "libcamera"
id = '{camera_id()}'
width_px = 320
height_px = 240
rate_hz = 30.0
[stream]
socket = "{FOLDER}/stream.sock"
[control]
socket = "{FOLDER}/control.sock"
[takes]
folder = "{FOLDER}/takes"
""")

    def delivered():
        done = subprocess.run([BIN / "facet", "status", "--json", f"--config={config}"], capture_output=True, text=True, check=False)
        cameras = (json.loads(done.stdout)["rig"] or {}).get("cameras") if done.returncode == 0 else []
        return cameras[0]["frames"]["delivered"] if cameras else 0

    def hosts():
        return [path.parent.name for path in Path("/proc").glob("[0-9]*/comm") if path.read_text().startswith("facet-camera-ho")]

    with Camera() as camera:
        for _ in range(2):
            daemon = subprocess.Popen([BIN / "facetd", f"--config={config}"])
            try:
                wait_until(lambda: delivered() > 10, 60, lambda: f"no frames; facetd's status: {daemon.poll()}")
                check(len(hosts()) == 1, f"processes of cameras: {hosts()}")
            finally:
                daemon.kill()
                daemon.wait()
            wait_until(lambda: not hosts(), 5, lambda: f"they go on: {hosts()}")
        camera.end()


def process_dies(signal_number, state, reason):
    with Camera() as camera, streaming(stall_ms=1500) as started:
        for _ in range(3):
            since = len(started.lines)
            killed = guest.now_ns()
            host = host_of(started)
            os.kill(host, signal_number)
            seen = started.wait_state(state, since=since)
            check(reason in seen["reason"], seen["reason"])
            again = started.wait_state("streaming", since=since, timeout_s=30)
            started.wait_frames(10)
        figure("noticed, streaming after, s", [round((seen["time_ns"] - killed) / 1e9, 2), round((again["time_ns"] - killed) / 1e9, 2)])
        end = started.end()
        check_pictures(started.frames())
        camera.end()
    check(end["reopened"] == 3, f"reopened {end['reopened']} times")
    check_counted(end, "reopened")


@test
def its_process_crashes():
    process_dies(signal.SIGSEGV, "failing", "was ended by SIGSEGV")


@test
def its_process_hangs():
    process_dies(signal.SIGSTOP, "stalled", "no frame for 1.5")


@test
def freezes_and_resumes():
    with Camera() as camera, streaming(stall_ms=1000) as started:
        since = len(started.lines)
        camera.tell("freeze")
        stalled = started.wait_state("stalled", since=since)
        check("no frame for 1" in stalled["reason"], stalled["reason"])
        time.sleep(3)
        resumed = guest.now_ns()
        camera.tell("resume")
        again = started.wait_state("streaming", since=since, timeout_s=30)
        figure("recovered after, s", round((again["time_ns"] - resumed) / 1e9, 2))
        started.wait_frames(10)
        end = started.end()
        check_pictures(started.frames())
        camera.end()
    check(end["reopened"] >= 1, f"reopened {end['reopened']} times")


@test
def absent_at_the_start():
    with Camera(plugged=False) as camera, probe() as started:
        check(started.wait_for("open", timeout_s=30)["state"] == "absent", "its state at the start")
        start = camera.plug()
        again = started.wait_state("streaming", timeout_s=30)
        figure("streaming after, s", round((again["time_ns"] - start) / 1e9, 2))
        started.wait_frames(10)
        end = started.end()
        camera.end()
    check_counted(end)


def unplug_and_plug(times):
    with Camera() as camera, streaming() as started:
        come_and_go(started, camera.unplug, camera.plug, times, gone=("absent", "failing", "stalled"))
        check_pictures(started.frames())
        camera.end()


@test
def unplugged_3_times():
    unplug_and_plug(3)


@full
def unplugged_20_times():
    unplug_and_plug(20)


run("modprobe", "-a", "vhci_hcd", "uvcvideo")
run("modprobe", "firmware_path")
guest.main()
