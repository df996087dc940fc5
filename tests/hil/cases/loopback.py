"""The V4L2 driver on v4l2loopback, which gives what another program writes into it, and stamps it with no clock named."""
import fcntl
import os
import struct
import subprocess
import sys
import time

import guest
from guest import Path, Probe, check, check_counted, check_frames_in_order, figure, run, test

DEVICE = "/dev/video10"
WIDTH, HEIGHT, RATE = 320, 240, 30
VIDIOC_S_FMT = 0xC0D05605
V4L2_BUF_TYPE_VIDEO_OUTPUT = 2
V4L2_FIELD_NONE = 1
V4L2_COLORSPACE_SRGB = 8


def write_pictures(first):
    """Writes numbered pictures (painted_number.hpp) until it is killed."""
    fd = os.open(DEVICE, os.O_RDWR)
    pixels = struct.pack("IIIIIII", WIDTH, HEIGHT, int.from_bytes(b"YUYV", "little"), V4L2_FIELD_NONE, WIDTH * 2,
                         WIDTH * HEIGHT * 2, V4L2_COLORSPACE_SRGB)
    fcntl.ioctl(fd, VIDIOC_S_FMT, struct.pack("I4x", V4L2_BUF_TYPE_VIDEO_OUTPUT) + pixels.ljust(200, b"\0"))
    picture = bytearray(b"\x80\x80" * (WIDTH * HEIGHT))
    black, white = b"\x10\x80" * 8, b"\xeb\x80" * 8
    due = time.monotonic()
    for number in range(first, first + 1_000_000):
        cells = b"".join(white if number >> bit & 1 else black for bit in range(32))
        for row in (*range(8), *range(HEIGHT - 8, HEIGHT)):
            picture[row * WIDTH * 2:row * WIDTH * 2 + len(cells)] = cells
        os.write(fd, picture)
        due += 1 / RATE
        late = time.monotonic() - due
        time.sleep(max(0, -late))
        due += max(0, late)


class Writer:
    def __init__(self, first=0):
        self.process = subprocess.Popen([sys.executable, __file__, "--write", str(first)])

    def kill(self):
        self.process.kill()
        self.process.wait()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.kill()


def load(exclusive_caps):
    run("modprobe", "-r", "v4l2loopback")
    run("modprobe", "v4l2loopback", "devices=1", f"exclusive_caps={exclusive_caps}", "video_nr=10", "card_label=Loopback")
    guest.wait_until(Path(DEVICE).exists, 10, f"no {DEVICE}")


def probe(**options):
    return Probe(DEVICE, width=WIDTH, height=HEIGHT, rate=RATE, **options)


@test
def awaits_its_writer():
    """Until something writes, a device with exclusive_caps=1 says that it takes pictures."""
    load(exclusive_caps=1)
    with probe() as looked_at:
        reason = looked_at.wait_state("failing")["reason"]
        check("nothing writes into it" in reason, reason)
        time.sleep(1)
        start = guest.now_ns()
        with Writer():
            streaming = looked_at.wait_state("streaming", timeout_s=20)
            figure("streaming after, s", round((streaming["time_ns"] - start) / 1e9, 2))
            frames = looked_at.wait_frames(60)
            end = looked_at.end()
    check_frames_in_order(frames)
    # v4l2loopback lets its writer overwrite what is being read: parts of two pictures have no number.
    numbers = [frame["picture"] for frame in frames if "picture" in frame]
    figure("of two pictures", len(frames) - len(numbers))
    check(len(numbers) > 50 and all(b > a for a, b in zip(numbers, numbers[1:])), f"pictures: {numbers}")
    lags_ms = sorted((frame["arrival_ns"] - frame["timestamp_ns"]) / 1e6 for frame in frames)
    figure("time stamp to delivery, ms: median, greatest", [round(lags_ms[len(lags_ms) // 2], 1), round(lags_ms[-1], 1)])
    figure("undated of delivered", [end["undated"], end["delivered"]])
    check_counted(end)


@test
def its_writer_dies_and_comes_back():
    """With exclusive_caps=1 version 0.12.7 takes no second writer (its S_FMT says EINVAL), whoever reads."""
    load(exclusive_caps=0)
    with Writer() as writer, probe(stall_ms=1000) as looked_at:
        looked_at.wait_frames(10, since=0, timeout_s=30)
        since = len(looked_at.lines)
        start = guest.now_ns()
        writer.kill()
        noticed = guest.wait_until(lambda: next((line for line in looked_at.of("state", since)
                                                 if line["state"] in ("stalled", "failing")), None), 10, "it was not noticed")
        figure("noticed after, s (stall_after 1 s)", round((noticed["time_ns"] - start) / 1e9, 2))
        figure("as", f"{noticed['state']}: {noticed['reason']}")
        time.sleep(2)
        since = len(looked_at.lines)
        start = guest.now_ns()
        with Writer(10_000):
            again = looked_at.wait_state("streaming", since=since, timeout_s=20)
            figure("recovered after, s", round((again["time_ns"] - start) / 1e9, 2))
            looked_at.wait_frames(10)
            end = looked_at.end()
    frames = looked_at.frames(since)
    check(all(frame.get("picture", 10_000) >= 10_000 for frame in frames), f"an old picture came again: {frames[:3]}")
    check_frames_in_order(looked_at.frames())
    check_counted(end, "reopened", "stale")


if "--write" in sys.argv:
    write_pictures(int(sys.argv[-1]))
guest.main()
