# SPDX-License-Identifier: Apache-2.0
# agnocast is switched off for one node, then for all that follow.
from agnocast_launch.actions import Node
from launch import LaunchDescription
from launch.actions import SetEnvironmentVariable


def talker(name, **arguments):
    return Node(package="demo_nodes_cpp", executable="talker", exec_name=name, name=name,
                output="screen", **arguments)


def generate_launch_description():
    return LaunchDescription([
        talker("one", additional_env={"AGNOCAST": "off"}),
        talker("other"),
        SetEnvironmentVariable("AGNOCAST", "off"),
        talker("later"),
    ])
