# SPDX-License-Identifier: Apache-2.0
"""agnocast-ctl as another program runs it. Needs no ROS.

The process becomes agnocast-ctl, so output, terminal, signals and exit status are its own.
"""
import argparse
import os
import shutil
import signal
import subprocess
import sys

AGNOCAST_CTL = "agnocast-ctl"


class AgnocastCtlNotFound(RuntimeError):
    """There is no `agnocast-ctl` in PATH."""


def find():
    """Returns the path of agnocast-ctl."""
    found = shutil.which(AGNOCAST_CTL)
    if found is None:
        raise AgnocastCtlNotFound(
            f"ros2 agnocast: there is no {AGNOCAST_CTL} in PATH\n"
            "hint: source the setup.bash of the workspace that contains agnocast, or install the "
            f"package {AGNOCAST_CTL}")
    return found


def add_words(parser):
    """Makes the parser pass on every word as it is, options and `--help` included, as `words`."""
    # A parser without prefix characters takes no word for an option.
    parser.prefix_chars = ""
    words = parser.add_argument("words", nargs=argparse.REMAINDER)
    words.completer = completions


def become(words):
    """Replaces this process by agnocast-ctl with these words; without words, with --help."""
    program = find()
    sys.stdout.flush()
    sys.stderr.flush()
    # Python ignores these signals, and a program inherits that.
    for name in ("SIGPIPE", "SIGXFSZ"):
        signal.signal(getattr(signal, name), signal.SIG_DFL)
    os.execv(program, [AGNOCAST_CTL, *(words or ["--help"])])


def completions(prefix, parsed_args, **_):
    """Returns the words that may stand at the cursor: a completer for argcomplete."""
    try:
        done = subprocess.run([find(), "--complete", *(parsed_args.words or []), prefix],
                              stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    except (AgnocastCtlNotFound, OSError):
        return []
    return done.stdout.splitlines()
