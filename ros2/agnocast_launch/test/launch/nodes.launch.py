# SPDX-License-Identifier: Apache-2.0
# One process of each action. The talker and the listener of agnocast are no ROS 2 nodes.
from agnocast_launch.actions import ComposableNodeContainer, ExecuteProcess, LifecycleNode, Node
from launch import LaunchDescription
from launch_ros.descriptions import ComposableNode


def generate_launch_description():
    return LaunchDescription([
        Node(package="demo_nodes_cpp", executable="listener", name="ear", output="screen",
             remappings=[("chatter", "words")]),
        LifecycleNode(package="lifecycle", executable="lifecycle_talker", name="lifecycle",
                      namespace="", output="screen"),
        ComposableNodeContainer(
            package="rclcpp_components", executable="component_container", name="container",
            namespace="", output="screen", composable_node_descriptions=[
                ComposableNode(package="demo_nodes_cpp", plugin="demo_nodes_cpp::Talker",
                               name="mouth", remappings=[("chatter", "words")])]),
        ExecuteProcess(cmd=["listener", "--verbose"], output="screen"),
        ExecuteProcess(cmd=["talker"], output="screen"),
    ])
