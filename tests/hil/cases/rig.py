"""facetd as it is shipped with a rig: mode "frames", GPIO lines that fire emulated USB cameras, takes of what they saw."""
import json
import os
import signal
import subprocess
import time

import guest
from guest import BIN, Chip, Lines, Path, check, figure, full, run, test, wait_until

CAMERAS = [f"/dev/v4l/by-path/platform-vhci_hcd.0-usb-0:{port + 1}:1.0-video-index0" for port in range(2)]
FOLDER = Path("/tmp/rig")
RATE = 15
PATTERN_LINES = 8
# Cameras and wires wait for no processor: below the trigger's thread, above all else.
URGENT = {"preexec_fn": lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(30))}


def configuration(chip, rate):
    slot_us = 1_000_000 // rate
    bits = [f"bit{i}" for i in range(PATTERN_LINES)]
    patterns = [[bits[i] for i in range(PATTERN_LINES) if slot >> i & 1] for slot in range(1 << PATTERN_LINES)]
    lines = ['mode = "frames"']
    for name, device in zip(("left", "right"), CAMERAS):
        lines += ["[[camera]]", f'name = "{name}"', f'device = "{device}"', "width_px = 320", "height_px = 240",
                  f"rate_hz = {rate}.0", "stall_after_ms = 2000"]
    lines += ["[trigger]", 'kind = "gpio"', f"slots_per_second = {rate}.0", f"settle_us = {slot_us // 8}",
              f"exposure_us = {slot_us // 2}", f"tolerance_us = {slot_us // 4}", f"patterns = {json.dumps(patterns)}",
              f'edge_log = "{FOLDER}/edges.log"']
    for i, name in enumerate([*bits, "cameras"]):
        lines += ["[[trigger.line]]", f'name = "{name}"', f'role = "{"camera" if name == "cameras" else "projector"}"',
                  f'chip = "{chip.label}"', f'line = "{i}"']
    lines += ['read_back_line = "9"', "[sets]", "deadline_ms = 500", "[stream]", f'socket = "{FOLDER}/stream.sock"', "[control]",
              f'socket = "{FOLDER}/control.sock"', "[takes]", f'folder = "{FOLDER}/takes"', "disk_reserve_mb = 1"]
    return "\n".join(lines) + "\n"


class Rig:
    """A chip, two cameras that watch its lines, the wire that proves edges, and facetd."""

    def __init__(self, chip, rate=RATE):
        (FOLDER / "takes").mkdir(parents=True, exist_ok=True)
        self.cameras = [Lines("usb_camera", f"--port={port}", f"--lines={chip.folder}", f"--pattern-lines={PATTERN_LINES}",
                              f"--trigger={PATTERN_LINES}", f"--exposure-ms={500 / rate}", **URGENT) for port in range(2)]
        for camera, device in zip(self.cameras, CAMERAS):
            camera.tell("plug")
            wait_until(Path(device).exists, 10, f"no {device}")
        self.wire = subprocess.Popen([BIN / "wire", chip.folder, "8", "9"], **URGENT)
        self.config = FOLDER / "facet.toml"
        self.config.write_text(configuration(chip, rate))
        run(BIN / "facetd", "--check-config", f"--config={self.config}")
        self.log = open(FOLDER / "log", "w+")
        self.start()

    def start(self):
        self.process = subprocess.Popen([BIN / "facetd", f"--config={self.config}"], stderr=self.log, stdout=self.log)

    def facet(self, *arguments):
        return run(BIN / "facet", *arguments, f"--config={self.config}")

    def rig(self):
        """What `facet status` says of the rig; nothing while the daemon does not answer."""
        done = subprocess.run([BIN / "facet", "status", "--json", f"--config={self.config}"], capture_output=True, text=True, check=False)
        return json.loads(done.stdout).get("rig") if done.returncode == 0 else None

    def wait(self, holds, what, timeout_s=60):
        """Waits until something holds of the rig; the rig."""
        last = {}

        def there():
            nonlocal last
            check(self.process.poll() is None, f"facetd ended with {self.process.poll()}: {self.said()}")
            last = self.rig() or last
            return last if last and holds(last) else None
        return wait_until(there, timeout_s, lambda: f"{what}: {json.dumps(last)[:1500]}; {self.said()}")

    def wait_sets(self, more):
        before = (self.wait(lambda rig: True, "no status"))["sets"]["complete"]
        return self.wait(lambda rig: rig["sets"]["complete"] >= before + more, f"not {more} sets more")

    def said(self):
        return Path(self.log.name).read_text()[-1500:]

    def stop(self):
        self.process.send_signal(signal.SIGTERM)
        check(self.process.wait(30) == 0, f"facetd ended with {self.process.returncode}: {self.said()}")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        for camera in self.cameras:
            camera.__exit__()
        self.wire.kill()
        self.wire.wait()
        self.log.close()
        wait_until(lambda: not any(Path(device).exists() for device in CAMERAS), 10, "the cameras stay")


def check_take(name):
    """Every picture of a take stands in its slot's set; the counts."""
    done = subprocess.run([BIN / "check_take", FOLDER / "takes" / f"{name}.take"], capture_output=True, text=True, check=False)
    check(done.returncode in (0, 1), f"check_take: {done.stderr}")
    told = json.loads(done.stdout)
    figure("sets recorded, complete; pictures right, wrong",
           [told["sets"], told["complete"], told["right"], len(told["wrong"])])
    check(not told["wrong"], f"pictures in the wrong set: {told['wrong'][:5]}")
    check(told["right"] > 0 and told["unreadable"] == 0, told)
    return told


@test
def sets_are_recorded_in_their_slots():
    with Rig(CHIP) as rig:
        rig.wait_sets(10)
        rig.facet("record", "start", "slots")
        rig.wait_sets(60)
        rig.facet("record", "stop")
        now = rig.rig()
        figure("sets", now["sets"])
        figure("trigger", {key: now["trigger"][key] for key in ("slots_fired", "slots_dropped", "edges_proven", "edges_missing", "real_time")})
        check(now["trigger"]["edges_proven"] > 0, now["trigger"])
        check(now["trigger"]["real_time"], now["trigger"]["scheduling"])
        rig.stop()
    told = check_take("slots")
    check(told["closed"], "the take is not closed")
    run(BIN / "facet", "export", FOLDER / "takes/slots.take", "--format", "jsonl", "-o", "/tmp/rig/slots.jsonl")


@test
def a_camera_comes_and_goes():
    """One camera is unplugged, plugged, frozen; the other goes on, and no picture changes its set."""
    with Rig(CHIP) as rig:
        rig.wait_sets(10)
        rig.facet("record", "start", "faults")
        faulty = rig.cameras[1]
        faulty.tell("unplug")
        rig.wait(lambda now: now["cameras"][1]["state"] == "absent", "the unplugging is not noticed")
        before = rig.rig()["cameras"][0]["sets"]["in_sets"]
        rig.wait(lambda now: now["cameras"][0]["sets"]["in_sets"] > before + 10, "the other camera does not go on")
        faulty.tell("plug")
        rig.wait_sets(15)
        faulty.tell("freeze")
        time.sleep(4)
        faulty.tell("resume")
        rig.wait_sets(15)
        now = rig.rig()
        check(now["cameras"][0]["frames"]["reopened"] == 0, f"the other camera: {now['cameras'][0]}")
        check(now["cameras"][1]["frames"]["reopened"] >= 1, f"the faulty camera: {now['cameras'][1]}")
        rig.facet("record", "stop")
        rig.stop()
    check_take("faults")


@test
def the_chip_is_removed_and_comes_back():
    """The trigger fails with a reason that names it; the daemon stays, and fires again once the lines are there."""
    with Rig(CHIP) as rig:
        rig.wait_sets(10)
        CHIP.remove()
        failed = rig.wait(lambda now: now["trigger"]["state"] == "failing", "the trigger goes on")
        figure("reason", failed["trigger"]["reason"])
        check(failed["trigger"]["reason"], failed["trigger"])
        CHIP.make_live()
        rig.wait(lambda now: now["trigger"]["state"] == "running" and now["trigger"]["opened"] >= 2, "it is not opened again")
        figure("opened", rig.rig()["trigger"]["opened"])
        rig.stop()


@test
def killed_it_leaves_a_take_and_takes_its_lines_again():
    """kill -9 while it records: the take is readable, a second daemon gets lines, cameras and sockets."""
    with Rig(CHIP) as rig:
        rig.wait_sets(10)
        rig.facet("record", "start", "killed")
        rig.wait_sets(40)
        rig.process.kill()
        rig.process.wait()
        rig.start()
        rig.wait_sets(10)
        rig.stop()
    told = check_take("killed")
    check(told["sets"] > 10, told)


@full
def four_minutes():
    with Rig(CHIP) as rig:
        rig.wait_sets(10)
        rig.facet("record", "start", "long")
        time.sleep(240)
        rig.facet("record", "stop")
        rig.stop()
    check_take("long")


run("modprobe", "-a", "gpio-sim", "vhci_hcd", "uvcvideo")
CHIP = Chip("booth", PATTERN_LINES + 2)  # the pattern, the trigger, its read-back
guest.main()
