"""facetd as it is shipped with a rig: mode "frames", GPIO lines that fire emulated USB cameras, takes of what they saw."""
import contextlib
import json
import os
import signal
import socket
import subprocess
import threading
import time

import guest
from booth import Rig, check_take, new_chip
from guest import BIN, Path, check, figure, full, run, test, wait_until


@test
def sets_are_recorded_in_their_slots():
    with Rig(CHIP) as rig:
        rig.wait_sets(10)
        take = rig.record("slots")
        rig.wait_sets(60)
        rig.facet("record", "stop")
        now = rig.rig()
        figure("sets", now["sets"])
        figure("trigger", {key: now["trigger"][key] for key in ("slots_fired", "slots_dropped", "edges_proven", "edges_missing", "real_time")})
        check(now["trigger"]["edges_proven"] > 0, now["trigger"])
        check(now["trigger"]["real_time"], now["trigger"]["scheduling"])
        rig.stop()
    told = check_take(take)
    check(told["closed"], "the take is not closed")
    run(BIN / "facet", "export", take, "--format", "jsonl", "-o", "/tmp/rig/slots.jsonl")


@test
def sets_say_which_lamps_lit_them():
    """Two lamps on lines of the trigger: what the cameras saw of them is what every set says, though one camera comes and goes."""
    lamps = ("top", "low")
    with Rig(CHIP, lamps) as rig:
        rig.wait_sets(10)
        take = rig.record("lamps")
        rig.wait_sets(30)
        rig.cameras[0].tell("skip 3")
        rig.cameras[1].tell("unplug")
        rig.wait(lambda now: now["cameras"][1]["state"] == "absent", "the unplugging is not noticed")
        rig.cameras[1].tell("plug")
        rig.wait_sets(30)
        rig.facet("record", "stop")
        rig.stop()
    told = check_take(take, lamps=lamps)
    figure("pictures that show their set's light", told["lit"])
    check(told["lit"] == told["right"] > 60, told)
    wrong = json.loads(subprocess.run([BIN / "check_take", take, "--lamps=low,top"], capture_output=True, text=True, check=False).stdout)
    check(len(wrong["otherwise_lit"]) > 20, "lamps with their names exchanged are not told")


@test
def a_camera_comes_and_goes():
    """One camera is unplugged, plugged, frozen; the other goes on, and no picture changes its set."""
    with Rig(CHIP) as rig:
        rig.wait_sets(10)
        take = rig.record("faults")
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
    check_take(take)


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
        take = rig.record("killed")
        rig.wait_sets(40)
        rig.process.kill()
        killed_ns = guest.now_ns()
        rig.process.wait()
        rig.start()
        rig.wait_sets(10)
        rig.stop()
    check_take(take, killed_ns)


@contextlib.contextmanager
def killed_at_the_end(process):
    try:
        yield
    finally:
        process.kill()


@test
def a_line_is_held_by_another_program():
    """The reason names chip, line and holder; the cameras wait, which is no fault of theirs; once the line is free, slots are fired."""
    with subprocess.Popen(["gpioset", "--mode=signal", CHIP.name, "3=0"]) as holder:
        time.sleep(1)
        logged = len(Rig.log.read_text()) if Rig.log.exists() else 0
        with killed_at_the_end(holder), Rig(CHIP) as rig:
            failed = rig.wait(lambda now: now["trigger"]["state"] == "failing", "the trigger goes on")
            figure("reason", failed["trigger"]["reason"])
            for words in ("bit3", CHIP.name, "gpioset"):
                check(words in failed["trigger"]["reason"], failed["trigger"])
            rig.wait(lambda now: all(camera["state"] == "waiting" for camera in now["cameras"]), "the cameras do not wait")
            time.sleep(8)  # longer than a camera's first frame may take
            waiting = [(camera["state"], camera["reason"]) for camera in rig.rig()["cameras"]]
            check(waiting == [("waiting", "the trigger does not fire")] * 2, waiting)
            check(all(camera["frames"]["reopened"] == 0 for camera in rig.rig()["cameras"]), rig.said())
            said = rig.log.read_text()[logged:]
            check("stalled" not in said, said)
            holder.kill()
            holder.wait()
            rig.wait_sets(10)
            rig.stop()


@test
def clock_jumps_and_a_freeze():
    """The clock of the day jumps, and all of facetd stands still for 5 s, as a suspended machine looks to it, while it records."""
    with Rig(CHIP) as rig:
        rig.wait_sets(10)
        take = rig.record("frozen")
        rig.wait_sets(10)
        day = time.clock_gettime(time.CLOCK_REALTIME)
        for jump_s in (3600, -7200):
            time.clock_settime(time.CLOCK_REALTIME, day + jump_s)
            rig.wait_sets(15)
        time.clock_settime(time.CLOCK_REALTIME, day)
        rig.process.send_signal(signal.SIGSTOP)
        time.sleep(5)
        rig.process.send_signal(signal.SIGCONT)
        now = rig.wait_sets(30)
        figure("slots dropped", now["trigger"]["slots_dropped"])
        check(now["trigger"]["slots_dropped"] >= 60, f"5 s are 75 slots: {now['trigger']}")
        rig.facet("record", "stop")
        rig.stop()
    check_take(take)


class Disk:
    """A small file system of its own for the takes."""

    def __init__(self, megabytes):
        self.image = Path("/tmp/disk")
        with open(self.image, "wb") as file:
            file.truncate(megabytes << 20)
        run("modprobe", "loop")
        run("mkfs.ext4", "-q", "-m", "0", self.image)
        self.device = run("losetup", "--find", "--show", self.image).strip()
        Rig.takes.mkdir(parents=True, exist_ok=True)
        run("mount", "-o", "errors=remount-ro", self.device, Rig.takes)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        run("umount", Rig.takes)
        run("losetup", "-d", self.device)
        self.image.unlink()


def recording_ends(rig, words):
    """The recording fails with a reason that has these words; sets go on."""
    status = rig.wait_status(lambda now: now["recording"]["state"] == "failed", "the recording goes on", timeout_s=90)
    figure("it says", status["recording"]["reason"])
    check(any(word in status["recording"]["reason"] for word in words), status["recording"])
    rig.wait_sets(15)


@test
def the_disk_fills_up():
    """Another program takes all that is free at once, too fast for the reserve. The take keeps all but a second, sets go on, and there
    is another take once there is room."""
    with Disk(64) as disk, Rig(CHIP) as rig:
        rig.wait_sets(10)
        take = rig.record("full")
        rig.wait_sets(30)
        filler = Rig.takes / "filler"
        block = bytes(1 << 20)
        with open(filler, "wb", buffering=0) as out:
            try:
                while True:
                    out.write(block)
            except OSError:
                full_ns = guest.now_ns()
        recording_ends(rig, ("space", "full", "free"))
        # Filling the disk keeps an emulated processor busy that facetd needs: 0.9 to 1.3 s were seen.
        check_take(take, full_ns, most_lost_s=2.0)
        filler.unlink()
        again = rig.record("again")
        rig.wait_sets(15)
        rig.facet("record", "stop")
        rig.stop()
        check(check_take(again)["closed"], "the second take is not closed")


@test
def the_disk_becomes_read_only():
    """As the kernel does with a file system in which it meets an error."""
    with Disk(64) as disk, Rig(CHIP) as rig:
        rig.wait_sets(10)
        take = rig.record("readonly")
        rig.wait_sets(30)
        lost_ns = guest.now_ns()
        Path(f"/sys/fs/ext4/{Path(disk.device).name}/trigger_fs_error").write_text("a test")
        recording_ends(rig, ("read-only", "readonly", "Read-only", "Input/output error", "disk I/O error"))
        refused = subprocess.run([BIN / "facet", "record", "start", "next", f"--config={rig.config}"], capture_output=True, text=True,
                                 check=False)
        check(refused.returncode != 0, "a second take was begun")
        figure("a second one", refused.stderr.strip())
        rig.stop()
        copy = Path("/tmp/copy")
        copy.mkdir(exist_ok=True)
        run("cp", "-r", *take.parent.glob("readonly.*"), copy)
        check_take(copy / take.name, lost_ns)


@test
def the_control_socket_is_abused():
    """Too many connections, lines without an end, nonsense, and someone who sends a byte now and then: refused or bounded. facetd
    answers others, sets go on."""
    def connect():
        connection = socket.socket(socket.AF_UNIX)
        connection.settimeout(10)
        connection.connect(str(Rig.sockets / "control.sock"))
        return connection

    def swallowed(connection, data):
        """Sends until the other side has enough; what it answered at last."""
        try:
            connection.sendall(data)
            connection.shutdown(socket.SHUT_WR)
        except OSError:
            pass
        answer = b""
        try:
            while part := connection.recv(65536):
                answer += part
        except OSError:
            pass
        return answer.decode(errors="replace")

    with Rig(CHIP) as rig:
        take = rig.record("abuse") if rig.wait_sets(10) else None
        before = rig.rig()
        idle = []
        for _ in range(100):
            try:
                idle.append(connect())
            except OSError:
                break
        # They are all taken at once by the kernel; facetd looks at them one by one.
        end = time.monotonic() + 20
        while (refused := sum(1 for connection in idle if connection_is_over(connection))) < 30 and time.monotonic() < end:
            time.sleep(0.2)
        figure("connections: open, refused", [len(idle) - refused, refused])
        check(refused >= 30, f"{len(idle) - refused} connections stay open")
        for connection in idle[:50]:
            connection.close()
        rig.wait_status(lambda now: True, "facetd does not answer others")
        slow = [connect() for _ in range(5)]
        stop = threading.Event()

        def drip():
            while not stop.wait(0.2):
                for connection in slow:
                    try:
                        connection.send(b"{")
                    except OSError:
                        pass
        dripping = threading.Thread(target=drip)
        dripping.start()
        huge = connect()
        answer = swallowed(huge, b"x" * (8 << 20))
        check("a request line has" in answer, f"8 MB in one line: {answer[:300]}")
        huge.close()
        nonsense = connect()
        answer = swallowed(nonsense, b'{"jsonrpc":"2.0","method":"record.start","params":[1],"id":1}\n\xff\xfe\n[]\n{"method":7}\nnull\n')
        figure("answers to nonsense", answer.count('"error"'))
        check(answer.count('"error"') == 5, answer)
        nonsense.close()
        stranger = subprocess.run(["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups", BIN / "facet", "record", "stop",
                                   f"--config={rig.config}"], capture_output=True, text=True, check=False)
        check(stranger.returncode == 7, f"a stranger: {stranger}")
        figure("a stranger is told", stranger.stderr.strip())
        after = rig.wait_sets(30)
        stop.set()
        dripping.join()
        for connection in slow + idle[50:]:
            connection.close()
        check(rig.status()["recording"]["state"] == "recording", rig.status()["recording"])
        for name in ("slots_dropped", "slots_fired"):
            figure(name.replace("_", " "), after["trigger"][name] - before["trigger"][name])
        rig.facet("record", "stop")
        rig.stop()
    check_take(take)


def connection_is_over(connection):
    """Whether the other side has closed it."""
    connection.setblocking(False)
    try:
        while part := connection.recv(65536):
            pass
        return part == b""
    except BlockingIOError:
        return False
    except OSError:
        return True


@full
def each_camera_is_unplugged_20_times():
    """One after the other: each comes back, the other one does not notice, no descriptor and no memory is lost."""
    with Rig(CHIP) as rig:
        rig.wait_sets(10)

        def held():
            folder = Path(f"/proc/{rig.process.pid}")
            return len(list((folder / "fd").iterdir())), int((folder / "statm").read_text().split()[1]) * 4

        for which, faulty in enumerate(rig.cameras):
            settled, others = None, rig.rig()["cameras"][1 - which]["frames"]["reopened"]
            for _ in range(20):
                faulty.tell("unplug")
                rig.wait(lambda now: now["cameras"][which]["state"] == "absent", "the unplugging is not noticed")
                faulty.tell("plug")
                now = rig.wait(lambda now: now["cameras"][which]["state"] == "streaming", "it does not come back")
                settled = settled or held()
            end = held()
            figure(f"camera {which}: descriptors, kB after the first and the last time", [*settled, *end])
            check(end[0] == settled[0] and end[1] <= settled[1] + 2048, f"descriptors, kB: {settled}, then {end}")
            check(now["cameras"][which]["frames"]["reopened"] >= 20, now["cameras"][which])
            check(now["cameras"][1 - which]["frames"]["reopened"] == others, f"the other camera: {now['cameras'][1 - which]}")
        rig.wait_sets(10)
        rig.stop()


@full
def four_minutes():
    with Rig(CHIP) as rig:
        rig.wait_sets(10)
        take = rig.record("long")
        time.sleep(240)
        rig.facet("record", "stop")
        rig.stop()
    check_take(take)


CHIP = new_chip()
guest.main()
