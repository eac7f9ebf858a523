# SPDX-License-Identifier: Apache-2.0
"""Actions of launch and launch_ros whose processes start with the heap hook.

They take the arguments of the actions of the same names, and differ in nothing else: a launch file
changes one import. heap_hook.py says when and where the hook is added.
"""
import launch.actions
import launch_ros.actions

from agnocast_launch.heap_hook import words_in_front


class HeapHook:
    """Put in front of an action that runs a process, starts the process with the heap hook.

        class MyNode(HeapHook, their_package.TheirNode): pass
    """

    def prepare(self, context):
        super().prepare(context)
        if getattr(self, "shell", False):
            # A shell would take the words in front for a part of its first command.
            raise ValueError(
                f"{self.process_description.final_name}: shell=True does not go with the heap "
                "hook\n"
                "hint: use launch's own action, with agnocast-run in front of the program in cmd")
        # Here substitutions are performed and the environment is known. The name of the process,
        # in front of each line of its output, stays that of the program.
        description = self.process_description
        command = description.final_cmd
        prefix = command[:len(command) - len(description.cmd)]
        command[:0] = words_in_front(description.final_name, prefix, description.final_env)


class ExecuteProcess(HeapHook, launch.actions.ExecuteProcess):
    """launch.actions.ExecuteProcess with the heap hook, for programs that are no ROS 2 nodes."""


class Node(HeapHook, launch_ros.actions.Node):
    """launch_ros.actions.Node with the heap hook."""


class LifecycleNode(HeapHook, launch_ros.actions.LifecycleNode):
    """launch_ros.actions.LifecycleNode with the heap hook."""


class ComposableNodeContainer(HeapHook, launch_ros.actions.ComposableNodeContainer):
    """launch_ros.actions.ComposableNodeContainer with the heap hook.

    The components that are loaded into it publish with the hook of the container.
    """
