"""The Debian packages in a guest with systemd: tests/packaging/check-package."""
import subprocess

import guest
from guest import HOST, check, figure, full


@full
def installs_serves_upgrades_and_goes():
    # Line by line: a guest that is not done in time shows how far it came.
    with subprocess.Popen(["bash", HOST / "packages/check-package", "--yes", HOST / "packages"], stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, text=True) as checking:
        lines = []
        for line in checking.stdout:
            lines.append(line.rstrip("\n"))
            print(lines[-1], flush=True)
    figure("it says", [line for line in lines if line.startswith(("exposure", "skipped"))] + lines[-1:])
    check(checking.returncode == 0, "; ".join(line for line in lines if line.startswith("FAILED")))


guest.main()
