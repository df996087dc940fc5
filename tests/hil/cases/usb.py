"""The V4L2 driver on a USB camera: the kernel's uvcvideo with the device emulated by usb_camera, over USB/IP."""
import time

import guest
from guest import Camera, Probe, check, check_counted, check_pictures, come_and_go, figure, full, run, test

DEVICE = guest.USB_CAMERA


def streaming(rate=30, width=320, height=240, **options):
    probe = Probe(DEVICE, rate=rate, width=width, height=height, **options)
    probe.wait_frames(5, since=0)
    return probe


@test
def streams_640x480():
    with Camera() as camera, streaming(rate=60, width=640, height=480) as probe:
        frames = probe.wait_frames(240)
        device = camera.status()
        end = probe.end()
        camera.end()
    check_pictures(frames)
    lags_ms = sorted((frame["arrival_ns"] - frame["timestamp_ns"]) / 1e6 for frame in frames)
    seconds = (frames[-1]["timestamp_ns"] - frames[0]["timestamp_ns"]) / 1e9
    figure("frames per second", round((frames[-1]["picture"] - frames[0]["picture"]) / seconds, 1))
    figure("of the device: taken, sent, missed", [device[name] for name in ("taken", "sent", "missed")])
    figure("delivered, skipped, lost, omitted", [end[name] for name in ("delivered", "skipped", "lost", "omitted")])
    figure("time stamp to delivery, ms: median, max", [round(lags_ms[len(lags_ms) // 2], 1), round(lags_ms[-1], 1)])
    check_counted(end)


@test
def first_frame():
    with Camera() as camera:
        start = guest.now_ns()
        with Probe(DEVICE, rate=30) as probe:
            first = probe.wait_frames(1, since=0)[0]
            figure("program started to first frame, s", round((first["arrival_ns"] - start) / 1e9, 2))
            check(first["sequence"] == 0, f"the first frame has the number {first['sequence']}")
            probe.end()
        camera.end()


@test
def controls_reach_the_device():
    with Camera() as camera:
        with streaming(exposure_us=5000, gain=42, white_balance_k=5600) as probe:
            status = camera.status()
            probe.end()
        for name, value in {"exposure_mode": 1, "exposure_100us": 50, "gain": 42, "white_balance_k": 5600,
                            "white_balance_auto": 0}.items():
            check(status[name] == value, f"the device has {name} {status[name]}, not {value}")
        with streaming() as probe:
            status = camera.status()
            probe.end()
        for name, value in {"exposure_mode": 8, "white_balance_auto": 1}.items():
            check(status[name] == value, f"the device has {name} {status[name]}, not {value}")
        with Probe(DEVICE, rate=30, exposure_us=9_000_000) as probe:
            refused = probe.wait_for("refused")["error"]
        check("source.exposure_us = 9000000: the device takes 100 to 500000" in refused, refused)
        camera.end()


def faults(command, nodrop):
    """Three faults while it streams; the counters, and the frames."""
    guest.Path("/sys/module/uvcvideo/parameters/nodrop").write_text("1" if nodrop else "0")
    with Camera() as camera, streaming() as probe:
        for _ in range(3):
            camera.tell(command)
            probe.wait_frames(5)
        end = probe.end()
        frames = probe.frames()
        camera.end()
    guest.Path("/sys/module/uvcvideo/parameters/nodrop").write_text("0")
    check_pictures(frames)
    figure("counted", [f"{name} {end[name]}" for name in ("lost", "omitted", "damaged", "truncated")])
    return end


@test
def frames_marked_bad():
    """uvcvideo keeps bad frames to itself, its numbers tell; with nodrop=1 it delivers and marks them."""
    end = faults("error", nodrop=False)
    check(end["lost"] >= 3, f"{end['lost']} lost")
    check_counted(end)
    end = faults("error", nodrop=True)
    check(end["damaged"] == 3, f"{end['damaged']} damaged")
    check_counted(end, "damaged")


@test
def short_frames():
    end = faults("short", nodrop=False)
    check(end["lost"] >= 3, f"{end['lost']} lost")
    check_counted(end)
    end = faults("short", nodrop=True)
    check(end["truncated"] == 3, f"{end['truncated']} truncated")
    check_counted(end, "truncated")


@test
def motion_jpeg():
    """Whole pictures; one cut short, which is delivered as damaged; noise, which is none."""
    with Camera() as camera, streaming(rate=15, format="MJPEG") as probe:
        frames = probe.wait_frames(20)
        check(not any(frame["corrupt"] for frame in frames), "a whole picture is damaged")
        for fault in ("short", "garbage", "short", "garbage"):
            camera.tell(fault)
            probe.wait_frames(5)
        end = probe.end()
        camera.end()
    check_pictures(probe.frames())
    figure("counted", [f"{name} {end[name]}" for name in ("lost", "damaged", "undecodable")])
    check(end["damaged"] == 2 and end["undecodable"] == 2, f"{end['damaged']} damaged, {end['undecodable']} undecodable")
    check_counted(end, "damaged", "undecodable")


@test
def frames_skipped_in_the_device():
    """Nothing but the times tells of these."""
    with Camera() as camera, streaming() as probe:
        before = probe.status()
        for _ in range(3):
            camera.tell("skip 2")
            probe.wait_frames(10)
        end = probe.end()
        check_pictures(probe.frames())
        camera.end()
    figure("omitted", end["omitted"] - before["omitted"])
    check(end["omitted"] - before["omitted"] >= 6, f"{end['omitted']} omitted")
    check_counted(end)


@test
def endpoint_that_fails_once():
    with Camera() as camera, streaming() as probe:
        since = len(probe.lines)
        camera.tell("stall")
        probe.wait_frames(30, since=since)
        end = probe.end()
        camera.end()
    check_pictures(probe.frames())
    figure("counted", [f"{name} {end[name]}" for name in ("lost", "damaged", "truncated", "reopened")])
    check(end["truncated"] > 0, "the buffers that uvcvideo gave back empty are not counted")
    check_counted(end, "truncated")


@test
def freezes_and_resumes():
    with Camera() as camera, streaming(stall_ms=1000) as probe:
        since = len(probe.lines)
        start = guest.now_ns()
        camera.tell("freeze")
        stalled = probe.wait_state("stalled", since=since)
        figure("noticed after, s (stall_after 1 s)", round((stalled["time_ns"] - start) / 1e9, 2))
        check("no frame for 1" in stalled["reason"], stalled["reason"])
        time.sleep(3)
        resumed = guest.now_ns()
        camera.tell("resume")
        again = probe.wait_state("streaming", since=since, timeout_s=20)
        figure("recovered after, s", round((again["time_ns"] - resumed) / 1e9, 2))
        probe.wait_frames(10)
        end = probe.end()
        camera.end()
    check_pictures(probe.frames())
    check(end["reopened"] >= 1, f"reopened {end['reopened']} times")
    check_counted(end, "reopened", "stale")


@test
def absent_at_the_start():
    with Camera(plugged=False) as camera, Probe(DEVICE, rate=30) as probe:
        check(probe.wait_for("open")["state"] == "absent", "its state at the start")
        probe.wait_state("absent")
        time.sleep(1)
        start = camera.plug()
        again = probe.wait_state("streaming", timeout_s=20)
        figure("streaming after, s", round((again["time_ns"] - start) / 1e9, 2))
        probe.wait_frames(10)
        end = probe.end()
        camera.end()
    check_counted(end)


def unplug_and_plug(times):
    with Camera() as camera, streaming() as probe:
        come_and_go(probe, camera.unplug, camera.plug, times)
        check_pictures(probe.frames())
        camera.end()


@test
def unplugged_3_times():
    unplug_and_plug(3)


@full
def unplugged_20_times():
    unplug_and_plug(20)


@test
def one_of_two_is_unplugged():
    """The other camera goes on undisturbed."""
    other_device = DEVICE.replace("usb-0:1:", "usb-0:2:")
    with Camera() as camera, Camera(port=1) as other:
        guest.wait_until(guest.Path(other_device).exists, 10, f"no {other_device}")
        with streaming(rate=15) as probe, Probe(other_device, width=320, height=240, rate=15) as other_probe:
            other_probe.wait_frames(5, since=0)
            for _ in range(3):
                since = len(probe.lines)
                camera.unplug()
                probe.wait_state("absent", since=since)
                since = len(probe.lines)
                camera.plug()
                probe.wait_state("streaming", since=since, timeout_s=20)
            other_probe.wait_frames(5)
            end = other_probe.end()
            probe.end()
        check_pictures(other_probe.frames())
        states = [line["state"] for line in other_probe.of("state")]
        check(states[-1] == "streaming" and not {"absent", "stalled", "failing"} & set(states), f"the other's states: {states}")
        check_counted(end)
        camera.end()
        other.end()


run("modprobe", "-a", "vhci_hcd", "uvcvideo")
guest.main()
