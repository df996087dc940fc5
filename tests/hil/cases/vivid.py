"""The V4L2 driver on the kernel's virtual camera vivid, all of whose faults it must survive and count under their cause."""
import json
import subprocess
import time
from pathlib import Path

import guest
from guest import Probe, check, check_counted, check_frames_in_order, come_and_go, figure, full, run, set_controls, test

DEVICE = "/dev/v4l/by-path/platform-vivid.0-video-index0"
DRIVER = Path("/sys/bus/platform/drivers/vivid")


def load(multi_planar=False):
    run("modprobe", "vivid", "n_devs=1", "node_types=0x1", f"multiplanar={2 if multi_planar else 1}")
    run("udevadm", "settle")
    # The text in the picture takes most of the emulated processor's time.
    set_controls(DEVICE, osd_text_mode=2)


# Small pictures for the faults: what the emulated processor is too slow for must not look like one.
SMALL = {"width": 320, "height": 180, "rate": 30}


def streaming(**options):
    """A probe that has its first frames."""
    probe = Probe(DEVICE, **{**SMALL, **options})
    probe.wait_frames(5, since=0)
    return probe


@test
def doctor_lists_the_camera():
    done = subprocess.run([guest.BIN / "facet", "doctor"], capture_output=True, text=True, check=False)
    line = next((line for line in done.stdout.splitlines() if "(vivid)" in line), "")
    check("/dev/video0 (vivid): " in line, f"facet doctor says: {done.stdout}{done.stderr}")
    for words in ("YUYV, NV12, GREY, Y10, Y16 320x180, 640x360, 640x480, ", " at 1, 2, ", ", 60 Hz; UYVY", "which Facet does not read"):
        check(words in line, f"no '{words}' in: {line}")
    figure("it says", line.partition(": ")[2])


@test
def camera_tests():
    """The case of tests/camera that needs a video device."""
    guest.gtest("test_camera", "V4l2RealDevice.*")
    return "reported"


@test
def streams_and_counts_nothing():
    with streaming(width=640, height=480) as probe:
        frames = probe.wait_frames(90)
        end = probe.end()
    check_frames_in_order(frames)
    steps = [b["timestamp_ns"] - a["timestamp_ns"] for a, b in zip(frames, frames[1:])]
    figure("frame period, ms: mean, max", [round(sum(steps) / len(steps) / 1e6, 2), round(max(steps) / 1e6, 2)])
    figure("skipped by the reader, lost, omitted", [end[name] for name in ("skipped", "lost", "omitted")])
    check(abs(sum(steps) / len(steps) - 1e9 / 30) < 2e6, "the frames' times are not 33.3 ms apart on average")
    check_counted(end)


@test
def every_format():
    for name in ("YUYV", "NV12", "GREY", "Y16", "Y10"):
        with Probe(DEVICE, rate=15, width=320, height=180, format=name) as probe:
            opened = probe.wait_for("open")
            check(opened["state"] == "idle", f"{name}: {opened}")
            frames = probe.wait_frames(5, since=0)
            check(not frames[-1]["corrupt"], name)


@test
def what_it_lacks_is_refused_with_what_it_has():
    with Probe(DEVICE, width=641, rate=30) as probe:
        refused = probe.wait_for("refused")["error"]
    check("641x480" in refused and "YUYV, NV12, GREY, Y10, Y16 320x180, 640x360, 640x480" in refused, refused)
    with Probe(DEVICE, rate=30, gain=100000) as probe:
        refused = probe.wait_for("refused")["error"]
    check("source.gain = 100000: the device takes 0 to 255" in refused, refused)


@test
def controls_are_set():
    with streaming(gain=77) as probe:
        said = run("v4l2-ctl", "-d", DEVICE, "--get-ctrl", "gain,gain_automatic")
        check("gain: 77" in said and "gain_automatic: 0" in said, said)
        probe.end()
    with streaming() as probe:
        said = run("v4l2-ctl", "-d", DEVICE, "--get-ctrl", "gain_automatic")
        check("gain_automatic: 1" in said, said)
        probe.end()


@test
def controls_are_set_by_their_names():
    wanted = {"Test Pattern": "100% White", "horizontal_movement": "Move Left", "Brightness": 99, "show_border": True,
              "Integer 64 Bits": -5_000_000_000, "bitmask": 0x00400010, "Integer Menu": 13}
    shown = {"test_pattern": "6", "horizontal_movement": "1", "brightness": "99", "show_border": "1", "integer_64_bits": "-5000000000",
             "bitmask": "4194320", "integer_menu": "6"}
    before = run("v4l2-ctl", "-d", DEVICE, "--get-ctrl", ",".join(shown))
    with streaming(control=[f"{name}={json.dumps(value)}" for name, value in wanted.items()]) as probe:
        said = run("v4l2-ctl", "-d", DEVICE, "--get-ctrl", ",".join(shown))
        for name, value in shown.items():
            check(any(line.startswith(f"{name}: {value}") for line in said.splitlines()), f"no {name} {value} in: {said}; before: {before}")
        probe.end()
    set_controls(DEVICE, test_pattern=0, horizontal_movement=3, show_border=0)
    for setting, words in (("test_pattern=\"Black\"", 'takes one of "75% Colorbar", "100% Colorbar"'), ("brightness=256", "takes 0 to 255"),
                           ("trigger_mode=true", "no such control; it has: brightness 0 to 255; ")):
        with Probe(DEVICE, **SMALL, control=[setting]) as probe:
            refused = probe.wait_for("refused")["error"]
        check(words in refused, refused)


@test
def dropped_buffers_are_losses():
    with streaming() as probe:
        before = probe.status()
        set_controls(DEVICE, percentage_of_dropped_buffers=10)
        probe.wait_frames(100)
        set_controls(DEVICE, percentage_of_dropped_buffers=0)
        after = probe.status()
        probe.end()
    lost = after["lost"] - before["lost"]
    figure("lost of delivered", f"{lost} of {after['delivered'] - before['delivered']}")
    check(lost >= 3, f"{lost} lost, 10 % are dropped")
    check_counted(after)


@test
def buffers_marked_bad_are_delivered_as_damaged():
    with streaming() as probe:
        for _ in range(3):
            set_controls(DEVICE, inject_v4l2_buf_flag_error=1)
            probe.wait_frames(3)
        end = probe.end()
        corrupt = sum(frame["corrupt"] for frame in probe.frames())
    figure("damaged, skipped", [end["damaged"], end["skipped"]])
    check(1 <= end["damaged"] <= 3 and corrupt == end["damaged"], f"{corrupt} corrupt frames, {end['damaged']} counted")
    check_counted(end, "damaged")


def refused_at_start(control, request):
    set_controls(DEVICE, **{control: 1})
    with Probe(DEVICE, **SMALL) as probe:
        failing = probe.wait_state("failing")
        check(request in failing["reason"], failing["reason"])
        streaming_again = probe.wait_state("streaming")
        figure("recovered after, s", round((streaming_again["time_ns"] - failing["time_ns"]) / 1e9, 2))
        probe.wait_frames(10)
        end = probe.end()
    check_counted(end)


@test
def reqbufs_error():
    refused_at_start("inject_vidioc_reqbufs_error", "VIDIOC_REQBUFS")


@test
def qbuf_error():
    refused_at_start("inject_vidioc_qbuf_error", "VIDIOC_QBUF")


@test
def streamon_error():
    refused_at_start("inject_vidioc_streamon_error", "VIDIOC_STREAMON")


def broken_while_streaming(control, state, request=""):
    with streaming() as probe:
        since = len(probe.lines)
        start = guest.now_ns()
        set_controls(DEVICE, **{control: 1})
        noticed = probe.wait_state(state, since=since)
        check(request in noticed["reason"], noticed["reason"])
        again = probe.wait_state("streaming", since=since)
        probe.wait_frames(10)
        end = probe.end()
    figure("noticed, recovered after, s", [round((at["time_ns"] - start) / 1e9, 2) for at in (noticed, again)])
    check_frames_in_order(probe.frames())
    check(end["reopened"] == 1, f"reopened: {end['reopened']}")
    check_counted(end, "reopened")


@test
def qbuf_error_while_streaming():
    broken_while_streaming("inject_vidioc_qbuf_error", "failing", "VIDIOC_QBUF")


@test
def fatal_streaming_error():
    broken_while_streaming("inject_fatal_streaming_error", "failing")


@test
def disconnect():
    broken_while_streaming("disconnect", "absent", "no such device")


@test
def sequence_numbers_wrap():
    """vivid's numbers begin 128 below 2^32."""
    set_controls(DEVICE, wrap_sequence_number=1)
    try:
        with Probe(DEVICE, **{**SMALL, "rate": 60}) as probe:
            frames = probe.wait_frames(200, since=0)
            end = probe.end()
    finally:
        set_controls(DEVICE, wrap_sequence_number=0)
    check_frames_in_order(frames)
    check(frames[0]["sequence"] < 10 and frames[-1]["sequence"] < 2000, f"numbers {frames[0]['sequence']} to {frames[-1]['sequence']}")
    check(frames[-1]["sequence"] >= 199, "it did not wrap")
    figure("last number, lost", [frames[-1]["sequence"], end["lost"]])
    check_counted(end)


def run_into_wrapping_times(count):
    """vivid's times begin 16 s before they no longer fit 64 (1) or 32 bits (2)."""
    for wrap in (1, 2):
        set_controls(DEVICE, wrap_timestamp=wrap)
        try:
            with Probe(DEVICE, **SMALL) as probe:
                frames = probe.wait_frames(count, since=0, timeout_s=60)
                end = probe.end()
        finally:
            set_controls(DEVICE, wrap_timestamp=0)
        check_frames_in_order(frames)
        figure(f"undated of delivered, {wrap}", f"{end['undated']} of {end['delivered']}")
        for frame in frames:
            late_ms = (frame["arrival_ns"] - frame["timestamp_ns"]) / 1e6
            check(0 <= late_ms < 1000, f"a frame's time lies {late_ms:.0f} ms before its arrival")
        check(end["undated"] > 0, "no frame is undated")
        check_counted(end, "undated")


@test
def times_out_of_range():
    run_into_wrapping_times(60)


@full
def times_wrap():
    run_into_wrapping_times(600)


def unbind():
    start = guest.now_ns()
    (DRIVER / "unbind").write_text("vivid.0")
    return start


def bind():
    (DRIVER / "bind").write_text("vivid.0")
    start = guest.now_ns()
    guest.wait_until(Path(DEVICE).exists, 10, f"no {DEVICE}")
    run("udevadm", "settle")  # the name may still be that of the device before
    set_controls(DEVICE, osd_text_mode=2)
    return start


def unbind_and_bind(times):
    with streaming() as probe:
        come_and_go(probe, unbind, bind, times)
        check_frames_in_order(probe.frames())


@test
def driver_unbound_and_bound_3_times():
    unbind_and_bind(3)


@full
def driver_unbound_and_bound_20_times():
    unbind_and_bind(20)


@test
def absent_at_the_start():
    (DRIVER / "unbind").write_text("vivid.0")
    with Probe(DEVICE, **SMALL) as probe:
        check(probe.wait_for("open")["state"] == "absent", "the state at the start")
        probe.wait_state("absent")
        time.sleep(1)
        start = guest.now_ns()
        (DRIVER / "bind").write_text("vivid.0")
        figure("streaming after, s", round((probe.wait_state("streaming")["time_ns"] - start) / 1e9, 2))
        probe.wait_frames(10)
        end = probe.end()
    check_counted(end)


@test
def held_by_another_program():
    with subprocess.Popen(["v4l2-ctl", "-d", DEVICE, "--stream-mmap=4", "--stream-count=100000"], stdout=subprocess.DEVNULL,
                          stderr=subprocess.DEVNULL) as other:
        time.sleep(1)
        with Probe(DEVICE, **SMALL) as probe:
            failing = probe.wait_state("failing")
            check("in use by another program" in failing["reason"], failing["reason"])
            other.kill()
            other.wait()
            probe.wait_state("streaming")
            probe.end()


@test
def multi_planar():
    """The other interface of V4L2: formats in one block of memory, and NV12 in two."""
    run("modprobe", "-r", "vivid")
    load(multi_planar=True)
    try:
        said = run("v4l2-ctl", "-d", DEVICE, "--all")
        check("Video Capture Multiplanar" in said, said)
        for name in ("YUYV", "NV12", "GREY", "Y16", "Y10"):
            with Probe(DEVICE, rate=15, width=320, height=180, format=name) as probe:
                opened = probe.wait_for("open")
                check(opened["state"] == "idle", f"{name}: {opened}")
                frames = probe.wait_frames(5, since=0)
                check(not frames[-1]["corrupt"], name)
                end = probe.end()
            check_frames_in_order(frames)
            check_counted(end)
        listed = run("v4l2-ctl", "-d", DEVICE, "--list-formats")
        check("NM12" in listed, f"NV12 is not there in two blocks: {listed}")
        with streaming() as probe:
            come_and_go(probe, unbind, bind, 2)
            check_frames_in_order(probe.frames())
    finally:
        run("modprobe", "-r", "vivid")
        load()


load()
guest.main()
