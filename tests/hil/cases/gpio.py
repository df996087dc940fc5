"""The trigger on GPIO lines of the kernel, simulated by gpio-sim."""
import subprocess

import guest
from guest import check, run, test


@test
def gpio_tests():
    """The cases of tests/trigger/gpio_sim_test.cpp, which are skipped where there is no gpio-sim."""
    run("modprobe", "gpio-sim")
    guest.gtest("test_trigger", "GpioSim.*")
    return "reported"


guest.main()
