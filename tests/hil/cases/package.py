"""The Debian packages in a guest with systemd: tests/packaging/check-package."""
import subprocess

import guest
from guest import HOST, check, figure, full


@full
def installs_serves_upgrades_and_goes():
    done = subprocess.run(["bash", HOST / "packages/check-package", "--yes", HOST / "packages"], stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, text=True, check=False)
    print(done.stdout)
    lines = done.stdout.splitlines()
    figure("it says", [line for line in lines if line.startswith(("exposure", "skipped"))] + lines[-1:])
    check(done.returncode == 0, "; ".join(line for line in lines if line.startswith("FAILED")))


guest.main()
