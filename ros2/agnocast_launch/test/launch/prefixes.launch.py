# SPDX-License-Identifier: Apache-2.0
# Nodes with prefixes of their own, by exec_name.
import os

from agnocast_launch.actions import Node
from launch import LaunchDescription


def talker(name, **arguments):
    return Node(package="demo_nodes_cpp", executable="talker", exec_name=name, name=name,
                output="screen", **arguments)


def generate_launch_description():
    processor = min(os.sched_getaffinity(0))
    return LaunchDescription([
        talker("pinned", prefix=f"taskset -c {processor}", log_cmd=True),
        talker("inside", prefix="env INSIDE=1 agnocast-run"),
        talker("argument", arguments=["agnocast-run"]),
        talker("preloads", additional_env={"LD_PRELOAD": "libm.so.6"}),
    ])
