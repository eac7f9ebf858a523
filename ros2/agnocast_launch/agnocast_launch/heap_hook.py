# SPDX-License-Identifier: Apache-2.0
"""How a command starts with the heap hook. Needs no ROS.

`agnocast-run` knows where the hook is and preloads it; this module decides whether a command needs
it. It goes in front of the whole command, a prefix included: a debugger wants to start a program,
not the script `agnocast-run`, and a program inherits the hook from `taskset`, `nice` or a debugger.
The loader ignores LD_PRELOAD in set-user-ID programs such as `sudo`, so a prefix that contains
`agnocast-run` itself is left as it is.
"""
import os
import shutil

AGNOCAST_RUN = "agnocast-run"


class AgnocastRunNotFound(RuntimeError):
    """There is no `agnocast-run` in the PATH of a process that shall start with it."""


def words_in_front(process, prefix, environment):
    """Returns the words in front of a command with which it starts with the heap hook.

    process:     what an error calls the process
    prefix:      the words that the user put in front of the command already
    environment: of the process; AGNOCAST=off in it switches agnocast off
    """
    if environment.get("AGNOCAST") == "off":
        return []
    if any(os.path.basename(word) == AGNOCAST_RUN for word in prefix):
        return []
    # Without a PATH in the environment, that of this process counts.
    found = shutil.which(AGNOCAST_RUN, path=environment.get("PATH"))
    if found is None:
        path = environment.get("PATH", os.environ.get("PATH", ""))
        raise AgnocastRunNotFound(
            f"{process}: there is no {AGNOCAST_RUN} in its PATH ({path})\n"
            "hint: source the setup.bash of the workspace that contains agnocast, or install the "
            "package libagnocast-heaphook; AGNOCAST=off starts the process without it")
    return [os.path.abspath(found)]
