"""The trigger on GPIO lines of the kernel, simulated by gpio-sim: who else holds them, and what becomes of them."""
import signal
import subprocess
import time

import guest
from guest import Chip, Lines, check, figure, run, test

RATE = 20


def loop(chip):
    """The trigger with nobody to see it: its camera never comes."""
    return Lines("closed_loop", f"--chip={chip.name}", "--camera=/dev/no-such-camera", f"--rate={RATE}", "--no-wait")


def status(program):
    since = len(program.lines)
    program.tell("status")
    return program.wait_for("status", since=since)


@test
def gpio_tests():
    """The cases of tests/trigger/gpio_sim_test.cpp, which are skipped where there is no gpio-sim."""
    guest.gtest("test_trigger", "GpioSim.*")
    return "reported"


@test
def lamp_tests():
    """The lamps of a kiosk on lines of gpio-sim: tests/pipeline/lamp_burst_test.cpp."""
    guest.gtest("test_pipeline", "LampsOnGpioSim.*")
    return "reported"


@test
def line_held_by_another_program():
    """The error names chip, line and holder; once the line is free all is well."""
    with Chip("held", 10) as chip:
        with subprocess.Popen(["gpioset", "--mode=signal", chip.name, "3=1"]) as other:
            guest.wait_until(lambda: chip.level(3) == 1, 5, "gpioset has not set the line")
            with loop(chip) as refused:
                error = refused.wait_for("refused")["error"]
            other.terminate()
        figure("it says", error)
        for words in ("'bit3'", chip.name, "line 3", "is held by 'gpioset'"):
            check(words in error, f"no {words} in: {error}")
        with loop(chip) as program:
            guest.wait_until(lambda: status(program)["slots_fired"] > 5, 20, "no slot is fired")
            program.end()


@test
def unknown_chip():
    with Lines("closed_loop", "--chip=no-such-chip", "--camera=/dev/no-such-camera", "--no-wait") as program:
        error = program.wait_for("refused")["error"]
    check("no-such-chip" in error, error)
    figure("it says", error)


@test
def lines_after_the_end():
    """Stopped, all lines rest; killed, the kernel takes them back and the next start brings them to rest."""
    with Chip("ends", 10) as chip:
        with loop(chip) as program:
            guest.wait_until(lambda: status(program)["slots_fired"] > 5, 20, "no slot is fired")
            program.end()
        check([chip.level(line) for line in range(9)] == [0] * 9, "a line does not rest after the end")
        for blow in (signal.SIGKILL, signal.SIGSEGV):
            with loop(chip) as program:
                guest.wait_until(lambda: status(program)["slots_fired"] > 5, 20, "no slot is fired")
                program.process.send_signal(blow)
                program.process.wait()
            figure(f"levels after {blow.name}", [chip.level(line) for line in range(9)])
        with loop(chip) as program:
            guest.wait_until(lambda: status(program)["slots_fired"] > 5, 20, "no slot is fired")
            program.end()
        check([chip.level(line) for line in range(9)] == [0] * 9, "a line does not rest after the end")


@test
def frozen_for_three_seconds():
    """Slots that could not be fired are left out, numbers and counts agree."""
    with Chip("freeze", 10) as chip, loop(chip) as program:
        guest.wait_until(lambda: status(program)["slots_fired"] > 5, 20, "no slot is fired")
        before = status(program)
        program.process.send_signal(signal.SIGSTOP)
        time.sleep(3)
        program.process.send_signal(signal.SIGCONT)
        guest.wait_until(lambda: status(program)["slots_fired"] > before["slots_fired"] + 20, 20, "it does not go on")
        end = program.end()
    dropped = end["slots_dropped"] - before["slots_dropped"]
    figure("slots dropped", dropped)
    check(3 * RATE * 0.8 < dropped < 3 * RATE * 2, f"{dropped} slots dropped in 3 s at {RATE} per second")


@test
def clock_of_the_day_jumps():
    """Nothing in the trigger's times depends on it."""
    with Chip("jump", 10) as chip, loop(chip) as program:
        guest.wait_until(lambda: status(program)["slots_fired"] > 5, 20, "no slot is fired")
        before = status(program)
        day = time.clock_gettime(time.CLOCK_REALTIME)
        for jump_s in (3600, -7200):
            time.clock_settime(time.CLOCK_REALTIME, time.clock_gettime(time.CLOCK_REALTIME) + jump_s)
            time.sleep(1)
        time.clock_settime(time.CLOCK_REALTIME, day)
        end = program.end()
    fired = end["slots_fired"] - before["slots_fired"]
    check(fired > 1.5 * RATE, f"{fired} slots fired in 2 s")
    check(end["slots_dropped"] - before["slots_dropped"] < RATE, f"{end['slots_dropped']} slots dropped")


run("modprobe", "gpio-sim")
guest.main()
