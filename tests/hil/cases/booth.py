"""A booth in a guest: emulated USB cameras that GPIO lines fire, and facetd in mode "frames". What the tests of rig.py, unit.py and
power.py share."""
import json
import os
import signal
import subprocess

from guest import BIN, Chip, Lines, Path, check, figure, run, wait_until

CAMERAS = [f"/dev/v4l/by-path/platform-vhci_hcd.0-usb-0:{port + 1}:1.0-video-index0" for port in range(2)]
RATE = 15
PATTERN_LINES = 8
# Cameras and wires wait for no processor: below the trigger's thread, above all else.
URGENT = {"preexec_fn": lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(30))}


def new_chip():
    """The chip of the lines: the pattern, the trigger, its read-back."""
    run("modprobe", "-a", "gpio-sim", "vhci_hcd", "uvcvideo")
    return Chip("booth", PATTERN_LINES + 2)


class Rig:
    """A chip, two cameras that watch its lines, the wire that proves edges, and facetd."""

    config = Path("/tmp/rig/facet.toml")
    sockets = Path("/tmp/rig")
    takes = Path("/tmp/rig/takes")
    log = Path("/tmp/rig/log")
    facet_program = BIN / "facet"

    def __init__(self, chip, lamps=()):
        """lamps: which hang on the pattern's first lines; the slots say what lights them."""
        self.chip = chip
        self.lamps = lamps
        for folder in (self.config.parent, self.sockets, self.takes):
            folder.mkdir(parents=True, exist_ok=True)
        self.cameras = [Lines("usb_camera", f"--port={port}", f"--lines={chip.folder}", f"--pattern-lines={PATTERN_LINES}",
                              f"--trigger={PATTERN_LINES}", f"--exposure-ms={500 / RATE}", **URGENT) for port in range(2)]
        for camera, device in zip(self.cameras, CAMERAS):
            camera.tell("plug")
            wait_until(Path(device).exists, 10, f"no {device}")
        self.wire = subprocess.Popen([BIN / "wire", chip.folder, "8", "9"], **URGENT)
        self.config.write_text(self.configuration())
        self.start()

    def configuration(self):
        slot_us = 1_000_000 // RATE
        bits = [f"bit{i}" for i in range(PATTERN_LINES)]
        patterns = [[bits[i] for i in range(PATTERN_LINES) if slot >> i & 1] for slot in range(1 << PATTERN_LINES)]
        lines = ['mode = "frames"']
        for name, device in zip(("left", "right"), CAMERAS):
            lines += ["[[camera]]", f'name = "{name}"', f'device = "{device}"', "width_px = 320", "height_px = 240",
                      f"rate_hz = {RATE}.0", "stall_after_ms = 2000"]
        lines += ["[trigger]", 'kind = "gpio"', f"slots_per_second = {RATE}.0", f"settle_us = {slot_us // 8}",
                  f"exposure_us = {slot_us // 2}", f"tolerance_us = {slot_us // 4}", f"patterns = {json.dumps(patterns)}"]
        if self.lamps:
            lit = [[lamp for i, lamp in enumerate(self.lamps) if slot >> i & 1] for slot in range(1 << PATTERN_LINES)]
            lines.append(f"light = {json.dumps(['light:' + '+'.join(names) if names else 'dark' for names in lit])}")
        for i, name in enumerate([*bits, "cameras"]):
            lines += ["[[trigger.line]]", f'name = "{name}"', f'role = "{"camera" if name == "cameras" else "projector"}"',
                      f'chip = "{self.chip.label}"', f'line = "{i}"']
        lines += ['read_back_line = "9"', "[expert.sets]", "deadline_ms = 500", "[stream]", f'socket = "{self.sockets}/stream.sock"',
                  "[control]", f'socket = "{self.sockets}/control.sock"', "[takes]", f'folder = "{self.takes}"', "disk_reserve_mb = 1"]
        return "\n".join(lines) + "\n"

    def start(self):
        with open(self.log, "a") as log:
            self.process = subprocess.Popen([BIN / "facetd", f"--config={self.config}"], stderr=log, stdout=log)

    def facet(self, *arguments):
        return run(self.facet_program, *arguments, f"--config={self.config}")

    def status(self):
        """What `facet status` says; nothing while the daemon does not answer."""
        done = subprocess.run([self.facet_program, "status", "--json", f"--config={self.config}"], capture_output=True, text=True,
                              check=False)
        return json.loads(done.stdout) if done.returncode == 0 else {}

    def rig(self):
        return self.status().get("rig")

    def check_alive(self):
        check(self.process.poll() is None, f"facetd ended with {self.process.poll()}: {self.said()}")

    def wait_status(self, holds, what, timeout_s=60):
        """Waits until something holds of the status; the status."""
        last = {}

        def there():
            nonlocal last
            self.check_alive()
            last = self.status() or last
            return last if last and holds(last) else None
        return wait_until(there, timeout_s, lambda: f"{what}: {json.dumps(last)[:1500]}; {self.said()}")

    def wait(self, holds, what, timeout_s=60):
        """Waits until something holds of the rig; the rig."""
        return self.wait_status(lambda status: status.get("rig") and holds(status["rig"]), what, timeout_s)["rig"]

    def wait_sets(self, more):
        """Waits for further complete sets; the rig."""
        before = (self.wait(lambda rig: True, "no status"))["sets"]["complete"]
        return self.wait(lambda rig: rig["sets"]["complete"] >= before + more, f"not {more} sets more")

    def record(self, name):
        self.facet("record", "start", name)
        return self.takes / f"{name}.take"

    def said(self):
        return self.log.read_text()[-1500:] if self.log.exists() else ""

    def stop(self):
        self.process.send_signal(signal.SIGTERM)
        check(self.process.wait(30) == 0, f"facetd ended with {self.process.returncode}: {self.said()}")

    def end(self):
        self.process.kill()
        self.process.wait()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.end()
        for camera in self.cameras:
            camera.__exit__()
        self.wire.kill()
        self.wire.wait()
        wait_until(lambda: not any(Path(device).exists() for device in CAMERAS), 10, "the cameras stay")


def check_take(take, until_ns=None, most_lost_s=1.0, lamps=()):
    """Every picture of a take stands in its slot's set, and shows the lamps that the set says where there are some; the counts.
    until_ns: when the recording met its end; at most so much before it may be lost."""
    done = subprocess.run([BIN / "check_take", take, *([f"--lamps={','.join(lamps)}"] if lamps else [])], capture_output=True, text=True, check=False)
    check(done.returncode in (0, 1), f"check_take: {done.stderr}")
    told = json.loads(done.stdout)
    figure("sets recorded, complete; pictures right, wrong",
           [told["sets"], told["complete"], told["right"], len(told["wrong"])])
    check(not told["wrong"], f"pictures in the wrong set: {told['wrong'][:5]}")
    check(not told["otherwise_lit"], f"pictures under another light: {told['otherwise_lit'][:5]}")
    check(told["right"] > 0 and told["unreadable"] == 0, told)
    if until_ns is not None:
        lost_s = (until_ns - told["last_trigger_ns"]) / 1e9
        figure("lost, s", round(lost_s, 2))
        check(lost_s <= most_lost_s, f"{lost_s:.2f} s are lost")
    return told
