"""The Debian packages in a guest with systemd: tests/packaging/check-package."""
import os
import subprocess
import time
from pathlib import Path

import guest
from guest import HOST, check, figure, full


def target(link):
    """Where a link leads; None where it is gone by now."""
    try:
        return Path(os.readlink(link))
    except OSError:
        return None


@full
def installs_serves_upgrades_and_goes():
    # Into a file, not a pipe: what it leaves behind would keep a pipe open.
    log = Path("/tmp/check-package.log")
    shown = ""
    with open(log, "w") as out:
        checking = subprocess.Popen(["bash", HOST / "packages/check-package", "--yes", HOST / "packages"], stdout=out,
                                    stderr=subprocess.STDOUT)
        while True:
            ended = checking.poll() is not None
            text = log.read_text()
            print(text[len(shown):], end="", flush=True)  # a guest that is not done in time shows how far it came
            shown = text
            if ended:
                break
            time.sleep(1)
    lines = shown.splitlines()
    left = [link.parent.parent for link in Path("/proc").glob("[0-9]*/fd/*") if target(link) == log]
    check(not left, f"left behind: {[(folder / 'cmdline').read_bytes() for folder in left]}")
    figure("it says", [line for line in lines if line.startswith(("exposure", "skipped"))] + lines[-1:])
    check(checking.returncode == 0, "; ".join(line for line in lines if line.startswith("FAILED")))


guest.main()
