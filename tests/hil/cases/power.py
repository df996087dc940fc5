"""The machine loses its power while facetd records."""
import os
import threading
import time

import guest
from booth import Rig, check_take, new_chip
from guest import HOST, check, figure, run, test

DISK = "/dev/vdb"  # outlives the guest, with what the guest has written to it
PROGRESS = HOST / "progress"


def mount():
    Rig.takes.mkdir(parents=True, exist_ok=True)
    run("mount", DISK, Rig.takes)


def note_the_time():
    """For the next guest: when the power went, within 20 ms."""
    while True:
        PROGRESS.with_suffix(".new").write_text(str(guest.now_ns()))
        os.replace(PROGRESS.with_suffix(".new"), PROGRESS)
        time.sleep(0.02)


@test
def a_recording():
    """Some seconds into it the power goes; the result is that of what follows."""
    run("mkfs.ext4", "-q", "-F", DISK)
    mount()
    with Rig(new_chip()) as rig:
        rig.wait_sets(10)
        rig.record("cut")
        rig.wait_sets(75)
        threading.Thread(target=note_the_time, daemon=True).start()
        time.sleep(0.5)
        guest.cut_power("survives_that_the_power_was_cut")


@guest.after_cut
def survives_that_the_power_was_cut():
    mount()
    figure("files", sorted(path.name for path in Rig.takes.iterdir()))
    told = check_take(Rig.takes / "cut.take", int(PROGRESS.read_text()))
    check(not told["closed"], "the take is closed: nothing was cut")
    run("umount", Rig.takes)
    run("fsck.ext4", "-n", "-f", DISK)


guest.main()
