# SPDX-License-Identifier: Apache-2.0
"""For tests of the Python packages below ros2/: a daemon, and programs that run beside a test."""
import importlib.util
import os
import re
import shutil
import signal
import subprocess
import tempfile
import time
import unittest

# No test asserts a time; a wait that takes so long has failed.
PATIENCE_S = 120
HOOK = "libagnocast_heaphook.so"


def require(modules=(), programs=()):
    """Skips the test module if it cannot run here."""
    for module in modules:
        if importlib.util.find_spec(module) is None:
            raise unittest.SkipTest(f"there is no Python module {module}: source a ROS 2")
    for program in programs:
        if shutil.which(program) is None:
            raise unittest.SkipTest(f"there is no {program} in PATH")


def eventually(look, what):
    """Returns the first true answer of look(); AssertionError with `what` if none comes."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        answer = look()
        if answer:
            return answer
        time.sleep(0.05)
    raise AssertionError(f"{what}: not within {PATIENCE_S} s")


def path_without(program):
    """Returns PATH without the folders that contain the program."""
    return os.pathsep.join(folder for folder in os.environ["PATH"].split(os.pathsep)
                           if not os.path.exists(os.path.join(folder, program)))


def environment_of(pid):
    """Returns the environment with which the program of the process was started."""
    with open(f"/proc/{pid}/environ", "rb") as file:
        words = file.read().decode(errors="replace").split("\0")
    return dict(word.split("=", 1) for word in words if "=" in word)


def has_hook(pid):
    with open(f"/proc/{pid}/maps", encoding="utf-8") as file:
        return HOOK in file.read()


def wait_for_program(pid, name):
    """Waits until the process, which may begin as another program, runs this one."""
    eventually(lambda: os.path.basename(os.readlink(f"/proc/{pid}/exe")) == name,
               f"process {pid} runs {name}")


class Program:
    """A program in a session of its own, as in a terminal of its own; its output is in a file."""

    def __init__(self, *words, environment=None):
        self.output_ = tempfile.TemporaryFile()
        self.process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=self.output_,
                                        stderr=subprocess.STDOUT, env=environment,
                                        start_new_session=True)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        try:
            os.killpg(self.process.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        self.process.wait()
        self.output_.close()

    def output(self):
        """Returns the output so far."""
        size = os.fstat(self.output_.fileno()).st_size
        return os.pread(self.output_.fileno(), size, 0).decode(errors="replace")

    def wait_for(self, expression):
        """Returns the first match of the expression in the output."""
        def look():
            ended = self.process.poll() is not None
            found = re.search(expression, self.output(), re.M)
            if found is None and ended:
                raise AssertionError(f"the program ended without '{expression}'")
            return found
        try:
            return eventually(look, f"'{expression}' in the output")
        except AssertionError as problem:
            raise AssertionError(f"{problem}:\n{self.output()[-4000:]}") from None

    def interrupt(self):
        """Sends SIGINT as Ctrl-C does, and returns the exit status.

        Only to the program itself: without a terminal, `ros2 launch` passes the signal on, and a
        second one kills a node that is shutting down.
        """
        self.process.send_signal(signal.SIGINT)
        return self.status()

    def status(self):
        try:
            return self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"does not end:\n{self.output()[-4000:]}") from None


class Daemon:
    """An agnocastd with a private socket, and ROS 2 programs that see nothing but each other.

    Changes the environment of this process until stop().
    """

    def __init__(self):
        self.folder_ = tempfile.TemporaryDirectory()
        self.before_ = dict(os.environ)
        folder = self.folder_.name
        os.environ.update({
            "AGNOCAST_SOCKET": f"{folder}/agnocastd.sock",
            "AGNOCAST_DAEMON_UID": str(os.getuid()),
            "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
            "ROS_LOCALHOST_ONLY": "1",
            "ROS_LOG_DIR": f"{folder}/log",
        })
        for name in ("AGNOCAST", "AGNOCAST_SCOPE", "LD_PRELOAD", "NO_COLOR"):
            os.environ.pop(name, None)
        self.program_ = Program("agnocastd", "--foreground", "--socket",
                                os.environ["AGNOCAST_SOCKET"])

        def look():
            if self.program_.process.poll() is not None:
                raise AssertionError(f"agnocastd has ended:\n{self.program_.output()}")
            return os.path.exists(os.environ["AGNOCAST_SOCKET"])
        try:
            eventually(look, "the daemon's socket")
        except AssertionError:
            self.stop()
            raise

    def stop(self):
        self.program_.__exit__()
        os.environ.clear()
        os.environ.update(self.before_)
        self.folder_.cleanup()
