"""facetd as systemd runs it, with the shipped unit and a rig of real drivers: every violent end, and what is left of the recording and of
the lines. (tests/packaging/check-package shows the unit as the package brings it, without devices.)"""
import os
import signal
import subprocess
import time

import guest
from booth import CAMERAS, Rig, check_take, new_chip
from guest import BIN, HOST, Path, check, figure, full, run, test, wait_until

UNITS = Path("/etc/systemd/system")


def install():
    """What the package installs, from the build."""
    files = HOST / "systemd"
    run("cp", BIN / "facetd", "/usr/sbin/facetd")
    run("cp", BIN / "facet", "/usr/bin/facet")
    run("cp", *files.glob("facetd*"), UNITS)
    run("cp", files / "sysusers.conf", "/usr/lib/sysusers.d/facet.conf")
    run("cp", files / "tmpfiles.conf", "/usr/lib/tmpfiles.d/facet.conf")
    run("cp", files / "55-facet.rules", "/lib/udev/rules.d/55-facet.rules")
    run("systemd-sysusers", "facet.conf")
    run("systemd-tmpfiles", "--create", "facet.conf")
    run("udevadm", "control", "--reload")
    # Emulation is ten times slower; the watchdog's 60 s would be too long for the tests, though.
    folder = UNITS / "facetd.service.d"
    folder.mkdir()
    (folder / "test.conf").write_text("[Unit]\nStartLimitIntervalSec=0\n[Service]\nWatchdogSec=15\n")
    run("systemctl", "daemon-reload")


def unit(name):
    return run("systemctl", "show", "-P", name, "facetd").strip()


class Service(Rig):
    """A rig whose facetd is the service."""

    config = Path("/etc/facet/facet.toml")
    sockets = Path("/run/facet")
    takes = Path("/var/lib/facet/takes")
    facet_program = Path("/usr/bin/facet")

    def start(self):
        run("udevadm", "settle")
        run("systemctl", "start", "facetd")

    def pid(self):
        return int(unit("MainPID"))

    def check_alive(self):
        pass  # systemd starts it anew

    def said(self):
        return run("journalctl", "-u", "facetd", "-n", "15", "-o", "cat")

    def stop(self):
        run("systemctl", "stop", "facetd")
        check(unit("Result") == "success", f"it ended with {unit('Result')}: {self.said()}")

    def end(self):
        subprocess.run(["systemctl", "kill", "-s", "KILL", "facetd"], check=False, capture_output=True)
        subprocess.run(["systemctl", "stop", "facetd", "facetd-stream.socket", "facetd-control.socket"], check=False)


def levels():
    return [CHIP.level(line) for line in range(9)]


def born_anew(name, end, result):
    """Ends the service while it records. Another is there before long and fires, the take has all but a second, and the lines rest
    in between. `end(pid)` does it."""
    with Service(CHIP) as rig:
        rig.wait_sets(10)
        take = rig.record(name)
        rig.wait_sets(30)
        before, restarts = rig.pid(), int(unit("NRestarts"))
        ended_ns = guest.now_ns()
        end(before)
        wait_until(lambda: rig.pid() != before, 60, lambda: f"it goes on: {rig.said()}")
        at_rest = levels()
        figure("ended after, s", round((guest.now_ns() - ended_ns) / 1e9, 1))
        check(not any(at_rest), f"lines after its end: {at_rest}")
        rig.wait(lambda now: now["sets"]["complete"] > 0, "it is not born anew", timeout_s=90)
        figure("sets again after, s", round((guest.now_ns() - ended_ns) / 1e9, 1))
        check(rig.pid() not in (0, before), "no other process")
        check(int(unit("NRestarts")) > restarts, "it is not systemd that started it")
        check(result in rig.said() + run("journalctl", "-u", "facetd", "-o", "cat"), f"the journal does not say {result}")
        rig.stop()
        check(not any(levels()), f"lines after its end: {levels()}")
    check_take(take, ended_ns)


@test
def serves_as_its_user():
    """The group's devices suffice: cameras, lines, real-time thread, locked memory; and the journal has no complaint."""
    with Service(CHIP) as rig:
        now = rig.wait_sets(30)
        check(now["trigger"]["real_time"], now["trigger"]["scheduling"])
        take = rig.record("served")
        rig.wait_sets(30)
        rig.facet("record", "stop")
        owner = run("stat", "-c", "%U", f"/proc/{rig.pid()}").strip()
        check(owner == "facet", f"it runs as {owner}")
        chips = {run("stat", "-c", "%a %U %G", chip).strip() for chip in Path("/dev").glob("gpiochip*")}
        check(chips == {"660 root facet-gpio"}, f"GPIO chips: {chips}")
        check("permitted" not in run("journalctl", "-u", "facetd", "-o", "cat"), rig.said())
        rig.stop()
    check_take(take)


@test
def killed():
    born_anew("killed", lambda pid: os.kill(pid, signal.SIGKILL), "code=killed, status=9/KILL")


@full
def crashes():
    born_anew("crashed", lambda pid: os.kill(pid, signal.SIGSEGV), "status=11/SEGV")


@test
def runs_out_of_memory():
    """The kernel's own choice, when memory is short; here it is told so."""
    def end(pid):
        Path(f"/proc/{pid}/oom_score_adj").write_text("1000")
        Path("/proc/sysrq-trigger").write_text("f")
    born_anew("oom", end, "killed by the OOM killer")


@test
def hangs():
    """It stands still; systemd's watchdog notices."""
    with Service(CHIP) as rig:
        rig.wait_sets(10)
        take = rig.record("hung")
        rig.wait_sets(30)
        before = rig.pid()
        hung_ns = guest.now_ns()
        os.kill(before, signal.SIGSTOP)
        wait_until(lambda: rig.pid() != before, 60, lambda: f"it goes on: {rig.said()}")
        figure("ended after, s (WatchdogSec 15)", round((guest.now_ns() - hung_ns) / 1e9, 1))
        rig.wait(lambda now: now["sets"]["complete"] > 0, "it is not born anew", timeout_s=90)
        check("Watchdog timeout" in run("journalctl", "-u", "facetd", "-o", "cat"), rig.said())
        rig.stop()
    check_take(take, hung_ns)


@full
def a_camera_is_unplugged_under_the_unit():
    """What hot-plugging needs is inside the sandbox."""
    with Service(CHIP) as rig:
        rig.wait_sets(10)
        faulty = rig.cameras[1]
        faulty.tell("unplug")
        rig.wait(lambda now: now["cameras"][1]["state"] == "absent", "the unplugging is not noticed")
        start = guest.now_ns()
        faulty.tell("plug")
        rig.wait(lambda now: now["cameras"][1]["state"] == "streaming", "it does not come back")
        figure("streaming after, s", round((guest.now_ns() - start) / 1e9, 1))
        rig.wait_sets(15)
        rig.stop()


@full
def clients_wait_while_it_is_born_anew():
    """systemd keeps the sockets: who connects while there is no daemon is answered by the next."""
    with Service(CHIP) as rig:
        rig.wait_sets(10)
        os.kill(rig.pid(), signal.SIGKILL)
        time.sleep(0.1)
        start = guest.now_ns()
        rig.facet("status")
        figure("answered after, s", round((guest.now_ns() - start) / 1e9, 1))
        rig.wait(lambda now: now["sets"]["complete"] > 0, "no sets")
        rig.stop()


install()
CHIP = new_chip()
run("udevadm", "settle")
guest.main()
