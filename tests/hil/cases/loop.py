"""The closed loop: the trigger sets GPIO lines, emulated USB cameras watch them and show what they say, and every frame must
come out in the set of its slot."""
import os
import time

import guest
from guest import BIN, Chip, Lines, Path, check, figure, full, run, test

CAMERAS = [f"/dev/v4l/by-path/platform-vhci_hcd.0-usb-0:{port + 1}:1.0-video-index0" for port in range(2)]
class Booth:
    """Cameras that watch the chip's lines, the wire that proves the trigger's edges, and the program that is looked at."""

    def __init__(self, cameras, rate, *options):
        # Cameras and wires wait for no processor: below the trigger's thread, above all else.
        urgent = {"preexec_fn": lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(30))}
        self.cameras = [Lines("usb_camera", f"--port={port}", f"--lines={CHIP.folder}", "--pattern-lines=8", "--trigger=8",
                              f"--exposure-ms={500 / rate}", **urgent) for port in range(cameras)]
        for camera, device in zip(self.cameras, CAMERAS):
            camera.tell("plug")
            guest.wait_until(Path(device).exists, 10, f"no {device}")
        self.wire = guest.subprocess.Popen([BIN / "wire", CHIP.folder, "8", "9"], **urgent)
        self.loop = Lines("closed_loop", f"--chip={CHIP.name}", f"--rate={rate}", *options,
                          *(f"--camera={device}" for device in CAMERAS[:cameras]))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for program in [*self.cameras, self.loop]:
            program.__exit__()
        self.wire.kill()
        self.wire.wait()
        # The controller needs a moment until its ports are free.
        guest.wait_until(lambda: not any(Path(device).exists() for device in CAMERAS), 10, "the cameras stay")

    @staticmethod
    def ask(program):
        since = len(program.lines)
        program.tell("status")
        return program.wait_for("status", since=since, timeout_s=20)

    def status(self):
        return self.ask(self.loop)

    def end(self):
        """Ends the run; what it counted."""
        end = self.loop.end()
        self.devices = [self.ask(camera) for camera in self.cameras]
        check(end["event"] == "status", f"it ended with {end}")
        figure("of the cameras: pictures taken, missed", [[device[name] for name in ("taken", "missed")] for device in self.devices])
        figure("slots fired, dropped", [end["slots_fired"], end["slots_dropped"]])
        figure("sets complete, incomplete; frames right, wrong",
               [end[name] for name in ("sets_complete", "sets_incomplete", "right", "wrong")])
        figure("edges proven, missing, stray", [end[name] for name in ("edges_proven", "edges_missing", "edges_stray")])
        figure("trigger to time stamp, ms: least, median, p95, greatest", end["stamp_after_trigger_ms"])
        figure("trigger to delivery of the set, ms", end["delivery_after_trigger_ms"])
        refused = [{name: camera[name] for name in ("no_slot", "time_disagrees", "sequence_disagrees", "duplicate", "too_late",
                                                    "corrupt", "overrun") if camera[name]} for camera in end["cameras"]]
        figure("frames refused, by camera", refused)
        wrong = self.loop.of("wrong")
        check(end["wrong"] == 0, f"{end['wrong']} frames stand in the wrong set: {wrong[:5]}")
        check(end["trigger"] == "works", end["trigger"])
        return end


def run_for(seconds, cameras, rate):
    edges = "/host/edges.txt"
    with Booth(cameras, rate, f"--edges={edges}") as booth:
        time.sleep(seconds)
        end = booth.end()
    # How many an emulated, busy processor manages is a figure; that it goes on is not.
    check(end["slots_fired"] + end["slots_dropped"] >= seconds * rate * 0.8,
          f"{end['slots_fired']} slots fired and {end['slots_dropped']} dropped in {seconds} s")
    check(end["sets_complete"] >= end["slots_fired"] * 0.1 > 0, f"{end['sets_complete']} sets of {end['slots_fired']} are complete")
    check(end["real_time"], "the edge thread is not real-time")
    return edges


@test
def one_camera():
    edges = run_for(15, 1, 30)
    run(BIN / "facet", "trigger-diagram", edges, "-o", "/host/edges.png")


@test
def two_cameras():
    run_for(15, 2, 15)


@full
def sixty_slots_per_second_for_10_minutes():
    run_for(600, 1, 60)


@test
def faults_never_shift_a_set():
    """Every fault of a camera, while the other goes on."""
    with Booth(2, 15) as booth:
        faulty = booth.cameras[1]
        guest.wait_until(lambda: booth.status()["sets_complete"] > 10, 20, lambda: f"no sets: {booth.status()}")
        for fault in ("error", "short", "skip 1", "skip 3", "stall", "error"):
            faulty.tell(fault)
            time.sleep(1.5)
        faulty.tell("freeze")
        time.sleep(4)
        faulty.tell("resume")
        time.sleep(3)
        for _ in range(2):
            faulty.tell("unplug")
            time.sleep(2)
            faulty.tell("plug")
            time.sleep(4)
        before = booth.status()
        guest.wait_until(lambda: booth.status()["sets_complete"] > before["sets_complete"] + 15, 30,
                         lambda: f"the sets do not become complete again: {booth.status()}")
        end = booth.end()
    check(end["cameras"][1]["reopened"] >= 2, f"the faulty camera: {end['cameras'][1]}")
    check(end["cameras"][0]["reopened"] == 0, f"the other camera: {end['cameras'][0]}")


@test
def the_chip_is_removed():
    """The trigger fails with a reason; the cameras go on."""
    with Booth(1, 15) as booth:
        guest.wait_until(lambda: booth.status()["sets_complete"] > 10, 20, lambda: f"no sets: {booth.status()}")
        CHIP.remove()
        failed = guest.wait_until(lambda: booth.status()["trigger"] != "works" and booth.status(), 10, "the trigger goes on")
        figure("reason", failed["trigger"])
        check("cameras" in failed["trigger"] or "bit" in failed["trigger"], failed["trigger"])
        end = booth.loop.end()
        check(end["wrong"] == 0, f"{end['wrong']} frames stand in the wrong set")
    CHIP.make_live()


run("modprobe", "-a", "gpio-sim", "vhci_hcd", "uvcvideo")
CHIP = Chip("booth", 10)  # 8 lines of the pattern, the trigger, its read-back
guest.main()
